"""The points' own noise, from what the surface leaves and from what it could follow."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from volatool.emap.solve import solve
from volatool.emap.system import Evidence, Springs, windows
from volatool.errors import OptionError
from volatool.model import F64
from volatool.scratch import Scratch

BLOCK_CELLS = 16
"""Cells a side of the blocks over which noise is summed."""

MAX_FREEDOM = 0.95
"""Above this part of the points the surface follows them all, and residuals say nothing."""

TOL = 1e-2
"""Stop of the solve for the degrees of freedom; signs are 1."""

PRIOR_POINTS = 50.0
"""Points' worth of the whole's sigma in each region's."""

KAPPA, ELL_M = 15.0, 10.0
"""Springs of `fixed_point`."""

ROUNDS = 4

SALT = 2
"""Salt of the random signs."""

Readings = Callable[[], Iterable[tuple[NDArray[np.int32], F64, F64, F64]]]
"""Yields stored points, their places (col, row) in cells and their heights."""


@dataclass(frozen=True, slots=True)
class Noise:
    """
    Noise of the points, by block of cells and as a whole.

    Parameters
    ----------
    sums : (h, w, 3) array of float64
        Number of points, squared residuals, degrees of freedom of each block.
    block : int
        Cells a side of a block.
    """

    sums: F64
    block: int

    @property
    def n_points(self) -> int:
        """Points that were read."""
        return int(self.sums[..., 0].sum())

    @property
    def residual_rms(self) -> float:
        """Root mean square of point minus surface."""
        return math.sqrt(self.sums[..., 1].sum() / max(1, self.n_points))

    @property
    def freedom(self) -> float:
        """Degrees of freedom that the surface spends per point."""
        return float(self.sums[..., 2].sum() / max(1, self.n_points))

    @property
    def sigma(self) -> float | None:
        """``sqrt(sum r^2 / (n - edf))``; None when the surface follows all points."""
        if not self.n_points or self.freedom > MAX_FREEDOM:
            return None
        return self.residual_rms / math.sqrt(1 - max(0.0, self.freedom))

    def map(self) -> F64:
        """
        Return sigma by block, smooth, drawn to the whole's where points are few.

        Returns
        -------
        sigma : (h, w) array of float64
            Of each block; the whole's everywhere when that is not known by blocks, NaN when it is
            not known at all.
        """
        whole = self.sigma
        if whole is None:
            return np.full(self.sums.shape[:2], np.nan)
        n, squares, freedom = (_smooth(self.sums[..., k]) for k in range(3))
        rest = 1 - max(0.0, self.freedom)
        left = np.maximum(n - freedom, (1 - MAX_FREEDOM) * n)
        drawn = PRIOR_POINTS * rest
        return np.asarray(np.sqrt((squares + drawn * whole**2) / (left + drawn)))


def _smooth(values: F64) -> F64:
    """Sum with the neighbours by the binomial weights 1, 4, 6, 4, 1 over 16, along both axes."""
    for axis in range(2):
        padding = [(0, 0), (0, 0)]
        padding[axis] = (2, 2)
        wide = np.pad(values, padding)
        n = values.shape[axis]
        parts = (np.take(wide, range(k, k + n), axis) for k in range(5))
        values = np.asarray(sum(f * part for f, part in zip((1, 4, 6, 4, 1), parts, strict=True)))
        values = values / 16
    return values


def signs(rows: NDArray[np.int32]) -> F64:
    """
    Return a random -1 or 1 for each point, that hangs on its stored integers.

    Parameters
    ----------
    rows : (n, 3) array of int32
        Stored x, y, z.
    """
    from volatool.kernels import chance

    bits = np.empty(len(rows), np.uint64)
    chance.hash_rows(rows, SALT, bits)
    return np.where(bits & np.uint64(1), 1.0, -1.0)


