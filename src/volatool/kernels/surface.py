"""One pass over stored points for a stage of a DEM: their springs, counts and residuals.

Places are worked out a block at a time: what is in between never leaves the nearest cache.
"""

import numpy as np

from volatool.kernels._jit import kernel
from volatool.kernels.binning import BLOCK, count_inner, mark, places
from volatool.kernels.spring import accumulate, interpolate


@kernel
def mark_cells(rows, lattice, cells):
    """
    Set the cells that hold points.

    Parameters
    ----------
    rows : (n, 3) array of int32
        Stored x, y, z.
    lattice : (2, 4) array of int64
        Of the grid, for `places`.
    cells : (h, w) array of uint8
        Set to 1 where a point is, see `binning.mark`.
    """
    col, row = np.empty(BLOCK), np.empty(BLOCK)
    for start in range(0, rows.shape[0], BLOCK):
        part = rows[start : start + BLOCK]
        n = part.shape[0]
        places(part, lattice, col[:n], row[:n])
        mark(col[:n], row[:n], cells)


@kernel
def add_points(data, right, counts, rows, lattice, zero, step, weight, nearest, first, last):
    """
    Add the springs of points to a grid's evidence, in their order, and count them by cell.

    Parameters
    ----------
    data, right : (h, 5, w), (h, w) arrays of float64
        Evidence, added to: see `spring.accumulate`.
    counts : (h - 2, w - 2) array of uint32
        Points of the cells inside the outermost nodes' ring, added to.
    rows : (n, 3) array of int32
        Stored x, y, z.
    lattice : (2, 4) array of int64
        Of the grid of nodes, for `places`.
    zero : int
        Stored z that heights are counted from.
    step : float
        A stored step of z in the unit of the heights.
    weight : float
        Stiffness of a point's spring.
    nearest : bool
        Attach to the nearest node alone.
    first, last : int
        Only rows ``first <= r < last`` of the nodes are touched, and of the cells those under them.
    """
    weights = np.full(1, weight)
    col, row, height = np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK)
    for start in range(0, rows.shape[0], BLOCK):
        part = rows[start : start + BLOCK]
        n = part.shape[0]
        places(part, lattice, col[:n], row[:n])
        for i in range(n):
            height[i] = (np.int64(part[i, 2]) - zero) * step
        accumulate(data, right, col[:n], row[:n], height[:n], weights, nearest, first, last)
        count_inner(col[:n], row[:n], first, last, counts)


@kernel
def squares(z, rows, lattice, zero, step, nearest, first, last, out, start, stop):
    """
    Squares of point minus surface.

    Parameters
    ----------
    z : (h, w) array of float64
        Heights of the nodes.
    rows, lattice, zero, step, nearest
        As for `add_points`.
    first, last : int
        Only points whose upper node row is in ``first <= r < last`` are looked at.
    out : (n,) array of float64
        Set for those; NaN for points off the grid.
    start, stop : int
        Only these points are looked at.
    """
    col, row, fit = np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK)
    for begin in range(start, stop, BLOCK):
        part = rows[begin : min(begin + BLOCK, stop)]
        n = part.shape[0]
        places(part, lattice, col[:n], row[:n])
        fit[:n] = np.inf
        interpolate(z, col[:n], row[:n], nearest, first, last, fit[:n])
        for i in range(n):
            if fit[i] != np.inf:
                rest = fit[i] - (np.int64(part[i, 2]) - zero) * step
                out[begin + i] = rest * rest
