"""The volume part of a tile: depth, files, sizes, and what the report says of them."""

from __future__ import annotations

import functools
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from volatool._version import __version__
from volatool.beside import Beside, IsStopped
from volatool.cube import Cube
from volatool.encodings import (
    DENSE_LIMIT_BYTES,
    Encoding,
    added_rows,
    encoding_row,
    encodings_of,
    output_stream,
    write_volume,
    written_bytes,
)
from volatool.errors import CodedWarning, OptionError
from volatool.model import CrsInfo, LevelCounts
from volatool.occupancy import depth as rules
from volatool.occupancy.levels import LevelRow, add_counts, level_rows
from volatool.options import ConvertOptions
from volatool.outputs import OutputSet
from volatool.reference import reference
from volatool.scratch import Scratch
from volatool.units import format_size

if TYPE_CHECKING:
    from volatool.points.source import Source
    from volatool.snapped import CubeIndex
    from volatool.vola.builder import VolaBuilder
    from volatool.vola.built import Built
    from volatool.vola.volume import Volume, VolumeInfo

_Files = dict[Encoding, tuple[Path, str]]
"""Temporary path and name of each file."""

_PIECES_BYTES = 8 << 20
"""What writing holds beside the volume: pieces, and the compressor's window."""

_DENSE_BYTES_PER_VOXEL = 64
"""What putting the voxels of a level in dense order takes."""

_SHARE_OF_BUDGET = 0.25
"""As much of the memory budget may be in use for a volume to be written beside other work."""


@dataclass(frozen=True, slots=True)
class VolumePart:
    """
    What the volumes of a tile add to the report.

    Parameters
    ----------
    cube, choice : dict
        Objects of the report.
    levels : tuple of dict
        List of the report.
    encodings : callable
        Waits until the files are written and returns the list of the report, a tuple of dict.
    volume : Volume
        The volume; with ``--split`` the one with the most points.
    warnings : tuple of CodedWarning
        What came up.
    """

    cube: dict[str, Any]
    choice: dict[str, Any]
    levels: tuple[dict[str, Any], ...]
    encodings: Callable[[], tuple[dict[str, Any], ...]]
    volume: Volume
    warnings: tuple[CodedWarning, ...]


def check_files(options: ConvertOptions) -> None:
    """Raise now if ``--depth-from`` or ``--cube-from`` names nothing of use."""
    if options.cube_from is not None:
        reference(options.cube_from)
    if options.depth_from is not None:
        rules.dataset_depth(_dataset(options.depth_from), Cube((0.0, 0.0, 0.0), 1.0))


def depth_in_advance(options: ConvertOptions, crs: CrsInfo, cube: Cube) -> int | None:
    """
    Return the depth if it does not depend on the points, else None.

    Parameters
    ----------
    options : ConvertOptions
        ``depth``, ``resolution`` and ``depth_from``.
    crs : CrsInfo
        For the unit of the resolution.
    cube : Cube
        The extent.
    """
    if options.depth is not None:
        return options.depth
    if options.resolution is not None:
        cell = options.resolution.in_units(crs.metres_per_unit_xy)
        return rules.depth_for_resolution(cube, float(cell), options.max_depth)
    if options.depth_from is not None:
        return rules.dataset_depth(_dataset(options.depth_from), cube).depth
    if options.takes_depth_from_volume:
        return reference(options.cube_from or "").depth
    return None


def own_depth(options: ConvertOptions, source: Source) -> int | None:
    """Return the depth of an imported grid, None without one or if another rule is asked for."""
    if source.own_grid is None or options.depth_options:
        return None
    return source.own_grid[1]


@functools.lru_cache(maxsize=1)
def _dataset(name: str) -> Mapping[str, Any]:
    """Return the JSON object of ``--depth-from``."""
    try:
        document = json.loads(Path(name).read_text(encoding="utf-8"))
    except OSError as error:
        raise OptionError(f"--depth-from {name}: can't be read ({error.strerror})") from error
    except ValueError as error:
        raise OptionError(f"--depth-from {name}: is not JSON ({error})") from error
    if not isinstance(document, Mapping):
        raise OptionError(
            f"--depth-from {name}: is not one JSON object; give what stats --summary wrote"
        )
    return document


