"""Plain twins of the cut springs, the lines and what points see: slow and obvious."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import scipy.sparse as sp


def surface_matrix(kb, km, edges):
    """Sparse km L + kb P with the factors of edges, one row per spring."""
    h, _, w = edges.shape
    east, south = edges[:, 0].astype(float), edges[:, 1].astype(float)
    rows, cols, values = [], [], []
    n = 0

    def spring(stiffness, *terms):
        nonlocal n
        for r, q, factor in terms:
            rows.append(n)
            cols.append(r * w + q)
            values.append(factor * np.sqrt(stiffness))
        n += 1

    for r, q in np.ndindex(h, w):
        if q + 1 < w:
            spring(km * east[r, q], (r, q, 1), (r, q + 1, -1))
        if r + 1 < h:
            spring(km * south[r, q], (r, q, 1), (r + 1, q, -1))
        if 0 < q < w - 1:
            factor = min(east[r, q - 1], east[r, q])
            spring(kb * factor, (r, q - 1, 1), (r, q, -2), (r, q + 1, 1))
        if 0 < r < h - 1:
            factor = min(south[r - 1, q], south[r, q])
            spring(kb * factor, (r - 1, q, 1), (r, q, -2), (r + 1, q, 1))
        if r + 1 < h and q + 1 < w:
            factor = min(east[r, q], east[r + 1, q], south[r, q], south[r, q + 1])
            corners = (r, q, 1), (r, q + 1, -1), (r + 1, q, -1), (r + 1, q + 1, 1)
            spring(2 * kb * factor, *corners)
    matrix = sp.csr_array((values, (rows, cols)), shape=(n, h * w))
    return matrix.T @ matrix


def parts(edges):
    """Label of the connected part of each node, by flooding."""
    h, _, w = edges.shape
    labels = np.full((h, w), -1)
    for start in np.ndindex(h, w):
        if labels[start] >= 0:
            continue
        labels[start] = start[0] * w + start[1]
        stack = [start]
        while stack:
            r, q = stack.pop()
            steps = [
                (r, q + 1, q + 1 < w and edges[r, 0, q] > 0),
                (r, q - 1, q > 0 and edges[r, 0, q - 1] > 0),
                (r + 1, q, r + 1 < h and edges[r, 1, q] > 0),
                (r - 1, q, r > 0 and edges[r - 1, 1, q] > 0),
            ]
            for r2, q2, is_open in steps:
                if is_open and labels[r2, q2] < 0:
                    labels[r2, q2] = labels[start]
                    stack.append((r2, q2))
    return labels


def is_inside(ring, x, y):
    """Even-odd rule with rational numbers; the point is not on the ring."""
    inside = False
    for (ax, ay), (bx, by) in zip(ring, ring[1:] + ring[:1], strict=True):
        if (ay > y) != (by > y):
            at = ax + Fraction(bx - ax) * Fraction(y - ay) / Fraction(by - ay)
            inside ^= x < at
    return inside
