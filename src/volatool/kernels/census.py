"""Counts of points as they pass by: extremes, classes, returns, heights, covered area."""

from __future__ import annotations

import numpy as np

from volatool.kernels._jit import kernel


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
    last_bin = np.int64(heights.shape[1] - 1)
    last_row, last_column = np.int64(covered.shape[0] - 1), np.int64(covered.shape[1] - 1)
    across, along = 1.0 / edges[0], 1.0 / edges[1]
    for i in range(x.size):
        px, py, pz = np.int64(x[i]), np.int64(y[i]), np.int64(z[i])
        bin_ = min(max((pz - low[2]) >> shift, np.int64(0)), last_bin)
        _widen(extremes[0], px, py, pz)
        heights[0, bin_] += 1
        if codes.size:
            classes[codes[i]] += 1
        if numbers.size:
            returns[numbers[i]] += 1
        if is_used.size and not is_used[i]:
            continue
        totals[0] += 1
        totals[1] += np.int64(numbers.size == 0 or numbers[i] <= 1)
        _widen(extremes[1], px, py, pz)
        heights[1, bin_] += 1
        column = _cell(px - low[0], edges[0], across)
        row = _cell(py - low[1], edges[1], along)
        row = min(max(row, np.int64(0)), last_row)
        column = min(max(column, np.int64(0)), last_column)
        covered[row, column] = True


@kernel
def _widen(extremes, x, y, z):
    """Grow a box to hold a point."""
    extremes[0] = min(extremes[0], x)
    extremes[1] = min(extremes[1], y)
    extremes[2] = min(extremes[2], z)
    extremes[3] = max(extremes[3], x)
    extremes[4] = max(extremes[4], y)
    extremes[5] = max(extremes[5], z)


@kernel
def _cell(away, edge, reciprocal):
    """Return ``away // edge``, by a reciprocal that is put right: the quotient is below 2**33."""
    cell = np.int64(away * reciprocal)
    rest = away - cell * edge
    return cell + np.int64(rest >= edge) - np.int64(rest < 0)
