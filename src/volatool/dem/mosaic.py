"""A seamless mosaic: what its tiles have in common before, one raster over all of them after."""

from __future__ import annotations

import filecmp
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from volatool._version import __version__
from volatool.catalog.headers import index_headers, set_lines
from volatool.dem.gdal import opened, read_window
from volatool.dem.parameters import check_unit, measure_parameters, read_parameters
from volatool.dem.raster import read_profile
from volatool.dem.statistics import RasterStatistics
from volatool.dem.vrt import mosaic
from volatool.encodings import output_stream
from volatool.errors import FormatError, InputError, OutputError
from volatool.naming import LAYERS, SET_SUFFIX
from volatool.options import ConvertOptions
from volatool.outputs import OutputSet
from volatool.report import dumps

SCHEMA = "volatool.mosaic/1"

WINDOW = 2048
"""Edge of the squares in which a mosaic is read: few blocks of files are decoded twice."""


def prepare(
    paths: Sequence[Path],
    options: ConvertOptions,
    folder: Path,
    name: str,
    params_from: Path | None = None,
) -> Path:
    """
    Index the headers of a set of tiles and find what their models have in common.

    Parameters
    ----------
    paths : sequence of pathlib.Path
        The tiles.
    options : ConvertOptions
        Of the models.
    folder, name : pathlib.Path, str
        ``NAME.set.json`` is written there; one that is there and the same stays as it is.
    params_from : pathlib.Path, optional
        Reports that give cell and spacing; by default they are measured on some tiles.

    Returns
    -------
    path : pathlib.Path
        The file: for ``neighbours`` and for ``params_from`` of every tile.

    Raises
    ------
    InputError
        No tile can be used; one of those that are measured can't be read.
    """
    index = index_headers(paths, options)
    if not len(index):
        for error in index.failed.values():
            raise error
        raise InputError("none of the tiles has a point: there is no model to make")
    if params_from is not None:
        parameters = read_parameters(params_from)
        check_unit(parameters, index.crs_at(0))
    else:
        parameters = measure_parameters(index, options)
    path = set_path(folder, name)
    with OutputSet(overwrite=True) as outputs:
        temporary = outputs.add(path)
        with output_stream(temporary) as stream:
            stream.writelines(set_lines(index, float(parameters.cell), parameters.spacing))
        if not (path.is_file() and filecmp.cmp(temporary, path, shallow=False)):
            outputs.commit()
    return path


def set_path(folder: Path, name: str) -> Path:
    """Return the path of a mosaic's index of headers."""
    return folder / (name + SET_SUFFIX)


def planned(folder: Path, name: str, options: ConvertOptions, *, cog: bool) -> list[Path]:
    """Return the files that `finish` writes, in its order."""
    suffixes = []
    for layer in ("", *(f".{one}" for one in LAYERS if one in options.layers)):
        suffixes.append(f".dem{layer}.vrt")
        if cog:
            suffixes.append(f".dem{layer}.tif")
    return [folder / (name + suffix) for suffix in (*suffixes, ".mosaic.json")]


