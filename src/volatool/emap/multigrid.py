"""The V-cycle: a hierarchy of grids that turns forces into heights, approximately."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from volatool.emap.system import Evidence, Springs, strips
from volatool.model import F64
from volatool.scratch import Scratch

COARSEST = 9
"""Side of a grid that is small enough to be solved directly."""

TOP = 4.0
"""Bound of the eigenvalues of ``diagonal^-1 H``: every spring holds at most 4 nodes' worth."""

BOTTOM = 0.06 * TOP
"""Where smoothing ends and the coarser grid takes over."""

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
    """

    data: NDArray[np.float32]
    right: NDArray[np.float32]
    x: NDArray[np.float32]
    d: NDArray[np.float32]
    kb: np.float32
    km: np.float32

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
    """

    def __init__(self, evidence: Evidence, springs: Springs, scratch: Scratch) -> None:
        from volatool.kernels import multigrid

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
        while max(height, width) > COARSEST:
            fine = self.levels[-1]
            height, width = (n // 2 + 1 if n > 1 else 1 for n in (height, width))
            coarse = self._level(height, width, float(fine.kb) / 4, float(fine.km))
            for start, stop in strips(*fine.shape):
                multigrid.coarsen_data(fine.data, coarse.data, start, stop)
                self._relax(start, stop, fine.data)
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
                level.data, unit, float(level.kb), float(level.km), 0, height, out, dots
            )
            matrix[:, k] = out.ravel()
            unit.flat[k] = 0.0
        multigrid.invert(matrix)
        return matrix

    def _relax(self, start: int, stop: int, *arrays: NDArray[Any]) -> None:
        for array in arrays:
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
                multigrid.restrict_residual(
                    level.data, level.right, level.x, level.kb, level.km, below.right, start, stop
                )
                self._relax(start, stop, level.data, level.right, level.x, level.d)
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
                    multigrid.smooth_first(*arrays, level.kb, level.km, beta, start, stop)
                else:
                    multigrid.smooth(*arrays, level.kb, level.km, alpha, beta, start, stop)
                self._relax(start, stop, *arrays)

    def _prolong(self, number: int, *, keep: bool) -> None:
        from volatool.kernels import multigrid

        level, below = self.levels[number], self.levels[number + 1]
        for start, stop in strips(*level.shape):
            multigrid.prolong(below.x, level.x, np.float32(keep), start, stop)
            self._relax(start, stop, level.x)

    def full(self) -> None:
        """Full multigrid: from the coarsest grid up, one V-cycle each, to the finest's ``x``."""
        from volatool.kernels import multigrid

        for fine, coarse in zip(self.levels, self.levels[1:], strict=False):
            for start, stop in strips(*fine.shape):
                multigrid.restrict_rows(fine.right, coarse.right, start, stop)
                self._relax(start, stop, fine.right)
        for number in range(len(self.levels) - 1, -1, -1):
            if number < len(self.levels) - 1:
                self._prolong(number, keep=False)
            self.cycle(number, is_zero=False)

    def free(self) -> None:
        """Give the memory back."""
        for level in self.levels:
            self.scratch.free(level.data, level.right, level.x, level.d)
        self.levels = []
