"""Bare earth from unclassified points: an EMap surface that points above it hardly pull on.

A sheet is fitted to the lowest points of cells, from coarse to fine; what lies above it pulls
less and less, what lies below pulls in full. Points near the last sheet are ground. The constants
are those of one rule for all terrain, chosen on four of the ISPRS samples: [Sithole2004]_.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from fractions import Fraction
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from volatool.dem.grid import Grid, grid_for
from volatool.emap.solve import solve
from volatool.emap.system import STRIP_CELLS, Evidence, Springs, strips
from volatool.model import F64, I64, Bool, Progress, no_progress
from volatool.scratch import Scratch, Spool

CELLS_M = (16, 8, 4, 2, 1)
"""Edges of the cells in metres, coarse to fine; each is twice the next, so that cells nest."""

ROUNDS = 3
"""Solves per cell size, each with weights from the one before."""

SPRINGS = Springs(kb=0.3, km=0.3 / 30**2)
"""Bending ``kb c^2 / w = 0.3 c^2`` and tension over 30 cells, per unit of cell."""

TOLERANCE_M = 0.02
"""Stop of the solves: far below the tolerances of the decisions."""

TAU_M, TAU_PER_SLOPE = 0.3, 0.8
"""A point pulls in full up to ``0.3 m + 0.8 cell min(slope, 1)`` above the sheet."""

BELOW_M, BELOW_PER_SLOPE = 1.0, 1.0
ABOVE_M, ABOVE_PER_SLOPE = 0.4, 0.8
"""Ground is from ``-(1 + slope)`` to ``0.4 + 0.8 slope`` metres of the last sheet, exclusive.

That is for its cells of 1 m; where sparse points leave larger cells, the slope counts so much more.
"""

LOW_CELL_M = 2
LOW_DROP_M = 3.0
LOW_REACH = 5
LOW_PART = 0.1
LOW_GROUP = 12
"""Low guard: in cells of 2 m, points 3 m below the 10th percentile of the lowest points of the
11 x 11 cells around, when at most 12 such cells stand together, are no ground and not fitted.

