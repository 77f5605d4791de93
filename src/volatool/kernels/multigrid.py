"""Multigrid for the springs: smoothing, transfer between grids, coarse data, the coarsest solve.

A coarse node sits on every second fine node, ``n // 2 + 1`` of them on an axis of n > 2; heights
go down by bilinear interpolation and forces up by its transpose. Grids are float32: all this is
only a preconditioner. Every loop works in place on rows in order, so strips of any height give
the same bytes.
"""

import numpy as np

from volatool.kernels._jit import kernel
from volatool.kernels.cut_multigrid import cut_restrict_row
from volatool.kernels.spring import diagonal_row, dot_row, next_row, start_rows


@kernel
def smooth_first(data, right, x, d, kb, km, beta, start, stop, edges=None):
    """
    First step of a Chebyshev-Jacobi sweep from zero heights: ``x = d = beta right / diagonal``.

    Parameters
    ----------
    data : (h, 5, w) array of float32
        Data stencil.
    right : (h, w) array of float32
        Right side.
    x, d : (h, w) arrays of float32
        Heights and last step; rows are set.
    kb, km : float32
        Stiffness on this grid.
    beta : float32
        Step length.
    start, stop : int
        Rows.
    edges : (h, 3, w) array of float32, optional
        Factors of cut springs and their diagonal.
    """
    h, w = x.shape
    diagonal = np.empty(w, x.dtype)
    for r in range(start, stop):
        diagonal_row(data, r, h, kb, km, diagonal, edges)
        force, heights, steps = right[r], x[r], d[r]
        for q in range(w):
            steps[q] = beta * force[q] / diagonal[q]
        heights[:] = steps


@kernel
def smooth(data, right, x, d, kb, km, alpha, beta, start, stop, edges=None):
    """
    One Chebyshev-Jacobi step: ``d = alpha d + beta (right - H x) / diagonal; x += d``.

    Parameters
    ----------
    data : (h, 5, w) array of float32
        Data stencil.
    right : (h, w) array of float32
        Right side.
    x, d : (h, w) arrays of float32
        Heights and last step, changed in place.
    kb, km : float32
        Stiffness on this grid.
    alpha, beta : float32
        Weights of the last step and of the new force.
    start, stop : int
        Rows of this strip. Heights lag two rows behind, since H reads two rows ahead and
        behind: strips must be done in order, down to the last row.
    edges : (h, 3, w) array of float32, optional
        Factors of cut springs and their diagonal.
    """
    h, w = x.shape
    steps = np.empty((3, w + 2), x.dtype)
    bends = np.empty((2, w + 2), x.dtype)
    fluxes = np.empty((2, w), x.dtype)
    across = np.zeros(w + 2, x.dtype)
    nothing = np.zeros(w, x.dtype)
    acc = np.empty(w, x.dtype)
    diagonal = np.empty(w, x.dtype)
    start_rows(x, start, kb, km, steps, bends, fluxes, edges)
    for r in range(start, stop):
        next_row(data, x, r, kb, km, steps, bends, fluxes, across, nothing, acc, edges)
        diagonal_row(data, r, h, kb, km, diagonal, edges)
        force, step = right[r], d[r]
        for q in range(w):
            step[q] = alpha * step[q] + beta * (force[q] - acc[q]) / diagonal[q]
        if r >= 2:
            heights, step = x[r - 2], d[r - 2]
            for q in range(w):
                heights[q] += step[q]
    if stop == h:
        for r in range(max(h - 2, 0), h):
            heights, step = x[r], d[r]
            for q in range(w):
                heights[q] += step[q]


@kernel
def restrict_residual(data, right, x, kb, km, coarse, start, stop, edges=None):
    """
    Right side of the next coarser grid: the transposed interpolation of ``right - H x``.

    Parameters
    ----------
    data : (h, 5, w) array of float32
        Data stencil.
    right, x : (h, w) arrays of float32
        Right side and heights.
    kb, km : float32
        Stiffness on this grid.
    coarse : (h // 2 + 1, w // 2 + 1) array of float32
        Set. Strips must be done in order.
    start, stop : int
        Rows of the fine grid.
    edges : (h, k, w) array of float32, optional
        Factors of cut springs.
    """
    w = x.shape[1]
    steps = np.empty((3, w + 2), x.dtype)
    bends = np.empty((2, w + 2), x.dtype)
    fluxes = np.empty((2, w), x.dtype)
    across = np.zeros(w + 2, x.dtype)
    nothing = np.zeros(w, x.dtype)
    acc = np.empty(w, x.dtype)
    force = np.zeros(2 * coarse.shape[1] + 1, x.dtype)
    start_rows(x, start, kb, km, steps, bends, fluxes, edges)
    for r in range(start, stop):
        next_row(data, x, r, kb, km, steps, bends, fluxes, across, nothing, acc, edges)
        own = right[r]
        inner = force[1:]
        for q in range(w):
            inner[q] = own[q] - acc[q]
        if edges is None:
            restrict_row(force, r, coarse)
        else:
            cut_restrict_row(force, r, edges, coarse)


