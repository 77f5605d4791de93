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
_ACC = _CARRY + 2 * (MAX_STEPS + 1)

WORK_ROWS = _ACC + 1
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
    nothing = np.zeros((1, 5, w), right.dtype)
    force = np.zeros(2 * target.shape[1] + 1, right.dtype)
    spare = np.empty(target.shape[1], right.dtype)
    coarse = np.zeros(source.shape[1] + 1, right.dtype)
    begin = start + 2 * n_stages if start > first else stage_begin(first, n_stages, restricts)
    for t in range(begin, stop + 2 * n_stages):
        if t < h:
            diagonal, step, row = _DIAGONAL + t % _BEHIND, _STEP + t % _BEHIND, t % RING
            diagonal_row(data, t, h, kb, km, work[diagonal], edges)
            if is_zero:
                beta = steps[0, 1]
                for q in range(w):
                    work[step, q] = beta * right[t, q] / work[diagonal, q]
                    work[row, q] = work[step, q]
            else:
                work[step] = 0.0
                if edges is None:
                    prolong_row(source, t, coarse, work[row])
                else:
                    cut_prolong_row(source, t, edges, work[row])
                if adds:
                    for q in range(w):
                        work[row, q] += x[t, q]
            if n_smoothing == 0:
                out[t] = work[row]
        for k in range(1, n_stages + 1):
            r = t - 2 * k
            begin = stage_begin(first, n_stages - k, restricts)
            heights, at = (work, RING * (k - 1)) if k <= n_smoothing else (out, -1)
            carry = _CARRY + 2 * (k - 1)
            if r == max(begin - 1, 0):
                start_carry(
                    data, heights, at, begin, h, kb, km, work, carry, nothing, work, _ACC, edges
                )
            if r < begin or r >= h:
                continue
            product_row(data, heights, at, r, h, kb, km, work, carry, nothing, work, _ACC, edges)
            if k <= n_smoothing:
                alpha, beta = steps[k - 1 + skipped, 0], steps[k - 1 + skipped, 1]
                into, row = (out, r) if k == n_smoothing else (work, RING * k + r % RING)
                step_row(right, r, work, at + r % RING, alpha, beta, into, row)
                continue
            for q in range(w):
                force[q + 1] = right[r, q] - work[_ACC, q]
            upper = target[r // 2] if r >= first else spare
            is_own = last == h or r + 1 < last
            lower = target[r // 2 + 1] if r % 2 == 1 and is_own else spare
            if edges is None:
                restrict_row(force, r, upper, lower)
            else:
                cut_restrict_row(force, r, edges, upper, lower)


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
def step_row(right, r, work, heights, alpha, beta, out, row):
    """
    One row of a Chebyshev-Jacobi step.

    Parameters
    ----------
    right : (h, w) array of float32
        Right side.
    r : int
        Row.
    work : (`WORK_ROWS`, w) array of float32
        Holds ``H x``, the diagonal of H, and the last step, which is set to the new one.
    heights : int
        Row of `work` that holds the heights.
    alpha, beta : float32
        Weights of the last step and of the new force.
    out : (n, w) array of float32
        Row `row` is set to the new heights.
    row : int
        Row of `out`.
    """
    diagonal, step = _DIAGONAL + r % _BEHIND, _STEP + r % _BEHIND
    for q in range(right.shape[1]):
        change = alpha * work[step, q]
        change += beta * (right[r, q] - work[_ACC, q]) / work[diagonal, q]
        work[step, q] = change
        out[row, q] = work[heights, q] + change
