"""Surface springs of which some are cut or weakened: the rows that `spring` puts together.

An edge between two neighbouring nodes has a factor, 0 cut, 1 whole::

    edges[r, 0, q]  (r, q) - (r, q + 1)        edges[r, 1, q]  (r, q) - (r + 1, q)

A stretching spring has its edge's factor, a second difference the smaller of its two edges', a
twist the smallest of the four around its quad. Factors of edges that would leave the grid are 1
and never used by the springs. Grids of the hierarchy hold the springs' diagonal in ``edges[r, 2]``.
"""

import numpy as np

from volatool.kernels._jit import kernel

ONE, TWO = np.uint64(1), np.uint64(2)


@kernel
def cut_bend(edges, r, carry, c):
    """
    Multiply second differences down the columns by their factors.

    Parameters
    ----------
    edges : (h, k, w) array of float32
        Factors.
    r : int
        Row, not the first.
    carry : (n, w) array of float
        Row c is changed in place.
    c : int
        Row of `carry`.
    """
    for q in range(edges.shape[2]):
        carry[c, q] *= min(edges[r - 1, 1, q], edges[r, 1, q])


@kernel
def cut_row(x, rows, data, r, over, above, kb, km, is_bent, carry, c, acc, a, edges, below):
    """
    `product.product_row` with the springs that are left.

    Parameters
    ----------
    x, rows, data, r, over, above, kb, km, is_bent, carry, c, acc, a
        As for `product.whole_row`.
    edges : (h, k, w) array of float32
        Factors.
    below : int
        The row below the row, or the row itself if it is the last.
    """
    upper, middle, lower, lowest = rows
    w = x.shape[1]
    cut_ends(x, rows, data, r, over, above, kb, km, is_bent, carry, c, acc, a, edges, below)
    zero = x.dtype.type(0)
    flux = c + 1
    for k in range(w - 4):
        q = np.uint64(k) + TWO
        west, east = q - ONE, q + ONE
        here = x[middle, q]
        before, after = here - x[middle, west], x[middle, east] - here
        e_west, e_here, s_here = edges[r, 0, west], edges[r, 0, q], edges[r, 1, q]
        bend = min(e_west, e_here) * (after - before)
        bend_west = min(edges[r, 0, q - TWO], e_west) * (
            before - (x[middle, west] - x[middle, q - TWO])
        )
        bend_east = min(e_here, edges[r, 0, east]) * (
            (x[middle, q + TWO] - x[middle, east]) - after
        )
        step = x[lower, q] - here
        fall = (x[lowest, q] - x[lower, q]) - step
        bend_below = min(s_here, edges[below, 1, q]) * fall if is_bent else zero
        square = min(min(e_here, edges[below, 0, q]), min(s_here, edges[r, 1, east]))
        twist = square * ((x[lower, east] - x[middle, east]) - step)
        square = min(min(e_west, edges[below, 0, west]), min(edges[r, 1, west], s_here))
        twist -= square * (step - (x[lower, west] - x[middle, west]))
        flow = kb * ((bend_below - carry[c, q]) + (twist + twist)) - km * (s_here * step)
        force = (flow - carry[flux, q]) + kb * ((bend_east - bend) - (bend - bend_west))
        force -= km * (e_here * after)
        force += km * (e_west * before)
        force += (
            data[r, 0, q] * here + data[r, 2, q] * x[lower, q] + over[above, 2, q] * x[upper, q]
        )
        force += (
            data[r, 1, q] * x[middle, east]
            + data[r, 3, q] * x[lower, east]
            + over[above, 4, east] * x[upper, east]
        )
        force += (
            data[r, 1, west] * x[middle, west]
            + data[r, 4, q] * x[lower, west]
            + over[above, 3, west] * x[upper, west]
        )
        carry[c, q] = bend_below
        carry[flux, q] = flow
        acc[a, q] = force


