"""Evidence by quads: the springs of the points between four neighbouring nodes, kept apart.

A quad is the square between the centres of four cells; row by row its nodes are 0 and 1 above, 2
and 3 below. All points in it pull on these four alone, so that its evidence is a symmetric 4 x 4
matrix and a right side, and can be weakened by itself without touching that of its neighbours::

    quad[0:4]   00 11 22 33          quad[4:10]  01 02 03 12 13 23
    quad[10:14] right side of nodes 0 to 3
"""

import numpy as np

from volatool.kernels._jit import kernel
from volatool.kernels.chance import hash_three

SALT = 41
"""Tells the signs of quads from those of points and surface springs."""

SIZE = 14
"""Numbers of a quad."""

COUPLING = ((0, 4, 5, 6), (4, 0, 7, 8), (5, 7, 0, 9), (6, 8, 9, 0))
"""Where a quad has the coupling of two different nodes."""

TOWARDS = ((0, 1, 2, 3), (0, 0, 4, 2), (0, 0, 0, 1), (0, 0, 0, 0))
"""Plane of the stencil for the coupling of a node to a later one."""


@kernel
def add_points(
    quads, counts, col, row, height, weights, order, first, last, left, top, nearest, most
):
    """
    Add the data springs of some points to a block's quads.

    Parameters
    ----------
    quads : (n, n, 14) array of float64
        Evidence, added to.
    counts : (n + 1, n + 1) array of uint32
        Points per cell, added to; the cells of the quads' four nodes.
    col, row : (m,) arrays of float64
        Places in cells from the world's origin; node (r, q) is at (r + 0.5, q + 0.5).
    height : (m,) array of float64
        Heights.
    weights : (m,) or (1,) array of float64
        Stiffness of each point's spring, or one for all of them.
    order : (m,) array of int64
        Points by block; those of this block are ``order[first:last]``.
    first, last : int
        As above.
    left, top : int
        Column and row of the block's first quad.
    nearest : bool
        Attach to the nearest node alone.
    most : float
        Bound of a quad's weight: what is over it weakens all of the quad's evidence alike.
    """
    last_weight = weights.size - 1
    for k in range(first, last):
        i = order[k]
        x = col[i] - 0.5
        y = row[i] - 0.5
        q = np.int64(np.floor(x))
        r = np.int64(np.floor(y))
        u = x - q
        v = y - r
        q -= left
        r -= top
        right_half = u >= 0.5
        lower_half = v >= 0.5
        counts[r + np.int64(lower_half), q + np.int64(right_half)] += np.uint32(1)
        weight = weights[min(i, last_weight)]
        quad = quads[r, q]
        if nearest:
            node = 2 * np.int64(lower_half) + np.int64(right_half)
            quad[node] += weight
            quad[10 + node] += weight * height[i]
            continue
        p0 = (1.0 - u) * (1.0 - v)
        p1 = u * (1.0 - v)
        p2 = (1.0 - u) * v
        p3 = u * v
        w0, w1, w2, w3 = weight * p0, weight * p1, weight * p2, weight * p3
        quad[0] += w0 * p0
        quad[1] += w1 * p1
        quad[2] += w2 * p2
        quad[3] += w3 * p3
        quad[4] += w0 * p1
        quad[5] += w0 * p2
        quad[6] += w0 * p3
        quad[7] += w1 * p2
        quad[8] += w1 * p3
        quad[9] += w2 * p3
        quad[10] += w0 * height[i]
        quad[11] += w1 * height[i]
        quad[12] += w2 * height[i]
        quad[13] += w3 * height[i]
    if most < np.inf:
        for k in range(first, last):
            i = order[k]
            quad = quads[
                np.int64(np.floor(row[i] - 0.5)) - top, np.int64(np.floor(col[i] - 0.5)) - left
            ]
            total = 0.0
            for part in range(4):
                total += quad[part]
            for part in range(4, 10):
                total += 2.0 * quad[part]
            if total > most:
                quad *= most / total


