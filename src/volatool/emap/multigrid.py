"""The V-cycle: a hierarchy of grids that turns forces into heights, approximately."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from volatool.emap.cuts import Cuts
from volatool.emap.system import Evidence, Springs, strips
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
    right, x, d : (h, w) arrays
        Right side, heights, last smoothing step.
    kb, km : float32
        Stiffness on this grid.
    edges : (h, 3, w) array, optional
        Factors of cut springs, and the diagonal of what is left of them.
    """

    data: NDArray[np.float32]
    right: NDArray[np.float32]
    x: NDArray[np.float32]
    d: NDArray[np.float32]
    kb: np.float32
    km: np.float32
    edges: NDArray[np.float32] | None = None

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
    """

    def __init__(
        self, evidence: Evidence, springs: Springs, scratch: Scratch, cuts: Cuts | None = None
    ) -> None:

        self.scratch = scratch
        self.steps = [(np.float32(alpha), np.float32(beta)) for alpha, beta in chebyshev()]
        height, width = evidence.shape
        self.levels = [self._level(height, width, springs.kb, springs.km)]
        finest = self.levels[0]
        for start, stop in strips(height, width):
            finest.data[start:stop] = evidence.data[start:stop]
            finest.right[start:stop] = evidence.right[start:stop]
            evidence.relax(start, stop)
            self._relax(start, stop, finest.data, finest.right)
        if cuts is not None:
            finest.edges = self.scratch.zeros((height, 3, width), np.float32)
            for start, stop in strips(height, width):
                finest.edges[start:stop, :2] = cuts.edges[start:stop]
                self._relax(start, stop, finest.edges, cuts.edges)
            self._stiffen(finest)
        while max(height, width) > COARSEST:
            fine = self.levels[-1]
            height, width = (n // 2 + 1 if n > 1 else 1 for n in (height, width))
            coarse = self._level(height, width, float(fine.kb) / 4, float(fine.km))
            self._coarsen(fine, coarse)
            self.levels.append(coarse)
        self.inverse = self._invert(self.levels[-1])

    def load(self, evidence: Evidence) -> None:
        """Take the right side of other evidence with the same data springs."""
        finest = self.levels[0]
        for start, stop in strips(*finest.shape):
            finest.right[start:stop] = evidence.right[start:stop]
            self._relax(start, stop, finest.right)

    def _level(self, height: int, width: int, kb: float, km: float) -> Level:
        zeros = self.scratch.zeros
        shape = (height, width)
        return Level(
            zeros((height, 5, width), np.float32),
            zeros(shape, np.float32),
            zeros(shape, np.float32),
            zeros(shape, np.float32),
            np.float32(kb),
            np.float32(km),
        )

    def _coarsen(self, fine: Level, coarse: Level) -> None:
        """Set data and edges of the coarser grid."""
        from volatool.kernels import cut_multigrid, multigrid

        if fine.edges is None:
            for start, stop in strips(*fine.shape):
                multigrid.coarsen_data(fine.data, coarse.data, start, stop)
                self._relax(start, stop, fine.data)
            return
        height, width = coarse.shape
        coarse.edges = self.scratch.zeros((height, 3, width), np.float32)
        for start, stop in strips(height, width):
            cut_multigrid.coarsen_edges(fine.edges, coarse.edges, start, stop)
            self._relax(2 * start, min(2 * stop, len(fine.edges)), fine.edges)
        self._stiffen(coarse)
        leak = np.float32(LEAK * fine.kb + fine.km)
        for start, stop in strips(*fine.shape):
            cut_multigrid.cut_coarsen_data(
                fine.data, fine.edges, coarse.edges, leak, coarse.data, start, stop
            )
            self._relax(start, stop, fine.data, fine.edges)

    def _stiffen(self, level: Level) -> None:
        """Set the diagonal of the springs that are left."""
        from volatool.kernels import cut_spring

        assert level.edges is not None
        for start, stop in strips(*level.shape):
            cut_spring.cut_stiffness(level.edges, level.kb, level.km, start, stop)
            self._relax(start, stop, level.edges)

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

    def _relax(self, start: int, stop: int, *arrays: NDArray[Any] | None) -> None:
        for array in arrays:
            if array is not None:
                self.scratch.relax(array, start, stop)

    def cycle(self, first: int = 0, is_zero: bool = True) -> None:
        """
        One V-cycle from a level down: ``x`` of the level from its ``right``.

        Parameters
        ----------
        first : int
            The level; 0 is the finest.
        is_zero : bool
            Start from zero heights instead of the level's present ones.
        """
        from volatool.kernels import multigrid

        last = len(self.levels) - 1
        for number in range(first, last):
            level, below = self.levels[number], self.levels[number + 1]
            self._smooth(level, is_zero or number > first)
            for start, stop in strips(*level.shape):
                arrays = (level.data, level.right, level.x)
                multigrid.restrict_residual(
                    *arrays, level.kb, level.km, below.right, start, stop, level.edges
                )
                self._relax(start, stop, *arrays, level.d, level.edges)
        coarsest = self.levels[last]
        multigrid.solve_small(self.inverse, coarsest.right, coarsest.x)
        for number in range(last - 1, first - 1, -1):
            self._prolong(number, keep=True)
            self._smooth(self.levels[number], is_zero=False)

    def _smooth(self, level: Level, is_zero: bool) -> None:
        from volatool.kernels import multigrid

        for number, (alpha, beta) in enumerate(self.steps):
            for start, stop in strips(*level.shape):
                arrays = (level.data, level.right, level.x, level.d)
                if is_zero and number == 0:
                    multigrid.smooth_first(
                        *arrays, level.kb, level.km, beta, start, stop, level.edges
                    )
                else:
                    multigrid.smooth(
                        *arrays, level.kb, level.km, alpha, beta, start, stop, level.edges
                    )
                self._relax(start, stop, *arrays, level.edges)

    def _prolong(self, number: int, *, keep: bool) -> None:
        from volatool.kernels import cut_multigrid, multigrid

        level, below = self.levels[number], self.levels[number + 1]
        factor = np.float32(keep)
        for start, stop in strips(*level.shape):
            if level.edges is None:
                multigrid.prolong(below.x, level.x, factor, start, stop)
            else:
                cut_multigrid.cut_prolong(below.x, level.x, factor, level.edges, start, stop)
            self._relax(start, stop, level.x, level.edges)

    def full(self) -> None:
        """Full multigrid: from the coarsest grid up, one V-cycle each, to the finest's ``x``."""
        from volatool.kernels import multigrid

        for fine, coarse in zip(self.levels, self.levels[1:], strict=False):
            for start, stop in strips(*fine.shape):
                multigrid.restrict_rows(fine.right, coarse.right, start, stop, fine.edges)
                self._relax(start, stop, fine.right, fine.edges)
        for number in range(len(self.levels) - 1, -1, -1):
            if number < len(self.levels) - 1:
                self._prolong(number, keep=False)
            self.cycle(number, is_zero=False)

    def free(self) -> None:
        """Give the memory back."""
        for level in self.levels:
            self.scratch.free(level.data, level.right, level.x, level.d)
            if level.edges is not None:
                self.scratch.free(level.edges)
        self.levels = []
