"""Points that can't be ground, found by rounds of a net that trusts far-off points ever less."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from volatool.dem.fit import readings
from volatool.dem.gather import SurfacePoints
from volatool.dem.grid import Grid
from volatool.emap.solve import solve
from volatool.emap.system import Evidence, Springs
from volatool.model import F64
from volatool.scratch import Scratch

HUBER_ROUNDS, CUT_ROUNDS = 3, 3
"""Rounds in which far-off points pull with a constant force; then hardly at all."""

LIMIT_SIGMAS, LEAST_M = 4.0, 0.3
"""A point is far off beyond so many robust standard deviations, and at least so many metres."""

LEFT = 1e-6
"""Weight that a far-off point keeps: it holds a surface that hangs on nothing else, and is far too
little for the soft net to follow it."""

MAX_RESIDUALS = 1 << 20
"""The median is of every n-th residual, so that there are no more than this."""

TOL_M = 2e-3
"""Stop of a round's solve."""


@dataclass(frozen=True, slots=True)
class Robust:
    """
    What tells good points from far-off ones.

    Parameters
    ----------
    z : (h, w) array of float64
        Surface of the last round; free it after use.
    tau : float
        A point farther from it is far off, vertical unit.
    is_nearest : bool
        How points read the surface.
    n_far : int
        Points that are.
    """

    z: F64
    tau: float
    is_nearest: bool
    n_far: int = 0

    def weights(self, col: F64, row: F64, heights: F64, *, is_cut: bool = True) -> F64:
        """Return the factor of each point's weight, 1 for good ones."""
        off = np.abs(_residuals(self.z, self.is_nearest, col, row, heights))
        far = off > self.tau
        if is_cut:
            return np.where(far, LEFT, 1.0)
        return np.where(far, self.tau / np.where(far, off, 1.0), 1.0)

    def to_dict(self) -> dict[str, Any]:
        """Return the report's ``dem.solver.robust``."""
        return {
            "rounds": HUBER_ROUNDS + CUT_ROUNDS,
            "limit": self.tau,
            "points_down_weighted": self.n_far,
        }


def find_far_off(
    points: SurfacePoints, outer: Grid, springs: Springs, unit_m: float, scratch: Scratch
) -> Robust:
    """
    Find the points that lie far off the surface of the others.

    Parameters
    ----------
    points : SurfacePoints
        At least one.
    outer : Grid
        Nodes.
    springs : Springs
        A single net, stiff enough not to follow single points.
    unit_m : float
        Metres per unit of height.
    scratch : Scratch
        Where grids live.

    Notes
    -----
    Rounds of Huber's weights, then a cut; starting with a cut loses good points on steep ground.
    """
    robust: Robust | None = None
    for number in range(HUBER_ROUNDS + CUT_ROUNDS + 1):
        evidence = Evidence(outer.height, outer.width, scratch)
        is_cut = number > HUBER_ROUNDS
        for first, last in evidence.windows():
            for _, col, row, heights in readings(points, outer):
                weights = None
                if robust is not None:
                    weights = robust.weights(col, row, heights, is_cut=is_cut)
                evidence.add(col, row, heights, springs, (first, last), weights)
            evidence.relax(first, last)
        z, _ = solve(
            evidence,
            springs,
            tol=TOL_M / unit_m,
            start=None if robust is None else robust.z,
            consume=True,
        )
        if robust is not None:
            scratch.free(robust.z)
        robust = Robust(z, _limit(points, outer, springs, z, unit_m), springs.is_nearest)
    assert robust is not None
    n_far = 0
    for _, col, row, heights in readings(points, outer):
        n_far += int(np.count_nonzero(robust.weights(col, row, heights) < 1))
    return Robust(robust.z, robust.tau, robust.is_nearest, n_far)


def _limit(points: SurfacePoints, outer: Grid, springs: Springs, z: F64, unit_m: float) -> float:
    """Return tau from the median of the residuals."""
    step, seen = -(-len(points) // MAX_RESIDUALS), 0
    kept = []
    for _, col, row, heights in readings(points, outer):
        mine = slice(-seen % step, None, step)
        seen += len(heights)
        kept.append(_residuals(z, springs.is_nearest, col[mine], row[mine], heights[mine]))
    spread = 1.4826 * float(np.median(np.abs(np.concatenate(kept))))
    return max(LIMIT_SIGMAS * spread, LEAST_M / unit_m)


def _residuals(z: F64, is_nearest: bool, col: F64, row: F64, heights: F64) -> F64:
    from volatool.kernels import spring

    fit = np.zeros(len(heights))
    spring.interpolate(
        z, np.ascontiguousarray(col), np.ascontiguousarray(row), is_nearest, 0, len(z), fit
    )
    return heights - fit
