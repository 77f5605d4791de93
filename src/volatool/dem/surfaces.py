"""A DEM from a surface's points: evidence on a grid, the EMap solve, and what each cell is."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from volatool.dem.cell import CellChoice, choose_cell, mean_spacing
from volatool.dem.distance import MEASURED, VOID, distance_cells, fill_flags
from volatool.dem.gather import ROW, SHARE, SurfacePoints
from volatool.dem.grid import Grid, grid_for
from volatool.emap.noise import Noise, answer, measure
from volatool.emap.solve import solve
from volatool.emap.system import STRIP_CELLS, Evidence, Springs, strips
from volatool.errors import OptionError
from volatool.model import F64, CrsInfo, Progress, as_fraction, no_progress
from volatool.scratch import Scratch, Spool

NODATA = -9999.0
"""What stands in files for a void cell; in memory it is NaN."""

MAX_GAP_M = 20.0
"""Default of ``max_gap`` in metres, and at least `MAX_GAP_CELLS` cells."""

MAX_GAP_CELLS = 10

NOISE_BLOCK = 8
"""Edge of the blocks over which noise is told, in mean spacings: some 64 points each."""

PRESETS = ("emap", "paper")


@dataclass(frozen=True, slots=True)
class Dem:
    """
    A digital elevation model with what is known of each cell.

    Parameters
    ----------
    z : (h, w) array of float32
        Heights of the cells' centres in the vertical unit, row 0 at the top; NaN where void.
    flag : (h, w) array of uint8
        0 void, 1 measured (a point of the surface is in the cell), 2 filled.
    count : (h, w) array of uint32
        Points of the surface in each cell (all of them, also where only one was used).
    grid : Grid
        Where the cells are.
    crs : CrsInfo
        Coordinate reference system and units.
    surface, ground_source : str
        Honest name and source of the points.
    spacing : float or None
        Mean spacing s of the points used, in the horizontal unit; None without points.
    residual_rmse : float or None
        Root mean square of point minus surface over the points used, vertical unit.
    noise_sigma : float or None
        Estimate of the points' own noise: the residuals' scale freed of the part that the
        surface follows; None when it follows all (see `emap.noise`).
    noise : Noise or None
        The same by region.
    springs : Springs or None
        Of the grid.
    sigma : (h, w) array of float32 or None
        Standard errors of the heights, vertical unit, NaN where void; when they were worked out
        (`dem.sigma`).
    solver : dict
        The report's ``dem.solver``.
    z_min, z_max : float or None
        Over all cells with a height.
    cells_measured, cells_filled, cells_void : int
        Counts of the flag's values.
    choice : CellChoice or None
        How the cell was chosen, when it was.
    scratch : Scratch
        Where the arrays live.
    """

    z: NDArray[np.float32]
    flag: NDArray[np.uint8]
    count: NDArray[np.uint32]
    grid: Grid
    crs: CrsInfo
    surface: str
    ground_source: str
    spacing: float | None = None
    residual_rmse: float | None = None
    noise_sigma: float | None = None
    noise: Noise | None = field(default=None, repr=False)
    springs: Springs | None = None
    sigma: NDArray[np.float32] | None = field(default=None, repr=False)
    solver: dict[str, Any] = field(default_factory=dict)
    z_min: float | None = None
    z_max: float | None = None
    cells_measured: int = 0
    cells_filled: int = 0
    cells_void: int = 0
    choice: CellChoice | None = None
    scratch: Scratch = field(default_factory=Scratch, repr=False)

    @property
    def distance(self) -> NDArray[np.float32]:
        """Distance to the nearest measured cell's centre, horizontal unit; worked out each time."""
        distance = distance_cells(self.flag, MEASURED, self.scratch)
        cell = np.float32(self.grid.cell)
        for start, stop in strips(*distance.shape):
            distance[start:stop] *= cell
            self.scratch.relax(distance, start, stop)
        return distance

    def sigma_or_void(self) -> NDArray[np.float32]:
        """Return the standard errors; NaN everywhere when nothing tells them."""
        if self.sigma is None:
            return np.full(self.z.shape, np.nan, np.float32)
        return self.sigma

    def to_dict(self) -> dict[str, Any]:
        """Return the report's ``dem`` object without ``path`` and ``holdout``."""
        return {
            "cell": self.grid.cell,
            "width": self.grid.width,
            "height": self.grid.height,
            "surface": self.surface,
            "ground_source": self.ground_source,
            "nodata": NODATA,
            "cells_measured": self.cells_measured,
            "cells_filled": self.cells_filled,
            "cells_void": self.cells_void,
            "z_min": self.z_min,
            "z_max": self.z_max,
            "residual_rmse": self.residual_rmse,
            "noise_sigma": self.noise_sigma,
            "solver": dict(self.solver),
        }

    def free(self) -> None:
        """Give the arrays' memory back; the DEM must not be used any more."""
        self.scratch.free(self.z, self.flag, self.count)
        if self.sigma is not None:
            self.scratch.free(self.sigma)


