"""A DEM made on more cells than were asked for, cut to those; counts over what is left."""

from __future__ import annotations

import math
from dataclasses import fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from volatool.dem.distance import VOID
from volatool.dem.grid import Grid
from volatool.emap.system import strips
from volatool.scratch import Scratch

if TYPE_CHECKING:
    from volatool.dem.surfaces import Dem


def summary(z: NDArray[np.float32], flag: NDArray[np.uint8], scratch: Scratch) -> dict[str, Any]:
    """
    Return the counts of the flags and the range of the heights, by their names in `Dem`.

    Parameters
    ----------
    z : (h, w) array of float32
        Heights, NaN where void.
    flag : (h, w) array of uint8
        What each cell is.
    scratch : Scratch
        Where the arrays live.
    """
    low, high = math.inf, -math.inf
    counts = np.zeros(3, np.int64)
    for start, stop in strips(*z.shape):
        part = flag[start:stop]
        counts += np.bincount(part.ravel(), minlength=3)
        known = z[start:stop][part != VOID]
        if len(known):
            low, high = min(low, float(known.min())), max(high, float(known.max()))
        scratch.relax(z, start, stop)
        scratch.relax(flag, start, stop)
    void, measured, filled = counts.tolist()
    return {
        "z_min": low if math.isfinite(low) else None,
        "z_max": high if math.isfinite(high) else None,
        "cells_measured": measured,
        "cells_filled": filled,
        "cells_void": void,
    }


def crop(dem: Dem, grid: Grid) -> Dem:
    """
    Return the part of a DEM that a grid on the same lines covers.

    Parameters
    ----------
    dem : Dem
        Its arrays are given back.
    grid : Grid
        Inside the DEM's.

    Returns
    -------
    part : Dem
        With copies of the arrays of cells, and its own counts and range; what was estimated from
        the points stays that of all of them.
    """
    if grid.exact == dem.grid.exact and (grid.width, grid.height) == dem.z.shape[::-1]:
        return dem
    left, top, cell = grid.exact
    row, col = (dem.grid.exact[1] - top) / cell, (left - dem.grid.exact[0]) / cell
    if row.denominator != 1 or col.denominator != 1 or cell != dem.grid.exact[2]:
        raise ValueError("the grids are not on the same lines")
    first, before = int(row), int(col)
    if not (
        0 <= first <= dem.grid.height - grid.height and 0 <= before <= dem.grid.width - grid.width
    ):
        raise ValueError("the grid to crop to is not inside the DEM's")
    arrays: dict[str, Any] = {}
    for item in fields(dem):
        array = getattr(dem, item.name)
        if isinstance(array, np.ndarray) and array.shape == (dem.grid.height, dem.grid.width):
            part = dem.scratch.zeros((grid.height, grid.width), array.dtype)
            for start, stop in strips(grid.height, grid.width):
                rows = array[first + start : first + stop]
                part[start:stop] = rows[:, before : before + grid.width]
                dem.scratch.relax(array)
                dem.scratch.relax(part, start, stop)
            dem.scratch.free(array)
            arrays[item.name] = part
    flags = summary(arrays["z"], arrays["flag"], dem.scratch)
    return replace(dem, grid=grid, **arrays, **flags)
