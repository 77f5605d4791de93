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
from volatool.emap.system import STRIP_CELLS, Evidence, Springs, strips
from volatool.emap.tuning import Net, Tuned
from volatool.model import F64, Progress, no_progress
from volatool.scratch import Scratch

if TYPE_CHECKING:
    from volatool.dem.barriers import Placed
    from volatool.dem.robust import Robust
    from volatool.dem.surfaces import Dem
    from volatool.emap.cuts import Cuts
    from volatool.emap.lines import Lines


def fit(
    points: SurfacePoints,
    outer: Grid,
    tuned: Tuned,
    dem: Dem,
    tol: float,
    progress: Progress,
    barriers: Placed | None = None,
    robust: Robust | None = None,
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

    Returns
    -------
    z : (h, w) array of float64
        Sum of the nets' heights above `stored_zero`; free it after use.
    solver : dict
        The report's ``dem.solver``.
    """
    evidence = _evidence(points, outer, tuned.springs, dem, barriers, robust)
    if barriers is not None:
        barriers.hold(evidence, tuned.springs.weight)
    cuts = None if barriers is None else barriers.cuts
    z, infos = solve_nets(evidence, tuned.nets, tol, cuts, progress)
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
) -> Evidence:
    """Sum the springs of the points and set the DEM's counts."""
    from volatool.kernels import binning

    lines = None if barriers is None else barriers.lines
    evidence = Evidence(outer.height, outer.width, dem.scratch)
    for first, last in evidence.windows():
        for _, col, row, heights in readings(points, outer):
            weights = None if robust is None else robust.weights(col, row, heights)
            evidence.add(col, row, heights, springs, (first, last), weights, lines)
            # the DEM's rows in this window: its row r is row r + 1 of the outer grid
            low, high = max(first - 1, 0), last - 1 if last < outer.height else last
            binning.count(col - 1.0, row - 1.0, low, high, dem.count)
        evidence.relax(first, last)
        dem.scratch.relax(dem.count)
    return evidence


def _read(
    z: F64,
    col: F64,
    row: F64,
    is_nearest: bool,
    window: tuple[int, int],
    lines: Lines | None,
    out: F64,
) -> None:
    """Read a surface at points, each on its own side of the lines."""
    from volatool.kernels import spring
    from volatool.kernels.lines import cut_interpolate

    if lines is None:
        spring.interpolate(z, col, row, is_nearest, *window, out)
    else:
        cut_interpolate(z, col, row, is_nearest, *window, *lines.tables, out)


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
) -> float:
    """Return the sum of the squares of point minus surface."""
    lines = None if barriers is None else barriers.lines
    sums: list[float] = []
    cells = 4 * STRIP_CELLS if scratch.spilled_bytes else outer.height * outer.width
    windows = list(strips(outer.height, outer.width, cells))
    for _, col, row, heights in readings(points, outer):
        fit = np.empty(len(col))
        for first, last in windows:
            _read(z, col, row, tuned.springs.is_nearest, (first, last), lines, fit)
            scratch.relax(z, first, last)
        fit -= heights
        sums.append(float(np.nansum(np.square(fit))))  # NaN: lines all round
    return math.fsum(sums)


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
