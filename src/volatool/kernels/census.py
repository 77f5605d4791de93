"""Counts of points as they pass by: extremes, classes, returns, heights, covered area."""

from __future__ import annotations

import numpy as np

from volatool.kernels._jit import kernel

BLOCK = 2048
"""Points that are counted together, in vectors where it goes."""


@kernel
def count_points(
    x, y, z, is_used, codes, numbers, low, edges, shift,
    extremes, classes, returns, heights, covered, totals,
):  # fmt: skip
    """
    Add points to the counts of a census, in one pass.

    Parameters
    ----------
    x, y, z : (n,) arrays of int32
        Stored integers.
    is_used : (n,) array of bool
        Which points are used; empty for all.
    codes, numbers : (n,) arrays of uint8
        Class codes and return numbers; empty where there are none.
    low : (3,) array of int64
        Where heights and area are counted from.
    edges : (2,) array of int64
        Edges of the cells of covered area.
    shift : int
        Bits of a height below its bin.
    extremes : (2, 6) array of int64
        Smallest x, y, z, then largest: of all points, of those used. Changed.
    classes, returns : (256,), (256,) arrays of int64
        Points by code and return number. Added to.
    heights : (2, bins) array of int64
        Points by height: all, used; those outside count in the outermost bins. Added to.
    covered : (rows, columns) array of bool
        Cells that hold a used point; those outside count in the outermost ones. Set.
    totals : (2,) array of int64
        Used points, and those of them that are first returns (or don't tell). Added to.
    """
    found = np.zeros((2, heights.shape[1]), np.int64)
    tallies = np.zeros((2, 2, 256), np.int64)
    places = np.empty((2, BLOCK), np.int64)
    kept = np.empty((3, BLOCK if is_used.size else 0), np.int32)
    for start in range(0, x.size, BLOCK):
        stop = min(start + BLOCK, x.size)
        xs, ys, zs = x[start:stop], y[start:stop], z[start:stop]
        _widen(extremes[0], xs, ys, zs)
        _count_heights(zs, low[2], shift, found[0], places[0])
        _tally(codes[start:stop], tallies[0])
        _tally(numbers[start:stop], tallies[1])
        if is_used.size:
            n = 0
            for i in range(start, stop):
                kept[0, n], kept[1, n], kept[2, n] = x[i], y[i], z[i]
                n += np.int64(is_used[i])
                if numbers.size:
                    totals[1] += np.int64(is_used[i] and numbers[i] <= 1)
            xs, ys, zs = kept[0, :n], kept[1, :n], kept[2, :n]
            _count_heights(zs, low[2], shift, found[1], places[0])
        elif numbers.size:
            for i in range(start, stop):
                totals[1] += np.int64(numbers[i] <= 1)
        totals[0] += xs.size
        if not numbers.size:
            totals[1] += xs.size
        _widen(extremes[1], xs, ys, zs)
        _cover(xs, ys, low, edges, covered, places)
    heights += found
    if not is_used.size:
        heights[1] += found[0]
    for turn in range(2):
        classes += tallies[0, turn]
        returns += tallies[1, turn]


@kernel
def _widen(extremes, x, y, z):
    """Grow a box to hold points."""
    for axis, values in enumerate((x, y, z)):
        if values.size:
            least, most = values[0], values[0]
            for i in range(values.size):
                least, most = min(least, values[i]), max(most, values[i])
            extremes[axis] = min(extremes[axis], np.int64(least))
            extremes[axis + 3] = max(extremes[axis + 3], np.int64(most))


@kernel
def _count_heights(z, low, shift, counts, places):
    """Count heights by bin; those outside in the outermost ones."""
    last = np.int64(counts.size - 1)
    for i in range(z.size):
        places[i] = min(max((np.int64(z[i]) - low) >> shift, np.int64(0)), last)
    for i in range(z.size):
        counts[places[i]] += 1


@kernel
def _tally(codes, counts):
    """Count codes, in two rows by turns: equal ones behind each other need not wait so long."""
    for i in range(codes.size):
        counts[i & 1, codes[i]] += 1


@kernel
def _cover(x, y, low, edges, covered, places):
    """Set the cells that hold points; those outside set the outermost ones."""
    last_row, last_column = np.int64(covered.shape[0] - 1), np.int64(covered.shape[1] - 1)
    across, along = 1.0 / edges[0], 1.0 / edges[1]
    for i in range(x.size):
        column = _cell(np.int64(x[i]) - low[0], edges[0], across)
        row = _cell(np.int64(y[i]) - low[1], edges[1], along)
        places[0, i] = min(max(row, np.int64(0)), last_row)
        places[1, i] = min(max(column, np.int64(0)), last_column)
    for i in range(x.size):
        covered[places[0, i], places[1, i]] = True


@kernel
def _cell(away, edge, reciprocal):
    """Return ``away // edge``, by a reciprocal that is put right: the quotient is below 2**33."""
    cell = np.int64(away * reciprocal)
    rest = away - cell * edge
    return cell + np.int64(rest >= edge) - np.int64(rest < 0)