@kernel
def gather(quads, factor, left, top, data, right):
    """
    Add a block's quads to the stencil of a window.

    Parameters
    ----------
    quads : (n, n, 14) array of float64
        Evidence of the block.
    factor : float
        On all of it.
    left, top : int
        Column and row of the block's first quad in the window; may lie outside.
    data : (h, 5, w) array of float64
        Stencil of `volatool.kernels.spring`, added to.
    right : (h, w) array of float64
        Right side, added to.

    Notes
    -----
    A coupling to a node outside the window goes to the inner node's diagonal: the outer node is
    taken to be as high as the inner one. Without that it would be held at height zero.
    """
    h, w = right.shape
    n = quads.shape[0]
    for i in range(max(0, -1 - top), min(n, h - top)):
        r = top + i
        has_upper = r >= 0
        has_lower = r + 1 < h
        for j in range(max(0, -1 - left), min(n, w - left)):
            q = left + j
            quad = quads[i, j]
            if has_upper and has_lower and q >= 0 and q + 1 < w:
                data[r, 0, q] += factor * quad[0]
                data[r, 0, q + 1] += factor * quad[1]
                data[r + 1, 0, q] += factor * quad[2]
                data[r + 1, 0, q + 1] += factor * quad[3]
                data[r, 1, q] += factor * quad[4]
                data[r, 2, q] += factor * quad[5]
                data[r, 3, q] += factor * quad[6]
                data[r, 4, q + 1] += factor * quad[7]
                data[r, 2, q + 1] += factor * quad[8]
                data[r + 1, 1, q] += factor * quad[9]
                right[r, q] += factor * quad[10]
                right[r, q + 1] += factor * quad[11]
                right[r + 1, q] += factor * quad[12]
                right[r + 1, q + 1] += factor * quad[13]
                continue
            for a in range(4):
                row, col = r + a // 2, q + a % 2
                if row < 0 or row >= h or col < 0 or col >= w:
                    continue
                own = quad[a]
                for b in range(4):
                    if b == a:
                        continue
                    coupling = quad[COUPLING[a][b]]
                    other_row, other_col = r + b // 2, q + b % 2
                    if 0 <= other_row < h and 0 <= other_col < w:
                        if a < b:
                            data[row, TOWARDS[a][b], col] += factor * coupling
                    else:
                        own += coupling
                data[row, 0, col] += factor * own
                right[row, col] += factor * quad[10 + a]


@kernel
def pull(quads, factor, left, top, world_left, world_top, first, forces):
    """
    Add random forces whose covariance is that of `gather`'s stencil, one for each sample.

    Parameters
    ----------
    quads : (n, n, 14) array of float64
        Evidence of the block.
    factor : float
        On all of it.
    left, top : int
        Column and row of the block's first quad in the window.
    world_left, world_top : int
        The same in the world: windows that overlap agree on the signs.
    first : int
        Number of the first sample.
    forces : (h, w, m) array of float32
        Of samples ``first .. first + m``, added to; at most 64 in all.

    Notes
    -----
    A quad's 4 x 4 matrix is ``L L^T`` (Cholesky, semi-definite: a direction without stiffness gets
    no force), and ``L e`` with four signs e has it as covariance. The points themselves are gone.
    """
    h, w, n_samples = forces.shape
    n = quads.shape[0]
    root = np.empty((4, 4))
    for i in range(max(0, -1 - top), min(n, h - top)):
        for j in range(max(0, -1 - left), min(n, w - left)):
            quad = quads[i, j]
            if not quad[0] + quad[1] + quad[2] + quad[3] > 0.0:
                continue
            rows = (top + i, top + i, top + i + 1, top + i + 1)
            cols = (left + j, left + j + 1, left + j, left + j + 1)
            root[:] = 0.0
            for a in range(4):
                if not (0 <= rows[a] < h and 0 <= cols[a] < w):
                    continue
                root[a, a] += quad[a]
                for b in range(4):
                    if b == a:
                        continue
                    coupling = quad[COUPLING[a][b]]
                    if 0 <= rows[b] < h and 0 <= cols[b] < w:
                        root[a, b] = coupling
                    else:
                        root[a, a] += coupling
            for k in range(4):
                limit = 1e-12 * root[k, k]
                for b in range(k):
                    root[k, k] -= root[k, b] * root[k, b]
                if not root[k, k] > limit:
                    root[k:, k] = 0.0
                    continue
                root[k, k] = np.sqrt(root[k, k])
                for a in range(k + 1, 4):
                    for b in range(k):
                        root[a, k] -= root[a, b] * root[k, b]
                    root[a, k] /= root[k, k]
            for k in range(4):
                if root[k, k] == 0.0:
                    continue
                bits = hash_three(world_top + i, world_left + j, k, SALT)
                for a in range(k, 4):
                    force = np.float32(np.sqrt(factor) * root[a, k])
                    if force != 0.0:
                        node = forces[rows[a], cols[a]]
                        for sample in range(n_samples):
                            if (bits >> np.uint64(first + sample)) & np.uint64(1):
                                node[sample] += force
                            else:
                                node[sample] -= force