def make_dem(
    points: SurfacePoints,
    crs: CrsInfo,
    cell: Literal["auto"] | float | Fraction = "auto",
    *,
    max_gap: float | None = None,
    fill: bool = True,
    k_surface: float | None = None,
    k_point: float | None = None,
    ell: float | None = None,
    tol_m: float = 1e-4,
    scratch: Scratch | None = None,
    progress: Progress = no_progress,
    preset: str = "emap",
) -> Dem:
    """
    Make a DEM.

    Parameters
    ----------
    points : SurfacePoints
        From `SurfaceGatherer`; dropped (closed) by the caller.
    crs : CrsInfo
        Units: lengths below are in the horizontal one, heights in the vertical one.
    cell : "auto", float or Fraction
        Edge of a cell; `choose_cell` by default.
    max_gap : float, optional
        No cell farther than this from a measured one is filled, see `fill_flags`; 20 m or 10
        cells by default, whichever is more.
    fill : bool
        False: heights only in measured cells.
    k_surface, k_point, ell : float, optional
        See `Springs.emap`.
    tol_m : float
        Stop of the solver, largest estimated error in metres.
    scratch : Scratch, optional
        Where grids live; the result's arrays too.
    progress : callable, optional
        Told the solver's iterations.
    preset : str
        ``"emap"`` or ``"paper"`` (stretching springs only, points pull on the nearest node).

    Returns
    -------
    dem : Dem
        All void without points.
    """
    if preset not in PRESETS:
        raise OptionError(f"preset must be one of {', '.join(PRESETS)}, got {preset!r}")
    for name, value in (("--max-gap", max_gap), ("--tol", tol_m)):
        if value is not None and not value > 0:
            raise OptionError(f"{name} must be greater than zero, got {value}")
    scratch = Scratch() if scratch is None else scratch
    choice = choose_cell(points, crs.metres_per_unit_xy) if cell == "auto" else None
    edge = as_fraction(cell) if choice is None else choice.cell  # type: ignore[arg-type]
    grid = grid_for(points.box or (Fraction(0),) * 4, edge)
    shape = (grid.height, grid.width)
    dem = Dem(
        scratch.zeros(shape, np.float32),
        scratch.zeros(shape, np.uint8),
        scratch.zeros(shape, np.uint32),
        grid,
        crs,
        points.name,
        points.ground_source,
        choice=choice,
        scratch=scratch,
    )
    if not len(points):
        dem.z[:] = np.nan
        return replace(dem, cells_void=grid.width * grid.height)
    used = _reduced(points, dem) if points.is_extreme else points
    s = mean_spacing(used, crs.metres_per_unit_xy)
    if preset == "paper":
        springs = Springs.paper(k_surface=k_surface, k_point=k_point)
    else:
        springs = Springs.emap(grid.cell, s, k_surface=k_surface, k_point=k_point, ell=ell)
    # one more cell all round: every point then has four nodes about it
    outer = grid.padded(1)
    evidence = _evidence(used, outer, springs, dem)
    tol = tol_m / float(crs.metres_per_unit_z or 1)
    z, info = solve(evidence, springs, tol=tol, consume=True, progress=progress)
    readings = partial(_readings, used, outer)
    freedom = answer((outer.height, outer.width), springs, readings, scratch)
    block = max(1, round(NOISE_BLOCK * s / grid.cell))
    noise = measure(springs, readings, z, freedom, block, scratch)
    scratch.free(freedom)
    if used is not points:
        used.close()
    n_void = _finish(dem, points, z, max_gap, fill, s)
    scratch.free(z)
    solver = info.to_dict()
    solver["k_surface"] = springs.kb * grid.cell**2 if springs.kb else springs.km
    solver["k_point"] = springs.weight
    return replace(
        dem,
        spacing=s,
        residual_rmse=noise.residual_rms,
        noise_sigma=noise.sigma,
        noise=noise,
        springs=springs,
        solver=solver,
        **n_void,
    )


