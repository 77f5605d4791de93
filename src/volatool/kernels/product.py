"""Rows of ``H x``: the force of all springs at each node of a grid row.

Nothing is assembled, see `volatool.kernels.spring`. A row needs the heights of the row before it
and of the two after it; what it needs of the row before that, the force that comes through the
springs from above, is carried from row to row. Heights may live in a ring: row r of the grid is row
``r % n`` of an (n, w) array, and the whole grid is a ring of all its rows.
"""

from volatool.kernels._jit import kernel
from volatool.kernels.cut_spring import cut_bends, cut_diagonal_row, cut_row

RING = 4
"""Rows of a ring that `product_row` reads."""


@kernel
def product_row(data, x, r, h, kb, km, carry, nothing, acc, edges=None):
    """
    One row of ``H x``; rows must be done in order.

    Parameters
    ----------
    data : (h, 5, w) array of float
        Data stencil.
    x : (n, w) array of float
        Ring of heights; rows r - 1 to r + 2 are read.
    r, h : int
        Row; rows of the grid.
    kb, km : float
        Stiffness, of x's type.
    carry : (2, w) array of float
        As `start_carry` or the call for row r - 1 left it: second differences down the columns at
        row r, and the force from row r - 1 on row r.
    nothing : (5, w) array of data's type
        Zeros.
    acc : (w,) array of float
        Set to the row of the product.
    edges : (h, k, w) array of float32, optional
        Factors of cut springs, see `cut_spring`.
    """
    n = x.shape[0]
    middle = x[r % n]
    upper = x[(r - 1) % n] if r > 0 else middle
    lower = x[(r + 1) % n] if r + 1 < h else middle
    lowest = x[(r + 2) % n] if r + 2 < h else lower
    above = data[r - 1] if r > 0 else nothing
    rows = (upper, middle, lower, lowest)
    is_bent = r + 2 < h  # the row below is neither the last nor beyond it
    if edges is None:
        whole_row(rows, data[r], above, kb, km, is_bent, carry[0], carry[1], acc)
    else:
        below = edges[min(r + 1, h - 1)]
        cut_row(rows, data[r], above, kb, km, is_bent, carry[0], carry[1], acc, edges[r], below)


@kernel
def start_carry(data, x, r, h, kb, km, carry, nothing, acc, edges=None):
    """
    Set what `product_row` carries into a row.

    Parameters
    ----------
    data, x, h, kb, km, carry, nothing, edges
        As for `product_row`; rows r - 2 to r + 1 of x are read.
    r : int
        Row that `product_row` will be called for first.
    acc : (w,) array of float
        Work space.
    """
    carry[:] = 0.0
    if r < 1:
        return
    n = x.shape[0]
    if r > 1:
        over, middle, under = x[(r - 2) % n], x[(r - 1) % n], x[r % n]
        bends = carry[0]
        for q in range(bends.size):
            bends[q] = (under[q] - middle[q]) - (middle[q] - over[q])
        if edges is not None:
            cut_bends(edges[r - 2], edges[r - 1], bends)
    product_row(data, x, r - 1, h, kb, km, carry, nothing, acc, edges)


