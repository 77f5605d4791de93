"""Heights from springs: conjugate gradients preconditioned by a multigrid V-cycle."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from volatool.emap.cuts import Cuts
from volatool.emap.multigrid import Hierarchy
from volatool.emap.system import Evidence, Springs
from volatool.model import F64, Progress, no_progress

METHOD = "multigrid-pcg"


@dataclass(frozen=True, slots=True)
class SolveInfo:
    """
    How a solve went.

    Parameters
    ----------
    iterations : int
        Of the conjugate gradients; the full-multigrid start is not counted.
    residual : float
        Largest estimated error left, ``max |M^-1 (b - H z)|``, in the unit of the heights.
    relative_residual : float
        ``||b - H z|| / ||b||``; says little about the error in heights.
    converged : bool
        The residual is below the tolerance.
    levels : int
        Grids of the hierarchy.
    """

    iterations: int
    residual: float
    relative_residual: float
    converged: bool
    levels: int
    method: str = METHOD

    def to_dict(self) -> dict[str, Any]:
        """Return the part of the report's ``dem.solver`` that the solver knows."""
        return {
            "method": self.method,
            "iterations": self.iterations,
            "relative_residual": self.relative_residual,
            "converged": self.converged,
        }


def solve(
    evidence: Evidence,
    springs: Springs,
    *,
    tol: float = 1e-4,
    start: F64 | None = None,
    max_iterations: int | None = None,
    consume: bool = False,
    hierarchy: Hierarchy | None = None,
    progress: Progress = no_progress,
    cuts: Cuts | None = None,
    threads: int = 1,
) -> tuple[F64, SolveInfo]:
    """
    Return the heights at which all springs are in balance.

    Parameters
    ----------
    evidence : Evidence
        Data springs and right side.
    springs : Springs
        Stiffness of the surface.
    tol : float
        Stop when the largest estimated error of a height is below this, in the heights' unit.
        A relative residual would hide errors that grow with the size of the grid.
    start : (h, w) array of float64, optional
        Heights to start from (a former solve); a full-multigrid pass otherwise.
    max_iterations : int, optional
        Give up after so many, `SolveInfo.converged` tells; 100 by default, 400 with cuts.
    consume : bool
        Free the evidence on the way, to save memory.
    hierarchy : Hierarchy, optional
        Of the same data springs and the same surface springs, to be used again; made and given
        back by default.
    progress : callable, optional
        Told (iterations done, a guess of how many there will be).
    cuts : Cuts, optional
        Springs that are missing or weaker. Parts of the grid that hang on no point keep the heights
        they start with, zero by default; `Cuts.islands` finds them.
    threads : int
        Threads that share the work; a hierarchy that is given has its own.

    Returns
    -------
    z : (h, w) array of float64
        Heights, in the evidence's scratch (give it back with ``scratch.free``).
    info : SolveInfo
        Iterations and what is left.

    Notes
    -----
    Dot products are summed by row, in order: the result doesn't depend on the strips, on threads,
    nor on where arrays live. The V-cycle is float32; heights, residuals and directions are float64.
    The last preconditioned residual, an estimate of the error, is added in the end.
    """
    limit = max_iterations
    if limit is None:
        limit = 100 if cuts is None else 400
    scratch = evidence.scratch
    is_lent = hierarchy is not None
    if hierarchy is None:
        hierarchy = Hierarchy(evidence, springs, scratch, cuts, threads)
    else:
        hierarchy.load(evidence)
    work = _Work(evidence, springs, hierarchy)
    norm = work.begin(start, consume)
    iterations = 0
    before = largest = 0.0
    while True:
        dot, largest = work.precondition()
        progress(iterations, max(8, iterations + 1))
        if not largest >= tol or iterations == limit:
            break
        curvature = work.advance(dot / before if iterations else 0.0)
        if not curvature > 0:
            break
        work.descend(dot / curvature)
        before = dot
        iterations += 1
    rest = work.finish()
    levels = len(hierarchy.levels)
    if not is_lent:
        hierarchy.free()
    info = SolveInfo(
        iterations,
        largest,
        rest / norm if norm else 0.0,
        bool(largest < tol),
        levels,
    )
    return work.z, info


