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
def cut_row_bend(step_above, step_below, edges, r, out):
    """
    Second differences down the columns at row r, times their factors.

    Parameters
    ----------
    step_above, step_below : (w + 2,) arrays of float
        `spring.row_step` of rows r - 1 and r.
    edges : (h, k, w) array of float32
        Factors.
    r : int
        Row.
    out : (w + 2,) array of float
        Set; zero at the first and last row.
    """
    h, _, w = edges.shape
    out[:] = 0.0
    if 1 <= r < h - 1:
        above, below = edges[r - 1, 1], edges[r, 1]
        over, under, inner = step_above[1:], step_below[1:], out[1:]
        for q in range(w):
            inner[q] = min(above[q], below[q]) * (under[q] - over[q])


@kernel
def cut_row_flux(step, bend_above, bend_below, edges, r, kb, km, out):
    """
    Force that passes from row r to row r + 1 through the springs that are left.

    Parameters
    ----------
    step : (w + 2,) array of float
        `spring.row_step` of row r.
    bend_above, bend_below : (w + 2,) arrays of float
        `cut_row_bend` of rows r and r + 1.
    edges : (h, k, w) array of float32
        Factors.
    r : int
        Row; nothing passes out of the grid.
    kb, km : float
        Stiffness.
    out : (w,) array of float
        Set; node r gets it, node r + 1 its opposite.
    """
    h, _, w = edges.shape
    if not 0 <= r < h - 1:
        out[:] = 0.0
        return
    twists = np.zeros(w + 1, out.dtype)
    inner, middle, after = twists[1:], step[1:], step[2:]
    east, south, beyond = edges[r, 0], edges[r, 1], edges[r, 1][1:]
    east_below = edges[r + 1, 0]
    for q in range(w - 1):
        factor = min(min(east[q], east_below[q]), min(south[q], beyond[q]))
        inner[q] = factor * (after[q] - middle[q])
    above, below = bend_above[1:], bend_below[1:]
    for q in range(w):
        twist = inner[q] - twists[q]
        out[q] = kb * ((below[q] - above[q]) + (twist + twist)) - km * (south[q] * middle[q])


@kernel
def cut_across(x, edges, r, kb, km, across, acc):
    """
    Add the springs along row r to its row of the product.

    Parameters
    ----------
    x : (h, w) array of float
        Heights.
    edges : (h, k, w) array of float32
        Factors.
    r : int
        Row.
    kb, km : float
        Stiffness.
    across : (w + 2,) array of float
        Work space; its two first and last entries must be zero, and stay so.
    acc : (w,) array of float
        Added to.
    """
    w = x.shape[1]
    east = edges[r, 0]
    middle = x[r]
    x1, x2, east1 = middle[1:], middle[2:], east[1:]
    inner = across[2:]
    for q in range(w - 2):
        inner[q] = min(east[q], east1[q]) * ((x2[q] - x1[q]) - (x1[q] - middle[q]))
    c1 = across[1:]
    for q in range(w):
        acc[q] += kb * ((inner[q] - c1[q]) - (c1[q] - across[q]))
    for q in range(w - 1):
        acc[q] -= km * (east[q] * (x1[q] - middle[q]))
    west = acc[1:]
    for q in range(w - 1):
        west[q] += km * (east[q] * (x1[q] - middle[q]))


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