@kernel
def whole_row(rows, here, above, kb, km, is_bent, bends, fluxes, acc):
    """
    `product_row` without cuts.

    Parameters
    ----------
    rows : tuple of 4 (w,) arrays of float
        Heights of the row above, of the row, and of the two below it.
    here, above : (5, w) arrays of float
        Data stencil of the row and of the one above it.
    kb, km : float
        Stiffness.
    is_bent : bool
        There are second differences at the row below.
    bends, fluxes : (w,) arrays of float
        Carried; set for the next row.
    acc : (w,) array of float
        Set.
    """
    upper, middle, lower, lowest = rows
    w = middle.size
    for q in range(min(2, w)):
        whole_node(rows, here, above, kb, km, is_bent, bends, fluxes, acc, q)
    for q in range(max(2, w - 2), w):
        whole_node(rows, here, above, kb, km, is_bent, bends, fluxes, acc, q)
    # index q stands for column q + 2: the loop has no conditions and no wrap-around, and is vector
    # code; the force down to the next row is kept, so that no difference is taken twice
    x1, x2, x3, x4 = middle[1:], middle[2:], middle[3:], middle[4:]
    up1, up2, up3 = upper[1:], upper[2:], upper[3:]
    down1, down2, down3, deep2 = lower[1:], lower[2:], lower[3:], lowest[2:]
    d0, d1, d1_west = here[0][2:], here[1][2:], here[1][1:]
    d2, d3, d4 = here[2][2:], here[3][2:], here[4][2:]
    u2, u3, u4 = above[2][2:], above[3][1:], above[4][3:]
    bend_here, flux, out = bends[2:], fluxes[2:], acc[2:]
    zero = middle.dtype.type(0)
    for q in range(w - 4):
        step = down2[q] - x2[q]
        bend = (deep2[q] - down2[q]) - step if is_bent else zero
        twist = ((down3[q] - x3[q]) - step) - (step - (down1[q] - x1[q]))
        below = kb * ((bend - bend_here[q]) + (twist + twist)) - km * step
        west = (x2[q] - x1[q]) - (x1[q] - middle[q])
        mid = (x3[q] - x2[q]) - (x2[q] - x1[q])
        east = (x4[q] - x3[q]) - (x3[q] - x2[q])
        force = (below - flux[q]) + kb * ((east - mid) - (mid - west)) - km * mid
        force += d0[q] * x2[q] + d2[q] * down2[q] + u2[q] * up2[q]
        force += d1[q] * x3[q] + d3[q] * down3[q] + u4[q] * up3[q]
        force += d1_west[q] * x1[q] + d4[q] * down1[q] + u3[q] * up1[q]
        bend_here[q] = bend
        flux[q] = below
        out[q] = force


@kernel
def whole_node(rows, here, above, kb, km, is_bent, bends, fluxes, acc, q):
    """
    One node of `whole_row`, near the ends of the row too.

    Parameters
    ----------
    rows, here, above, kb, km, is_bent, bends, fluxes, acc
        As for `whole_row`.
    q : int
        Column.
    """
    upper, middle, lower, lowest = rows
    w = middle.size
    step = lower[q] - middle[q]
    bend = (lowest[q] - lower[q]) - step if is_bent else middle.dtype.type(0)
    # differences go on past the ends: there is no twist
    after = lower[q + 1] - middle[q + 1] if q + 1 < w else step
    before = lower[q - 1] - middle[q - 1] if q > 0 else step
    twist = (after - step) - (step - before)
    below = kb * ((bend - bends[q]) + (twist + twist)) - km * step
    west, mid, east = second(middle, q - 1), second(middle, q), second(middle, q + 1)
    force = (below - fluxes[q]) + kb * ((east - mid) - (mid - west)) - km * mid
    if w > 1 and q == 0:
        force -= km * (middle[1] - middle[0])
    if w > 1 and q == w - 1:
        force -= km * (middle[w - 2] - middle[w - 1])
    force += here[0, q] * middle[q] + here[2, q] * lower[q] + above[2, q] * upper[q]
    if q + 1 < w:
        force += (
            here[1, q] * middle[q + 1] + here[3, q] * lower[q + 1] + above[4, q + 1] * upper[q + 1]
        )
    if q > 0:
        force += (
            here[1, q - 1] * middle[q - 1]
            + here[4, q] * lower[q - 1]
            + above[3, q - 1] * upper[q - 1]
        )
    bends[q] = bend
    fluxes[q] = below
    acc[q] = force


@kernel
def second(row, q):
    """
    Second difference along a row; zero at its ends and beyond.

    Parameters
    ----------
    row : (w,) array of float
        Heights.
    q : int
        Column.
    """
    if 1 <= q < row.size - 1:
        return (row[q + 1] - row[q]) - (row[q] - row[q - 1])
    return row.dtype.type(0)


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
