"""Plain surfaces to compare EMap with: a statistic per cell, inverse distances, triangles.

=======  ======================================================  ==========================
name     height of a cell                                        cells without points
=======  ======================================================  ==========================
min      lowest point in it                                      void
max      highest point in it                                     void
mean     mean of the points in it                                void
idw      inverse distances (power 2) of the 12 nearest points    filled as far as `max_gap`
tin      linear on Delaunay triangles, at the cell's centre      the same, inside the hull
=======  ======================================================  ==========================
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from volatool.dem.cell import mean_spacing
from volatool.dem.crop import summary
from volatool.dem.distance import FILLED, MEASURED, VOID, fill_flags
from volatool.dem.gather import SurfacePoints
from volatool.emap.system import STRIP_CELLS, strips, windows
from volatool.errors import InputError, ResourceError
from volatool.model import F64
from volatool.scratch import Scratch
from volatool.units import format_size

if TYPE_CHECKING:
    from volatool.dem.surfaces import Dem

BINNED = ("min", "max", "mean")
INTERPOLATED = ("idw", "tin")
BASELINES = BINNED + INTERPOLATED

NEIGHBOURS, POWER = 12, 2
"""Points and power of ``idw``."""

LIBRARY_BYTES = 64 << 20
"""scipy, loaded for the first time."""

BYTES_PER_POINT = {"idw": 160, "tin": 900}
"""Peak of scipy's trees and triangles, measured at 0.1 and 1 million points, and a fifth more."""

Interpolator = Callable[[F64, F64], F64]


def fill_baseline(dem: Dem, points: SurfacePoints, gap: float, fill: bool) -> Dem:
    """
    Make a plain surface.

    Parameters
    ----------
    dem : Dem
        Of zeros; its arrays are set.
    points : SurfacePoints
        At least one; their name is one of `BASELINES`.
    gap : float
        ``max_gap`` in cells.
    fill : bool
        False: heights only in measured cells.

    Raises
    ------
    ResourceError
        ``E_MEMORY``: scipy would take more memory for the points than there is.
    InputError
        ``E_NO_TRIANGLE``: fewer than three points, or all on a line.
    """
    if points.name in BINNED:
        residual = _bin(dem, points)
        solver = _solver({"min": "lowest", "max": "highest"}.get(points.name, "mean") + " per cell")
        flags = summary(dem.z, dem.flag, dem.scratch)
        return replace(dem, residual_rmse=residual, solver=solver, **flags)
    spacing = mean_spacing(points, dem.crs.metres_per_unit_xy)
    check_memory(points, dem.scratch)
    _count(dem, points)
    if fill:
        fill_flags(dem.flag, gap, 2 * max(1.0, spacing / dem.grid.cell), dem.scratch)
    heights, facts = (_idw if points.name == "idw" else _tin)(*_places(dem, points), gap)
    _interpolate(dem, heights, float(_zero(points)) * points.scale[2] + points.offset[2])
    if "radius" in facts:
        facts["radius"] *= dem.grid.cell
    flags = summary(dem.z, dem.flag, dem.scratch)
    return replace(dem, spacing=spacing, solver=_solver(points.name) | facts, **flags)


def _solver(method: str) -> dict[str, Any]:
    """Return the report's ``solver``, of which only the method means something here."""
    names = ("iterations", "relative_residual", "k_surface", "k_point")
    return {"method": method, **dict.fromkeys(names)}


def _zero(points: SurfacePoints) -> int:
    return sum(points.z_range) // 2


def check_memory(points: SurfacePoints, scratch: Scratch) -> None:
    """
    Refuse points for which scipy would need more than is left of the memory budget.

    Raises
    ------
    ResourceError
        ``E_MEMORY``, before anything is allocated.
    """
    if scratch.budget_bytes is None:
        return
    needed = LIBRARY_BYTES + BYTES_PER_POINT[points.name] * len(points)
    left = scratch.budget_bytes - scratch.used_bytes
    if needed > left:
        raise ResourceError(
            f"--surface {points.name} of {len(points)} points takes about {format_size(needed)}, "
            f"{format_size(max(0, left))} of --memory are left: raise --memory by "
            f"{format_size(needed - left)}, thin the points out (--thin), or take the EMap surface "
            "(--surface auto), which keeps any ceiling"
        )


def _count(dem: Dem, points: SurfacePoints) -> None:
    """Set counts, and flags of measured cells."""
    from volatool.kernels import binning

    height, width = dem.count.shape
    for first, last in _windows(dem):
        for rows in points.pieces():
            col, row = dem.grid.places(rows, points.scale, points.offset)
            binning.count(col, row, first, last, dem.count)
        dem.scratch.relax(dem.count, first, last)
    for start, stop in strips(height, width):
        dem.flag[start:stop] = np.where(dem.count[start:stop] > 0, MEASURED, VOID)
        dem.scratch.relax(dem.count, start, stop)
        dem.scratch.relax(dem.flag, start, stop)


def _windows(dem: Dem) -> list[tuple[int, int]]:
    """Row windows to pass all points for: one, unless arrays are in files."""
    height, width = dem.count.shape
    return windows(dem.scratch, height, width, dem.z, dem.flag, dem.count)


