"""Rows of ``H x``: the force of all springs at each node of a grid row.

Nothing is assembled, see `volatool.kernels.spring`. A row needs the heights of the row before it
and of the two after it; what it needs of the row before that, the force that comes through the
springs from above, is carried from row to row. Heights may live in a ring: row r of the grid is row
``r % RING`` of it.

Rows are passed as arrays and row numbers, not as views: a view costs as much as some 40 nodes. The
loops index by unsigned numbers, which numba doesn't wrap around the array's end, and are vector
code.
"""

import numpy as np

from volatool.kernels._jit import kernel
from volatool.kernels.cut_spring import cut_bend, cut_diagonal_row, cut_row

RING = 4
"""Rows of a ring that `product_row` reads."""

ONE, TWO = np.uint64(1), np.uint64(2)


@kernel
def product_row(data, x, at, r, h, kb, km, carry, c, nothing, acc, a, edges=None):
    """
    One row of ``H x``; rows must be done in order.

    Parameters
    ----------
    data : (h, 5, w) array of float
        Data stencil.
    x : (n, w) array of float
        Heights; rows r - 1 to r + 2 are read.
    at : int
        Where the ring of heights begins in x; negative if x is the whole grid.
    r, h : int
        Row; rows of the grid.
    kb, km : float
        Stiffness, of x's type.
    carry : (n, w) array of float
        Rows c and c + 1 as `start_carry` or the call for row r - 1 left them: second differences
        down the columns at row r, and the force from row r - 1 on row r.
    c : int
        Where they are.
    nothing : (1, 5, w) array of data's type
        Zeros.
    acc : (n, w) array of float
        Row a is set to the row of the product.
    a : int
        Row of `acc`.
    edges : (h, k, w) array of float32, optional
        Factors of cut springs, see `cut_spring`.
    """
    middle = ring_row(at, r)
    upper = ring_row(at, r - 1) if r > 0 else middle
    lower = ring_row(at, r + 1) if r + 1 < h else middle
    lowest = ring_row(at, r + 2) if r + 2 < h else lower
    rows = (upper, middle, lower, lowest)
    is_bent = r + 2 < h  # the row below is neither the last nor beyond it
    over, above = (data, r - 1) if r > 0 else (nothing, 0)
    if edges is None:
        whole_row(x, rows, data, r, over, above, kb, km, is_bent, carry, c, acc, a)
    else:
        below = min(r + 1, h - 1)
        cut_row(x, rows, data, r, over, above, kb, km, is_bent, carry, c, acc, a, edges, below)


@kernel
def ring_row(at, r):
    """
    Row of an array that holds row r of the grid.

    Parameters
    ----------
    at : int
        Where the ring begins; negative if the array is the whole grid.
    r : int
        Row, not negative.
    """
    return r if at < 0 else at + r % RING


@kernel
def start_carry(data, x, at, r, h, kb, km, carry, c, nothing, acc, a, edges=None):
    """
    Set what `product_row` carries into a row.

    Parameters
    ----------
    data, x, at, h, kb, km, carry, c, nothing, edges
        As for `product_row`; rows r - 2 to r + 1 of x are read.
    r : int
        Row that `product_row` will be called for first.
    acc, a
        Work space.
    """
    carry[c : c + 2] = 0.0
    if r < 1:
        return
    if r > 1:
        over, middle, under = ring_row(at, r - 2), ring_row(at, r - 1), ring_row(at, r)
        for q in range(x.shape[1]):
            carry[c, q] = (x[under, q] - x[middle, q]) - (x[middle, q] - x[over, q])
        if edges is not None:
            cut_bend(edges, r - 1, carry, c)
    product_row(data, x, at, r - 1, h, kb, km, carry, c, nothing, acc, a, edges)


