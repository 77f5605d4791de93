"""Multigrid for the springs: transfer between grids, coarse data, the coarsest solve.

A coarse node sits on every second fine node, ``n // 2 + 1`` of them on an axis of n > 2; heights
go down by bilinear interpolation and forces up by its transpose. Grids are float32: all this is
only a preconditioner. Every loop works in place on rows in order, so strips of any height give
the same bytes.
"""

import numpy as np

from volatool.kernels._jit import kernel
from volatool.kernels.cut_multigrid import cut_restrict_row


@kernel
def restrict_row(force, r, upper, lower):
    """
    Add a fine row to the coarse grid by transposed bilinear interpolation.

    Parameters
    ----------
    force : (2 n + 1,) array of float
        The fine row from index 1 on, zeros before and after; n coarse columns.
    r : int
        Its row; a coarse row is set by the first fine row that touches it.
    upper, lower : (n,) arrays of float
        Coarse rows ``r // 2`` and ``r // 2 + 1``, added to; the lower one only if r is odd.
    """
    n = upper.size
    half = upper.dtype.type(0.5)
    if r == 0:
        upper[:] = 0.0
    if r % 2 == 0:
        for q in range(n):
            upper[q] += force[2 * q + 1] + half * (force[2 * q] + force[2 * q + 2])
    else:
        lower[:] = 0.0
        for q in range(n):
            part = half * (force[2 * q + 1] + half * (force[2 * q] + force[2 * q + 2]))
            upper[q] += part
            lower[q] += part


