"""Exact integer sums of point attributes per block and class, and the metadata words of them.

A row of sums is 8 int64: key (path key of the block << 8 | class code), number of points, then
the sums of red, green, blue, stored z, number of returns and intensity. One cache line.
"""

from __future__ import annotations

import numpy as np

from volatool.kernels._jit import kernel

ROW = 8
"""Columns of a row of sums."""


@kernel
def _touch(code, sums, touched, n_touched):
    """Note that a class has points in the block at hand, classes in order; return how many do."""
    if sums[code, 0] > 0:
        return n_touched
    place = n_touched
    while place > 0 and touched[place - 1] > code:
        touched[place] = touched[place - 1]
        place -= 1
    touched[place] = code
    return n_touched + 1


@kernel
def _put_rows(block, sums, touched, n_touched, rows, n_rows):
    """Write the rows of a complete block, classes in order, and clear its sums."""
    for t in range(n_touched):
        code = touched[t]
        rows[n_rows, 0] = (block << 8) | code
        for column in range(1, ROW):
            rows[n_rows, column] = sums[code, column - 1]
            sums[code, column - 1] = 0
        n_rows += 1
    return n_rows


@kernel
def fold_rows(rows, digits):
    """
    Add up the sums of coarser blocks.

    Parameters
    ----------
    rows : (n, 8) array of int64
        Rows of sums, blocks in order; classes in any order, also repeated, inside a block.
    digits : int
        By how many levels the blocks become coarser; 0 only unites repeated keys.

    Returns
    -------
    folded : (k, 8) array of int64
        Keys strictly increasing.
    """
    folded = np.empty((rows.shape[0], ROW), np.int64)
    sums = np.zeros((256, ROW - 1), np.int64)
    touched = np.empty(256, np.int64)
    n_touched = n_rows = np.int64(0)
    block = np.int64(-1)
    for i in range(rows.shape[0]):
        here = rows[i, 0] >> np.int64(8 + 6 * digits)
        if here != block:
            n_rows = _put_rows(block, sums, touched, n_touched, folded, n_rows)
            n_touched = np.int64(0)
            block = here
        c = rows[i, 0] & 255
        n_touched = _touch(c, sums, touched, n_touched)
        for column in range(1, ROW):
            sums[c, column - 1] += rows[i, column]
    n_rows = _put_rows(block, sums, touched, n_touched, folded, n_rows)
    return folded[:n_rows]


@kernel
def merge_rows(left, right):
    """
    Union of two sets of rows of sums; rows with the same key are added.

    Parameters
    ----------
    left, right : (n, 8), (m, 8) arrays of int64
        Keys strictly increasing.

    Returns
    -------
    merged : (k, 8) array of int64
        Keys strictly increasing, the front of an array of n + m rows.
    """
    merged = np.empty((left.shape[0] + right.shape[0], ROW), np.int64)
    i = j = k = np.int64(0)
    while i < left.shape[0] or j < right.shape[0]:
        takes_left = j >= right.shape[0] or (i < left.shape[0] and left[i, 0] <= right[j, 0])
        takes_right = i >= left.shape[0] or (j < right.shape[0] and right[j, 0] <= left[i, 0])
        source = left[i] if takes_left else right[j]
        for column in range(ROW):
            merged[k, column] = source[column]
        if takes_left and takes_right:
            for column in range(1, ROW):
                merged[k, column] += right[j, column]
        i += np.int64(takes_left)
        j += np.int64(takes_right)
        k += 1
    return merged[:k]


@kernel
def _scaled_mean(total, n, offset, num, den):
    """
    Return ``floor((total / n - offset) num / den + 1/2)`` limited to 0 .. 255.

    Exact, and without an overflow: the sum is divided first, its remainder is carried along.
    """
    whole = total // n
    rest = total - whole * n
    byte = (2 * num * (whole - offset) + den + (2 * num * rest) // n) // (2 * den)
    return min(max(byte, 0), 255)


@kernel
def encode_rows(rows, scaling, has_class):
    """
    Metadata words of blocks.

    Parameters
    ----------
    rows : (n, 8) array of int64
        Rows of sums, keys strictly increasing.
    scaling : (6, 3) array of int64
        Offset, numerator and denominator of red, green, blue, height, returns, intensity:
        ``byte = (mean - offset) num / den``, half up; numerator 0 for a channel that is absent.
    has_class : bool
        Byte 6 is the most frequent class code (ties: the lowest), else 0.

    Returns
    -------
    words : (k,) array of uint64
        One for each block, in order; byte 7 is 1.
    """
    words = np.empty(rows.shape[0], np.uint64)
    n_words = np.int64(0)
    totals = np.empty(ROW - 1, np.int64)
    i = np.int64(0)
    while i < rows.shape[0]:
        block = rows[i, 0] >> 8
        totals[:] = 0
        best_class = best_count = np.int64(0)
        while i < rows.shape[0] and rows[i, 0] >> 8 == block:
            for column in range(1, ROW):
                totals[column - 1] += rows[i, column]
            if rows[i, 1] > best_count:
                best_count = rows[i, 1]
                best_class = rows[i, 0] & 255
            i += 1
        word = np.int64(1) << 56
        for channel in range(6):
            offset, num, den = scaling[channel, 0], scaling[channel, 1], scaling[channel, 2]
            byte = _scaled_mean(totals[channel + 1], totals[0], offset, num, den)
            word |= byte << (8 * channel)
        if has_class:
            word |= best_class << 48
        words[n_words] = np.uint64(word)
        n_words += 1
    return words[:n_words]
