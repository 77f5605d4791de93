"""Rasters read: heights, places, values at points, and what a file says of itself.

Opening is `volatool.dem.gdal`'s; a model that was written is checked by `volatool.dem.recheck`.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from volatool.dem.gdal import (
    BLOCK,
    opened,
    quiet_about_place,
    read_rows,
    read_window,
    wkt_of,
)
from volatool.dem.grid import MAX_CELLS, Grid
from volatool.errors import FormatError, ResourceError
from volatool.model import F64


@dataclass(frozen=True, slots=True)
class DemFile:
    """
    What a DEM file holds.

    Parameters
    ----------
    z : (h, w) array of float32
        Heights, NaN where the file has nodata.
    grid : Grid
        Where the cells are.
    wkt : str or None
        Coordinate reference system.
    unit, description : str or None
        Of the band.
    tags, statistics : dict
        Dataset tags; ``STATISTICS_...`` of the band.
    """

    z: NDArray[np.float32]
    grid: Grid
    wkt: str | None
    unit: str | None
    description: str | None
    tags: dict[str, str] = field(default_factory=dict)
    statistics: dict[str, float] = field(default_factory=dict)


def read_dem(path: Path) -> DemFile:
    """
    Read a DEM.

    Parameters
    ----------
    path : pathlib.Path
        A GeoTIFF of one band with square cells, north up.

    Raises
    ------
    InputNotFoundError, FormatError
        Not there; not such a file.
    """
    with opened(path) as file:
        t = file.transform
        _refuse_unless_square(path, file)
        z = file.read(1).astype(np.float32)
        if file.nodata is not None:
            z[z == np.float32(file.nodata)] = np.nan
        return DemFile(
            z,
            Grid(t.c, t.f, t.a, file.width, file.height),
            wkt_of(file),
            file.units[0],
            file.descriptions[0],
            file.tags(),
            _statistics(file.tags(1)),
        )


def _refuse_unless_square(path: Path, file: Any) -> None:
    t = file.transform
    if file.count != 1 or t.b or t.d or not math.isclose(t.a, -t.e):
        raise FormatError(f"{path}: not a raster of one band with square cells, north up")


def read_grid(path: Path) -> tuple[Grid, str | None]:
    """
    Return the cells of a raster without reading them, and its CRS.

    Parameters
    ----------
    path : pathlib.Path
        A GeoTIFF with square cells, north up.

    Returns
    -------
    grid, wkt : Grid, str or None

    Raises
    ------
    InputNotFoundError, FormatError, ResourceError
        Not there; not such a file; more than `MAX_CELLS` cells.
    """
    with opened(path) as file:
        t = file.transform
        if t.b or t.d or not t.a > 0 or not math.isclose(t.a, -t.e) or t.is_identity:
            raise FormatError(f"{path}: not a raster with a place, square cells and north up")
        _refuse_if_large(path, file)
        return Grid(t.c, t.f, t.a, file.width, file.height), wkt_of(file)


def _refuse_if_large(path: Path, file: Any) -> None:
    if file.width * file.height > MAX_CELLS:
        raise ResourceError(
            f"{path}: has {file.width} x {file.height} cells, more than any model of volatool "
            "may have",
            "E_SIZE",
        )


@dataclass(frozen=True, slots=True)
class Place:
    """
    Where a raster's cells are, which need not be square.

    Parameters
    ----------
    left, top : float
        Its upper left corner.
    step_x, step_y : float
        Edges of a cell, above zero.
    wkt : str or None
        Coordinate reference system.
    """

    left: float
    top: float
    step_x: float
    step_y: float
    wkt: str | None


def read_place(path: Path) -> Place:
    """
    Return where the cells of an elevation model are.

    Parameters
    ----------
    path : pathlib.Path
        A GeoTIFF of one band, north up.

    Raises
    ------
    InputNotFoundError, FormatError, ResourceError
        Not there; not such a file; more than `MAX_CELLS` cells.
    """
    with _elevations(path) as file:
        t = file.transform
        return Place(t.c, t.f, t.a, -t.e, wkt_of(file))


def height_rows(path: Path) -> Iterator[tuple[int, F64]]:
    """
    Yield an elevation model some rows at a time, from the north.

    Parameters
    ----------
    path : pathlib.Path
        As for `read_place`.

    Yields
    ------
    first, heights : int, (h, w) array of float64
        Number of the first row; NaN where there is no value.
    """
    with _elevations(path) as file:
        for start, cells in read_rows(file, BLOCK * BLOCK * 4):
            with np.errstate(invalid="ignore"):  # signalling NaNs
                heights = cells.astype(np.float64)
                nodata = file.nodata
                if nodata is not None:  # which an integer type need not be able to hold
                    is_float = cells.dtype.kind == "f"
                    heights[heights == (cells.dtype.type(nodata) if is_float else nodata)] = np.nan
            scale, offset = file.scales[0], file.offsets[0]
            yield start, heights if (scale, offset) == (1.0, 0.0) else heights * scale + offset


@contextlib.contextmanager
def _elevations(path: Path) -> Iterator[Any]:
    with quiet_about_place(), opened(path, "GTiff") as file:
        t = file.transform
        if file.count != 1 or t.b or t.d or not (t.a > 0 > t.e) or "complex" in file.dtypes[0]:
            raise FormatError(f"{path}: not a raster of one band, north up")
        _refuse_if_large(path, file)
        yield file


def read_heights_at(path: Path, x: F64, y: F64) -> tuple[F64, NDArray[np.bool_]]:
    """
    Return a raster's values at places, bilinear between the cells' centres.

    Parameters
    ----------
    path : pathlib.Path
        A GeoTIFF of one band with square cells, north up.
    x, y : (n,) arrays of float64
        Places, in the raster's CRS.

    Returns
    -------
    values : (n,) array of float64
        NaN off the raster and where one of the four cells has no value. Within half a cell of
        the rim the outermost centres' value holds.
    inside : (n,) array of bool
        On the raster.

    Raises
    ------
    InputNotFoundError, FormatError
        Not there; not such a file.
    """
    values = np.full(len(x), np.nan)
    with _one_band(path) as (file, read):
        col, row = _places(file, x, y)
        inside = (col >= 0) & (col <= file.width) & (row >= 0) & (row <= file.height)
        for k in np.flatnonzero(inside):
            u = min(max(col[k] - 0.5, 0.0), file.width - 1.0)
            v = min(max(row[k] - 0.5, 0.0), file.height - 1.0)
            q, r = int(u), int(v)
            part_x, part_y = u - q, v - r
            # a cell without weight need not have a value, nor be there
            n, m = 1 + (part_x > 0), 1 + (part_y > 0)
            cells = read(q, r, n, m)
            across = np.array([1 - part_x, part_x][:n])
            down = np.array([1 - part_y, part_y][:m])
            values[k] = down @ cells @ across
    return values, inside


def read_values_at(path: Path, x: F64, y: F64) -> F64:
    """
    Return the values of the cells that hold places; NaN off the raster and for nodata.

    Parameters
    ----------
    path, x, y
        As for `read_heights_at`.
    """
    values = np.full(len(x), np.nan)
    with _one_band(path) as (file, read):
        col, row = _places(file, x, y)
        inside = (col >= 0) & (col <= file.width) & (row >= 0) & (row <= file.height)
        for k in np.flatnonzero(inside):
            q, r = min(int(col[k]), file.width - 1), min(int(row[k]), file.height - 1)
            values[k] = read(q, r, 1, 1)[0, 0]
    return values


@contextlib.contextmanager
def _one_band(path: Path) -> Iterator[tuple[Any, Callable[[int, int, int, int], F64]]]:
    """Open a raster of one band, north up; gives it and a function that reads a window."""
    with opened(path) as file:
        _refuse_unless_square(path, file)

        def read(col: int, row: int, width: int, height: int) -> F64:
            cells = read_window(file, col, row, width, height)
            values = np.asarray(cells, np.float64)
            if file.nodata is not None:
                values[cells == cells.dtype.type(file.nodata)] = np.nan
            return values

        yield file, read


def _places(file: Any, x: F64, y: F64) -> tuple[F64, F64]:
    t = file.transform
    return (x - t.c) / t.a, (y - t.f) / t.e


def read_profile(path: Path) -> dict[str, Any]:
    """
    Return what the file says without reading its cells, for ``volatool info``.

    Parameters
    ----------
    path : pathlib.Path
        A raster that GDAL opens.

    Returns
    -------
    facts : dict
        ``width``, ``height``, ``cell``, ``bounds`` (left, bottom, right, top), ``dtype``,
        ``block`` (rows, columns of a tile of the file), ``nodata``, ``unit``, ``description``,
        ``crs_name``, ``crs_wkt2``, ``overviews``, ``layout``, ``statistics``, ``tags``.

    Raises
    ------
    InputNotFoundError, FormatError
        Not there; not a raster.
    """
    with opened(path) as file:
        wkt = wkt_of(file)
        return {
            "width": file.width,
            "height": file.height,
            "cell": file.transform.a,
            "bounds": list(file.bounds),
            "dtype": file.dtypes[0],
            "block": list(file.block_shapes[0]),
            "nodata": file.nodata,
            "unit": file.units[0],
            "description": file.descriptions[0],
            "crs_name": wkt.split('"')[1] if wkt else None,
            "crs_wkt2": wkt,
            "overviews": file.overviews(1),
            "layout": file.tags(ns="IMAGE_STRUCTURE").get("LAYOUT"),
            "statistics": _statistics(file.tags(1)),
            "tags": file.tags(),
        }


def _statistics(tags: Mapping[str, str]) -> dict[str, float]:
    """Return the numbers of a band's statistics tags; tags that aren't numbers are left out."""
    found = {}
    for name, value in tags.items():
        if name.startswith("STATISTICS_"):
            with contextlib.suppress(ValueError):
                found[name] = float(value)
    return found
