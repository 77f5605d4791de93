"""Distances to the nearest set cell, by branch and bound down the levels.

All lengths are in cells of the deepest level, all coordinates in its lattice: cell k of an axis is
``[k, k + 1]``. Coordinates that are halves of whole numbers give exact squares.
"""

from __future__ import annotations

import math

import numpy as np

from volatool.kernels._jit import kernel
from volatool.kernels.contiguity import popcount

_ONE = np.uint64(1)


@kernel
def _gap(low, high, from_, to):
    """Distance between two intervals of an axis, 0 if they meet."""
    return max(from_ - high, low - to, 0.0)


@kernel
def nearest(words, first, depth, points, inset, squares):
    """
    Square of the distance from each point to the nearest set cell.

    Parameters
    ----------
    words, first : (n,) arrays of uint64 and int64
        The nodes of all levels, root first, and the place of each one's first child.
    depth : int
        Levels.
    points : (m, 3) array of float64
        Lattice coordinates, inside the cube or not.
    inset : float
        The cells are taken to be that much smaller on all sides: 0 for their boxes, 0.5 for their
        centres.
    squares : (m,) array of float64
        Out: infinity without any cell, NaN for points that are not finite.

    Notes
    -----
    Branch and bound [Roussopoulos1995]_: the children of a node are visited nearest first, and
    left out once they are no nearer than what was found.
    """
    bounds = np.empty((depth, 64))
    bits = np.empty((depth, 64), np.int64)
    counts = np.zeros(depth, np.int64)
    node = np.zeros(depth, np.int64)
    corner = np.zeros((depth, 3), np.int64)
    gaps = np.empty((3, 4))
    for i in range(points.shape[0]):
        if not (
            math.isfinite(points[i, 0])
            and math.isfinite(points[i, 1])
            and math.isfinite(points[i, 2])
        ):
            squares[i] = np.nan
            continue
        best = np.inf
        level = 0
        is_new = True
        while level >= 0:
            if is_new:
                span = 1 << 2 * (depth - 1 - level)
                for axis in range(3):
                    for slot in range(4):
                        low = float((4 * corner[level, axis] + slot) * span)
                        p = points[i, axis]
                        gap = _gap(p, p, low + inset, low + span - inset)
                        gaps[axis, slot] = gap * gap
                word = words[node[level]]
                n = 0
                while word:
                    low_bit = word & (~word + _ONE)
                    word ^= low_bit
                    bit = popcount(low_bit - _ONE)
                    square = gaps[0, bit & 3] + gaps[1, (bit >> 2) & 3] + gaps[2, bit >> 4]
                    if square < best:
                        if level == depth - 1:
                            best = square
                        else:
                            bounds[level, n] = square
                            bits[level, n] = bit
                            n += 1
                counts[level] = n
                is_new = False
            # the nearest child that is left
            k = -1
            square = best
            for j in range(counts[level]):
                if bounds[level, j] < square:
                    square = bounds[level, j]
                    k = j
            if k < 0:
                level -= 1
                continue
            bit = bits[level, k]
            counts[level] -= 1
            bounds[level, k] = bounds[level, counts[level]]
            bits[level, k] = bits[level, counts[level]]
            here = node[level]
            node[level + 1] = first[here] + popcount(
                words[here] & ((_ONE << np.uint64(bit)) - _ONE)
            )
            corner[level + 1, 0] = 4 * corner[level, 0] + (bit & 3)
            corner[level + 1, 1] = 4 * corner[level, 1] + ((bit >> 2) & 3)
            corner[level + 1, 2] = 4 * corner[level, 2] + (bit >> 4)
            level += 1
            is_new = True
        squares[i] = best


@kernel
def keeps_clear(words, first, depth, box, square, stack):
    """
    Tell whether no set cell comes nearer to a box than a distance.

    Parameters
    ----------
    words, first, depth
        The nodes, as for `nearest`.
    box : (6,) array of float64
        Lowest and highest x, y, z in lattice coordinates; a point when they are equal.
    square : float
        The distance's square. A cell that meets the box is at 0.
    stack : (63 * depth + 1, 5) array of int64
        To work in.

    Returns
    -------
    is_clear : bool
    """
    stack[0, :] = 0
    n = 1
    while n:
        n -= 1
        level, here = stack[n, 0], stack[n, 1]
        x, y, z = 4 * stack[n, 2], 4 * stack[n, 3], 4 * stack[n, 4]
        span = 1 << 2 * (depth - 1 - level)
        word = words[here]
        child = first[here]
        while word:
            low_bit = word & (~word + _ONE)
            word ^= low_bit
            bit = popcount(low_bit - _ONE)
            cx, cy, cz = x + (bit & 3), y + ((bit >> 2) & 3), z + (bit >> 4)
            gx = _gap(box[0], box[3], float(cx * span), float((cx + 1) * span))
            gy = _gap(box[1], box[4], float(cy * span), float((cy + 1) * span))
            gz = _gap(box[2], box[5], float(cz * span), float((cz + 1) * span))
            if gx * gx + gy * gy + gz * gz < square:
                if level == depth - 1:
                    return False
                stack[n, 0], stack[n, 1] = level + 1, child
                stack[n, 2], stack[n, 3], stack[n, 4] = cx, cy, cz
                n += 1
            child += 1
    return True


