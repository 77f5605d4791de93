"""Bare earth from unclassified points: an EMap surface that points above it hardly pull on.

A sheet is fitted to the lowest points of cells, from coarse to fine; what lies above it pulls
less and less, what lies below pulls in full. Points near the last sheet are ground. The constants
are those of one rule for all terrain, chosen on four of the ISPRS samples: [Sithole2004]_.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from fractions import Fraction
from functools import partial
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from volatool.dem.grid import Grid, grid_for
from volatool.emap.solve import solve
from volatool.emap.system import Evidence, Springs, strips, windows
from volatool.model import F64, I64, Bool, Progress, no_progress
from volatool.scratch import Scratch, Spool
from volatool.threads import Crew

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
        All points to fit, whatever their class; read once, or twice where the low guard drops any.
        At least one.
    metres_per_unit_xy, metres_per_unit_z : Fraction or None
        Of the CRS; None counts as 1.
    scratch : Scratch
        Where grids and points live.
    progress : callable
        Told (solves done, solves to do).
    threads : int
        Passes over points share their rows of cells among so many.

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
        threads: int = 1,
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
        self.crew = Crew(threads)
        self.limits: I64 | None = None
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
        from volatool.kernels import ground

        keep = np.empty(len(rows), np.bool_)
        limits = np.empty((0, 0), np.int64) if self.limits is None else self.limits
        work = partial(
            ground.near,
            self.z,
            rows,
            *self._stored(self.grid),
            self.cell_m,
            (ABOVE_M, ABOVE_PER_SLOPE, BELOW_M, BELOW_PER_SLOPE),
            self._lattice(self.grid if self.limits is None else self.low_grid),
            limits,
            keep,
        )
        for window in self._windows(self.z):
            self.crew.run(partial(work, *window), self.crew.shares(0, len(rows)))
            self.scratch.relax(self.z, *window)
            self.scratch.relax(limits)
        return keep

    def free(self) -> None:
        """Give the memory back and end the threads; the filter must not be used any more."""
        self.crew.close()
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

    def _lattice(self, grid: Grid) -> I64:
        return grid.lattice(self.scale, self.offset)

    def _stored(self, grid: Grid) -> tuple[I64, int, float]:
        """Return what the kernels make places and heights of stored points from."""
        return self._lattice(grid), self.zero, self.step_m

    def _windows(self, array: NDArray[Any]) -> list[tuple[int, int]]:
        """Row windows of an array to pass points in any order for: one, unless it is in a file."""
        return windows(self.scratch, *array.shape[:2], array)

    def _lowest(self, points: StoredPoints, cells_m: list[int]) -> list[Spool]:
        """Return the lowest point of each cell, by rows of cells, for each cell size."""
        best = self._lowest_of(points.pieces, self._grid(cells_m[-1]))
        if LOW_CELL_M in cells_m:
            self._guard(points, best, self._grid(cells_m[-1]))
        spools = [self._spooled(best)]
        for cell_m in reversed(cells_m[:-1]):
            # cells nest: the lowest of the finer cells' lowest
            spools.insert(
                0, self._spooled(self._lowest_of(_writable(spools[0]), self._grid(cell_m)))
            )
        return spools

    def _lowest_of(
        self, source: Callable[[], Iterable[NDArray[np.int32]]], grid: Grid
    ) -> NDArray[np.int32]:
        """Return the (h, w, 3) array of the lowest point of each cell."""
        from volatool.kernels import ground

        scratch = self.scratch
        best: NDArray[np.int32] = scratch.zeros((grid.height, grid.width, 3), np.int32)
        lattice = self._lattice(grid)
        for first, last in self._windows(best):
            best[first:last] = ground.NONE
            for rows in source():
                work = partial(ground.lowest, best, rows, lattice)
                self.crew.run(work, self.crew.shares(first, last))
            scratch.relax(best, first, last)
        return best

    def _spooled(self, best: NDArray[np.int32]) -> Spool:
        """Return the lowest points by rows of cells; their array is given back."""
        from volatool.kernels import ground

        spool = Spool(self.scratch, ROW, share=0.5)
        for start, stop in strips(*best.shape[:2]):
            spool.append(ground.take_lowest(best, start, stop))
            self.scratch.relax(best, start, stop)
        self.scratch.free(best)
        return spool

    def _guard(self, points: StoredPoints, best: NDArray[np.int32], grid: Grid) -> None:
        """Set the limits of the low guard, and replace lowest points that it drops."""
        from volatool.kernels import ground

        scratch = self.scratch
        self.low_grid = self._grid(LOW_CELL_M)
        lows = self._lowest_of(partial(self._taken, best), self.low_grid)
        self.limits = self._low_limits(lows)
        scratch.free(lows)
        if self.limits is None:
            return
        again = scratch.zeros(best.shape[:2], np.uint8)
        lattices = self._lattice(grid), self._lattice(self.low_grid)
        n_again = 0
        for start, stop in strips(*again.shape):
            n_again += ground.drop_low(best, lattices[1], self.limits, start, stop, again)
            for array in (best, again):
                scratch.relax(array, start, stop)
            scratch.relax(self.limits)
        for first, last in self._windows(best) if n_again else ():
            for rows in points.pieces():
                arrays = (best, rows, lattices[0], again, lattices[1], self.limits)
                self.crew.run(partial(ground.lowest_again, *arrays), self.crew.shares(first, last))
            for array in (best, again):
                scratch.relax(array, first, last)
            scratch.relax(self.limits)
        scratch.free(again)

    def _taken(self, best: NDArray[np.int32]) -> Iterator[NDArray[np.int32]]:
        """Yield lowest points by rows of cells."""
        from volatool.kernels import ground

        for start, stop in strips(*best.shape[:2]):
            yield ground.take_lowest(best, start, stop)
            self.scratch.relax(best, start, stop)

    def _low_limits(self, lows: NDArray[np.int32]) -> I64 | None:
        """Return the limits of the low guard; None without any."""
        from volatool.kernels import ground

        scratch, shape = self.scratch, lows.shape[:2]
        drop = LOW_DROP_M / self.step_m
        found: I64 = scratch.zeros(shape, np.int64)
        limits: I64 = scratch.zeros(shape, np.int64)
        for start, stop in strips(*shape):
            ground.low_limits(lows, drop, LOW_REACH, LOW_PART, start, stop, found)
            for array in (lows, found):
                scratch.relax(array, start, stop)
        is_any = False
        for start, stop in strips(*shape):
            ground.spare_large(found, LOW_GROUP, start, stop, limits)
            is_any = is_any or bool(np.any(limits[start:stop] > ground.NO_LIMIT))
            scratch.relax(found, start, stop)
            scratch.relax(limits, start, stop)
        scratch.free(found)
        if is_any:
            return limits
        scratch.free(limits)
        return None

    # the sheet

    def _fit(self, spool: Spool, is_first: bool) -> None:
        """Solve once more, with weights from the sheet so far."""
        from volatool.kernels import ground

        evidence = Evidence(self.grid.height, self.grid.width, self.scratch)
        sheet = np.empty((0, 0)) if is_first else self.z
        for rows in _writable(spool)():
            work = partial(
                ground.pull,
                evidence.data,
                evidence.right,
                rows,
                *self._stored(self.grid),
                sheet,
                self.cell_m,
                TAU_M,
                TAU_PER_SLOPE * self.cell_m,
            )
            for window in self._reached(rows, evidence):
                self.crew.run(work, self.crew.shares(*window))
                evidence.relax()
                self.scratch.relax(sheet)
        start = None if is_first else self.z
        z, _ = solve(
            evidence,
            SPRINGS,
            tol=TOLERANCE_M,
            start=start,
            consume=True,
            threads=self.crew.threads,
        )
        if start is not None:
            self.scratch.free(start)
        self.z = z

    def _reached(self, rows: NDArray[np.int32], evidence: Evidence) -> Iterator[tuple[int, int]]:
        """Yield the windows of the evidence that points in the order of its rows pull on."""
        _, ends = self.grid.places(rows[[0, -1]], self.scale, self.offset)
        for first, last in evidence.windows():
            if first <= ends[1] + 1 and last >= ends[0] - 1:
                yield first, last

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