def answer(
    shape: tuple[int, int], springs: Springs, readings: Readings, scratch: Scratch | None = None
) -> F64:
    """
    Return the surface through random signs in place of the points' heights.

    Parameters
    ----------
    shape : tuple of 2 int
        Rows and columns of the grid.
    springs : Springs
        Of the surface whose degrees of freedom are wanted.
    readings : callable
        Points.
    scratch : Scratch, optional
        Where grids live.

    Returns
    -------
    z : (h, w) array of float64
        For `measure`; in the scratch, give it back with ``scratch.free``.
    """
    evidence = Evidence(*shape, scratch)
    for first, last in evidence.windows():
        for rows, col, row, _ in readings():
            evidence.add(col, row, signs(rows), springs, (first, last))
        evidence.relax(first, last)
    z, _ = solve(evidence, springs, tol=TOL, consume=True)
    return z


def measure(
    springs: Springs,
    readings: Readings,
    z: F64,
    freedom: F64,
    block: int = BLOCK_CELLS,
    scratch: Scratch | None = None,
) -> Noise:
    """
    Return the noise from a surface and the `answer` to signs.

    Degrees of freedom by one random vector of signs v over the points: ``v . S v``, with S v the
    surface's answer at the points [Hutchinson1990].

    Parameters
    ----------
    springs : Springs
        For the attachment.
    readings : callable
        Points.
    z, freedom : (h, w) arrays of float64
        The surface; the answer.
    block : int
        Cells a side of a block.
    scratch : Scratch, optional
        Where the two grids live.
    """
    from volatool.kernels import chance, spring

    height, width = z.shape
    scratch = Scratch() if scratch is None else scratch
    sums = np.zeros((-(-height // block), -(-width // block), 3))
    for rows, col, row, heights in readings():
        residuals, freedoms = np.empty(len(rows)), np.empty(len(rows))
        for first, last in windows(scratch, height, width, z, freedom):
            spring.interpolate(z, col, row, springs.is_nearest, first, last, residuals)
            spring.interpolate(freedom, col, row, springs.is_nearest, first, last, freedoms)
            scratch.relax(z, first, last)
            scratch.relax(freedom, first, last)
        np.subtract(heights, residuals, out=residuals)
        freedoms *= signs(rows)
        chance.add_to_blocks(col, row, residuals, freedoms, block, sums)
    return Noise(sums, block)


def fixed_point(
    readings: Readings,
    shape: tuple[int, int],
    cell: float,
    *,
    kappa: float = KAPPA,
    ell: float = ELL_M,
    start: float = 0.1,
    rounds: int = ROUNDS,
    tol: float = 1e-3,
    scratch: Scratch | None = None,
) -> tuple[float, Springs]:
    """
    Return the noise and the springs that agree: ``kb cell^2 / w = kappa sigma^2``.

    Parameters
    ----------
    readings : callable
        Points and their places on the grid, heights counted from near their mean.
    shape : tuple of 2 int
        Rows and columns of the grid.
    cell : float
        Its cell, in metres as all lengths here.
    kappa : float
        Stiffness of the surface in units of the noise.
    ell : float
        Length beyond which tension rules over bending.
    start : float
        First guess of sigma.
    rounds : int
        Solves; four give two digits.
    tol : float
        Stop of each solve.
    scratch : Scratch, optional
        Where grids live.

    Returns
    -------
    sigma : float
        Noise of the points.
    springs : Springs
        Of the last solve.

    Raises
    ------
    OptionError
        The points leave nothing to tell noise from terrain by.
    """
    sigma = start
    springs = Springs(1.0, 0.0)
    evidence = Evidence(*shape, scratch)
    for first, last in evidence.windows():
        for _, col, row, heights in readings():
            evidence.add(col, row, heights, springs, (first, last))
    for _ in range(rounds):
        ratio = kappa * sigma**2
        springs = replace(springs, kb=ratio / cell**2, km=ratio / ell**2)
        z, _ = solve(evidence, springs, tol=tol)
        freedom = answer(shape, springs, readings, evidence.scratch)
        noise = measure(springs, readings, z, freedom, scratch=evidence.scratch)
        evidence.scratch.free(z, freedom)
        if noise.sigma is None:
            raise OptionError("the points are too few to tell noise from terrain")
        sigma = max(noise.sigma, 1e-6 * start)
    evidence.free()
    return sigma, springs