@kernel
def whole_row(x, rows, data, r, over, above, kb, km, is_bent, carry, c, acc, a):
    """
    `product_row` without cuts.

    Parameters
    ----------
    x : (n, w) array of float
        Heights.
    rows : tuple of 4 int
        Rows of x: the row above, the row, and the two below it.
    data, over : (h, 5, w) arrays of float
        Data stencils.
    r, above : int
        Rows of them: the row in `data`, the one above it in `over`.
    kb, km : float
        Stiffness.
    is_bent : bool
        There are second differences at the row below.
    carry, c, acc, a
        As for `product_row`.
    """
    upper, middle, lower, lowest = rows
    w = x.shape[1]
    whole_ends(x, rows, data, r, over, above, kb, km, is_bent, carry, c, acc, a)
    zero = x.dtype.type(0)
    flux = c + 1
    for k in range(w - 4):
        q = np.uint64(k) + TWO
        west, east = q - ONE, q + ONE
        here = x[middle, q]
        before, after = here - x[middle, west], x[middle, east] - here
        bend = after - before
        bend_west = before - (x[middle, west] - x[middle, q - TWO])
        bend_east = (x[middle, q + TWO] - x[middle, east]) - after
        step = x[lower, q] - here
        bend_below = (x[lowest, q] - x[lower, q]) - step if is_bent else zero
        twist = (x[lower, east] - x[middle, east]) - step
        twist -= step - (x[lower, west] - x[middle, west])
        below = kb * ((bend_below - carry[c, q]) + (twist + twist)) - km * step
        force = (below - carry[flux, q]) + kb * ((bend_east - bend) - (bend - bend_west))
        force -= km * bend
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
        carry[flux, q] = below
        acc[a, q] = force


@kernel
def whole_ends(x, rows, data, r, over, above, kb, km, is_bent, carry, c, acc, a):
    """
    Do what `whole_row` does for the two nodes at each end of the row.

    Parameters
    ----------
    x, rows, data, r, over, above, kb, km, is_bent, carry, c, acc, a
        As for `whole_row`.
    """
    upper, middle, lower, lowest = rows
    w = x.shape[1]
    n = min(4, w)
    for k in range(n):
        q = k if k < 2 else w - n + k
        here = x[middle, q]
        step = x[lower, q] - here
        bend_below = (x[lowest, q] - x[lower, q]) - step if is_bent else x.dtype.type(0)
        # differences go on past the ends: there is no twist
        after = x[lower, q + 1] - x[middle, q + 1] if q + 1 < w else step
        before = x[lower, q - 1] - x[middle, q - 1] if q > 0 else step
        twist = (after - step) - (step - before)
        below = kb * ((bend_below - carry[c, q]) + (twist + twist)) - km * step
        west, bend, east = second(x, middle, q - 1), second(x, middle, q), second(x, middle, q + 1)
        force = (below - carry[c + 1, q]) + kb * ((east - bend) - (bend - west)) - km * bend
        if w > 1 and q == 0:
            force -= km * (x[middle, 1] - here)
        if w > 1 and q == w - 1:
            force -= km * (x[middle, q - 1] - here)
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
        carry[c + 1, q] = below
        acc[a, q] = force


@kernel
def second(x, r, q):
    """
    Second difference along a row; zero at its ends and beyond.

    Parameters
    ----------
    x : (n, w) array of float
        Heights.
    r, q : int
        Row of the array, column.
    """
    if 1 <= q < x.shape[1] - 1:
        return (x[r, q + 1] - x[r, q]) - (x[r, q] - x[r, q - 1])
    return x.dtype.type(0)


@kernel
def diagonal_row(data, r, h, kb, km, out, edges=None):
    """
    One row of the diagonal of H.

    Parameters
    ----------
    data : (h, 5, w) array of float
        Data stencil.
    r, h : int
        Row, number of rows.
    kb, km : float
        Stiffness, of the array's type.
    out : (w,) array of float
        Set; 1 where nothing holds a node (a grid of a single node without data).
    edges : (h, 3, w) array of float32, optional
        Factors of cut springs and their diagonal.
    """
    if edges is None:
        whole_diagonal_row(data, r, h, kb, km, out)
    else:
        cut_diagonal_row(data, edges, r, out)


@kernel
def whole_diagonal_row(data, r, h, kb, km, out):
    """
    One row of the diagonal of H without cuts.

    Parameters
    ----------
    data, r, h, kb, km, out
        As in `diagonal_row`.
    """
    w = out.size
    own = data[r, 0]
    # second differences that hold the node: weight 4 as their middle, 1 as an end
    vertical = 4 * (0 < r < h - 1) + (r > 1) + (r < h - 2)
    rows = (r > 0) + (r < h - 1)
    k_inner = kb * out.dtype.type(6 + vertical + 4 * rows) + km * out.dtype.type(2 + rows)
    for q in range(w):
        out[q] = own[q] + k_inner
    for k in range(4):
        q = k if k < 2 else w - 1 - (k - 2)
        if 0 <= q < w:
            horizontal = 4 * (0 < q < w - 1) + (q > 1) + (q < w - 2)
            cols = (q > 0) + (q < w - 1)
            k_edge = kb * out.dtype.type(horizontal + vertical + 2 * cols * rows)
            out[q] = own[q] + (k_edge + km * out.dtype.type(cols + rows))
            if not out[q] > 0:
                out[q] = 1.0