@kernel
def restrict_row(force, r, coarse):
    """
    Add a fine row to the coarse grid by transposed bilinear interpolation.

    Parameters
    ----------
    force : (2 n + 1,) array of float
        The fine row from index 1 on, zeros before and after; n coarse columns.
    r : int
        Its row; a coarse row is set by the first fine row that touches it.
    coarse : (m, n) array of float
        Added to.
    """
    n = coarse.shape[1]
    half = coarse.dtype.type(0.5)
    if r == 0:
        coarse[0, :] = 0.0
    if r % 2 == 1:
        coarse[r // 2 + 1, :] = 0.0
    target = coarse[r // 2]
    if r % 2 == 0:
        for q in range(n):
            target[q] += force[2 * q + 1] + half * (force[2 * q] + force[2 * q + 2])
    else:
        below = coarse[r // 2 + 1]
        for q in range(n):
            part = half * (force[2 * q + 1] + half * (force[2 * q] + force[2 * q + 2]))
            target[q] += part
            below[q] += part


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
    force = np.zeros(2 * coarse.shape[1] + 1, right.dtype)
    for r in range(start, stop):
        force[1 : w + 1] = right[r]
        if edges is None:
            restrict_row(force, r, coarse)
        else:
            cut_restrict_row(force, r, edges, coarse)


@kernel
def prolong(coarse, x, keep, start, stop):
    """
    Bilinear interpolation of coarse heights: ``x = keep x + P coarse``.

    Parameters
    ----------
    coarse : (h // 2 + 1, w // 2 + 1) array of float32
        Coarse heights.
    x : (h, w) array of float32
        Fine heights, rows changed in place.
    keep : float32
        1 to add, 0 to set.
    start, stop : int
        Rows of the fine grid.
    """
    w = x.shape[1]
    n = coarse.shape[1]
    half = x.dtype.type(0.5)
    row = np.zeros(n + 1, x.dtype)
    for r in range(start, stop):
        upper = coarse[r // 2]
        lower = coarse[(r + 1) // 2]
        for q in range(n):
            row[q] = half * (upper[q] + lower[q])
        heights = x[r]
        odd = heights[1:]
        after = row[1:]
        for q in range((w + 1) // 2):
            heights[2 * q] = keep * heights[2 * q] + row[q]
        for q in range(w // 2):
            odd[2 * q] = keep * odd[2 * q] + half * (row[q] + after[q])


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


@kernel
def descend(z, residual, p, product, step, right, start, stop):
    """
    Move along a search direction: ``z += step p; residual -= step product; right = residual``.

    Parameters
    ----------
    z, residual, p, product : (h, w) arrays of float64
        Heights, residual, direction, ``H p``.
    step : float64
        Step length.
    right : (h, w) array of float32
        Set to the residual for the preconditioner.
    start, stop : int
        Rows.
    """
    for r in range(start, stop):
        heights, along = z[r], p[r]
        for q in range(z.shape[1]):
            heights[q] += step * along[q]
        rest, force, change = residual[r], right[r], product[r]
        for q in range(z.shape[1]):
            rest[q] -= step * change[q]
            force[q] = rest[q]


@kernel
def measure(residual, x, start, stop, dots, norms, largest):
    """
    Products that conjugate gradients need, by row.

    Parameters
    ----------
    residual : (h, w) array of float64
        Residual.
    x : (h, w) array of float32
        Preconditioned residual.
    start, stop : int
        Rows.
    dots, norms, largest : (h,) arrays of float64
        Set: ``residual . x``, ``residual . residual``, largest ``|x|``.
    """
    for r in range(start, stop):
        dots[r] = dot_row(residual[r], x[r])
        norms[r] = dot_row(residual[r], residual[r])
        top = 0.0
        for value in x[r]:
            top = max(top, abs(value))
        largest[r] = top


@kernel
def turn(p, x, beta, start, stop):
    """
    Next search direction: ``p = x + beta p``.

    Parameters
    ----------
    p : (h, w) array of float64
        Direction, changed in place.
    x : (h, w) array of float32
        Preconditioned residual.
    beta : float64
        Weight of the last direction.
    start, stop : int
        Rows.
    """
    for r in range(start, stop):
        along, new = p[r], x[r]
        for q in range(p.shape[1]):
            along[q] = new[q] + beta * along[q]
