"""Half a V-cycle's work on one grid in a single walk down its rows.

Interpolation, the smoothing steps and the residual for the coarser grid follow each other row by
row, each stage two rows behind the one before, since ``H`` reads two rows ahead. Rows in between
stay in the cache; the grid goes through it once instead of once a stage. The numbers are those of
one stage after the other.
"""

import numpy as np

from volatool.kernels._jit import kernel
from volatool.kernels.cut_multigrid import cut_prolong_row, cut_restrict_row
from volatool.kernels.multigrid import prolong_row, restrict_row
from volatool.kernels.product import RING, diagonal_row, product_row, start_carry

MAX_STEPS = 4
"""Smoothing steps that the work space has room for."""

_BEHIND = 2 * MAX_STEPS + 1  # rows that are between the first and the last smoothing step
_STEP = RING * MAX_STEPS
_DIAGONAL = _STEP + _BEHIND
_CARRY = _DIAGONAL + _BEHIND

WORK_ROWS = _CARRY + 2 * (MAX_STEPS + 1)
"""Rows of work space for `sweep`."""


@kernel
def sweep(
    data,
    right,
    x,
    out,
    kb,
    km,
    steps,
    source,
    adds,
    target,
    work,
    first,
    last,
    start,
    stop,
    edges=None,
):
    """
    Interpolate, smooth, restrict: Chebyshev-Jacobi steps with what comes before and after.

    A step is ``d = alpha d + beta (right - H x) / diagonal; x += d``.

    Parameters
    ----------
    data : (h, 5, w) array of float32
        Data stencil.
    right : (h, w) array of float32
        Right side.
    x : (h, w) array of float32
        Heights, read if `adds`.
    out : (h, w) array of float32
        Set to the smoothed heights; may be x if all rows are done by one caller.
    kb, km : float32
        Stiffness on this grid.
    steps : (n, 2) array of float32
        Alpha and beta of each step, n at most `MAX_STEPS`; the first alpha counts as 0.
    source : (h // 2 + 1, w // 2 + 1) array of float32
        Coarse heights to interpolate. Without rows: smoothing starts from zero heights.
    adds : bool
        Add what is interpolated to x.
    target : (h // 2 + 1, w // 2 + 1) array of float32
        Set to the right side of the coarser grid, the transposed interpolation of
        ``right - H x``. Without rows: not asked for.
    work : (`WORK_ROWS`, w) array of float32
        Work space; holds what one call leaves for the next.
    first, last : int
        Rows of `out` to set, and with them rows ``first // 2`` to ``last // 2`` of the target (to
        its end if `last` is h); even numbers or h. Others may be set too, to what they will be.
    start, stop : int
        Rows that the last stage does; all of ``first`` to ``last`` in one or more calls, in order.
    edges : (h, 3, w) array of float32, optional
        Factors of cut springs and their diagonal.
    """
    h, w = right.shape
    is_zero = source.shape[0] == 0
    restricts = target.shape[0] > 0
    skipped = 1 if is_zero else 0  # the first stage is the first step then
    n_smoothing = steps.shape[0] - skipped
    n_stages = n_smoothing + (1 if restricts else 0)
    acc = np.empty(w, right.dtype)
    nothing = np.zeros((5, w), right.dtype)
    padded = np.zeros(2 * target.shape[1] + 1, right.dtype)
    spare = np.empty(target.shape[1], right.dtype)
    coarse = np.zeros(source.shape[1] + 1, right.dtype)
    begin = start + 2 * n_stages if start > first else stage_begin(first, n_stages, restricts)
    for t in range(begin, stop + 2 * n_stages):
        if t < h:
            row = work[t % RING]
            diagonal, step = work[_DIAGONAL + t % _BEHIND], work[_STEP + t % _BEHIND]
            diagonal_row(data, t, h, kb, km, diagonal, edges)
            if is_zero:
                force, beta = right[t], steps[0, 1]
                for q in range(w):
                    step[q] = beta * force[q] / diagonal[q]
                row[:] = step
            else:
                step[:] = 0.0
                if edges is None:
                    prolong_row(source, t, coarse, row)
                else:
                    cut_prolong_row(source, t, edges, row)
                if adds:
                    before = x[t]
                    for q in range(w):
                        row[q] += before[q]
            if n_smoothing == 0:
                out[t] = row
        for k in range(1, n_stages + 1):
            r = t - 2 * k
            begin = stage_begin(first, n_stages - k, restricts)
            heights = work[RING * (k - 1) : RING * k] if k <= n_smoothing else out
            carry = work[_CARRY + 2 * (k - 1) : _CARRY + 2 * k]
            if r == max(begin - 1, 0):
                start_carry(data, heights, begin, h, kb, km, carry, nothing, acc, edges)
            if r < begin or r >= h:
                continue
            product_row(data, heights, r, h, kb, km, carry, nothing, acc, edges)
            force = right[r]
            if k <= n_smoothing:
                alpha, beta = steps[k - 1 + skipped, 0], steps[k - 1 + skipped, 1]
                row = out[r] if k == n_smoothing else work[RING * k + r % RING]
                diagonal, step = work[_DIAGONAL + r % _BEHIND], work[_STEP + r % _BEHIND]
                step_row(force, acc, diagonal, heights[r % RING], alpha, beta, step, row)
                continue
            inner = padded[1:]
            for q in range(w):
                inner[q] = force[q] - acc[q]
            upper = target[r // 2] if r >= first else spare
            is_own = last == h or r + 1 < last
            lower = target[r // 2 + 1] if r % 2 == 1 and is_own else spare
            if edges is None:
                restrict_row(padded, r, upper, lower)
            else:
                cut_restrict_row(padded, r, edges, upper, lower)


@kernel
def stage_begin(first, n_after, restricts):
    """
    First row that a stage of a sweep has to do.

    Parameters
    ----------
    first : int
        First row of heights that the sweep has to set.
    n_after : int
        Stages after this one; each reads two rows more.
    restricts : bool
        The row before the first counts for the coarser grid, too.
    """
    if first == 0:
        return 0
    return max(0, first - 2 * n_after - (1 if restricts else 0))


@kernel
def step_row(force, acc, diagonal, x, alpha, beta, step, out):
    """
    One row of a Chebyshev-Jacobi step.

    Parameters
    ----------
    force, acc, diagonal, x : (w,) arrays of float32
        Right side, ``H x``, diagonal of H, heights.
    alpha, beta : float32
        Weights of the last step and of the new force.
    step : (w,) array of float32
        Last step; set to the new one.
    out : (w,) array of float32
        Set to the new heights.
    """
    for q in range(x.size):
        change = alpha * step[q] + beta * (force[q] - acc[q]) / diagonal[q]
        step[q] = change
        out[q] = x[q] + change