def make_volumes(
    builders: Mapping[CubeIndex, VolaBuilder],
    source: Source,
    options: ConvertOptions,
    outputs: OutputSet,
    base: Path | None,
    corners: Sequence[float],
    scratch: Scratch | None = None,
    beside: Beside | None = None,
) -> VolumePart:
    """
    Build the volumes, choose one depth for them and write them.

    Parameters
    ----------
    builders : mapping of cube index to VolaBuilder
        One, or one per snapped cube.
    source : Source
        For CRS, name and sizes.
    options : ConvertOptions
        What is asked for.
    outputs : OutputSet
        Takes the files.
    base : pathlib.Path or None
        Path of the outputs without suffix; None to write nothing.
    corners : sequence of 6 float
        Box of the points: smallest x, y, z, then largest, in units of the CRS.
    scratch : Scratch, optional
        Memory budget.
    beside : Beside, optional
        Writes a single volume while the caller goes on, if the budget has room for that.
    """
    built = {index: builders[index].build() for index in sorted(builders)}
    counts = add_counts(one.counts for one in built.values())
    n_points = sum(one.n_points for one in built.values())
    largest = max(built, key=lambda index: built[index].n_points)
    info = _info(source)
    if options.split is None:  # the size of a file under --budget depends on all its bytes
        info = _placed(info, source, built[largest], corners)
    given = own_depth(options, source)
    if given is not None:
        choice = rules.own_depth(given, built[largest].cube, counts)
    else:
        choice = _choose(options, source.crs, built[largest], counts, n_points, info)
    last = max(choice.depth, rules.stop_level(counts, n_points, options.max_depth))
    if options.all_levels:
        last = len(counts)
    rows: tuple[LevelRow, ...] = level_rows(
        counts[:last], built[largest].cube.exact[3], n_points, tiles=len(built)
    )
    warnings = list(choice.warnings)

    def volume_of(index: CubeIndex) -> tuple[Volume, _Files]:
        one = built[index]
        volume = one.volume(choice.depth, _placed(info, source, one, corners))
        builders[index].close()
        if base is None:
            return volume, {}
        return volume, _files(volume, options, outputs, _named(base, index, options), warnings)

    if len(built) == 1 and scratch is not None and beside is not None:
        shown, files = volume_of(largest)
        encodings = _started(shown, files, source, scratch, beside)
    else:
        rows_of_all: list[dict[str, Any]] = []
        for index in built:
            volume, files = volume_of(index)
            rows_of_all = added_rows(rows_of_all, _write(volume, files, source), *_sizes(source))
            if index == largest:
                shown = volume
        encodings = partial(tuple, rows_of_all)
    return VolumePart(
        cube=cube_document(built[largest].cube, source.crs, options, len(built)),
        choice=choice.to_dict(),
        levels=tuple(row.to_dict() for row in rows),
        encodings=encodings,
        volume=shown,
        warnings=tuple(warnings),
    )


def _started(
    volume: Volume, files: _Files, source: Source, scratch: Scratch, beside: Beside
) -> Callable[[], tuple[dict[str, Any], ...]]:
    """Write a volume beside the main thread, or at once where memory for both is short."""
    n_bytes = _PIECES_BYTES + _DENSE_BYTES_PER_VOXEL * len(volume)
    if not scratch.take(n_bytes, _SHARE_OF_BUDGET):
        return partial(tuple, _write(volume, files, source))
    result = beside.start(lambda is_stopped: _write(volume, files, source, is_stopped))
    given = False

    def wait() -> tuple[dict[str, Any], ...]:
        nonlocal given
        rows = tuple(result())
        if not given:
            scratch.give(n_bytes)
            given = True
        return rows

    return wait


def _sizes(source: Source) -> tuple[int, int]:
    return source.header.las_equivalent_bytes, source.header.size_bytes


def place_of(crs: CrsInfo, corners: Sequence[float]) -> tuple[float | None, float | None]:
    """
    Return latitude and longitude of the middle of a box, None where they can't be had.

    Parameters
    ----------
    crs : CrsInfo
        Of the box.
    corners : sequence of 6 float
        Smallest x, y, z, then largest.
    """
    from volatool.points.crs_places import latlon

    x, y = ((corners[axis] + corners[3 + axis]) / 2 for axis in (0, 1))
    return latlon(crs, x, y) or (None, None)


