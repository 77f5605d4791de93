"""Standard errors of a DEM: of its heights, cell by cell, and of points measured against it.

The spread of random surfaces (`emap.uncertainty`), times the points' noise about each place
(`emap.noise`), times a factor by distance to data that makes 95 % intervals hold at points held
out of the fit. Grids are coarser than the DEM's, as standard errors are smooth.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from volatool.dem.distance import MEASURED, VOID, distance_cells
from volatool.dem.fit import fit_nets, readings, stored_zero
from volatool.dem.gather import SurfacePoints
from volatool.dem.grid import Grid, grid_for
from volatool.dem.split import part, some, split
from volatool.emap.noise import Noise
from volatool.emap.system import Evidence, Springs, strips
from volatool.emap.tuning import Net, Tuned
from volatool.emap.uncertainty import SAMPLES, Origin, samples
from volatool.model import F64, CrsInfo
from volatool.scratch import Scratch

COARSE = ((1 << 18, 1), (1 << 22, 2))
"""DEM cells up to which sigma's cells are so many times larger; 4 times above."""

SCATTERED, BLOCKED = 0.05, 0.15
"""Parts of the points held out for the factors: one by one, and in blocks."""

CLASSES = (1.5, 3.0, 6.0, 12.0)
"""Distances to data, in spacings, that part the classes of factors."""

MIDDLES = (0.7, 2.1, 4.2, 8.5, 17.0)
"""Distances at which a class's factor holds; between them it is interpolated in the logarithm."""

NEAR_LEVEL, GAP_LEVEL = 0.95, 0.975
"""Quantiles that the factors bring to 1.96 sigma; gaps are few, so theirs is a little higher."""

DOUBT = 5.0
"""Blocks' worth of doubt in a factor below 1, that would make intervals narrower."""

MAX_TEST = 1 << 17
"""Held-out points that are looked at, about; more say no more."""

MIN_POINTS = 30
"""A class of fewer held-out points takes its neighbour's factor."""

Z95 = 1.959963984540054


@dataclass(frozen=True, slots=True)
class Model:
    """
    What a DEM needs to know to tell standard errors.

    Parameters
    ----------
    tuned : Tuned
        Nets of the DEM's grid.
    spacing : float
        Mean spacing of the points, horizontal unit.
    sigma : (h, w) array of float64
        Noise of the points by block, vertical unit.
    block : float
        Edge of a block, horizontal unit; block (0, 0) has its corner at that of the padded grid.
    outer : Grid
        The DEM's grid with one more cell all round.
    factors : tuple of float
        By class of distance, at `MIDDLES`.
    n_held : int
        Points that the factors are from; 0 for factors of 1.
    """

    tuned: Tuned
    spacing: float
    sigma: F64
    block: float
    outer: Grid
    factors: tuple[float, ...] = (1.0,) * len(MIDDLES)
    n_held: int = 0

    def scale(self, col: F64, row: F64, distance: F64) -> F64:
        """
        Return the factor from unit standard errors to real ones.

        Parameters
        ----------
        col, row : arrays of float64, any shape
            Places in cells of the padded grid.
        distance : array of float64
            To the nearest measured cell, horizontal unit.
        """
        from volatool.kernels import spring

        side = self.outer.cell / self.block
        noise = np.empty(col.size)
        values = self.sigma
        if min(values.shape) < 2:  # bilinear reading needs two a side
            values = np.pad(values, ((0, 1), (0, 1)), mode="edge")
        height, width = values.shape
        x = np.clip(col.ravel() * side, 0, width)
        y = np.clip(row.ravel() * side, 0, height)
        spring.interpolate(values, x, y, False, 0, height, noise)
        return noise.reshape(col.shape) * self.factor(distance)

    def factor(self, distance: F64) -> F64:
        """Return the factor of distances to data in the horizontal unit."""
        near = np.log(np.maximum(distance / self.spacing, 0.1))
        return np.asarray(np.exp(np.interp(near, np.log(MIDDLES), np.log(self.factors))))

    def to_dict(self) -> dict[str, Any]:
        """Return the report's ``dem.sigma``."""
        return {
            "samples": SAMPLES,
            "calibration": {
                "n": self.n_held,
                "distance_spacings": list(MIDDLES),
                "factors": [round(value, 4) for value in self.factors],
            },
        }


