"""The calls that most Python users need: convert or classify a tile, and its statistics alone."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import fields
from typing import Any

from volatool.errors import OptionError
from volatool.model import Progress, no_progress
from volatool.options import ConvertOptions
from volatool.remote.path import path_of
from volatool.report import Report
from volatool.tile import convert_tile


def convert(
    path: str | os.PathLike[str],
    outdir: str | os.PathLike[str] | None = None,
    *,
    overwrite: bool = False,
    progress: Progress = no_progress,
    **options: Any,
) -> Report:
    """
    Convert a tile to a volume, an elevation model and a report.

    Parameters
    ----------
    path : path
        LAS, LAZ or COPC.
    outdir : path, optional
        Folder for the outputs, made if need be; beside the input by default.
    overwrite : bool
        Replace outputs that exist.
    progress : callable
        Called with (points done, points of the file).
    **options
        Of `volatool.options.ConvertOptions`.

    Returns
    -------
    report : Report
        ``report.paths`` are the files written.

    Raises
    ------
    VolatoolError
        Nothing is left behind then.
    """
    folder = None if outdir is None else path_of(outdir)
    checked = _options(options)
    return convert_tile(
        path_of(path), checked, outdir=folder, overwrite=overwrite, progress=progress
    )


def import_points(
    path: str | os.PathLike[str],
    outdir: str | os.PathLike[str] | None = None,
    *,
    overwrite: bool = False,
    progress: Progress = no_progress,
    dem: bool = False,
    **options: Any,
) -> Report:
    """
    Make a volume and a report of points, a mesh, a grid or a raster of another format.

    Parameters
    ----------
    path : path
        A format of `volatool.imports.registry`: xyz, csv, ply, pcd, npy, npz, KITTI, STL, OBJ,
        binvox, OctoMap, ESRI ASCII grid, GeoTIFF.
    outdir : path, optional
        Folder for the outputs, made if need be; beside the input by default.
    overwrite : bool
        Replace outputs that exist.
    progress : callable
        Called with (points done, points of the file).
    dem : bool
        Make the elevation model too.
    **options
        Of `volatool.options.ConvertOptions`; ``from_format``, ``columns``, ``mesh``, ``spacing``
        and ``swap_yz`` are for imports.

    Returns
    -------
    report : Report
        ``report.paths`` are the files written.

    Raises
    ------
    VolatoolError
        Nothing is left behind then.
    """
    folder = None if outdir is None else path_of(outdir)
    checked = _options({**options, "dem": dem})
    return convert_tile(
        path_of(path), checked, kind="import", outdir=folder, overwrite=overwrite, progress=progress
    )


def classify(
    path: str | os.PathLike[str],
    outdir: str | os.PathLike[str] | None = None,
    *,
    overwrite: bool = False,
    progress: Progress = no_progress,
    **options: Any,
) -> Report:
    """
    Write a tile's points as LAZ with class 2 set by the ground filter, all else unchanged.

    Parameters
    ----------
    path : path
        LAS, LAZ or COPC.
    outdir : path, optional
        Folder for the output, made if need be; beside the input by default.
    overwrite : bool
        Replace an output that exists; never an input.
    progress : callable
        Called with (points read, points to read).
    **options
        Of `volatool.options.ConvertOptions`: selection (what it leaves out is written as it is),
        CRS, reading and memory.

    Returns
    -------
    report : Report
        ``report.classification`` says what changed.

    Raises
    ------
    VolatoolError
        Nothing is left behind then.
    """
    from volatool.classification import classify_tile

    folder = None if outdir is None else path_of(outdir)
    checked = _options(options)
    return classify_tile(
        path_of(path), checked, outdir=folder, overwrite=overwrite, progress=progress
    )


def stats(
    paths: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    *,
    progress: Progress = no_progress,
    **options: Any,
) -> Statistics:
    """
    Return the reports of point or VOLA files; nothing is written.

    Parameters
    ----------
    paths : path or sequence of paths
        LAS, LAZ, COPC or VOLA files.
    progress : callable
        Called with (points done, points of the file) of each.
    **options
        Of `volatool.options.ConvertOptions`.

    Raises
    ------
    VolatoolError
        From the first file that can't be used.
    """
    if isinstance(paths, str | os.PathLike):
        paths = [paths]
    checked = _options(options)
    return Statistics(
        [convert_tile(path_of(path), checked, kind="stats", progress=progress) for path in paths]
    )


class Statistics(list[Report]):
    """Reports of several inputs, in order."""

    def summary(self) -> Report:
        """Return their sum."""
        from volatool.summary import summarize

        return summarize(self)

    def to_frame(self) -> Any:
        """
        Return a pandas table, one row per input and level.

        Raises
        ------
        OptionError
            pandas is not installed.
        """
        try:
            import pandas
        except ImportError as error:
            raise OptionError("to_frame needs pandas: pip install pandas") from error
        from volatool.tables import level_records

        return pandas.DataFrame.from_records(level_records(self))


def _options(options: dict[str, Any]) -> ConvertOptions:
    """Return checked options; an unknown name is an error that says so."""
    unknown = set(options) - {field.name for field in fields(ConvertOptions)}
    if unknown:
        raise OptionError(f"unknown option: {', '.join(sorted(unknown))}")
    return ConvertOptions(**options)
