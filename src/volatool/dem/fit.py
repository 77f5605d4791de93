"""The EMap surface through a DEM's points: evidence on the grid and solve, net after net."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from volatool.dem.gather import SurfacePoints
from volatool.dem.grid import Grid
from volatool.emap.noise import TOL, signs
from volatool.emap.solve import SolveInfo, solve
from volatool.emap.system import Evidence, strips
from volatool.emap.tuning import Net, Tuned
from volatool.model import F64, Progress
from volatool.scratch import Scratch

if TYPE_CHECKING:
    from volatool.dem.surfaces import Dem


def fit(
    points: SurfacePoints, outer: Grid, tuned: Tuned, dem: Dem, tol: float, progress: Progress
) -> tuple[F64, dict[str, Any]]:
    """
    Solve net after net.

    Parameters
    ----------
    points : SurfacePoints
        At least one.
    outer : Grid
        Nodes: those of the DEM's cells and one more all round.
    tuned : Tuned
        The nets.
    dem : Dem
        Takes the counts of points.
    tol : float
        Stop of the solver, vertical unit.
    progress : callable
        Told the iterations.

    Returns
    -------
    z : (h, w) array of float64
        Sum of the nets' heights above `stored_zero`; free it after use.
    solver : dict
        The report's ``dem.solver``.
    """
    z: F64 | None = None
    infos: list[SolveInfo] = []

    def tell(done: int, of: int) -> None:
        before = sum(info.iterations for info in infos)
        progress(before + done, before + of * (len(tuned.nets) - len(infos)))

    for net in tuned.nets:
        evidence = _evidence(points, outer, net, dem, z)
        # each net may add its error to those before
        part, info = solve(
            evidence, net.springs, tol=tol / len(tuned.nets), consume=True, progress=tell
        )
        infos.append(info)
        if z is None:
            z = part
            continue
        for start, stop in strips(*z.shape):
            z[start:stop] += part[start:stop]
            dem.scratch.relax(z, start, stop)
            dem.scratch.relax(part, start, stop)
        dem.scratch.free(part)
    assert z is not None
    springs = tuned.nets[0].springs
    return z, {
        "method": infos[0].method,
        "iterations": sum(info.iterations for info in infos),
        "relative_residual": max(info.relative_residual for info in infos),
        "converged": all(info.converged for info in infos),
        "k_surface": springs.kb * outer.cell**2 if springs.kb else springs.km,
        "k_point": springs.weight,
        "rule": tuned.rule,
        "nets": [_describe(net, outer.cell) for net in tuned.nets],
    }


def _describe(net: Net, cell: float) -> dict[str, float | None]:
    """Return a net's stiffness ``k = kb cell^2``, ``ell = sqrt(k / km)`` and length of tether."""
    stiffness = net.springs.kb * cell**2
    ell = math.sqrt(stiffness / net.springs.km) if stiffness and net.springs.km else None
    tether = (stiffness * cell**2 / net.tether) ** 0.25 if net.tether else None
    return {"k_surface": stiffness or net.springs.km, "ell": ell, "tether": tether}


def _evidence(
    points: SurfacePoints, outer: Grid, net: Net, dem: Dem, before: F64 | None
) -> Evidence:
    """
    Sum the springs of the points, of their heights above the nets before.

    The first time (`before` is None) it also sets the DEM's counts.
    """
    from volatool.kernels import binning, spring

    evidence = Evidence(outer.height, outer.width, dem.scratch)
    zero = stored_zero(points)
    for first, last in evidence.windows():
        for rows in points.pieces():
            col, row = outer.places(rows, points.scale, points.offset)
            heights = np.asarray((rows[:, 2] - zero) * points.scale[2], np.float64)
            if before is not None:
                below = np.zeros(len(rows))
                # points that pull on the window's first row may lie in the row above
                top = max(first - 1, 0)
                spring.interpolate(before, col, row, net.springs.is_nearest, top, last, below)
                heights -= below
                dem.scratch.relax(before)
            evidence.add(col, row, heights, net.springs, (first, last))
            if before is None:
                # the DEM's rows in this window: its row r is row r + 1 of the outer grid
                low, high = max(first - 1, 0), last - 1 if last < outer.height else last
                binning.count(col - 1.0, row - 1.0, low, high, dem.count)
        evidence.relax(first, last)
        dem.scratch.relax(dem.count)
    if net.tether:
        evidence.tether(net.tether)
    return evidence


def stored_zero(points: SurfacePoints) -> np.int64:
    """Return the stored z that heights are counted from: the middle, to keep digits."""
    return np.int64(sum(points.z_range) // 2)


def readings(
    points: SurfacePoints, grid: Grid
) -> Iterator[tuple[NDArray[np.int32], F64, F64, F64]]:
    """
    Yield points, their places on a grid, and their heights above `stored_zero`.

    Parameters
    ----------
    points : SurfacePoints
        Points.
    grid : Grid
        Their places are in its cells.
    """
    zero = stored_zero(points)
    for rows in points.pieces():
        heights = np.asarray((rows[:, 2] - zero) * points.scale[2], np.float64)
        yield rows, *grid.places(rows, points.scale, points.offset), heights


def fit_nets(
    read: Callable[[], Iterable[tuple[NDArray[np.int32], F64, F64, F64]]],
    shape: tuple[int, int],
    nets: Sequence[Net],
    tol: float,
    scratch: Scratch,
) -> F64:
    """
    Return the surface of nets through points, without a DEM around it.

    Parameters
    ----------
    read : callable
        Yields stored points, their places and heights, anew at each call.
    shape : tuple of 2 int
        Rows and columns of nodes.
    nets : sequence of Net
        Solved one after the other.
    tol : float
        Stop of the solver.
    scratch : Scratch
        Where grids live.

    Returns
    -------
    z : (h, w) array of float64
        Sum of the nets' heights; give it back with ``scratch.free``.
    """
    from volatool.kernels import spring

    z: F64 | None = None
    for net in nets:
        evidence = Evidence(*shape, scratch)
        for first, last in evidence.windows():
            for _, col, row, heights in read():
                if z is not None:
                    below = np.zeros(len(heights))
                    top = max(first - 1, 0)
                    spring.interpolate(z, col, row, net.springs.is_nearest, top, last, below)
                    heights = heights - below
                    scratch.relax(z)
                evidence.add(col, row, heights, net.springs, (first, last))
            evidence.relax(first, last)
        if net.tether:
            evidence.tether(net.tether)
        part, _ = solve(evidence, net.springs, tol=tol / len(nets), consume=True)
        if z is None:
            z = part
            continue
        for start, stop in strips(*shape):
            z[start:stop] += part[start:stop]
            scratch.relax(z, start, stop)
            scratch.relax(part, start, stop)
        scratch.free(part)
    assert z is not None
    return z


def answer(points: SurfacePoints, outer: Grid, tuned: Tuned, scratch: Scratch) -> F64:
    """
    Return the surface through random signs in place of heights, for `emap.noise.measure`.

    Parameters
    ----------
    points, outer, tuned
        As for `fit`.
    scratch : Scratch
        Where grids live.
    """

    def read() -> Iterator[tuple[NDArray[np.int32], F64, F64, F64]]:
        for rows, col, row, _ in readings(points, outer):
            yield rows, col, row, signs(rows)

    return fit_nets(read, (outer.height, outer.width), tuned.nets, TOL, scratch)