def coarse_grid(grid: Grid) -> tuple[Grid, int]:
    """Return the padded grid for random surfaces, and how many DEM cells make its cell's side."""
    n_cells = grid.width * grid.height
    step = next((step for limit, step in COARSE if n_cells <= limit), 4)
    left, top, cell = grid.exact
    box = (left, top - grid.height * cell, left + grid.width * cell, top)
    return grid_for(box, cell * step).padded(1), step


@dataclass(slots=True)
class Ensemble:
    """
    Random surfaces of some points on a coarse grid.

    Parameters
    ----------
    points : SurfacePoints
        The points of the fit.
    tuned : Tuned
        Nets of the DEM's grid.
    grid : Grid
        The DEM's.
    scratch : Scratch
        Where grids live.
    """

    points: SurfacePoints
    tuned: Tuned
    grid: Grid
    scratch: Scratch
    coarse: Grid = field(init=False)
    step: int = field(init=False)
    own: Springs = field(init=False)

    def __post_init__(self) -> None:
        self.coarse, self.step = coarse_grid(self.grid)
        # kb cell^2 and km do not hang on the cell
        self.own = self._coarser(self.tuned.springs)

    def _coarser(self, springs: Springs) -> Springs:
        return replace(springs, kb=springs.kb / self.step**2)

    def surface(self, tol: float) -> F64:
        """Return the surface of the points, heights above `stored_zero`; free it after use."""
        nets = [
            Net(self._coarser(net.springs), net.tether * self.step**2) for net in self.tuned.nets
        ]
        shape = (self.coarse.height, self.coarse.width)
        read = partial(readings, self.points, self.coarse)
        return fit_nets(read, shape, nets, tol, self.scratch)

    def places(self) -> Iterator[tuple[NDArray[np.int32], F64, F64]]:
        """Yield the points and their places on the coarse grid."""
        for rows in self.points.pieces():
            yield rows, *self.coarse.places(rows, self.points.scale, self.points.offset)

    def evidence(self) -> Evidence:
        """Return the points' springs on the coarse grid."""
        evidence = Evidence(self.coarse.height, self.coarse.width, self.scratch)
        for first, last in evidence.windows():
            for _, col, row in self.places():
                # heights do not matter for how sure they are
                evidence.add(col, row, np.zeros(len(col)), self.own, (first, last))
            evidence.relax(first, last)
        return evidence

    def surfaces(self, evidence: Evidence, n_samples: int = SAMPLES) -> Iterator[F64]:
        """Yield the random surfaces, in units of the points' noise."""
        left, top, cell = self.coarse.exact
        origin = Origin(round(-top / cell), round(left / cell))
        yield from samples(evidence, self.own, self.places, n_samples, origin=origin)


def unit_errors_at(ensemble: Ensemble, evidence: Evidence, at: SurfacePoints) -> F64:
    """
    Return the surface's standard error at points, in units of the noise.

    Parameters
    ----------
    ensemble : Ensemble
        Of the points of the fit.
    evidence : Evidence
        Theirs.
    at : SurfacePoints
        Where to read, of the same scaling and extent.

    Returns
    -------
    errors : (n,) array of float64
        In the ensemble's scratch.
    """
    from volatool.kernels import spring

    squares: F64 = ensemble.scratch.zeros((len(at),), np.float64)
    for z in ensemble.surfaces(evidence):
        start = 0
        for rows in at.pieces():
            col, row = ensemble.coarse.places(rows, at.scale, at.offset)
            found = np.empty(len(rows))
            spring.interpolate(z, col, row, ensemble.own.is_nearest, 0, len(z), found)
            squares[start : start + len(rows)] += np.square(found)
            start += len(rows)
    squares /= SAMPLES
    return np.sqrt(squares, out=squares)


