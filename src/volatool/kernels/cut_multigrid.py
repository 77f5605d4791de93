"""Transfer between grids with cut springs: no height is carried across a cut.

A fine node takes its height from the coarse nodes that it hangs together with; see `parents`. A
coarse edge is as strong as the weakest fine edge on its way.
"""

import numpy as np

from volatool.kernels._jit import kernel

CARRIES = 0.1
"""Coarse edges weaker than this don't count as holding their nodes together."""


@kernel
def share(a, b):
    """
    Weights of two neighbours by the factors of the edges to them.

    Parameters
    ----------
    a, b : float32
        Factors.

    Returns
    -------
    weights : tuple of 2 float32
        They sum to one; zeros when both are cut off.
    """
    total = a + b
    if not total > 0:
        return np.float32(0), np.float32(0)
    return a / total, b / total


@kernel
def factor(edges, r, axis, q):
    """
    Factor of an edge; 1 if it leaves the grid, towards the coarse nodes beyond its rim.

    Parameters
    ----------
    edges : (h, k, w) array of float32
        Factors.
    r, axis, q : int
        Row; 0 for the edge east, 1 for the edge south; column.
    """
    h, _, w = edges.shape
    if (axis == 0 and q >= w - 1) or (axis == 1 and r >= h - 1):
        return np.float32(1)
    return edges[r, axis, q]


@kernel
def parents(edges, r, q):
    """
    Weights of the coarse nodes from which a fine node is interpolated.

    Parameters
    ----------
    edges : (h, k, w) array of float32
        Factors of the fine grid.
    r, q : int
        Fine node.

    Returns
    -------
    weights : tuple of 4 float32
        Of coarse nodes (r // 2, q // 2), the next one in the row, and both in the row below. They
        sum to one, or to zero for a node that hangs together with none of them.

    Notes
    -----
    With whole edges this is bilinear interpolation. A node between two coarse ones shares by its
    edges' factors; a node amid four takes from its four neighbours what they have, by the edges'
    factors, leaving out those that have nothing.
    """
    zero, one, half = np.float32(0), np.float32(1), np.float32(0.5)
    h, _, w = edges.shape
    if r % 2 == 0 and q % 2 == 0:
        return one, zero, zero, zero
    if r % 2 == 0:
        a, b = share(edges[r, 0, q - 1], factor(edges, r, 0, q))
        return a, b, zero, zero
    if q % 2 == 0:
        a, b = share(edges[r - 1, 1, q], factor(edges, r, 1, q))
        return a, zero, b, zero
    n0, n1 = share(edges[r - 1, 0, q - 1], factor(edges, r - 1, 0, q))
    w0, w1 = share(edges[r - 1, 1, q - 1], factor(edges, r, 1, q - 1))
    s0, s1, e0, e1 = half, half, half, half
    if r + 1 < h:
        s0, s1 = share(edges[r + 1, 0, q - 1], factor(edges, r + 1, 0, q))
    if q + 1 < w:
        e0, e1 = share(edges[r - 1, 1, q + 1], factor(edges, r, 1, q + 1))
    north = edges[r - 1, 1, q] * (n0 + n1)
    west = edges[r, 0, q - 1] * (w0 + w1)
    south = factor(edges, r, 1, q) * (s0 + s1)
    east = factor(edges, r, 0, q) * (e0 + e1)
    total = north + west + south + east
    if not total > 0:
        return zero, zero, zero, zero
    return (
        (north * n0 + west * w0) / total,
        (north * n1 + east * e0) / total,
        (south * s0 + west * w1) / total,
        (south * s1 + east * e1) / total,
    )


@kernel
def cut_restrict_row(force, r, edges, upper, lower):
    """
    Add a fine row to the coarse grid by the transpose of `cut_prolong_row`.

    Parameters
    ----------
    force : (2 n + 1,) array of float32
        The fine row from index 1 on.
    r : int
        Its row; a coarse row is set by the first fine row that touches it.
    edges : (h, k, w) array of float32
        Factors of the fine grid.
    upper, lower : (n,) arrays of float32
        Coarse rows ``r // 2`` and ``r // 2 + 1``, added to; the lower one only if r is odd.
    """
    if r == 0:
        upper[:] = 0.0
    if r % 2 == 1:
        lower[:] = 0.0
    for q in range(edges.shape[2]):
        a, b, c, d = parents(edges, r, q)
        value = force[q + 1]
        left, right = q // 2, (q + 1) // 2
        upper[left] += a * value
        upper[right] += b * value
        if r % 2 == 1:
            lower[left] += c * value
            lower[right] += d * value


