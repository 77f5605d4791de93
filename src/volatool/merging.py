"""Files of volumes to one: union, intersection, differences, on one grid."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce
from pathlib import Path

from volatool.encodings import Encoding, output_stream, write_volume
from volatool.errors import CodedWarning, OptionError, OutputExistsError, VolatoolError
from volatool.formats.registry import open_volume
from volatool.naming import VOLUME_SUFFIXES
from volatool.outputs import OutputSet, refuse_existing
from volatool.reference import reference
from volatool.vola.algebra import OPERATIONS, combine, unite
from volatool.vola.tiles import common_grid
from volatool.vola.volume import Volume
from volatool.volumes import place_of


@dataclass(frozen=True, slots=True)
class Merged:
    """
    What became of a merge.

    Parameters
    ----------
    path : pathlib.Path
        The file written.
    volume : Volume
        What is in it.
    warnings : tuple of CodedWarning
        What came up.
    """

    path: Path
    volume: Volume
    warnings: tuple[CodedWarning, ...]


def merge_files(
    paths: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    output: str | os.PathLike[str],
    *,
    op: str = "or",
    resample: bool = False,
    cube_from: str | None = None,
    depth: int | None = None,
    overwrite: bool = False,
) -> Merged:
    """
    Merge volume files into one.

    Parameters
    ----------
    paths : path or sequence of path
        VOLA files, at least one.
    output : path
        ``.vol``, ``.vol.gz``, ``.dvol`` or ``.dvol.gz``, which says what is written.
    op : str
        Of `volatool.vola.algebra.OPERATIONS`: ``"or"`` of all; ``"and"``, ``"xor"`` one after the
        other; ``"sub"`` the first without all others.
    resample : bool
        Resample what is not on the grid; see `volatool.vola.tiles.common_grid`.
    cube_from : str, optional
        A VOLA file whose cube and depth the result gets.
    depth : int, optional
        Drop the levels of the result below this one.
    overwrite : bool
        Replace `output` if it exists; never an input.

    Returns
    -------
    merged : Merged

    Raises
    ------
    OptionError
        An output that exists or has another suffix, before anything is read.
    InputError
        ``E_GRID``, ``E_CRS`` and what reading files may raise, with their names.
    """
    if op not in OPERATIONS:
        raise OptionError(f"no operation {op!r}; there are {', '.join(OPERATIONS)}")
    if isinstance(paths, str | os.PathLike):
        paths = [paths]
    inputs, target = [Path(path) for path in paths], Path(output)
    if not inputs:
        raise OptionError("no volume is named, there is nothing to merge")
    if op != "or" and len(inputs) < 2:
        raise OptionError(f"--op {op} is of two volumes or more, {len(inputs)} was named")
    kind = encoding_for(target)
    refuse_input(target, [*inputs, *([Path(cube_from)] if cube_from is not None else [])])
    refuse_existing([target], overwrite)
    grid = None if cube_from is None else reference(cube_from)
    volumes = [open_volume(path) for path in inputs]
    if grid is not None:
        for path, volume in zip(inputs, volumes, strict=True):
            grid.check_crs(volume.crs, path.name)
    try:
        common = common_grid(
            volumes,
            cube=None if grid is None else grid.cube,
            depth=None if grid is None else grid.depth,
            resample=resample,
        )
    except VolatoolError as error:
        names = f"{inputs[0]} and others" if len(inputs) > 2 else " and ".join(map(str, inputs))
        raise type(error)(f"{names}: {error}", error.code) from error
    placed = common.volumes
    result = unite(placed) if op == "or" else reduce(lambda a, b: combine(a, b, op), placed)
    if depth is not None:
        result = result.truncated(depth)
    result = _placed(result)
    warnings = [
        *(w for volume in volumes for w in volume.info.warnings),
        *common.warnings,
        *_lost_metadata(volumes if op in ("or", "xor") else volumes[:1], result),
    ]
    with OutputSet(overwrite) as outputs:
        with output_stream(outputs.add(target)) as stream:
            write_volume(stream, result, replace(kind, bits_per_voxel=1 + result.has_metadata))
        outputs.commit()
    return Merged(target, result, tuple(warnings))


def encoding_for(path: Path) -> Encoding:
    """
    Return how a volume is written under a name.

    Parameters
    ----------
    path : pathlib.Path
        The file.

    Raises
    ------
    OptionError
        Its name ends in none of `volatool.naming.VOLUME_SUFFIXES`.
    """
    name = path.name.lower()
    if not name.endswith(VOLUME_SUFFIXES):
        raise OptionError(f"{path}: the name must end in {', '.join(VOLUME_SUFFIXES)}")
    codec = "gzip" if name.endswith(".gz") else "none"
    kind = "dense" if name.removesuffix(".gz").endswith(".dvol") else "sparse"
    return Encoding(kind, 1, codec)


def refuse_input(output: Path, inputs: Sequence[Path]) -> None:
    """Raise if an output is one of the inputs, whatever it is called."""
    for path in inputs:
        if path.resolve() == output.resolve() or (
            output.exists() and path.exists() and output.samefile(path)
        ):
            raise OutputExistsError(f"{output}: is an input, which is never replaced")


def _placed(volume: Volume) -> Volume:
    """Return a volume with latitude and longitude of its own middle."""
    x, y, z = volume.cube.origin
    side = volume.cube.side
    corners = volume.info.box or (x, y, z, x + side, y + side, z + side)
    lat, lon = place_of(volume.crs, corners)
    if lat is None:
        lat, lon = volume.info.lat, volume.info.lon
    return replace(volume, info=replace(volume.info, lat=lat, lon=lon))


def _lost_metadata(volumes: Sequence[Volume], result: Volume) -> list[CodedWarning]:
    """Say so when metadata, or channels of it, are not in the result."""
    names = {str(c["name"]) for volume in volumes for c in volume.info.channels}
    lost = sorted(names - {str(c["name"]) for c in result.info.channels})
    if result.has_metadata and not lost:
        return []
    if not any(volume.has_metadata for volume in volumes):
        return []
    what = f"the channels {', '.join(lost)}" if result.has_metadata else "metadata"
    return [CodedWarning("W_METADATA_LOST", f"not all volumes have {what}: left out")]