def distances_at(points: SurfacePoints, at: SurfacePoints, grid: Grid, scratch: Scratch) -> F64:
    """
    Return how far points are from data: from their cell's centre to that of one with data.

    Parameters
    ----------
    points : SurfacePoints
        The data.
    at : SurfacePoints
        Where.
    grid : Grid
        The DEM's cells.
    scratch : Scratch
        Where grids live.

    Returns
    -------
    distance : (n,) array of float64
        Horizontal unit; infinite without data.
    """
    from volatool.kernels import binning

    cells = scratch.zeros((grid.height, grid.width), np.uint8)
    for rows in points.pieces():
        binning.mark(*grid.places(rows, points.scale, points.offset), cells)
    distance = distance_cells(cells, 1, scratch)
    scratch.free(cells)
    out: F64 = scratch.zeros((len(at),), np.float64)
    start = 0
    for rows in at.pieces():
        col, row = grid.places(rows, at.scale, at.offset)
        q = np.clip(col.astype(np.int64), 0, grid.width - 1)
        r = np.clip(row.astype(np.int64), 0, grid.height - 1)
        out[start : start + len(rows)] = distance[r, q]
        start += len(rows)
    scratch.free(distance)
    out *= grid.cell
    return out


def fit(
    points: SurfacePoints,
    grid: Grid,
    tuned: Tuned,
    noise: Noise | None,
    spacing: float,
    crs: CrsInfo,
    scratch: Scratch,
    sigma: float | None = None,
) -> Model | None:
    """
    Return the model of a DEM's standard errors.

    Parameters
    ----------
    points : SurfacePoints
        The points of the DEM.
    grid : Grid
        Its cells.
    tuned : Tuned
        Its nets.
    noise : Noise or None
        Of its residuals; blocks on the padded grid.
    spacing : float
        Mean spacing of the points.
    crs : CrsInfo
        Units.
    scratch : Scratch
        Where grids live.
    sigma : float, optional
        The points' noise, in the vertical unit, when it is known: taken as it is, without factors.

    Returns
    -------
    model : Model or None
        None when nothing tells the noise: the surface follows all points.
    """
    outer = grid.padded(1)
    if sigma is not None:
        side = max(outer.width, outer.height) * outer.cell
        return Model(tuned, spacing, np.full((1, 1), sigma), side, outer)
    if noise is None or noise.sigma is None:
        return None
    rounding = points.scale[2] / math.sqrt(12)  # of stored heights: nothing is surer
    by_block = np.maximum(noise.map(), rounding)
    model = Model(tuned, spacing, by_block, noise.block * grid.cell, outer)
    return _calibrate(model, points, grid, crs, scratch)


def _calibrate(
    model: Model, points: SurfacePoints, grid: Grid, crs: CrsInfo, scratch: Scratch
) -> Model:
    """Return the model with the factors that points held out of a coarse fit ask for."""
    from volatool.kernels import spring

    if len(points) < 2 * MIN_POINTS:
        return model
    chosen = split(points, SCATTERED, BLOCKED, model.spacing, crs.metres_per_unit_xy, salt=1)
    train = part(points, chosen, held=False)
    test = some(part(points, chosen, held=True), MAX_TEST, scratch)
    if len(train) < MIN_POINTS or len(test) < MIN_POINTS:
        test.close()
        return model
    ensemble = Ensemble(train, model.tuned, grid, scratch)
    zero = stored_zero(points)
    z = ensemble.surface(tol=1e-2 * float(model.sigma.min()))
    residuals: F64 = scratch.zeros((len(test),), np.float64)
    start = 0
    for rows in test.pieces():
        found = np.empty(len(rows))
        places = ensemble.coarse.places(rows, test.scale, test.offset)
        spring.interpolate(z, *places, ensemble.own.is_nearest, 0, len(z), found)
        height = (rows[:, 2] - zero) * test.scale[2]
        residuals[start : start + len(rows)] = height - found
        start += len(rows)
    scratch.free(z)
    evidence = ensemble.evidence()
    unit = unit_errors_at(ensemble, evidence, test)
    evidence.free()
    distance = distances_at(train, test, grid, scratch)
    ratios = np.abs(residuals) / (scale_at(model, test, distance) * np.sqrt(1 + np.square(unit)))
    blocks = np.concatenate([chosen.block_of(test, rows) for rows in test.pieces()])
    factors = class_factors(ratios, distance / model.spacing, blocks)
    n_held = len(test)
    test.close()
    scratch.free(residuals, unit, distance)
    return replace(model, factors=factors, n_held=n_held)