@kernel
def _slope_and_square(a, step, box, t):
    """Half the derivative and the value of the square distance to a box at ``a + t step``."""
    slope = square = 0.0
    for axis in range(3):
        p = a[axis] + t * step[axis]
        away = min(p - box[axis], 0.0) + max(p - box[3 + axis], 0.0)
        slope += away * step[axis]
        square += away * away
    return slope, square


@kernel
def segment_square(a, step, box):
    """
    Square of the distance between a segment and a box.

    Parameters
    ----------
    a, step : (3,) arrays of float64
        The segment's start, and from there to its end.
    box : (6,) array of float64
        Lowest and highest x, y, z.

    Returns
    -------
    square : float

    Notes
    -----
    The square is convex along the segment, and quadratic between the places where it crosses a
    plane of the box: its derivative's zero is found between the nearest two of them.
    """
    left, right = 0.0, 1.0
    left_slope, left_square = _slope_and_square(a, step, box, left)
    if left_slope >= 0.0:
        return left_square
    right_slope, right_square = _slope_and_square(a, step, box, right)
    if right_slope <= 0.0:
        return right_square
    for plane in range(6):
        along = step[plane % 3]
        if along == 0.0:
            continue
        t = (box[plane] - a[plane % 3]) / along
        if left < t < right:
            slope = _slope_and_square(a, step, box, t)[0]
            if slope <= 0.0:
                left, left_slope = t, slope
            else:
                right, right_slope = t, slope
    t = left - (right - left) * left_slope / (right_slope - left_slope)
    return _slope_and_square(a, step, box, t)[1]


@kernel
def segment_clearances(words, first, depth, starts, ends, squares):
    """
    Square of the distance between each segment and the nearest set cell.

    Parameters
    ----------
    words, first, depth
        The nodes, as for `nearest`.
    starts, ends : (m, 3) arrays of float64
        Lattice coordinates.
    squares : (m,) array of float64
        In: nothing at this distance or beyond is looked for. Out: the least of that and the
        square found.
    """
    stack = np.empty((63 * depth + 1, 5), np.int64)
    bounds = np.empty(63 * depth + 1)
    box = np.empty(6)
    for i in range(starts.shape[0]):
        a = starts[i]
        step = ends[i] - a
        best = squares[i]
        stack[0, :] = 0
        bounds[0] = 0.0
        n = 1
        while n:
            n -= 1
            if bounds[n] >= best:
                continue
            level, here = stack[n, 0], stack[n, 1]
            x, y, z = 4 * stack[n, 2], 4 * stack[n, 3], 4 * stack[n, 4]
            span = 1 << 2 * (depth - 1 - level)
            word = words[here]
            child = first[here]
            bottom = n
            while word:
                low_bit = word & (~word + _ONE)
                word ^= low_bit
                bit = popcount(low_bit - _ONE)
                cell = (x + (bit & 3), y + ((bit >> 2) & 3), z + (bit >> 4))
                square = 0.0
                for axis in range(3):
                    box[axis] = cell[axis] * span
                    box[3 + axis] = (cell[axis] + 1) * span
                    low, high = a[axis], a[axis] + step[axis]
                    gap = _gap(min(low, high), max(low, high), box[axis], box[3 + axis])
                    square += gap * gap
                if square < best:
                    square = segment_square(a, step, box)
                if square < best:
                    if level == depth - 1:
                        best = square
                    else:
                        # the nearest on top; an insertion into a short sorted run
                        k = n
                        while k > bottom and bounds[k - 1] < square:
                            bounds[k] = bounds[k - 1]
                            stack[k] = stack[k - 1]
                            k -= 1
                        bounds[k] = square
                        stack[k, 0], stack[k, 1] = level + 1, child
                        stack[k, 2], stack[k, 3], stack[k, 4] = cell
                        n += 1
                child += 1
        squares[i] = best