@kernel
def cut_ends(x, rows, data, r, over, above, kb, km, is_bent, carry, c, acc, a, edges, below):
    """
    Do what `cut_row` does for the two nodes at each end of the row.

    Parameters
    ----------
    x, rows, data, r, over, above, kb, km, is_bent, carry, c, acc, a, edges, below
        As for `cut_row`.
    """
    upper, middle, lower, lowest = rows
    w = x.shape[1]
    zero = x.dtype.type(0)
    n = min(4, w)
    for k in range(n):
        q = k if k < 2 else w - n + k
        here = x[middle, q]
        step = x[lower, q] - here
        fall = (x[lowest, q] - x[lower, q]) - step
        bend_below = min(edges[r, 1, q], edges[below, 1, q]) * fall if is_bent else zero
        twist = zero
        if q + 1 < w:
            square = min(
                min(edges[r, 0, q], edges[below, 0, q]), min(edges[r, 1, q], edges[r, 1, q + 1])
            )
            twist += square * ((x[lower, q + 1] - x[middle, q + 1]) - step)
        if q > 0:
            square = min(
                min(edges[r, 0, q - 1], edges[below, 0, q - 1]),
                min(edges[r, 1, q - 1], edges[r, 1, q]),
            )
            twist -= square * (step - (x[lower, q - 1] - x[middle, q - 1]))
        flow = kb * ((bend_below - carry[c, q]) + (twist + twist)) - km * (edges[r, 1, q] * step)
        west, bend = cut_second(x, middle, edges, r, q - 1), cut_second(x, middle, edges, r, q)
        east = cut_second(x, middle, edges, r, q + 1)
        force = (flow - carry[c + 1, q]) + kb * ((east - bend) - (bend - west))
        if q + 1 < w:
            force -= km * (edges[r, 0, q] * (x[middle, q + 1] - here))
        if q > 0:
            force += km * (edges[r, 0, q - 1] * (here - x[middle, q - 1]))
        force += (
            data[r, 0, q] * here + data[r, 2, q] * x[lower, q] + over[above, 2, q] * x[upper, q]
        )
        if q + 1 < w:
            force += (
                data[r, 1, q] * x[middle, q + 1]
                + data[r, 3, q] * x[lower, q + 1]
                + over[above, 4, q + 1] * x[upper, q + 1]
            )
        if q > 0:
            force += (
                data[r, 1, q - 1] * x[middle, q - 1]
                + data[r, 4, q] * x[lower, q - 1]
                + over[above, 3, q - 1] * x[upper, q - 1]
            )
        carry[c, q] = bend_below
        carry[c + 1, q] = flow
        acc[a, q] = force


@kernel
def cut_second(x, middle, edges, r, q):
    """
    Second difference along a row, times its factor; zero at its ends and beyond.

    Parameters
    ----------
    x : (n, w) array of float
        Heights.
    middle : int
        Row of the array.
    edges : (h, k, w) array of float32
        Factors.
    r, q : int
        Row of the grid, column.
    """
    if 1 <= q < x.shape[1] - 1:
        return min(edges[r, 0, q - 1], edges[r, 0, q]) * (
            (x[middle, q + 1] - x[middle, q]) - (x[middle, q] - x[middle, q - 1])
        )
    return x.dtype.type(0)


@kernel
def cut_stiffness(edges, kb, km, start, stop):
    """
    Diagonal of the surface springs.

    Parameters
    ----------
    edges : (h, 3, w) array of float32
        Factors in ``edges[:, :2]``; ``edges[start:stop, 2]`` is set.
    kb, km : float
        Stiffness.
    start, stop : int
        Rows.
    """
    h, _, w = edges.shape
    for r in range(start, stop):
        for q in range(w):
            bend = 0.0
            stretch = 0.0
            for k in range(-1, 2):
                weight = 4.0 if k == 0 else 1.0
                if 1 <= q + k < w - 1:
                    bend += weight * min(edges[r, 0, q + k - 1], edges[r, 0, q + k])
                if 1 <= r + k < h - 1:
                    bend += weight * min(edges[r + k - 1, 1, q], edges[r + k, 1, q])
            for a in range(max(r - 1, 0), min(r + 1, h - 1)):
                stretch += edges[a, 1, q]
                for b in range(max(q - 1, 0), min(q + 1, w - 1)):
                    bend += 2.0 * min(
                        min(edges[a, 0, b], edges[a + 1, 0, b]),
                        min(edges[a, 1, b], edges[a, 1, b + 1]),
                    )
            for b in range(max(q - 1, 0), min(q + 1, w - 1)):
                stretch += edges[r, 0, b]
            edges[r, 2, q] = kb * bend + km * stretch


@kernel
def cut_diagonal_row(data, edges, r, out):
    """
    One row of the diagonal of H.

    Parameters
    ----------
    data : (h, 5, w) array of float
        Data stencil.
    edges : (h, 3, w) array of float32
        As `cut_stiffness` left them.
    r : int
        Row.
    out : (w,) array of float
        Set; infinite where nothing holds a node, which then stays where it is.
    """
    own, surface = data[r, 0], edges[r, 2]
    for q in range(out.size):
        out[q] = own[q] + surface[q]
        if not out[q] > 0:
            out[q] = np.inf
