"""64-bit words: the cells that their bits stand for, rank, means of metadata words."""

from __future__ import annotations

import numpy as np

from volatool.kernels._jit import kernel
from volatool.kernels.contiguity import popcount

_ONE = np.uint64(1)


@kernel
def child_keys(words, keys, n_cells):
    """
    Path keys of the cells that words have set.

    Parameters
    ----------
    words : (n,) array of uint64
        Occupancy words.
    keys : (n,) array of uint64
        Path keys of their blocks.
    n_cells : int
        Set bits of all words.

    Returns
    -------
    cells : (n_cells,) array of uint64
        One level deeper, in the order of the words and their bits.
    """
    cells = np.empty(n_cells, np.uint64)
    place = 0
    for i in range(words.size):
        word = words[i]
        key = keys[i] << np.uint64(6)
        while word:
            low = word & (~word + _ONE)
            cells[place] = key | np.uint64(popcount(low - _ONE))
            place += 1
            word ^= low
    return cells


@kernel
def child_cells(words, blocks, n_cells):
    """
    Cell indices that words have set.

    Parameters
    ----------
    words : (n,) array of uint64
        Occupancy words.
    blocks : (n, 3) array of int32
        x, y, z of their blocks, at most ``4**14 - 1``.
    n_cells : int
        Set bits of all words.

    Returns
    -------
    cells : (n_cells, 3) array of int32
        x, y, z one level deeper, in the order of the words and their bits.
    """
    cells = np.empty((n_cells, 3), np.int32)
    place = 0
    for i in range(words.size):
        word = words[i]
        x, y, z = 4 * blocks[i, 0], 4 * blocks[i, 1], 4 * blocks[i, 2]
        while word:
            low = word & (~word + _ONE)
            bit = popcount(low - _ONE)
            cells[place, 0] = x + (bit & 3)
            cells[place, 1] = y + ((bit >> 2) & 3)
            cells[place, 2] = z + (bit >> 4)
            place += 1
            word ^= low
    return cells


@kernel
def mean_words(words, starts):
    """
    Mean metadata word of each group of cells.

    Parameters
    ----------
    words : (n,) array of uint64
        Metadata words of the cells, group after group.
    starts : (m,) array of int64
        Where each group begins, ascending from 0; none is empty.

    Returns
    -------
    means : (m,) array of uint64
        Byte by byte the mean, halves up; byte 6, the class, is the most frequent, ties go to the
        lowest code.
    """
    means = np.zeros(starts.size, np.uint64)
    sums = np.zeros(8, np.int64)
    votes = np.zeros(256, np.int64)
    for group in range(starts.size):
        start = starts[group]
        stop = starts[group + 1] if group + 1 < starts.size else words.size
        n = stop - start
        sums[:] = 0
        for i in range(start, stop):
            word = words[i]
            for byte in range(8):
                sums[byte] += np.int64((word >> np.uint64(8 * byte)) & np.uint64(255))
            votes[np.int64((word >> np.uint64(48)) & np.uint64(255))] += 1
        best = np.int64(-1)
        n_best = np.int64(0)
        for i in range(start, stop):
            code = np.int64((words[i] >> np.uint64(48)) & np.uint64(255))
            if votes[code] > n_best or (votes[code] == n_best and n_best > 0 and code < best):
                best = code
                n_best = votes[code]
            votes[code] = 0
        mean = np.uint64(0)
        for byte in range(8):
            value = best if byte == 6 else (2 * sums[byte] + n) // (2 * n)
            mean |= np.uint64(value) << np.uint64(8 * byte)
        means[group] = mean
    return means