@kernel
def cut_prolong_row(coarse, r, edges, out):
    """
    One row of heights of the coarse nodes that fine nodes hang together with.

    Parameters
    ----------
    coarse : (m, n) array of float32
        Coarse heights.
    r : int
        Fine row.
    edges : (h, k, w) array of float32
        Factors of the fine grid.
    out : (w,) array of float32
        Set.
    """
    upper = coarse[r // 2]
    lower = coarse[(r + 1) // 2]
    for q in range(out.size):
        a, b, c, d = parents(edges, r, q)
        left, right = q // 2, (q + 1) // 2
        out[q] = (a * upper[left] + b * upper[right]) + (c * lower[left] + d * lower[right])


@kernel
def coarsen_edges(edges, coarse, start, stop):
    """
    Factors of the next coarser grid: the smallest on the way.

    Parameters
    ----------
    edges : (h, k, w) array of float32
        Factors of the fine grid.
    coarse : (h // 2 + 1, k, w // 2 + 1) array of float32
        Set. Nodes beyond the fine grid's rim have the factors of the rim.
    start, stop : int
        Rows of the coarse grid.
    """
    h, _, w = edges.shape
    for a in range(start, stop):
        r = min(2 * a, h - 1)
        for b in range(coarse.shape[2]):
            q = min(2 * b, w - 1)
            coarse[a, 0, b] = min(factor(edges, r, 0, 2 * b), factor(edges, r, 0, 2 * b + 1))
            coarse[a, 1, b] = min(factor(edges, 2 * a, 1, q), factor(edges, 2 * a + 1, 1, q))


@kernel
def cut_coarsen_data(data, edges, coarse_edges, stiffness, coarse, start, stop):
    """
    Galerkin product of the data stencil with `cut_prolong_row`: again 9-point.

    Parameters
    ----------
    data : (h, 5, w) array of float32
        Fine stencil.
    edges : (h, k, w) array of float32
        Factors of the fine grid.
    coarse_edges : (h // 2 + 1, k, w // 2 + 1) array of float32
        Factors of the coarse grid.
    stiffness : float32
        Of a spring across a fine edge by which nodes hang together whose parents do not. The coarse
        grid would not know of it, hold parts of itself too weakly, and correct too much.
    coarse : (h // 2 + 1, 5, w // 2 + 1) array of float32
        Added to; zeros before the first strip. Strips must be done in order.
    start, stop : int
        Rows of the fine grid.
    """
    w = data.shape[2]
    for r in range(start, stop):
        for q in range(w):
            own = data[r, 0, q]
            for axis in range(2):
                if is_leak(edges, coarse_edges, r, axis, q):
                    k = edges[r, axis, q] * stiffness
                    add_spring(edges, coarse, r, q, r + axis, q + 1 - axis, k)
            if own == 0:
                continue  # no point is attached: no coupling either
            mine = parents(edges, r, q)
            for i in range(4):
                for j in range(i, 4):
                    value = own * mine[i] * mine[j]
                    if value != 0:
                        add_coupling(coarse, r, q, i, r, q, j, value)
            for k in range(1, 5):
                value = data[r, k, q]
                if value == 0:
                    continue
                r2 = r if k == 1 else r + 1
                q2 = q + (0 if k == 2 else (-1 if k == 4 else 1))
                other = parents(edges, r2, q2)
                for i in range(4):
                    for j in range(4):
                        part = value * mine[i] * other[j]
                        if part != 0:
                            add_coupling(coarse, r, q, i, r2, q2, j, part)
                            if same_node(r, q, i, r2, q2, j):
                                add_coupling(coarse, r, q, i, r2, q2, j, part)


@kernel
def coarse_place(r, q, i):
    """
    Row and column of a fine node's i-th parent.

    Parameters
    ----------
    r, q, i : int
        Fine node; parent as `parents` numbers them.
    """
    row = r // 2 if i < 2 else (r + 1) // 2
    col = q // 2 if i % 2 == 0 else (q + 1) // 2
    return row, col


@kernel
def same_node(r, q, i, r2, q2, j):
    """
    Whether two parents are one coarse node.

    Parameters
    ----------
    r, q, i, r2, q2, j : int
        Two fine nodes and their parents' numbers.
    """
    a, b = coarse_place(r, q, i)
    c, d = coarse_place(r2, q2, j)
    return a == c and b == d


@kernel
def add_coupling(coarse, r, q, i, r2, q2, j, value):
    """
    Add to the stored coupling of two coarse nodes, in whichever order they come.

    Parameters
    ----------
    coarse : (m, 5, n) array of float32
        Data stencil.
    r, q, i, r2, q2, j : int
        Two fine nodes and their parents' numbers.
    value : float32
        Added once, also to a diagonal.
    """
    a, b = coarse_place(r, q, i)
    c, d = coarse_place(r2, q2, j)
    if c < a or (c == a and d < b):
        a, b, c, d = c, d, a, b
    if a == c:
        coarse[a, 0 if b == d else 1, b] += value
    else:
        coarse[a, 2 if d == b else (3 if d > b else 4), b] += value


@kernel
def is_leak(edges, coarse_edges, r, axis, q):
    """
    Whether a fine edge holds together what the coarse grid does not.

    Parameters
    ----------
    edges, coarse_edges : arrays of float32
        Factors of the fine and the coarse grid.
    r, axis, q : int
        Fine edge.
    """
    h, _, w = edges.shape
    if (axis == 0 and q >= w - 1) or (axis == 1 and r >= h - 1) or not edges[r, axis, q] > 0:
        return False
    a, b = r // 2, q // 2
    m, n = coarse_edges.shape[0], coarse_edges.shape[2]
    above = b + 1 >= n or coarse_edges[a, 0, b] >= CARRIES
    below = a + 1 >= m or b + 1 >= n or coarse_edges[a + 1, 0, b] >= CARRIES
    left = a + 1 >= m or coarse_edges[a, 1, b] >= CARRIES
    right = a + 1 >= m or b + 1 >= n or coarse_edges[a, 1, b + 1] >= CARRIES
    if above and below and left and right:
        return False
    # number the parts of the coarse quad
    part = np.arange(4)
    for _ in range(3):
        if above:
            part[0] = part[1] = min(part[0], part[1])
        if below:
            part[2] = part[3] = min(part[2], part[3])
        if left:
            part[0] = part[2] = min(part[0], part[2])
        if right:
            part[1] = part[3] = min(part[1], part[3])
    seen = -1
    n_held = 0
    for k in range(2):
        r2, q2 = r + k * axis, q + k * (1 - axis)
        of_node = parents(edges, r2, q2)
        total = np.float32(0)
        for i in range(4):
            total += of_node[i]
            if of_node[i] > 0:
                c, d = coarse_place(r2, q2, i)
                own = part[2 * (c - a) + d - b]
                if seen >= 0 and own != seen:
                    return True
                seen = own
        n_held += 1 if total > 0 else 0
    return n_held == 1


@kernel
def add_spring(edges, coarse, r, q, r2, q2, stiffness):
    """
    Add a spring between two fine nodes to the coarse stencil.

    Parameters
    ----------
    edges : (h, k, w) array of float32
        Factors of the fine grid.
    coarse : (m, 5, n) array of float32
        Data stencil.
    r, q, r2, q2 : int
        Fine nodes, neighbours.
    stiffness : float32
        Of the spring.
    """
    mine, other = parents(edges, r, q), parents(edges, r2, q2)
    for i in range(4):
        for j in range(i, 4):
            add_coupling(coarse, r, q, i, r, q, j, stiffness * mine[i] * mine[j])
            add_coupling(coarse, r2, q2, i, r2, q2, j, stiffness * other[i] * other[j])
        for j in range(4):
            value = -stiffness * mine[i] * other[j]
            if value != 0:
                add_coupling(coarse, r, q, i, r2, q2, j, value)
                if same_node(r, q, i, r2, q2, j):
                    add_coupling(coarse, r, q, i, r2, q2, j, value)
