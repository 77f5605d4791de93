"""A DEM from a surface's points: evidence on a grid, the EMap solve, and what each cell is."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from volatool.dem.baselines import BASELINES, fill_baseline
from volatool.dem.cell import CellChoice, choose_cell, mean_spacing
from volatool.dem.crop import summary
from volatool.dem.distance import MEASURED, VOID, distance_cells, fill_flags
from volatool.dem.fit import answer, fit, readings, stored_zero, sum_of_squares
from volatool.dem.gather import SurfacePoints
from volatool.dem.grid import Grid, grid_for
from volatool.emap.noise import Noise, measure
from volatool.emap.system import strips
from volatool.emap.tuning import MAX_FREEDOM, Tuned, choose_springs, degrees_of_freedom
from volatool.errors import CodedWarning, OptionError
from volatool.model import F64, CrsInfo, Progress, as_fraction, no_progress
from volatool.scratch import Scratch

if TYPE_CHECKING:
    from volatool.dem.barriers import Placed
    from volatool.dem.vectors import Barriers

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
        Points of the surface in each cell .
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
    tuned : Tuned or None
        The nets of the surface.
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
    barriers : dict or None
        The report's ``dem.barriers``.
    notes : tuple of CodedWarning
        What came up.
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
    tuned: Tuned | None = field(default=None, repr=False)
    sigma: NDArray[np.float32] | None = field(default=None, repr=False)
    solver: dict[str, Any] = field(default_factory=dict)
    z_min: float | None = None
    z_max: float | None = None
    cells_measured: int = 0
    cells_filled: int = 0
    cells_void: int = 0
    choice: CellChoice | None = None
    barriers: dict[str, Any] | None = None
    notes: tuple[CodedWarning, ...] = ()
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

    def to_dict(self) -> dict[str, Any]:
        """Return the report's ``dem`` object without ``path`` and ``holdout``."""
        document = {
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
            "spacing": self.spacing,
            "solver": dict(self.solver),
        }
        if self.barriers is not None:
            document["barriers"] = self.barriers
        return document

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
    spacing: float | None = None,
    tol_m: float = 1e-4,
    scratch: Scratch | None = None,
    progress: Progress = no_progress,
    preset: str = "emap",
    grid: Grid | None = None,
    barriers: Barriers | None = None,
    with_noise: bool = False,
    robust: bool = False,
    threads: int = 1,
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
        See `choose_springs`.
    spacing : float, optional
        Mean spacing of the points, which the stiffness follows; found by default.
    tol_m : float
        Stop of the solver, largest estimated error in metres.
    scratch : Scratch, optional
        Where grids live; the result's arrays too.
    progress : callable, optional
        Told the solver's iterations.
    preset : str
        ``"emap"`` or ``"paper"`` (stretching springs only, points pull on the nearest node).
    grid : Grid, optional
        Cells to make, whatever `cell` and the points' box say; points outside don't count.
    barriers : Barriers, optional
        Break lines and water; not for plain baselines.
    with_noise : bool
        Tell the points' noise by blocks, for standard errors: costs as much again as the surface.
    robust : bool
        Find the points that lie far off all others and let them hardly count.
    threads : int
        Never changes the result.

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
    choice = None
    if grid is None:
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
    gap = gap_cells(crs, grid.cell, max_gap)
    if points.name in BASELINES:
        return fill_baseline(dem, points, gap, fill)
    s = mean_spacing(points, crs.metres_per_unit_xy) if spacing is None else spacing
    tuned = choose_springs(
        grid.cell, s, preset=preset, k_surface=k_surface, k_point=k_point, ell=ell
    )
    # one more cell all round: every point then has four nodes about it
    outer = grid.padded(1)
    tol = tol_m / float(crs.metres_per_unit_z or 1)
    placed, used = None, points
    if barriers is not None:
        from volatool.dem.barriers import place

        placed = place(barriers, outer, points, s, scratch)
        used = placed.dry(points, outer)
    trusted = None
    if robust:
        from volatool.dem.robust import find_far_off

        unit = float(crs.metres_per_unit_z or 1)
        trusted = find_far_off(used, outer, tuned.springs, unit, scratch)
    z, solver = fit(used, outer, tuned, dem, tol, progress, placed, trusted, threads)
    if trusted is not None:
        solver["robust"] = trusted.to_dict()
        scratch.free(trusted.z)
    if with_noise:
        freedom = answer(used, outer, tuned, scratch)
        block = max(1, round(NOISE_BLOCK * s / grid.cell))
        noise = measure(tuned.springs, partial(readings, used, outer), z, freedom, block, scratch)
        scratch.free(freedom)
        dem = replace(dem, noise=noise, residual_rmse=noise.residual_rms, noise_sigma=noise.sigma)
    else:
        squares = sum_of_squares(used, outer, tuned, z, scratch, placed, threads)
        rms = math.sqrt(squares / len(used))
        part = degrees_of_freedom(tuned.nets, grid.cell, s)
        sigma = rms / math.sqrt(1 - part) if part < MAX_FREEDOM else None
        dem = replace(dem, residual_rmse=rms, noise_sigma=sigma)
    found = _finish(dem, used, z, gap, fill, s, placed)
    scratch.free(z)
    if placed is not None:
        dem = replace(dem, barriers=placed.document, notes=tuple(placed.warnings))
        placed.free()
    if used is not points:
        used.close()
    return replace(dem, spacing=s, tuned=tuned, solver=solver, **found)


def gap_cells(crs: CrsInfo, cell: float, max_gap: float | None) -> float:
    """Return ``max_gap``, given in the horizontal unit or its default, in cells."""
    default = max(MAX_GAP_M / float(crs.metres_per_unit_xy or 1), MAX_GAP_CELLS * cell)
    return (default if max_gap is None else max_gap) / cell


def _finish(
    dem: Dem,
    points: SurfacePoints,
    z: F64,
    gap: float,
    fill: bool,
    spacing: float,
    barriers: Placed | None,
) -> dict[str, Any]:
    """Set flags and heights; return the counts and the range."""
    scratch, grid = dem.scratch, dem.grid
    for start, stop in strips(grid.height, grid.width):
        dem.flag[start:stop] = np.where(dem.count[start:stop] > 0, MEASURED, VOID)
        scratch.relax(dem.count, start, stop)
        scratch.relax(dem.flag, start, stop)
    if fill:
        fill_flags(dem.flag, gap, 2 * max(1.0, spacing / grid.cell), scratch)
    base = float(stored_zero(points)) * points.scale[2] + points.offset[2]
    if barriers is not None:
        barriers.flood(z, base)
        barriers.settle(dem.flag)
    for start, stop in strips(grid.height, grid.width):
        rows = z[start + 1 : stop + 1, 1:-1] + base
        rows[dem.flag[start:stop] == VOID] = np.nan
        dem.z[start:stop] = rows
        for array in (dem.z, dem.flag, z):
            scratch.relax(array, start, stop)
    return summary(dem.z, dem.flag, scratch)