@kernel
def restrict_rows(right, coarse, start, stop, edges=None):
    """
    Transposed bilinear interpolation of a right side to the next coarser grid.

    Parameters
    ----------
    right : (h, w) array of float32
        Fine right side.
    coarse : (h // 2 + 1, w // 2 + 1) array of float32
        Set. Strips must be done in order.
    start, stop : int
        Rows of the fine grid.
    edges : (h, k, w) array of float32, optional
        Factors of cut springs.
    """
    w = right.shape[1]
    last = coarse.shape[0] - 1
    force = np.zeros(2 * coarse.shape[1] + 1, right.dtype)
    for r in range(start, stop):
        force[1 : w + 1] = right[r]
        upper, lower = coarse[r // 2], coarse[min(r // 2 + 1, last)]
        if edges is None:
            restrict_row(force, r, upper, lower)
        else:
            cut_restrict_row(force, r, edges, upper, lower)


@kernel
def prolong_row(coarse, r, row, out):
    """
    One row of the bilinear interpolation of coarse heights.

    Parameters
    ----------
    coarse : (m, n) array of float32
        Coarse heights.
    r : int
        Fine row.
    row : (n + 1,) array of float32
        Work space, its last entry finite.
    out : (w,) array of float32
        Set; w is 2 n - 1 or 2 n - 2.
    """
    w = out.size
    half = out.dtype.type(0.5)
    upper = coarse[r // 2]
    lower = coarse[(r + 1) // 2]
    for q in range(upper.size):
        row[q] = half * (upper[q] + lower[q])
    odd, after = out[1:], row[1:]
    for q in range((w + 1) // 2):
        out[2 * q] = row[q]
    for q in range(w // 2):
        odd[2 * q] = half * (row[q] + after[q])


@kernel
def coarsen_data(data, coarse, start, stop):
    """
    Galerkin product of the data stencil: ``P^T D P``, again 9-point.

    Parameters
    ----------
    data : (h, 5, w) array of float32
        Fine stencil.
    coarse : (h // 2 + 1, 5, w // 2 + 1) array of float32
        Added to; zeros before the first strip. Strips must be done in order.
    start, stop : int
        Rows of the fine grid.

    Notes
    -----
    Columns first, then rows: with m the fine column between two coarse ones, an edge's coupling is
    ``1/2 T[m-1, m] + 1/4 T[m, m] + 1/2 T[m, m+1]`` and a diagonal
    ``T[q, q] + T[q, q+1] + T[q, q-1] + 1/4 (T[q+1, q+1] + T[q-1, q-1])`` for a symmetric T.
    """
    w = data.shape[2]
    n = coarse.shape[2]
    half = data.dtype.type(0.5)
    quarter = data.dtype.type(0.25)
    fine = np.zeros((5, 2 * n + 4), data.dtype)  # fine column q at index q + 1
    row = np.zeros((5, n + 1), data.dtype)
    for r in range(start, stop):
        fine[:, 1 : w + 1] = data[r]
        own, e, s, se, sw = fine[0], fine[1], fine[2], fine[3], fine[4]
        for c in range(n):
            q = 2 * c + 1
            m = q + 1
            row[0, c] = own[q] + e[q] + e[q - 1] + quarter * (own[q + 1] + own[q - 1])
            row[1, c] = half * (e[q] + e[m]) + quarter * own[m]
            row[2, c] = (
                s[q]
                + half * (se[q] + sw[q + 1] + se[q - 1] + sw[q])
                + quarter * (s[q + 1] + s[q - 1])
            )
            row[3, c] = half * (se[q] + se[m]) + quarter * s[m]
            # from coarse column c to c - 1 of the row below: the fine column q - 1 lies between
            row[4, c] = half * (sw[q] + sw[q - 1]) + quarter * s[q - 1]
        row[4, 0] = 0.0
        target = coarse[r // 2]
        if r % 2 == 0:
            for c in range(n):
                target[0, c] += row[0, c] + row[2, c]
                target[1, c] += row[1, c] + half * (row[3, c] + row[4, c + 1])
                target[2, c] += half * row[2, c]
                target[3, c] += half * row[3, c]
                target[4, c] += half * row[4, c]
        else:
            below = coarse[r // 2 + 1]
            for c in range(n):
                target[0, c] += quarter * row[0, c]
                target[1, c] += quarter * row[1, c]
                target[2, c] += quarter * row[0, c] + half * row[2, c]
                target[3, c] += quarter * row[1, c] + half * row[3, c]
                target[4, c] += half * row[4, c]
                below[0, c] += quarter * row[0, c] + row[2, c]
                below[1, c] += quarter * row[1, c] + half * (row[3, c] + row[4, c + 1])
            for c in range(1, n):
                target[4, c] += quarter * row[1, c - 1]


@kernel
def invert(matrix):
    """
    Inverse of a small symmetric positive (semi-)definite matrix, in place.

    Parameters
    ----------
    matrix : (n, n) array of float64
        Replaced by its inverse. Directions without stiffness get none: their rows and columns
        become zero, which makes it a generalized inverse.

    Notes
    -----
    Gauss-Jordan on the diagonal, in a fixed order of operations: a library's would depend on the
    machine.
    """
    n = matrix.shape[0]
    limit = 0.0
    for k in range(n):
        limit = max(limit, matrix[k, k])
    limit *= 1e-12
    dead = np.zeros(n, np.bool_)
    for k in range(n):
        pivot = matrix[k, k]
        if not pivot > limit:
            dead[k] = True
            continue
        matrix[k, k] = 1.0
        for j in range(n):
            matrix[k, j] /= pivot
        for i in range(n):
            if i != k:
                factor = matrix[i, k]
                matrix[i, k] = 0.0
                for j in range(n):
                    matrix[i, j] -= factor * matrix[k, j]
    for k in range(n):
        if dead[k]:
            matrix[k, :] = 0.0
            matrix[:, k] = 0.0


@kernel
def solve_small(inverse, right, x):
    """
    Heights of the coarsest grid.

    Parameters
    ----------
    inverse : (n, n) array of float64
        As `invert` made it.
    right, x : (h, w) arrays of float32, h w = n
        Right side; heights, set.
    """
    w = x.shape[1]
    for i in range(inverse.shape[0]):
        total = 0.0
        for j in range(inverse.shape[0]):
            total += inverse[i, j] * right[j // w, j % w]
        x[i // w, i % w] = total
