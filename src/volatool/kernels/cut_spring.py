"""Surface springs of which some are cut or weakened: the rows that `spring` puts together.

An edge between two neighbouring nodes has a factor, 0 cut, 1 whole::

    edges[r, 0, q]  (r, q) - (r, q + 1)        edges[r, 1, q]  (r, q) - (r + 1, q)

A stretching spring has its edge's factor, a second difference the smaller of its two edges', a
twist the smallest of the four around its quad. Factors of edges that would leave the grid are 1
and never used by the springs. Grids of the hierarchy hold the springs' diagonal in ``edges[r, 2]``.
"""

import numpy as np

from volatool.kernels._jit import kernel


@kernel
def cut_bends(above, here, bends):
    """
    Multiply second differences down the columns by their factors.

    Parameters
    ----------
    above, here : (k, w) arrays of float32
        Factors of the row above and of the row.
    bends : (w,) array of float
        Changed in place.
    """
    over, under = above[1], here[1]
    for q in range(bends.size):
        bends[q] *= min(over[q], under[q])


@kernel
def cut_row(rows, here, above, kb, km, is_bent, bends, fluxes, acc, edges, edges_below):
    """
    `product.product_row` with the springs that are left.

    Parameters
    ----------
    rows, here, above, kb, km, is_bent, bends, fluxes, acc
        As for `product.whole_row`.
    edges, edges_below : (k, w) arrays of float32
        Factors of the row and of the one below it.
    """
    upper, middle, lower, lowest = rows
    w = middle.size
    arrays = (here, above, kb, km, is_bent, bends, fluxes, acc, edges, edges_below)
    for q in range(min(2, w)):
        cut_node(rows, *arrays, q)
    for q in range(max(2, w - 2), w):
        cut_node(rows, *arrays, q)
    # as in `whole_row`, index q stands for column q + 2
    x1, x2, x3, x4 = middle[1:], middle[2:], middle[3:], middle[4:]
    up1, up2, up3 = upper[1:], upper[2:], upper[3:]
    down1, down2, down3, deep2 = lower[1:], lower[2:], lower[3:], lowest[2:]
    d0, d1, d1_west = here[0][2:], here[1][2:], here[1][1:]
    d2, d3, d4 = here[2][2:], here[3][2:], here[4][2:]
    u2, u3, u4 = above[2][2:], above[3][1:], above[4][3:]
    bend_here, flux, out = bends[2:], fluxes[2:], acc[2:]
    e0, e1, e2, e3 = edges[0], edges[0][1:], edges[0][2:], edges[0][3:]
    s1, s2, s3 = edges[1][1:], edges[1][2:], edges[1][3:]
    e1_below, e2_below, s2_below = edges_below[0][1:], edges_below[0][2:], edges_below[1][2:]
    zero = middle.dtype.type(0)
    for q in range(w - 4):
        step = down2[q] - x2[q]
        bend = min(s2[q], s2_below[q]) * ((deep2[q] - down2[q]) - step) if is_bent else zero
        square = min(min(e2[q], e2_below[q]), min(s2[q], s3[q]))
        square_west = min(min(e1[q], e1_below[q]), min(s1[q], s2[q]))
        after, before = down3[q] - x3[q], down1[q] - x1[q]
        twist = square * (after - step) - square_west * (step - before)
        below = kb * ((bend - bend_here[q]) + (twist + twist)) - km * (s2[q] * step)
        west = min(e0[q], e1[q]) * ((x2[q] - x1[q]) - (x1[q] - middle[q]))
        mid = min(e1[q], e2[q]) * ((x3[q] - x2[q]) - (x2[q] - x1[q]))
        east = min(e2[q], e3[q]) * ((x4[q] - x3[q]) - (x3[q] - x2[q]))
        force = (below - flux[q]) + kb * ((east - mid) - (mid - west))
        force -= km * (e2[q] * (x3[q] - x2[q]))
        force += km * (e1[q] * (x2[q] - x1[q]))
        force += d0[q] * x2[q] + d2[q] * down2[q] + u2[q] * up2[q]
        force += d1[q] * x3[q] + d3[q] * down3[q] + u4[q] * up3[q]
        force += d1_west[q] * x1[q] + d4[q] * down1[q] + u3[q] * up1[q]
        bend_here[q] = bend
        flux[q] = below
        out[q] = force


@kernel
def cut_node(rows, here, above, kb, km, is_bent, bends, fluxes, acc, edges, edges_below, q):
    """
    One node of `cut_row`, near the ends of the row too.

    Parameters
    ----------
    rows, here, above, kb, km, is_bent, bends, fluxes, acc, edges, edges_below
        As for `cut_row`.
    q : int
        Column.
    """
    upper, middle, lower, lowest = rows
    w = middle.size
    zero = middle.dtype.type(0)
    east, south, east_below = edges[0], edges[1], edges_below[0]
    step = lower[q] - middle[q]
    bend = min(south[q], edges_below[1, q]) * ((lowest[q] - lower[q]) - step) if is_bent else zero
    twist = zero
    if q + 1 < w:
        square = min(min(east[q], east_below[q]), min(south[q], south[q + 1]))
        twist += square * ((lower[q + 1] - middle[q + 1]) - step)
    if q > 0:
        square = min(min(east[q - 1], east_below[q - 1]), min(south[q - 1], south[q]))
        twist -= square * (step - (lower[q - 1] - middle[q - 1]))
    below = kb * ((bend - bends[q]) + (twist + twist)) - km * (south[q] * step)
    left, mid = cut_second(middle, east, q - 1), cut_second(middle, east, q)
    right = cut_second(middle, east, q + 1)
    force = (below - fluxes[q]) + kb * ((right - mid) - (mid - left))
    if q + 1 < w:
        force -= km * (east[q] * (middle[q + 1] - middle[q]))
    if q > 0:
        force += km * (east[q - 1] * (middle[q] - middle[q - 1]))
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
def cut_second(row, east, q):
    """
    Second difference along a row, times its factor; zero at its ends and beyond.

    Parameters
    ----------
    row : (w,) array of float
        Heights.
    east : (w,) array of float32
        Factors of the row's edges.
    q : int
        Column.
    """
    if 1 <= q < row.size - 1:
        return min(east[q - 1], east[q]) * ((row[q + 1] - row[q]) - (row[q] - row[q - 1]))
    return row.dtype.type(0)


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
