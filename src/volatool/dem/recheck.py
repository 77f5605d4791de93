"""A written raster read again: is the file sound, and the facts that ``validate`` compares."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from volatool.dem.gdal import BLOCK, opened, read_rows
from volatool.dem.grid import MAX_CELLS
from volatool.dem.statistics import RasterStatistics
from volatool.errors import FormatError, InputNotFoundError

Problem = tuple[str, str, int | None]
"""Code, message, and byte offset if known, as in ``volatool validate``."""


def check_dem(path: Path) -> list[Problem]:
    """
    Return what is wrong with a DEM file; nothing if it is sound.

    Parameters
    ----------
    path : pathlib.Path
        The file.

    Returns
    -------
    problems : list of (code, message, offset)
        ``E_CORRUPT``: unreadable. ``E_NOT_COG``: no tiles or overviews missing. ``E_STATISTICS``:
        the tags don't agree with the cells.
    """
    problems: list[Problem] = []
    try:
        with opened(path) as file:
            if file.count != 1:
                problems.append(("E_CORRUPT", f"{file.count} bands instead of one", None))
            if file.tags(ns="IMAGE_STRUCTURE").get("LAYOUT") != "COG":
                problems.append(("E_NOT_COG", "the layout is not that of a COG", None))
            if max(file.shape) > BLOCK and not file.overviews(1):
                problems.append(("E_NOT_COG", "overviews are missing", None))
            tags = file.tags(1)
            found = _statistics(file, path).tags()
            for name in ("STATISTICS_MINIMUM", "STATISTICS_MAXIMUM"):
                if name in tags and tags[name] != found.get(name):
                    message = f"{name} is {tags[name]}, the cells say {found.get(name)}"
                    problems.append(("E_STATISTICS", message, None))
    except (FormatError, InputNotFoundError) as error:
        problems.append(("E_CORRUPT", str(error), None))
    return problems


def _rows_of(file: Any, path: Path) -> Iterator[NDArray[Any]]:
    """Yield the first band of an opened raster, some rows at a time."""
    if file.width * file.height > MAX_CELLS:
        raise FormatError(
            f"{path}: claims {file.width} x {file.height} cells, more than any model of "
            "volatool has"
        )
    for _, rows in read_rows(file, BLOCK * BLOCK):
        yield rows


def _statistics(file: Any, path: Path) -> RasterStatistics:
    statistics = RasterStatistics()
    for rows in _rows_of(file, path):
        statistics.add(rows, file.nodata)
    return statistics


@dataclass(frozen=True, slots=True)
class RasterFacts:
    """
    What the cells of a raster say.

    Parameters
    ----------
    width, height : int
        Cells.
    cell : float
        Edge of a cell, horizontal unit.
    nodata : float or None
        The value of void cells.
    n_void : int
        How many there are.
    low, high : float or None
        Range of the others; None if there are none.
    """

    width: int
    height: int
    cell: float
    nodata: float | None
    n_void: int
    low: float | None
    high: float | None


def raster_facts(path: Path) -> RasterFacts:
    """
    Return size and range of a raster, from all of its cells.

    Raises
    ------
    FormatError, InputNotFoundError
        It can't be read.
    """
    with opened(path) as file:
        statistics = _statistics(file, path)
        n_known = sum(statistics.counts)
        return RasterFacts(
            file.width,
            file.height,
            file.transform.a,
            file.nodata,
            file.width * file.height - n_known,
            statistics.low if n_known else None,
            statistics.high if n_known else None,
        )


def flag_counts(path: Path) -> list[int]:
    """
    Return how many cells of a flag layer are void, measured and filled.

    Raises
    ------
    FormatError, InputNotFoundError
        It can't be read, or is no flag layer.
    """
    with opened(path) as file:
        if file.dtypes[0] != "uint8":
            raise FormatError(f"{path}: a flag layer has bytes, this one has {file.dtypes[0]}")
        counts = np.zeros(256, np.int64)
        for rows in _rows_of(file, path):
            counts += np.bincount(rows.ravel(), minlength=256)
    if counts[3:].any():
        raise FormatError(f"{path}: flags are 0, 1 and 2, this layer has {counts.nonzero()[0][-1]}")
    return [int(n) for n in counts[:3]]