class _Work:
    """Vectors of the conjugate gradients and the loops over their rows."""

    def __init__(self, evidence: Evidence, springs: Springs, hierarchy: Hierarchy) -> None:
        self.evidence = evidence
        self.springs = springs
        self.hierarchy = hierarchy
        self.scratch = evidence.scratch
        self.finest = hierarchy.levels[0]
        self.shape = evidence.shape
        self.dots = np.empty(self.shape[0])
        self.largest = np.empty(self.shape[0], np.uint32)
        self.moved = 0.0

    def _zeros(self) -> F64:
        array: F64 = self.scratch.zeros(self.shape, np.float64)
        return array

    def _each(self, function: Callable[[int, int], object], *arrays: NDArray[Any] | None) -> None:
        self.hierarchy.walk.each(function, *self.shape, *arrays)

    def begin(self, start: F64 | None, consume: bool) -> float:
        """Set z and the residual from the evidence; return the norm of the right side."""
        from volatool.kernels import conjugate, spring

        evidence, finest = self.evidence, self.finest
        if start is None:
            self.hierarchy.full()
        z = self.z = self._zeros()
        given = finest.x if start is None else start

        def copy(first: int, last: int) -> None:
            z[first:last] = given[first:last]

        self._each(copy, z, given)
        product = self.product = self._zeros()
        data, right, edges = evidence.data, evidence.right, finest.edges
        residual = self.residual = right if consume else self._zeros()
        kb, km = self.springs.kb, self.springs.km
        self._each(
            lambda *rows: spring.apply_rows(data, z, kb, km, *rows, product, self.dots, edges),
            *(data, z, product, edges),
        )
        self._each(
            lambda *rows: conjugate.begin(right, product, residual, finest.right, self.dots, *rows),
            *(right, product, residual, finest.right),
        )
        if consume:
            self.scratch.free(data)
            del evidence.data, evidence.right
        self.p = self._zeros()
        return math.sqrt(math.fsum(self.dots))

    def precondition(self) -> tuple[float, float]:
        """Run a V-cycle on the residual; return its product r . s with the result, max abs s."""
        from volatool.kernels import conjugate

        self.hierarchy.cycle()
        residual, x = self.residual, self.finest.x
        self._each(
            lambda *rows: conjugate.measure(residual, x, *rows, self.dots, self.largest),
            *(residual, x),
        )
        return math.fsum(self.dots), float(self.largest.max().view(np.float32))

    def advance(self, beta: float) -> float:
        """Move along the last direction, turn to the next one p; return p . H p."""
        from volatool.kernels import conjugate, spring

        z, p, x, product, dots = self.z, self.p, self.finest.x, self.product, self.dots
        data, edges = self.finest.data, self.finest.edges
        kb, km = self.springs.kb, self.springs.km
        walk = self.hierarchy.walk
        if len(walk.bands(*self.shape)) > 1:
            self._each(lambda *rows: conjugate.turn(z, p, x, self.moved, beta, *rows), z, p, x)
            self._each(
                lambda *rows: spring.apply_rows(data, p, kb, km, *rows, product, dots, edges),
                *(data, p, product, edges),
            )
        else:
            walk.in_order(
                lambda *rows: conjugate.advance(
                    z, p, x, self.moved, beta, data, kb, km, product, dots, *rows, edges
                ),
                *self.shape,
                *(z, p, x, data, product, edges),
            )
        return math.fsum(dots)

    def descend(self, step: float) -> None:
        """Take a step along the direction off the residual; the heights follow in `advance`."""
        from volatool.kernels import conjugate

        residual, product, force = self.residual, self.product, self.finest.right
        self._each(
            lambda *rows: conjugate.descend(residual, product, step, force, *rows),
            *(residual, product, force),
        )
        self.moved = step

    def finish(self) -> float:
        """Take the last step, add the last estimate of the error; return the residual's norm."""
        from volatool.kernels import conjugate

        z, p, x, residual = self.z, self.p, self.finest.x, self.residual
        self._each(
            lambda *rows: conjugate.finish(z, p, x, self.moved, residual, self.dots, *rows),
            *(z, p, x, residual),
        )
        self.scratch.free(residual, p, self.product)
        return math.sqrt(math.fsum(self.dots))