def scale_at(model: Model, at: SurfacePoints, distance: F64) -> F64:
    """Return `Model.scale` at points."""
    out = np.empty(len(at))
    start = 0
    for rows in at.pieces():
        stop = start + len(rows)
        places = model.outer.places(rows, at.scale, at.offset)
        out[start:stop] = model.scale(*places, distance[start:stop])
        start = stop
    return out


def class_factors(ratios: F64, distance: F64, blocks: NDArray[np.int64]) -> tuple[float, ...]:
    """
    Return the factor of each class of distance: its quantile of ``|error| / sd`` over 1.96.

    Errors within a block hang together, so a factor below 1 from few blocks is drawn to 1.

    Parameters
    ----------
    ratios : (n,) array of float64
        ``|error| / sd`` at held-out points.
    distance : (n,) array of float64
        Of these points to data, in spacings.
    blocks : (n,) array of int64
        Block in which each point lies.

    Returns
    -------
    factors : tuple of 5 float
        Of `MIDDLES`; a class of too few points has its neighbours' (1 when all have too few), but
        none below 1 beyond the last one that has enough.
    """
    number = np.searchsorted(CLASSES, distance, side="right")
    known, values = [], []
    for k in range(len(MIDDLES)):
        own = ratios[number == k]
        if len(own) >= MIN_POINTS:
            level = NEAR_LEVEL if k == 0 else GAP_LEVEL
            value = math.log(max(float(np.quantile(own, level)) / Z95, 0.05))
            n_blocks = len(np.unique(blocks[number == k]))
            known.append(math.log(MIDDLES[k]))
            values.append(value if value > 0 else value * n_blocks / (n_blocks + DOUBT))
    if not known:
        return (1.0,) * len(MIDDLES)
    logs = np.interp(np.log(MIDDLES), known, values)
    # farther than any held-out point, nothing speaks for intervals narrower than the model's
    far = np.log(MIDDLES) > known[-1]
    logs[far] = np.maximum(logs[far], 0.0)
    return tuple(float(value) for value in np.exp(logs))


def sigma_layer(
    points: SurfacePoints,
    grid: Grid,
    flag: NDArray[np.uint8],
    model: Model,
    scratch: Scratch,
) -> NDArray[np.float32]:
    """
    Return the standard error of the DEM's heights at the centres of its cells.

    Parameters
    ----------
    points : SurfacePoints
        The points of the DEM.
    grid : Grid
        Its cells.
    flag : (h, w) array of uint8
        What each cell is.
    model : Model
        From `fit`.
    scratch : Scratch
        Where grids live.

    Returns
    -------
    sigma : (h, w) array of float32
        Vertical unit, NaN where void. Of the surface's own height: a point measured there
        differs by its noise too.
    """
    from volatool.kernels import chance

    ensemble = Ensemble(points, model.tuned, grid, scratch)
    evidence = ensemble.evidence()
    out: NDArray[np.float32] = scratch.zeros((grid.height, grid.width), np.float32)
    left, top, cell = grid.exact
    coarse_left, coarse_top, _ = ensemble.coarse.exact
    corner = (round((coarse_top - top) / cell), round((left - coarse_left) / cell))
    for z in ensemble.surfaces(evidence):
        for start, stop in strips(grid.height, grid.width):
            chance.add_squares(z, ensemble.step, *corner, start, stop, out)
            scratch.relax(out, start, stop)
    evidence.free()
    distance = distance_cells(flag, MEASURED, scratch)
    cols = np.arange(grid.width) + 1.5
    for start, stop in strips(grid.height, grid.width):
        rows = np.arange(start, stop) + 1.5
        col, row = np.broadcast_arrays(cols[None, :], rows[:, None])
        away = distance[start:stop].astype(np.float64) * grid.cell
        values = np.sqrt(out[start:stop] / SAMPLES) * model.scale(col, row, away)
        values[flag[start:stop] == VOID] = np.nan
        out[start:stop] = values
        scratch.relax(distance, start, stop)
        scratch.relax(out, start, stop)
    scratch.free(distance)
    return out