def _bin(dem: Dem, points: SurfacePoints) -> float | None:
    """Set heights, counts and flags; return the points' residual about means."""
    from volatool.kernels import binning

    scratch, shape = dem.scratch, dem.count.shape
    is_mean = points.name == "mean"
    sums = scratch.zeros(shape if is_mean else (*shape, 3), np.int64 if is_mean else np.int32)
    scale, base = points.scale[2], points.offset[2]
    squares: list[float] = []
    for first, last in _windows(dem):
        for rows in points.pieces():
            col, row = dem.grid.places(rows, points.scale, points.offset)
            if is_mean:
                binning.add_heights(rows, col, row, first, last, sums, dem.count)
            else:
                sign = 1 if points.name == "min" else -1
                binning.extreme(rows, col, row, sign, first, last, sums, dem.count)
        for start, stop in strips(last - first, shape[1]):
            part = slice(first + start, first + stop)
            count = dem.count[part]
            stored = sums[part] / np.maximum(count, 1) if is_mean else sums[part][..., 2]
            dem.z[part] = np.where(count > 0, stored * scale + base, np.nan)
            dem.flag[part] = np.where(count > 0, MEASURED, VOID)
            scratch.relax(dem.z, first + start, first + stop)
            scratch.relax(dem.flag, first + start, first + stop)
        scratch.relax(sums, first, last)
        scratch.relax(dem.count, first, last)
    if is_mean:
        for rows in points.pieces():
            squares.append(_squares(dem, points, rows))
    scratch.free(sums)
    return math.sqrt(math.fsum(squares) / len(points)) if is_mean else None


def _squares(dem: Dem, points: SurfacePoints, rows: NDArray[np.int32]) -> float:
    """Sum of squares of point minus the height of its cell."""
    col, row = dem.grid.places(rows, points.scale, points.offset)
    height, width = dem.z.shape
    inside = (col >= 0) & (col <= width) & (row >= 0) & (row <= height)
    cells = (
        np.minimum(row[inside].astype(np.int64), height - 1),
        np.minimum(col[inside].astype(np.int64), width - 1),
    )
    rise = rows[inside, 2] * points.scale[2] + points.offset[2] - dem.z[cells]
    return float(np.sum(np.square(rise)))


def _places(dem: Dem, points: SurfacePoints) -> tuple[F64, F64]:
    """Return the points' places in cells, (n, 2), and heights above their middle."""
    xy, z = np.empty((len(points), 2)), np.empty(len(points))
    start = 0
    for rows in points.pieces():
        part = slice(start, start + len(rows))
        xy[part, 0], xy[part, 1] = dem.grid.places(rows, points.scale, points.offset)
        z[part] = (rows[:, 2] - np.int64(_zero(points))) * points.scale[2]
        start += len(rows)
    return xy, z


def _idw(xy: F64, z: F64, gap: float) -> tuple[Interpolator, dict[str, Any]]:
    """Inverse distances of the nearest points; beyond the radius only the nearest counts."""
    from scipy.spatial import cKDTree

    tree = cKDTree(xy)
    n = min(NEIGHBOURS, len(z))

    def heights(col: F64, row: F64) -> F64:
        distance, index = tree.query(np.column_stack([col, row]), k=range(1, n + 1))
        nearest = distance[:, :1]
        # relative to the nearest: no division by zero where a point is at the centre
        weight = (np.maximum(nearest, 1e-9) / np.maximum(distance, 1e-9)) ** POWER
        weight[:, 1:][distance[:, 1:] > gap] = 0.0
        found: F64 = np.sum(weight * z[index], axis=1) / np.sum(weight, axis=1)
        return found

    return heights, {"points": n, "power": POWER, "radius": gap}


def _tin(xy: F64, z: F64, gap: float) -> tuple[Interpolator, dict[str, Any]]:
    """Linear on Delaunay triangles; NaN outside their hull."""
    from scipy.interpolate import LinearNDInterpolator
    from scipy.spatial import Delaunay, QhullError

    try:
        triangles = Delaunay(xy) if len(z) >= 3 else None
    except QhullError:
        triangles = None
    if triangles is None:
        raise InputError(
            "--surface tin needs three points that are not on one line; take --surface idw, or "
            "auto for the EMap surface",
            "E_NO_TRIANGLE",
        )
    interpolate = LinearNDInterpolator(triangles, z)

    def heights(col: F64, row: F64) -> F64:
        return np.asarray(interpolate(col, row), np.float64)

    return heights, {"triangles": len(triangles.simplices)}


def _interpolate(dem: Dem, heights: Interpolator, base: float) -> None:
    """Set the heights of all cells that are not void; void those that get none."""
    height, width = dem.z.shape
    centres: F64 = np.arange(width, dtype=np.float64) + 0.5
    for start, stop in strips(height, width, STRIP_CELLS // 8):
        flag, z = dem.flag[start:stop], dem.z[start:stop]
        z[:] = np.nan
        rows, cols = np.nonzero(flag != VOID)
        if len(rows):
            middles: F64 = rows.astype(np.float64) + (start + 0.5)
            z[rows, cols] = heights(centres[cols], middles) + base
            flag[np.isnan(z) & ((flag == FILLED) | (flag == MEASURED))] = VOID
        dem.scratch.relax(dem.z, start, stop)
        dem.scratch.relax(dem.flag, start, stop)
