"""The V-cycle: a hierarchy of grids that turns forces into heights, approximately."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from volatool.emap.cuts import Cuts
from volatool.emap.system import Evidence, Springs
from volatool.emap.walk import Walk
from volatool.model import F64
from volatool.scratch import Scratch

COARSEST = 9
"""Side of a grid that is small enough to be solved directly."""

TOP = 4.0
"""Bound of the eigenvalues of ``diagonal^-1 H``: every spring holds at most 4 nodes' worth."""

BOTTOM = 0.06 * TOP
"""Where smoothing ends and the coarser grid takes over."""

LEAK = 1.0
"""Stiffness, in kb, of springs that stand for bending where the coarse grid is cut too much."""

STEPS = 3
"""Chebyshev steps before and after the coarser grid."""

NOTHING = np.zeros((0, 0), np.float32)
"""No coarser grid to come from or to go to."""


def chebyshev(steps: int = STEPS) -> list[tuple[float, float]]:
    """
    Return (alpha, beta) of each step ``d = alpha d + beta (right - H x) / diagonal``.

    The polynomial is the smallest on ``[BOTTOM, TOP]``. `TOP` needs no power iteration: for a
    spring ``(v . z)^2`` the Cauchy inequality gives at most ``sum |v|`` times its part of the
    diagonal, and that is 4 nodes for points, 4 and 3.2 at the rim and inside for bending.
    """
    middle, half = (TOP + BOTTOM) / 2, (TOP - BOTTOM) / 2
    sigma = middle / half
    rho = 1 / sigma
    result = [(0.0, 1 / middle)]
    for _ in range(steps - 1):
        after = 1 / (2 * sigma - rho)
        result.append((after * rho, 2 * after / half))
        rho = after
    return result


@dataclass(slots=True)
class Level:
    """
    One grid of the hierarchy, all float32.

    Parameters
    ----------
    data : (h, 5, w) array
        Data stencil.
    right, x : (h, w) arrays
        Right side, heights.
    kb, km : float32
        Stiffness on this grid.
    edges : (h, 3, w) array, optional
        Factors of cut springs, and the diagonal of what is left of them.
    spare : (h, w) array, optional
        Where threads put heights that others still read; changes places with x.
    """

    data: NDArray[np.float32]
    right: NDArray[np.float32]
    x: NDArray[np.float32]
    kb: np.float32
    km: np.float32
    edges: NDArray[np.float32] | None = None
    spare: NDArray[np.float32] | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        height, width = self.x.shape
        return height, width