The percentile must be that of a wide window: an opening of the surface takes the ground seen
through a canopy for outliers.
"""

CELLS_PER_POINT = 64
"""Cells finer than points 8 cells apart tell nothing more and are left out."""

MAX_SPARSE_CELLS = 1 << 20
"""Of few points that spread over more coarse cells than this, the coarse cells are larger."""

ROW = np.dtype((np.int32, (3,)))


class StoredPoints(Protocol):
    """
    Points as a file stores them, as often as wanted: `volatool.dem.gather.SurfacePoints`.

    Attributes
    ----------
    scale, offset : tuple of 3 float
        Of the stored integers.
    z_range : tuple of 2 int
        Smallest and largest stored z.
    box : tuple of 4 Fraction or None
        Exact left, bottom, right, top.
    """

    @property
    def scale(self) -> tuple[float, float, float]:
        """Scale of x, y, z."""
        ...

    @property
    def offset(self) -> tuple[float, float, float]:
        """Offset of x, y, z."""
        ...

    @property
    def z_range(self) -> tuple[int, int]:
        """Smallest and largest stored z."""
        ...

    @property
    def box(self) -> tuple[Fraction, Fraction, Fraction, Fraction] | None:
        """Exact left, bottom, right, top."""
        ...

    def __len__(self) -> int: ...

    def pieces(self) -> Iterable[NDArray[np.int32]]:
        """Yield (n, 3) arrays of int32 x, y, z."""
        ...


class GroundFilter:
    """
    The bare-earth sheet under a file's points, and which of them are ground.

    The result depends on the set of points alone: not on their order nor on how they come in
    pieces (two points of a cell at the same height: the one of smaller x, then y, is fitted).

    Parameters
    ----------
    points : StoredPoints
        All points to fit, whatever their class; read twice. At least one.
    metres_per_unit_xy, metres_per_unit_z : Fraction or None
        Of the CRS; None counts as 1.
    scratch : Scratch
        Where grids and points live.
    progress : callable
        Told (solves done, solves to do).

    Attributes
    ----------
    grid : Grid
        Nodes of the sheet, in units of the CRS.
    z : (h, w) array of float64
        Heights of the sheet in metres above `zero`.
    zero : int
        Stored z that heights are counted from.
    limits : (h, w) array of int64, or None
        Of the low guard, on `low_grid`: smaller stored z are no ground.

    Raises
    ------
    ResourceError
        ``E_SIZE``: the points spread too far.
    """

    def __init__(
        self,
        points: StoredPoints,
        metres_per_unit_xy: Fraction | None = None,
        metres_per_unit_z: Fraction | None = None,
        scratch: Scratch | None = None,
        progress: Progress = no_progress,
    ) -> None:
        if points.box is None or not len(points):
            raise ValueError("the ground filter needs points")
        self.scratch = Scratch() if scratch is None else scratch
        self.scale, self.offset = points.scale, points.offset
        self.unit = metres_per_unit_xy or Fraction(1)
        self.step_m = points.scale[2] * float(metres_per_unit_z or 1)
        self.zero = sum(points.z_range) // 2
        self._box = points.box
        self._n_points = len(points)
        self.limits: I64 | None = None
        if self._n_cells(LOW_CELL_M) <= CELLS_PER_POINT * self._n_points:
            self.low_grid = grid_for(self._box, LOW_CELL_M / self.unit)
            self.limits = self._low_limits(points)
        cells_m = self._cells_m()
        spools = self._lowest(points, cells_m)
        before: Grid | None = None
        for number, (cell_m, spool) in enumerate(zip(cells_m, spools, strict=True)):
            self.grid = self._grid(cell_m).padded(1)  # all points have four nodes about them
            self.cell_m = float(cell_m)
            if before is not None:
                self.z = self._refined(before)
            for turn in range(ROUNDS):
                self._fit(spool, is_first=before is None and turn == 0)
                progress(number * ROUNDS + turn + 1, len(cells_m) * ROUNDS)
            spool.close()
            before = self.grid

    def keeps(self, rows: NDArray[np.int32]) -> Bool:
        """
        Return which points are ground.

        Parameters
        ----------
        rows : (n, 3) array of int32, C-contiguous
            Stored x, y, z; of the points that were fitted.

        Returns
        -------
        ground : (n,) array of bool
            Near the sheet and not below the low guard's limit.
        """
        fit, slope = np.empty(len(rows)), np.zeros(len(rows))
        self._read(rows, fit, slope)
        rise = self._heights(rows) - fit
        slope *= self.cell_m
        ground: Bool = rise < ABOVE_M + ABOVE_PER_SLOPE * slope
        ground &= rise > -(BELOW_M + BELOW_PER_SLOPE * slope)
        self._drop_low(rows, ground)
        return ground

    def free(self) -> None:
        """Give the memory back; the filter must not be used any more."""
        self.scratch.free(self.z)
        if self.limits is not None:
            self.scratch.free(self.limits)

    # lowest points

    def _grid(self, cell_m: int) -> Grid:
        return grid_for(self._box, cell_m / self.unit)

    def _n_cells(self, cell_m: int) -> Fraction:
        left, bottom, right, top = self._box
        return (right - left) * (top - bottom) * self.unit**2 / cell_m**2

    def _cells_m(self) -> list[int]:
        """Return the cells, coarse to fine, that are not much finer than the points."""
        most = CELLS_PER_POINT * self._n_points
        coarsest = CELLS_M[0]
        while self._n_cells(coarsest) > max(most, MAX_SPARSE_CELLS):
            coarsest *= 2
        finer = [cell for cell in CELLS_M[1:] if self._n_cells(cell) <= most]
        return [coarsest, *finer]

    def _windows(self, height: int, width: int) -> list[tuple[int, int]]:
        """Row windows to pass points in any order for: one, unless arrays are in files."""
        cells = 4 * STRIP_CELLS if self.scratch.spilled_bytes else height * width
        return list(strips(height, width, cells))

    def _extremes(
        self, pieces: Iterable[NDArray[np.int32]], grid: Grid, first: int, last: int,
        best: NDArray[np.int32], counts: NDArray[np.uint32],
    ) -> None:  # fmt: skip
        """Find the lowest point of each cell of some rows."""
        from volatool.kernels import binning

        for rows in pieces:
            col, row = grid.places(rows, self.scale, self.offset)
            binning.extreme(rows, col, row, 1, first, last, best, counts)
        self.scratch.relax(best, first, last)
        self.scratch.relax(counts, first, last)

    def _low_limits(self, points: StoredPoints) -> I64 | None:
        """Return the limits of the low guard; None without any."""
        from volatool.kernels import ground

        scratch, shape = self.scratch, (self.low_grid.height, self.low_grid.width)
        best = scratch.zeros((*shape, 3), np.int32)
        counts = scratch.zeros(shape, np.uint32)
        for first, last in self._windows(*shape):
            self._extremes(points.pieces(), self.low_grid, first, last, best, counts)
        drop = LOW_DROP_M / self.step_m
        found: I64 = scratch.zeros(shape, np.int64)
        limits: I64 = scratch.zeros(shape, np.int64)
        for start, stop in strips(*shape):
            ground.low_limits(best, counts, drop, LOW_REACH, LOW_PART, start, stop, found)
            for array in (best, counts, found):
                scratch.relax(array, start, stop)
        scratch.free(best, counts)
        is_any = False
        for start, stop in strips(*shape):
            ground.spare_large(found, LOW_GROUP, start, stop, limits)
            is_any = is_any or bool(np.any(limits[start:stop] > np.iinfo(np.int64).min))
            scratch.relax(found, start, stop)
            scratch.relax(limits, start, stop)
        scratch.free(found)
        if is_any:
            return limits
        scratch.free(limits)
        return None

    def _drop_low(self, rows: NDArray[np.int32], keep: Bool) -> None:
        """Clear the flag of points that the low guard drops."""
        from volatool.kernels import ground

        if self.limits is None:
            return
        col, row = self.low_grid.places(rows, self.scale, self.offset)
        for first, last in self._windows(*self.limits.shape):
            ground.not_low(rows, col, row, self.limits, first, last, keep)
            self.scratch.relax(self.limits, first, last)

    def _not_low(self, pieces: Iterable[NDArray[np.int32]]) -> Iterator[NDArray[np.int32]]:
        for rows in pieces:
            keep = np.ones(len(rows), np.bool_)
            self._drop_low(rows, keep)
            yield rows if keep.all() else rows[keep]

    def _lowest(self, points: StoredPoints, cells_m: list[int]) -> list[Spool]:
        """Return the lowest point of each cell, by rows of cells, for each cell size."""
        spools: list[Spool] = []
        source: Callable[[], Iterable[NDArray[np.int32]]] = points.pieces
        for cell_m in reversed(cells_m):
            spool = self._lowest_of(source, self._grid(cell_m), is_all=not spools)
            spools.insert(0, spool)
            source = _writable(spool)  # cells nest: the lowest of the finer cells' lowest
        return spools

    def _lowest_of(
        self, source: Callable[[], Iterable[NDArray[np.int32]]], grid: Grid, is_all: bool
    ) -> Spool:
        from volatool.kernels import binning

        scratch, shape = self.scratch, (grid.height, grid.width)
        best = scratch.zeros((*shape, 3), np.int32)
        counts = scratch.zeros(shape, np.uint32)
        spool = Spool(scratch, ROW, share=0.5)
        for first, last in self._windows(*shape):
            pieces = self._not_low(source()) if is_all else source()
            self._extremes(pieces, grid, first, last, best, counts)
            for start, stop in strips(last - first, shape[1]):
                spool.append(binning.take_extremes(best, counts, first + start, first + stop))
            scratch.relax(best, first, last)
            scratch.relax(counts, first, last)
        scratch.free(best, counts)
        return spool

    # the sheet

    def _heights(self, rows: NDArray[np.int32]) -> F64:
        """Heights in metres above `zero`."""
        return np.asarray((rows[:, 2] - np.int64(self.zero)) * self.step_m, np.float64)

    def _read(self, rows: NDArray[np.int32], fit: F64, slope: F64) -> None:
        """Set height and slope of the sheet at points."""
        from volatool.kernels import ground, spring

        col, row = self.grid.places(rows, self.scale, self.offset)
        for first, last in self._windows(*self.z.shape):
            spring.interpolate(self.z, col, row, False, first, last, fit)
            ground.slopes(self.z, col, row, self.cell_m, first, last, slope)
            self.scratch.relax(self.z, first, last)

    def _fit(self, spool: Spool, is_first: bool) -> None:
        """Solve once more, with weights from the sheet so far."""
        from volatool.kernels import ground

        evidence = Evidence(self.grid.height, self.grid.width, self.scratch)
        for rows in _writable(spool)():
            weights: F64 | None = None
            heights = self._heights(rows)
            if not is_first:
                fit, slope = np.empty(len(rows)), np.empty(len(rows))
                self._read(rows, fit, slope)
                weights = np.empty(len(rows))
                ground.pulls(heights - fit, slope, TAU_M, TAU_PER_SLOPE * self.cell_m, weights)
            col, row = self.grid.places(rows, self.scale, self.offset)
            evidence.add(col, row, heights, SPRINGS, weights=weights)
            evidence.relax()
        start = None if is_first else self.z
        z, _ = solve(evidence, SPRINGS, tol=TOLERANCE_M, start=start, consume=True)
        if start is not None:
            self.scratch.free(start)
        self.z = z

    def _refined(self, coarse: Grid) -> F64:
        """Return the sheet on the present grid, read bilinearly from a coarser one."""
        from volatool.kernels import spring

        fine, scratch = self.grid, self.scratch
        z: F64 = scratch.zeros((fine.height, fine.width), np.float64)
        left, top, cell = (float(value) for value in _place(fine, coarse))
        col = left + (np.arange(fine.width) + 0.5) * cell
        for start, stop in strips(fine.height, fine.width):
            row = top + (np.arange(start, stop) + 0.5) * cell
            out = np.empty(len(row) * fine.width)
            places = np.tile(col, len(row)), np.repeat(row, fine.width)
            spring.interpolate(self.z, *places, False, 0, coarse.height, out)
            z[start:stop] = out.reshape(len(row), fine.width)
            scratch.relax(z, start, stop)
            scratch.relax(self.z)
        scratch.free(self.z)
        return z


def _writable(spool: Spool) -> Callable[[], Iterator[NDArray[np.int32]]]:
    """Rows read back from a file are read-only, which would be another kernel signature."""

    def pieces() -> Iterator[NDArray[np.int32]]:
        for rows in spool.pieces():
            yield rows if rows.flags.writeable else rows.copy()

    return pieces


def _place(fine: Grid, coarse: Grid) -> tuple[Fraction, Fraction, Fraction]:
    """Return where a grid's corner is in another's cells, and how large its cells are there."""
    left, top, cell = fine.exact
    coarse_left, coarse_top, coarse_cell = coarse.exact
    return (
        (left - coarse_left) / coarse_cell,
        (coarse_top - top) / coarse_cell,
        cell / coarse_cell,
    )
