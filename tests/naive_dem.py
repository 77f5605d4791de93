"""Plain twins of the spring, multigrid and binning kernels: slow, obvious, dense."""

from __future__ import annotations

import numpy as np


def weights(col, row, shape):
    """Nodes and bilinear weights of a point; nodes are cell centres, the rim is clamped."""
    h, w = shape
    x = min(max(col - 0.5, 0.0), w - 1.0)
    y = min(max(row - 0.5, 0.0), h - 1.0)
    q, r = min(int(x), w - 2), min(int(y), h - 2)
    u, v = x - q, y - r
    return [
        ((r, q), (1 - u) * (1 - v)),
        ((r, q + 1), u * (1 - v)),
        ((r + 1, q), (1 - u) * v),
        ((r + 1, q + 1), u * v),
    ]


def surface_matrix(h, w, kb, km):
    """Dense km L + kb P from one row per spring."""
    rows = []

    def spring(stiffness, *terms):
        line = np.zeros((h, w))
        for r, q, factor in terms:
            line[r, q] += factor
        rows.append(np.sqrt(stiffness) * line.ravel())

    for r in range(h):
        for q in range(w):
            if q + 1 < w:
                spring(km, (r, q, 1), (r, q + 1, -1))
            if r + 1 < h:
                spring(km, (r, q, 1), (r + 1, q, -1))
            if 0 < q < w - 1:
                spring(kb, (r, q - 1, 1), (r, q, -2), (r, q + 1, 1))
            if 0 < r < h - 1:
                spring(kb, (r - 1, q, 1), (r, q, -2), (r + 1, q, 1))
            if r + 1 < h and q + 1 < w:
                spring(
                    2 * kb, (r, q, 1), (r, q + 1, -1), (r + 1, q, -1), (r + 1, q + 1, 1)
                )  # fmt: skip
    if not rows:
        return np.zeros((h * w, h * w))
    springs = np.array(rows)
    return springs.T @ springs


def data_matrix(col, row, height, weight, shape):
    """Dense D and b."""
    n = shape[0] * shape[1]
    matrix, right = np.zeros((n, n)), np.zeros(n)
    for x, y, z in zip(col, row, height, strict=True):
        phi = np.zeros(shape)
        for node, part in weights(x, y, shape):
            phi[node] += part
        phi = phi.ravel()
        matrix += weight * np.outer(phi, phi)
        right += weight * z * phi
    return matrix, right


def dense_stencil(data):
    """Dense matrix of a 9-point stencil."""
    h, _, w = data.shape
    matrix = np.zeros((h * w, h * w))
    for r in range(h):
        for q in range(w):
            matrix[r * w + q, r * w + q] += data[r, 0, q]
            for k, (dr, dq) in enumerate(((0, 1), (1, 0), (1, 1), (1, -1)), start=1):
                if r + dr < h and 0 <= q + dq < w:
                    a, b = r * w + q, (r + dr) * w + q + dq
                    matrix[a, b] += data[r, k, q]
                    matrix[b, a] += data[r, k, q]
                else:
                    assert data[r, k, q] == 0
    return matrix


def prolongation(n):
    """Interpolation matrix along one axis, n fine nodes from n // 2 + 1 coarse ones."""
    matrix = np.zeros((n, n // 2 + 1))
    for fine in range(n):
        if fine % 2 == 0:
            matrix[fine, fine // 2] = 1
        else:
            matrix[fine, fine // 2] = matrix[fine, fine // 2 + 1] = 0.5
    return matrix


def distances(cells, wanted):
    """Distance of every cell to the nearest wanted one."""
    at = np.argwhere(cells == wanted)
    out = np.full(cells.shape, np.inf)
    for r, q in np.ndindex(cells.shape):
        for a, b in at:
            out[r, q] = min(out[r, q], np.hypot(r - a, q - b))
    return out


def lowest(rows, cell_of, sign):
    """Best point of each cell: lowest (1) or highest (-1), ties by x, then y."""
    best = {}
    for x, y, z in rows.tolist():
        key = cell_of(x, y)
        best[key] = min(best.get(key, (np.inf,)), (sign * z, x, y))
    return {key: (x, y, sign * z) for key, (z, x, y) in best.items()}


def idw(x, y, z, at_x, at_y, n=12):
    """Mean of the n nearest points by inverse squared distance, at each place."""
    out = []
    for px, py in zip(at_x, at_y, strict=True):
        square = (x - px) ** 2 + (y - py) ** 2
        near = np.argsort(square)[:n]
        near = near[(square[near] <= 400) | (near == near[0])]
        weight = 1 / square[near]
        out.append(np.sum(weight * z[near]) / np.sum(weight))
    return np.array(out)
