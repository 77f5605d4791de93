"""Heights from springs: conjugate gradients preconditioned by a multigrid V-cycle."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from volatool.emap.cuts import Cuts
from volatool.emap.multigrid import Hierarchy
from volatool.emap.system import Evidence, Springs, strips
from volatool.model import F64, Progress, no_progress
from volatool.scratch import Scratch

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

    Returns
    -------
    z : (h, w) array of float64
        Heights, in the evidence's scratch (give it back with ``scratch.free``).
    info : SolveInfo
        Iterations and what is left.

    Notes
    -----
    Dot products are summed by row, in order: the result doesn't depend on the strips, nor on
    where arrays live. The V-cycle is float32; heights, residuals and directions are float64.
    The last preconditioned residual, an estimate of the error, is added in the end.
    """
    limit = max_iterations
    if limit is None:
        limit = 100 if cuts is None else 400
    scratch = evidence.scratch
    is_lent = hierarchy is not None
    if hierarchy is None:
        hierarchy = Hierarchy(evidence, springs, scratch, cuts)
    else:
        hierarchy.load(evidence)
    work = _Work(evidence, hierarchy, scratch)
    norm = work.begin(springs, start, consume)
    iterations = 0
    before = largest = rest = 0.0
    while True:
        dot, rest, largest = work.precondition()
        progress(iterations, max(8, iterations + 1))
        if not largest >= tol or iterations == limit:
            break
        work.turn(dot / before if iterations else 0.0)
        curvature = work.product(springs)
        if not curvature > 0:
            break
        work.descend(dot / curvature)
        before = dot
        iterations += 1
    work.finish()
    levels = len(hierarchy.levels)
    if not is_lent:
        hierarchy.free()
    info = SolveInfo(
        iterations,
        largest,
        math.sqrt(rest) / norm if norm else 0.0,
        bool(largest < tol),
        levels,
    )
    return work.z, info


class _Work:
    """Vectors of the conjugate gradients and the loops over their strips."""

    def __init__(self, evidence: Evidence, hierarchy: Hierarchy, scratch: Scratch) -> None:
        self.evidence = evidence
        self.hierarchy = hierarchy
        self.scratch = scratch
        self.finest = hierarchy.levels[0]
        self.shape = evidence.shape
        self.rows = np.empty((3, self.shape[0]))

    def _zeros(self) -> F64:
        array: F64 = self.scratch.zeros(self.shape, np.float64)
        return array

    def _relax(self, start: int, stop: int, *arrays: NDArray[Any] | None) -> None:
        for array in arrays:
            if array is not None:
                self.scratch.relax(array, start, stop)

    def begin(self, springs: Springs, start: F64 | None, consume: bool) -> float:
        """Set z and the residual from the evidence; return the norm of the right side."""
        from volatool.kernels import multigrid, spring

        evidence, finest = self.evidence, self.finest
        if start is None:
            self.hierarchy.full()
        self.z = self._zeros()
        for first, last in strips(*self.shape):
            self.z[first:last] = finest.x[first:last] if start is None else start[first:last]
            self._relax(first, last, self.z, finest.x)
        self.product_array = self._zeros()
        self.residual = evidence.right if consume else self._zeros()
        data = evidence.data
        for first, last in strips(*self.shape):
            spring.apply_rows(
                data,
                self.z,
                springs.kb,
                springs.km,
                first,
                last,
                self.product_array,
                self.rows[0],
                finest.edges,
            )
            right = evidence.right[first:last]
            multigrid.measure(
                evidence.right, finest.x, first, last, self.rows[0], self.rows[1], self.rows[2]
            )
            np.subtract(right, self.product_array[first:last], out=self.residual[first:last])
            finest.right[first:last] = self.residual[first:last]
            self._relax(first, last, self.z, data, evidence.right, self.residual)
            self._relax(first, last, self.product_array, finest.right, finest.x)
        norm = math.sqrt(math.fsum(self.rows[1]))
        if consume:
            self.scratch.free(data)
            del evidence.data, evidence.right
        self.p = self._zeros()
        return norm

    def precondition(self) -> tuple[float, float, float]:
        """Run a V-cycle on the residual; return r . s, r . r and max abs s."""
        from volatool.kernels import multigrid

        self.hierarchy.cycle()
        dots, norms, largest = self.rows
        for start, stop in strips(*self.shape):
            multigrid.measure(self.residual, self.finest.x, start, stop, dots, norms, largest)
            self._relax(start, stop, self.residual, self.finest.x)
        return math.fsum(dots), math.fsum(norms), float(largest.max())

    def turn(self, beta: float) -> None:
        """Set the direction from the preconditioned residual and the last one."""
        from volatool.kernels import multigrid

        for start, stop in strips(*self.shape):
            multigrid.turn(self.p, self.finest.x, beta, start, stop)
            self._relax(start, stop, self.p, self.finest.x)

    def product(self, springs: Springs) -> float:
        """Set H p; return p . H p."""
        from volatool.kernels import spring

        data, edges, kb, km = self.finest.data, self.finest.edges, springs.kb, springs.km
        out, dots = self.product_array, self.rows[0]
        for start, stop in strips(*self.shape):
            spring.apply_rows(data, self.p, kb, km, start, stop, out, dots, edges)
            self._relax(start, stop, data, self.p, out, edges)
        return math.fsum(self.rows[0])

    def descend(self, step: float) -> None:
        """Move along the direction."""
        from volatool.kernels import multigrid

        arrays = (self.z, self.residual, self.p, self.product_array)
        for start, stop in strips(*self.shape):
            multigrid.descend(*arrays, step, self.finest.right, start, stop)
            self._relax(start, stop, *arrays, self.finest.right)

    def finish(self) -> None:
        """Add the last estimate of the error and give back all but the heights."""
        for start, stop in strips(*self.shape):
            self.z[start:stop] += self.finest.x[start:stop]
            self._relax(start, stop, self.z, self.finest.x)
        self.scratch.free(self.residual, self.p, self.product_array)
        if not hasattr(self.evidence, "data"):
            del self.evidence