def finish(
    models: Sequence[Path],
    folder: Path,
    name: str,
    options: ConvertOptions,
    *,
    cog: bool,
    overwrite: bool,
) -> tuple[dict[str, Any], list[Path]]:
    """
    Write the mosaic of elevation models, and of each layer beside them.

    Parameters
    ----------
    models : sequence of pathlib.Path
        ``*.dem.tif`` in `folder`, at least one, in the order in which they lie on each other.
    folder, name : pathlib.Path, str
        ``NAME.dem.vrt`` and ``NAME.mosaic.json`` are written there.
    options : ConvertOptions
        ``layers``.
    cog : bool
        Write each mosaic as one Cloud-Optimised GeoTIFF, too.
    overwrite : bool
        Replace what exists.

    Returns
    -------
    document : dict
        What ``NAME.mosaic.json`` says: size, range, and how many cells are measured, filled and
        void; measured and filled are null without the layer ``flag``.
    paths : list of pathlib.Path
        Files written.

    Raises
    ------
    FormatError
        ``E_GRID``: the models don't mesh.
    OutputError
        A file can't be written or does not read back.
    """
    with OutputSet(overwrite) as outputs:
        document: dict[str, Any] = {"schema": SCHEMA, "tiles": len(models)}
        for layer in ("", *(f".{one}" for one in LAYERS if one in options.layers)):
            paths = [
                path.with_name(path.name.removesuffix(".dem.tif") + f".dem{layer}.tif")
                for path in models
            ]
            vrt = outputs.add(folder / f"{name}.dem{layer}.vrt")
            _write(vrt, mosaic(paths))
            if cog:
                target = outputs.add(folder / f"{name}.dem{layer}.tif")
                statistics = _write_cog(vrt, paths, target)
            elif not layer:
                statistics = statistics_of(vrt)
            if not layer:
                document |= _facts(vrt, statistics)
            elif layer == ".flag":
                flags = _flags(vrt)
                document |= {"cells_measured": flags[1], "cells_filled": flags[2]}
        summary = outputs.add(folder / f"{name}.mosaic.json")
        _write(summary, (dumps(document, 2) + "\n").encode())
        return document, outputs.commit()


def _write(path: Path, content: bytes) -> None:
    with output_stream(path) as stream:
        stream.write(content)


def _write_cog(vrt: Path, paths: Sequence[Path], target: Path) -> RasterStatistics:
    """Copy a mosaic into one file, and read that back."""
    from volatool.dem.geotiff import copy_as_cog

    statistics = statistics_of(vrt)
    first = read_profile(paths[0])
    kept = {
        key: value
        for key, value in first["tags"].items()
        if key in ("surface", "ground_source", "AREA_OR_POINT")
    }
    tags = {**kept, "TIFFTAG_SOFTWARE": f"volatool {__version__}", "TILES": str(len(paths))}
    # the statistics of the whole go along with the copy
    told = vrt.with_suffix(".tmp.vrt")
    try:
        _write(told, mosaic(paths, tags, statistics.tags()))
        copy_as_cog(told, target, is_float=first["dtype"].startswith("float"))
    finally:
        told.unlink(missing_ok=True)
    try:
        profile = read_profile(target)
        is_whole = statistics_of(target).tags() == statistics.tags()
    except FormatError as error:
        raise OutputError(f"{target}: does not read back ({error})") from error
    if profile["layout"] != "COG" or not is_whole:
        raise OutputError(f"{target}: does not read back as it was written")
    return statistics


def windows(path: Path) -> Iterator[tuple[NDArray[Any], float | None]]:
    """Yield squares of a raster with its nodata value, west to east, then south."""
    with opened(path) as file:
        for row in range(0, file.height, WINDOW):
            for col in range(0, file.width, WINDOW):
                width, height = min(WINDOW, file.width - col), min(WINDOW, file.height - row)
                yield read_window(file, col, row, width, height), file.nodata


def statistics_of(path: Path) -> RasterStatistics:
    """Return the statistics of a raster of any width."""
    statistics = RasterStatistics()
    for values, nodata in windows(path):
        statistics.add(values, nodata)
    return statistics


def _flags(path: Path) -> list[int]:
    counts = np.zeros(256, np.int64)
    for values, _ in windows(path):
        counts += np.bincount(values.ravel(), minlength=256)
    return [int(n) for n in counts[:3]]


def _facts(vrt: Path, statistics: RasterStatistics) -> dict[str, Any]:
    profile = read_profile(vrt)
    n_known = sum(statistics.counts)
    return {
        "cell": profile["cell"],
        "width": profile["width"],
        "height": profile["height"],
        "bounds": profile["bounds"],
        "cells_measured": None,
        "cells_filled": None,
        "cells_void": profile["width"] * profile["height"] - n_known,
        "z_min": statistics.low if n_known else None,
        "z_max": statistics.high if n_known else None,
    }
