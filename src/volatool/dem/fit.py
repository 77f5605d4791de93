"""The EMap surface through a DEM's points: evidence on the grid and solve, net after net."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from volatool.dem.gather import SurfacePoints
from volatool.dem.grid import Grid
from volatool.emap.noise import TOL, signs
from volatool.emap.solve import SolveInfo, solve
from volatool.emap.system import Evidence, Springs, strips, windows
from volatool.emap.tuning import Net, Tuned
from volatool.model import F64, Progress, no_progress
from volatool.scratch import Scratch
from volatool.threads import Crew

if TYPE_CHECKING:
    from volatool.dem.barriers import Placed
    from volatool.dem.robust import Robust
    from volatool.dem.surfaces import Dem
    from volatool.emap.cuts import Cuts


def fit(
    points: SurfacePoints,
    outer: Grid,
    tuned: Tuned,
    dem: Dem,
    tol: float,
    progress: Progress,
    barriers: Placed | None = None,
    robust: Robust | None = None,
    threads: int = 1,
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
    barriers : Placed, optional
        What no spring crosses.
    robust : Robust, optional
        Tells which points hardly count.
    threads : int
        Never changes the result.

    Returns
    -------
    z : (h, w) array of float64
        Sum of the nets' heights above `stored_zero`; free it after use.
    solver : dict
        The report's ``dem.solver``.
    """
    evidence = _evidence(points, outer, tuned.springs, dem, barriers, robust, threads)
    if barriers is not None:
        barriers.hold(evidence, tuned.springs.weight)
    cuts = None if barriers is None else barriers.cuts
    z, infos = solve_nets(evidence, tuned.nets, tol, cuts, progress, threads)
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


def solve_nets(
    evidence: Evidence,
    nets: Sequence[Net],
    tol: float,
    cuts: Cuts | None = None,
    progress: Progress = no_progress,
    threads: int = 1,
) -> tuple[F64, list[SolveInfo]]:
    """
    Solve net after net, each for what the ones before leave of the points' heights.

    Parameters
    ----------
    evidence : Evidence
        Of the points; used up.
    nets : sequence of Net
        On the evidence's grid.
    tol : float
        Stop of each solve.
    cuts : Cuts, optional
        Springs that are missing.
    progress : callable
        Told the iterations.
    threads : int
        Threads of each solve; the heights are the same for any number.

    Returns
    -------
    z : (h, w) array of float64
        Sum of the nets' heights, in the evidence's scratch.
    infos : list of SolveInfo
        Of each net.
    """
    scratch, shape = evidence.scratch, evidence.shape
    z: F64 | None = None
    infos: list[SolveInfo] = []

    def tell(done: int, of: int) -> None:
        before = sum(info.iterations for info in infos)
        progress(before + done, before + of * (len(nets) - len(infos)))

    tether = 0.0
    for number, net in enumerate(nets):
        if net.tether != tether:
            evidence.tether(net.tether - tether)
            tether = net.tether
        is_last = number == len(nets) - 1
        # what is left for a later net is small: level 0 is a better start than a multigrid pass
        level = None if z is None else scratch.zeros(shape, np.float64)
        part, info = solve(
            evidence,
            net.springs,
            tol=tol,
            start=level,
            consume=is_last,
            progress=tell,
            cuts=cuts,
            threads=threads,
        )
        if level is not None:
            scratch.free(level)
        infos.append(info)
        if not is_last:
            evidence.subtract(part, tether)
        if z is None:
            z = part
            continue
        for start, stop in strips(*shape):
            z[start:stop] += part[start:stop]
            scratch.relax(z, start, stop)
            scratch.relax(part, start, stop)
        scratch.free(part)
    assert z is not None
    return z, infos


