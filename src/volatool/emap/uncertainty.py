"""How sure a surface is: random surfaces whose scatter is the posterior's (perturb and MAP)."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from volatool.emap.multigrid import Hierarchy
from volatool.emap.solve import solve
from volatool.emap.system import Evidence, Springs, strips
from volatool.errors import OptionError
from volatool.model import F64, Progress, no_progress

SAMPLES = 32
"""Random surfaces: the standard error is right to about ``1 / sqrt(2 SAMPLES)``, 12 %."""

MAX_SAMPLES = 64
"""Signs that a hash of 64 bits holds."""

BATCH = 8
"""Samples whose forces are summed in one pass over the points."""

TOL = 0.03
"""Stop of a sample's solve, in units of the points' noise."""

Places = Callable[[], Iterable[tuple[NDArray[np.int32], F64, F64]]]
"""Yields stored points and their places (col, row) in cells of the evidence's grid."""


@dataclass(frozen=True, slots=True)
class Origin:
    """
    Absolute index of a grid's first node, so that grids that overlap agree on random forces.

    Parameters
    ----------
    top, left : int
        Cells from the origin of the CRS, down and right.
    """

    top: int = 0
    left: int = 0


def samples(
    evidence: Evidence,
    springs: Springs,
    places: Places,
    n_samples: int = SAMPLES,
    *,
    origin: Origin | None = None,
    tol: float = TOL,
    progress: Progress = no_progress,
) -> Iterator[F64]:
    """
    Yield random surfaces with mean zero and covariance ``H^-1``, one by one.

    A random force ``sqrt(k) e`` pulls at every spring of the points and of the surface; their
    sums have covariance ``H``, so the surfaces in balance with them have ``H^-1 H H^-1``. Times
    the points' noise, their scatter is the posterior's. Read them where a standard error is
    wanted and average the *squares* of what is read: interpolated variances are too large.

    Parameters
    ----------
    evidence : Evidence
        The points' data springs; its right side does not matter and is left alone.
    springs : Springs
        The same as made the evidence.
    places : callable
        The same points again, for every `BATCH` samples.
    n_samples : int
        1 to 64.
    origin : Origin, optional
        Of the grid.
    tol : float
        Stop of each solve; heights are in units of the points' noise.
    progress : callable, optional
        Told (samples done, n_samples).

    Yields
    ------
    z : (h, w) array of float64
        Valid until the next one is asked for.

    Notes
    -----
    Perturb-and-MAP [Papandreou2010], with signs in place of normal numbers (`kernels.chance`).
    The same bytes whatever the chunks, windows and order of the loops, but for the order in which
    forces of points that share a node are summed.
    """
    from volatool.kernels import chance

    if not 1 <= n_samples <= MAX_SAMPLES:
        raise OptionError(f"samples must be 1 to {MAX_SAMPLES}, got {n_samples}")
    origin = origin or Origin()
    scratch, (height, width) = evidence.scratch, evidence.shape
    hierarchy = Hierarchy(evidence, springs, scratch)
    pulled = copy.copy(evidence)
    pulled.right = scratch.zeros((height, width), np.float64)
    try:
        for start in range(0, n_samples, BATCH):
            m = min(BATCH, n_samples - start)
            forces = scratch.zeros((height, width, m), np.float32)
            for first, last in evidence.windows():
                window = (start, first, last)
                chance.surface_forces(
                    springs.kb, springs.km, origin.top, origin.left, *window, forces
                )
                for rows, col, row in places():
                    bits = np.empty(len(rows), np.uint64)
                    chance.hash_rows(rows, 0, bits)
                    chance.point_forces(
                        col, row, bits, springs.weight, springs.is_nearest, *window, forces
                    )
                scratch.relax(forces, first, last)
            for k in range(m):
                for first, last in strips(height, width):
                    pulled.right[first:last] = forces[first:last, :, k]
                    scratch.relax(forces, first, last)
                    scratch.relax(pulled.right, first, last)
                z, _ = solve(pulled, springs, tol=tol, hierarchy=hierarchy)
                yield z
                scratch.free(z)
                progress(start + k + 1, n_samples)
            scratch.free(forces)
    finally:
        scratch.free(pulled.right)
        hierarchy.free()
