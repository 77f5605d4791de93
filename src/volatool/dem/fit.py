"""The EMap surface through a DEM's points: evidence on the grid and solve, net after net."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from volatool.dem.gather import SurfacePoints
from volatool.dem.grid import Grid
from volatool.emap.solve import SolveInfo, solve
from volatool.emap.system import STRIP_CELLS, Evidence, Springs, strips
from volatool.emap.tuning import Net, Tuned
from volatool.model import F64, Progress
from volatool.scratch import Scratch

if TYPE_CHECKING:
    from volatool.dem.surfaces import Dem


def _row_windows(shape: tuple[int, int], is_spilled: bool) -> list[tuple[int, int]]:
    """Row windows to pass all points for: one, unless the grid is not in RAM."""
    height, width = shape
    return list(strips(height, width, 4 * STRIP_CELLS if is_spilled else height * width))


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

    evidence = _evidence(points, outer, tuned.springs, dem)
    tether = 0.0
    for number, net in enumerate(tuned.nets):
        if net.tether != tether:
            evidence.tether(net.tether - tether)
            tether = net.tether
        is_last = number == len(tuned.nets) - 1
        # each net may add its error to those before
        part, info = solve(
            evidence, net.springs, tol=tol / len(tuned.nets), consume=is_last, progress=tell
        )
        infos.append(info)
        if not is_last:
            evidence.subtract(part, tether)
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


def _evidence(points: SurfacePoints, outer: Grid, springs: Springs, dem: Dem) -> Evidence:
    """Sum the springs of the points and set the DEM's counts."""
    from volatool.kernels import binning

    evidence = Evidence(outer.height, outer.width, dem.scratch)
    zero = stored_zero(points)
    for first, last in evidence.windows():
        for rows in points.pieces():
            col, row = outer.places(rows, points.scale, points.offset)
            heights = np.asarray((rows[:, 2] - zero) * points.scale[2], np.float64)
            evidence.add(col, row, heights, springs, (first, last))
            # the DEM's rows in this window: its row r is row r + 1 of the outer grid
            low, high = max(first - 1, 0), last - 1 if last < outer.height else last
            binning.count(col - 1.0, row - 1.0, low, high, dem.count)
        evidence.relax(first, last)
        dem.scratch.relax(dem.count)
    return evidence


def stored_zero(points: SurfacePoints) -> np.int64:
    """Return the stored z that heights are counted from: the middle, to keep digits."""
    return np.int64(sum(points.z_range) // 2)


def sum_of_squares(
    points: SurfacePoints, outer: Grid, tuned: Tuned, z: F64, scratch: Scratch
) -> float:
    """Return the sum of the squares of point minus surface."""
    from volatool.kernels import spring

    zero = stored_zero(points)
    sums: list[float] = []
    windows = _row_windows((outer.height, outer.width), bool(scratch.spilled_bytes))
    for rows in points.pieces():
        col, row = outer.places(rows, points.scale, points.offset)
        fit = np.empty(len(rows))
        for first, last in windows:
            spring.interpolate(z, col, row, tuned.springs.is_nearest, first, last, fit)
            scratch.relax(z, first, last)
        fit -= (rows[:, 2] - zero) * points.scale[2]
        sums.append(float(np.sum(np.square(fit))))
    return math.fsum(sums)