def _describe(net: Net, cell: float) -> dict[str, float | None]:
    """Return a net's stiffness ``k = kb cell^2``, ``ell = sqrt(k / km)`` and length of tether."""
    stiffness = net.springs.kb * cell**2
    ell = math.sqrt(stiffness / net.springs.km) if stiffness and net.springs.km else None
    tether = (stiffness * cell**2 / net.tether) ** 0.25 if net.tether else None
    return {"k_surface": stiffness or net.springs.km, "ell": ell, "tether": tether}


def _evidence(
    points: SurfacePoints,
    outer: Grid,
    springs: Springs,
    dem: Dem,
    barriers: Placed | None,
    robust: Robust | None,
    threads: int,
) -> Evidence:
    """Sum the springs of the points and set the DEM's counts."""
    from volatool.kernels import binning, surface

    lines = None if barriers is None else barriers.lines
    evidence = Evidence(outer.height, outer.width, dem.scratch)
    sums = (evidence.data, evidence.right, dem.count)
    attachment = (springs.weight, springs.is_nearest)
    with Crew(threads) as crew:
        for window in evidence.windows():
            if lines is None and robust is None:
                for about in _stored(points, outer):
                    crew.run(
                        partial(surface.add_points, *sums, *about, *attachment),
                        crew.shares(*window),
                    )
            else:
                for _, col, row, heights in readings(points, outer):
                    weights = None if robust is None else robust.weights(col, row, heights)
                    evidence.add(col, row, heights, springs, window, weights, lines)
                    binning.count_inner(col, row, *window, dem.count)
            evidence.relax(*window)
            dem.scratch.relax(dem.count)
    return evidence


def _stored(
    points: SurfacePoints, grid: Grid
) -> Iterator[tuple[NDArray[np.int32], NDArray[np.int64], np.int64, float]]:
    """Yield stored points with what `volatool.kernels.surface` makes places and heights from."""
    lattice = grid.lattice(points.scale, points.offset)
    zero, step = stored_zero(points), float(points.scale[2])
    for rows in points.pieces():
        yield rows, lattice, zero, step


def stored_zero(points: SurfacePoints) -> np.int64:
    """Return the stored z that heights are counted from: the middle, to keep digits."""
    return np.int64(sum(points.z_range) // 2)


def sum_of_squares(
    points: SurfacePoints,
    outer: Grid,
    tuned: Tuned,
    z: F64,
    scratch: Scratch,
    barriers: Placed | None = None,
    threads: int = 1,
) -> float:
    """Return the sum of the squares of point minus surface."""
    from volatool.kernels import surface
    from volatool.kernels.lines import cut_interpolate

    lines = None if barriers is None else barriers.lines
    is_nearest = tuned.springs.is_nearest
    sums: list[float] = []
    with Crew(threads) as crew:
        for rows, *about in _stored(points, outer):
            out = np.empty(len(rows))
            if lines is not None:
                col, row = outer.places(rows, points.scale, points.offset)
            for window in windows(scratch, outer.height, outer.width, z):
                if lines is None:
                    work = partial(surface.squares, z, rows, *about, is_nearest, *window, out)
                    crew.run(work, crew.shares(0, len(rows)))
                else:
                    cut_interpolate(z, col, row, is_nearest, *window, *lines.tables, out)
                scratch.relax(z, *window)
            if lines is not None:
                out = np.square(out - _heights(rows, points))
            sums.append(float(np.nansum(out)))  # NaN: off the grid, or lines all round
    return math.fsum(sums)


def _heights(rows: NDArray[np.int32], points: SurfacePoints) -> F64:
    """Return heights above `stored_zero`."""
    return np.asarray((rows[:, 2] - stored_zero(points)) * points.scale[2], np.float64)


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
    for rows in points.pieces():
        yield rows, *grid.places(rows, points.scale, points.offset), _heights(rows, points)


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
    evidence = Evidence(*shape, scratch)
    for first, last in evidence.windows():
        for _, col, row, heights in read():
            evidence.add(col, row, heights, nets[0].springs, (first, last))
        evidence.relax(first, last)
    return solve_nets(evidence, nets, tol)[0]


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