class Hierarchy:
    """
    Grids from fine to coarse: springs re-discretised, data springs by Galerkin products.

    Parameters
    ----------
    evidence : Evidence
        Of the finest grid; read once.
    springs : Springs
        Of the finest grid. Coarser by 2: km stays, kb is a quarter.
    scratch : Scratch
        Where the grids live.
    cuts : Cuts, optional
        Springs that are missing. A coarse edge is as strong as the weakest fine one on its way.
    threads : int
        Threads that share the work; the heights are the same for any number.
    """

    def __init__(
        self,
        evidence: Evidence,
        springs: Springs,
        scratch: Scratch,
        cuts: Cuts | None = None,
        threads: int = 1,
    ) -> None:
        self.scratch = scratch
        self.walk = Walk(scratch, threads)
        self.steps = np.array(chebyshev(), np.float32)
        height, width = evidence.shape
        self.levels = [self._level(height, width, springs.kb, springs.km)]
        finest = self.levels[0]

        def copy(start: int, stop: int) -> None:
            finest.data[start:stop] = evidence.data[start:stop]

        self.walk.each(copy, height, width, finest.data, evidence.data)
        self.load(evidence)
        if cuts is not None:
            edges = finest.edges = self.scratch.zeros((height, 3, width), np.float32)

            def copy_edges(start: int, stop: int) -> None:
                edges[start:stop, :2] = cuts.edges[start:stop]

            self.walk.each(copy_edges, height, width, edges, cuts.edges)
            self._stiffen(finest)
        while max(height, width) > COARSEST:
            fine = self.levels[-1]
            height, width = (n // 2 + 1 if n > 1 else 1 for n in (height, width))
            coarse = self._level(height, width, float(fine.kb) / 4, float(fine.km))
            self._coarsen(fine, coarse)
            self.levels.append(coarse)
        self.inverse = self._invert(self.levels[-1])

    def load(self, evidence: Evidence) -> None:
        """Take the right side of evidence with the hierarchy's data springs."""
        finest = self.levels[0]

        def copy(start: int, stop: int) -> None:
            finest.right[start:stop] = evidence.right[start:stop]

        self.walk.each(copy, *finest.shape, finest.right, evidence.right)

    def _level(self, height: int, width: int, kb: float, km: float) -> Level:
        zeros = self.scratch.zeros
        shape = (height, width)
        level = Level(
            zeros((height, 5, width), np.float32),
            zeros(shape, np.float32),
            zeros(shape, np.float32),
            np.float32(kb),
            np.float32(km),
        )
        if len(self.walk.bands(height, width)) > 1:
            level.spare = zeros(shape, np.float32)
        return level

    def _coarsen(self, fine: Level, coarse: Level) -> None:
        """Set data and edges of the coarser grid."""
        from volatool.kernels import cut_multigrid, multigrid

        if fine.edges is None:
            self.walk.in_order(
                lambda start, stop: multigrid.coarsen_data(fine.data, coarse.data, start, stop),
                *fine.shape,
                *(fine.data, coarse.data),
            )
            return
        height, width = coarse.shape
        edges = coarse.edges = self.scratch.zeros((height, 3, width), np.float32)
        self.walk.in_order(
            lambda start, stop: cut_multigrid.coarsen_edges(fine.edges, edges, start, stop),
            *coarse.shape,
            *(edges, fine.edges),
        )
        self._stiffen(coarse)
        leak = np.float32(LEAK * fine.kb + fine.km)
        self.walk.in_order(
            lambda start, stop: cut_multigrid.cut_coarsen_data(
                fine.data, fine.edges, edges, leak, coarse.data, start, stop
            ),
            *fine.shape,
            *(fine.data, fine.edges, edges, coarse.data),
        )

    def _stiffen(self, level: Level) -> None:
        """Set the diagonal of the springs that are left."""
        from volatool.kernels import cut_spring

        self.walk.each(
            lambda *rows: cut_spring.cut_stiffness(level.edges, level.kb, level.km, *rows),
            *level.shape,
            level.edges,
        )

    @staticmethod
    def _invert(level: Level) -> F64:
        """Inverse of the coarsest grid's matrix, column by column from the operator."""
        from volatool.kernels import multigrid, spring

        height, width = level.shape
        n = height * width
        matrix = np.empty((n, n))
        unit, out, dots = np.zeros((height, width)), np.empty((height, width)), np.empty(height)
        for k in range(n):
            unit.flat[k] = 1.0
            spring.apply_rows(
                level.data,
                unit,
                float(level.kb),
                float(level.km),
                0,
                height,
                out,
                dots,
                level.edges,
            )
            matrix[:, k] = out.ravel()
            unit.flat[k] = 0.0
        multigrid.invert(matrix)
        return matrix

    def cycle(self, first: int = 0) -> None:
        """
        One V-cycle from a level down: ``x`` of the level from its ``right``.

        Parameters
        ----------
        first : int
            The level; 0 is the finest.
        """
        from volatool.kernels import multigrid

        last = len(self.levels) - 1
        for number in range(first, last):
            self._sweep(number, target=self.levels[number + 1].right)
        coarsest = self.levels[last]
        multigrid.solve_small(self.inverse, coarsest.right, coarsest.x)
        for number in range(last - 1, first - 1, -1):
            self._sweep(number, source=self.levels[number + 1].x, adds=True)

    def full(self) -> None:
        """Full multigrid: from the coarsest grid up, one V-cycle each, to the finest's ``x``."""
        from volatool.kernels import multigrid

        for fine, coarse in zip(self.levels, self.levels[1:], strict=False):
            arrays = (fine.right, coarse.right)
            edges = fine.edges
            self.walk.in_order(
                lambda *rows, arrays=arrays, edges=edges: multigrid.restrict_rows(
                    *arrays, *rows, edges
                ),
                *fine.shape,
                *(*arrays, edges),
            )
        last = len(self.levels) - 1
        self.cycle(last)
        for number in range(last - 1, -1, -1):
            below = self.levels[number + 1]
            self._sweep(number, source=below.x, target=below.right)
            self.cycle(number + 1)
            self._sweep(number, source=below.x, adds=True)

    def _sweep(
        self,
        number: int,
        *,
        source: NDArray[np.float32] = NOTHING,
        adds: bool = False,
        target: NDArray[np.float32] = NOTHING,
    ) -> None:
        """Smooth a level: from zero heights or coarse ones, and on to the coarser right side."""
        from volatool.kernels import sweep

        level = self.levels[number]
        height, width = level.shape
        out = level.x if level.spare is None else level.spare

        def walk(work: NDArray[np.float32], band: tuple[int, int], start: int, stop: int) -> None:
            sweep.sweep(
                level.data,
                level.right,
                level.x,
                out,
                level.kb,
                level.km,
                self.steps,
                source,
                adds,
                target,
                work,
                *band,
                start,
                stop,
                level.edges,
            )

        def walk_band(first: int, last: int) -> None:
            work = np.empty((sweep.WORK_ROWS, width), np.float32)
            self.walk.in_order(
                lambda *rows: walk(work, (first, last), *rows),
                height,
                width,
                *(level.data, level.right, level.x, out, level.edges, source, target),
                band=(first, last),
            )

        self.walk.at_once(walk_band, self.walk.bands(height, width))
        if level.spare is not None:
            level.x, level.spare = out, level.x

    def free(self) -> None:
        """Give the memory back."""
        for level in self.levels:
            for array in (level.data, level.right, level.x, level.edges, level.spare):
                if array is not None:
                    self.scratch.free(array)
        self.levels = []
        self.walk.close()