def _row_windows(shape: tuple[int, int], is_spilled: bool) -> list[tuple[int, int]]:
    """Row windows to pass all points for: one, unless the grid is not in RAM."""
    height, width = shape
    return list(strips(height, width, 4 * STRIP_CELLS if is_spilled else height * width))


def _reduced(points: SurfacePoints, dem: Dem) -> SurfacePoints:
    """Lowest or highest point of each cell, in cell order; sets the DEM's counts."""
    from volatool.kernels import binning

    scratch, shape = dem.scratch, dem.count.shape
    before = scratch.spilled_bytes
    best = scratch.zeros((*shape, 3), np.int32)
    windows = _row_windows(dem.count.shape, scratch.spilled_bytes > before)
    sign = 1 if points.name == "min" else -1
    spool = Spool(scratch, ROW, SHARE)
    for first, last in windows:
        for rows in points.pieces():
            col, row = dem.grid.places(rows, points.scale, points.offset)
            binning.extreme(rows, col, row, sign, first, last, best, dem.count)
        for start, stop in strips(last - first, shape[1]):
            spool.append(binning.take_extremes(best, dem.count, first + start, first + stop))
        scratch.relax(best, first, last)
        scratch.relax(dem.count, first, last)
    scratch.free(best)
    return replace(points, spool=spool)


def _evidence(points: SurfacePoints, outer: Grid, springs: Springs, dem: Dem) -> Evidence:
    """Sum the points' springs; set the DEM's counts unless `_reduced` has."""
    from volatool.kernels import binning

    evidence = Evidence(outer.height, outer.width, dem.scratch)
    zero = _zero(points)
    for first, last in evidence.windows():
        for rows in points.pieces():
            col, row = outer.places(rows, points.scale, points.offset)
            heights = np.asarray((rows[:, 2] - zero) * points.scale[2], np.float64)
            evidence.add(col, row, heights, springs, (first, last))
            if not points.is_extreme:
                # the DEM's rows in this window: its row r is row r + 1 of the outer grid
                low, high = max(first - 1, 0), last - 1 if last < outer.height else last
                binning.count(col - 1.0, row - 1.0, low, high, dem.count)
        evidence.relax(first, last)
        dem.scratch.relax(dem.count)
    return evidence


def _zero(points: SurfacePoints) -> np.int64:
    """Return the stored z that heights are counted from: the middle, to keep digits."""
    return np.int64(sum(points.z_range) // 2)


def _readings(
    points: SurfacePoints, outer: Grid
) -> Iterator[tuple[NDArray[np.int32], F64, F64, F64]]:
    """Yield points, their places on the padded grid and their heights from near the mean."""
    zero = _zero(points)
    for rows in points.pieces():
        heights = np.asarray((rows[:, 2] - zero) * points.scale[2], np.float64)
        yield rows, *outer.places(rows, points.scale, points.offset), heights


def _finish(
    dem: Dem, points: SurfacePoints, z: F64, max_gap: float | None, fill: bool, spacing: float
) -> dict[str, Any]:
    """Set flags and heights; return the counts and the range."""
    scratch, grid = dem.scratch, dem.grid
    for start, stop in strips(grid.height, grid.width):
        dem.flag[start:stop] = np.where(dem.count[start:stop] > 0, MEASURED, VOID)
        scratch.relax(dem.count, start, stop)
        scratch.relax(dem.flag, start, stop)
    if fill:
        gap = max(MAX_GAP_M / float(dem.crs.metres_per_unit_xy or 1), MAX_GAP_CELLS * grid.cell)
        gap = gap if max_gap is None else max_gap
        margin = 2 * max(1.0, spacing / grid.cell)
        fill_flags(dem.flag, gap / grid.cell, margin, scratch)
    base = float(_zero(points)) * points.scale[2] + points.offset[2]
    low, high = math.inf, -math.inf
    counts = np.zeros(3, np.int64)
    for start, stop in strips(grid.height, grid.width):
        rows = z[start + 1 : stop + 1, 1:-1] + base
        flag = dem.flag[start:stop]
        rows[flag == VOID] = np.nan
        dem.z[start:stop] = rows
        counts += np.bincount(flag.ravel(), minlength=3)
        known = dem.z[start:stop][flag != VOID]
        if len(known):
            low, high = min(low, float(known.min())), max(high, float(known.max()))
        for array in (dem.z, dem.flag, z):
            scratch.relax(array, start, stop)
    void, measured, filled = counts.tolist()
    return {
        "z_min": low if measured else None,
        "z_max": high if measured else None,
        "cells_measured": measured,
        "cells_filled": filled,
        "cells_void": void,
    }