def _placed(info: VolumeInfo, source: Source, built: Built, corners: Sequence[float]) -> VolumeInfo:
    """Return the description with the place of a volume's own points."""
    lat, lon = place_of(source.crs, built.box or corners)
    return replace(info, lat=lat, lon=lon)


def _info(source: Source) -> VolumeInfo:
    from volatool.vola.info import VolumeInfo

    return VolumeInfo(
        crs=source.crs,
        source_name=source.name,
        source_bytes=source.header.size_bytes,
        epsg=source.crs.epsg,
        generator=f"volatool {__version__}",
    )


def _choose(
    options: ConvertOptions,
    crs: CrsInfo,
    built: Built,
    counts: list[LevelCounts],
    n_points: int,
    info: VolumeInfo,
) -> rules.Choice:
    cube = built.cube
    if options.depth is not None:
        return rules.fixed_depth(options.depth, cube, counts)
    if options.resolution is not None:
        cell = float(options.resolution.in_units(crs.metres_per_unit_xy))
        return rules.resolution_depth(cube, cell, options.max_depth, counts)
    if options.depth_from is not None:
        return rules.dataset_depth(_dataset(options.depth_from), cube, counts)
    if options.takes_depth_from_volume:
        found = reference(options.cube_from or "")
        return rules.volume_depth(found.depth, found.name, cube, counts)
    if options.budget is not None:
        deepest = built.volume(built.deepest, info)
        bits = 2 if deepest.has_metadata else 1
        encoding = Encoding("sparse", bits, "gzip" if options.gzip else "none")
        return rules.budget_depth(
            lambda depth: written_bytes(deepest.truncated(depth), encoding),
            options.budget,
            cube,
            deepest.depth,
            counts,
        )
    return rules.choose_depth(
        counts,
        n_points,
        cube=cube,
        threshold=options.min_occupancy,
        max_depth=options.max_depth,
    )


def _named(base: Path, index: CubeIndex, options: ConvertOptions) -> Path:
    if options.split is None:
        return base
    x, y, z = index
    return base.with_name(f"{base.name}_x{x}_y{y}_z{z}")


def _files(
    volume: Volume,
    options: ConvertOptions,
    outputs: OutputSet,
    base: Path,
    warnings: list[CodedWarning],
) -> _Files:
    """Return what is to be written, the dense file if it is wanted: temporary paths and names."""
    bits = 2 if volume.has_metadata else 1
    codec = "gzip" if options.gzip else "none"
    wanted = [Encoding("sparse", bits, codec)]
    dense = Encoding("dense", bits, codec)
    if options.dense == "always":
        wanted.append(dense)
    elif options.dense == "auto" and options.split is None:
        size = dense.payload_bytes(volume)
        if size <= DENSE_LIMIT_BYTES:
            wanted.append(dense)
        else:
            warnings.append(
                CodedWarning(
                    "W_DENSE_SKIPPED",
                    f"a dense volume of depth {volume.depth} takes {format_size(size)}; not "
                    "written (--dense always writes it)",
                )
            )
    names = {encoding: base.name + encoding.suffix for encoding in wanted}
    return {encoding: (outputs.add(base.with_name(name)), name) for encoding, name in names.items()}


def _write(
    volume: Volume, files: _Files, source: Source, is_stopped: IsStopped | None = None
) -> list[dict[str, Any]]:
    """Write a volume's files; return the report's list of encodings."""
    for encoding, (target, _) in files.items():
        with output_stream(target) as stream:
            write_volume(stream, volume, encoding, is_stopped)
    rows = []
    for encoding in encodings_of(volume):
        path, name = files.get(encoding, (None, None))
        rows.append(encoding_row(volume, encoding, path, name, *_sizes(source), is_stopped))
    return rows


def cube_document(
    cube: Cube, crs: CrsInfo, options: ConvertOptions, n_cubes: int
) -> dict[str, Any]:
    """Return the report's ``cube``."""
    document: dict[str, Any] = {
        "origin": list(cube.origin) if options.split is None else None,
        "side": cube.side,
        "unit": crs.unit_xy,
        "snapped": cube.is_snapped,
        "z_scale": float(crs.z_ratio),
    }
    if options.split is not None:
        document["cubes"] = n_cubes
    return document
