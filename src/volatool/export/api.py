"""Export a volume: select, name, write."""

from __future__ import annotations

import os
from dataclasses import fields
from pathlib import Path
from typing import Any

from volatool.errors import InputError, OptionError, ResourceError, VolatoolError
from volatool.export.model import Exported, Exporter, ExportOptions, Target, is_same
from volatool.export.registry import exporter_for, exporter_of, run
from volatool.export.select import select
from volatool.formats.registry import open_volume
from volatool.naming import stem
from volatool.outputs import OutputSet, refuse_existing
from volatool.remote.path import path_of
from volatool.vola.volume import Volume

__all__ = ["export_volume", "output_path"]


def export_volume(
    volume: Volume | str | os.PathLike[str],
    output: str | os.PathLike[str] | None = None,
    to: str | None = None,
    *,
    overwrite: bool = False,
    **options: Any,
) -> Exported:
    """
    Write a volume in another format.

    Parameters
    ----------
    volume : Volume or path
        What is exported.
    output : path, optional
        The file, or a folder: one that is there, or text that ends with a slash; beside the input
        by default. Of formats with several files the name that they begin with.
    to : str, optional
        Name of a format (`volatool.export.registry.FORMATS`); told by the output's name if not
        given.
    overwrite : bool
        Replace outputs that exist; never the input.
    **options
        Of `volatool.export.model.ExportOptions`.

    Returns
    -------
    exported : Exported
        ``exported.paths`` are the files written, ``exported.warnings`` what could not be kept.

    Raises
    ------
    OptionError
        An option that can't be used; ``E_NO_EXTRA``; an output that exists.
    InputError
        ``E_EMPTY``: no voxel is selected. And whatever reading the file raises.
    ResourceError
        ``E_SIZE``: the output would be too large.
    OutputError
        It can't be written. Nothing is left behind then.
    """
    unknown = set(options) - {field.name for field in fields(ExportOptions)}
    if unknown:
        raise OptionError(f"unknown option: {', '.join(sorted(unknown))}")
    checked = ExportOptions(**options)
    source = None if isinstance(volume, Volume) else path_of(volume)
    exporter = exporter_of(to) if to is not None else _told_by(output)
    checked.check(exporter)
    path = output_path(source, output, exporter)
    if source is not None and is_same(path, source):
        raise OptionError(f"{path}: is the input; give the output another name with --output")
    if exporter.has_main:  # before any work
        refuse_existing([path], overwrite)
    whole = volume if isinstance(volume, Volume) else open_volume(volume)
    if path.exists() and path.name == whole.info.source_name:
        raise OptionError(
            f"{path}: is called as what the volume was made from; give another name with --output"
        )
    chosen = select(whole, checked)
    if not len(chosen):
        raise InputError(f"{source or 'the volume'}: {_nothing_of(whole)}", "E_EMPTY")
    with OutputSet(overwrite) as outputs:
        target = Target(outputs, path, exporter.suffix, source)
        try:
            warnings = run(exporter, chosen, target, checked)
        except VolatoolError as error:
            _name(error, source, checked)
            raise
        except MemoryError as error:
            if hasattr(error, "code"):
                raise
            raise ResourceError(
                f"{path}: there is not enough memory to write it; give --bounds or --level"
            ) from error
        paths = outputs.commit()
    warnings = [*whole.info.warnings, *warnings]
    return Exported(tuple(paths), exporter.name, len(chosen), tuple(warnings))


def _nothing_of(volume: Volume) -> str:
    """Return why there is nothing to export."""
    if not len(volume):
        return "has no voxels, there is nothing to export"
    box = volume.info.box
    if box is None:
        ends = [(low, low + volume.cube.side) for low in volume.cube.origin]
        ratio = float(volume.crs.z_ratio)
        ends[2] = (ends[2][0] / ratio, ends[2][1] / ratio)
    else:
        ends = list(zip(box[:3], box[3:], strict=True))
    places = (f"{axis} {a:.10g} to {b:.10g}" for axis, (a, b) in zip("xyz", ends, strict=True))
    return f"no voxel is selected; it has {len(volume):,} in {', '.join(places)}"


def _name(error: VolatoolError, source: Path | None, options: ExportOptions) -> None:
    """Put the volume's name in front of what an exporter says of it."""
    is_of_volume = error.code not in ("E_OPTION", "E_NO_EXTRA", "E_OUTPUT_EXISTS", "E_WRITE")
    named = (str(name) for name in (source, options.ground) if name is not None)
    if source is not None and is_of_volume and not any(name in str(error) for name in named):
        error.args = (f"{source}: {error}",)


def _told_by(output: str | os.PathLike[str] | None) -> Exporter:
    if output is None:
        raise OptionError("give --to FORMAT, or an --output whose name ends in one")
    return exporter_for(Path(output))


def output_path(
    source: Path | None, output: str | os.PathLike[str] | None, exporter: Exporter
) -> Path:
    """
    Return the name of an export.

    Parameters
    ----------
    source : pathlib.Path or None
        The input.
    output : path or None
        A name; or a folder: one that is there, or text that ends with a slash.
    exporter : Exporter
        For the suffix.

    Raises
    ------
    OptionError
        Neither says a name.

    Examples
    --------
    >>> from volatool.export.registry import FORMATS
    >>> output_path(Path("a/tile.vol.gz"), None, FORMATS["laz"]).as_posix()
    'a/tile.voxels.laz'
    """
    text = None if output is None else os.fspath(output)
    if text is not None and not text.endswith(("/", os.sep)) and not Path(text).is_dir():
        if not Path(text).name:
            raise OptionError("--output is an empty name; is a shell variable unset?")
        return Path(text)
    if source is None:
        raise OptionError("a volume without a file needs the name of an output file")
    folder = source.parent if text is None else Path(text)
    return folder / (stem(source) + exporter.suffix)
