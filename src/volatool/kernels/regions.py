"""Blocks and columns of a part of a volume: only what meets it is visited."""

from __future__ import annotations

import numpy as np

from volatool.kernels._jit import kernel
from volatool.kernels.contiguity import popcount
from volatool.kernels.locate import child_row

_ONE = np.uint64(1)
_RUNS = np.array([0xF, 0xFFFF, 0xFFFF_FFFF_FFFF_FFFF], np.uint64)
_REPEATS = np.array([0x1111_1111_1111_1111, 0x0001_0001_0001_0001, 1], np.uint64)


@kernel
def range_mask(block, first, last):
    """
    Cells of a block that lie in a range.

    Parameters
    ----------
    block : (3,) array of int
        x, y, z of the block, in blocks.
    first, last : (3,) arrays of int64
        Cells, both inclusive.

    Returns
    -------
    mask : uint64
        Bit ``lx + 4 ly + 16 lz``.
    """
    mask = ~np.uint64(0)
    for axis in range(3):
        start = 4 * np.int64(block[axis])
        low, high = max(first[axis] - start, 0), min(last[axis] - start, 3)
        if low > high:
            return np.uint64(0)
        # digits low to high: one run of bits, repeated for each digit of the axes above
        width = 1 << 2 * axis
        digits = _RUNS[axis] >> np.uint64(width * (3 - high))
        digits &= _RUNS[axis] << np.uint64(width * low)
        mask &= digits * _REPEATS[axis]
    return mask


@kernel
def masked_words(directory, rows, blocks, first, last, words):
    """
    Words of blocks, only their cells in a range.

    Parameters
    ----------
    directory : (m, 2) array of uint64
        The levels, see `volatool.kernels.locate`.
    rows : (n,) array of int64
        Rows of the blocks.
    blocks : (n, 3) array of int64
        Their x, y, z, in blocks of their level.
    first, last : (3,) arrays of int64
        Cells of their level, both inclusive.
    words : (n,) array of uint64
        Set.

    Returns
    -------
    n_cells : int64
        Cells set in all of them.
    """
    n_cells = np.int64(0)
    for i in range(rows.size):
        words[i] = directory[rows[i], 0] & range_mask(blocks[i], first, last)
        n_cells += popcount(words[i])
    return n_cells


@kernel
def children(directory, rows, blocks, words, below_rows, below):
    """
    Blocks below the cells that are set in words.

    Parameters
    ----------
    directory : (m, 2) array of uint64
        The levels.
    rows, blocks : (n,) and (n, 3) arrays of int64
        The blocks above.
    words : (n,) array of uint64
        Which of their cells; bits that they have set.
    below_rows, below : (n_cells,) and (n_cells, 3) arrays of int64
        Set: rows of the blocks in those cells, and their x, y, z, in VOLA order.
    """
    place = 0
    for i in range(rows.size):
        word = words[i]
        whole = directory[rows[i], 0]
        start = np.int64(directory[rows[i], 1])
        while word:
            low = word & (~word + _ONE)
            bit = popcount(low - _ONE)
            below_rows[place] = start + popcount(whole & (low - _ONE))
            below[place, 0] = 4 * blocks[i, 0] + (bit & 3)
            below[place, 1] = 4 * blocks[i, 1] + ((bit >> 2) & 3)
            below[place, 2] = 4 * blocks[i, 2] + (bit >> 4)
            place += 1
            word ^= low


@kernel
def tight_range(blocks, words, first, last):
    """
    Smallest range of cells that holds all that are set.

    Parameters
    ----------
    blocks : (n, 3) array of int64
        x, y, z of blocks.
    words : (n,) array of uint64
        Their cells.
    first, last : (3,) arrays of int64
        Set, both inclusive; ``first > last`` without any cell.
    """
    first[:] = np.int64(2**62)
    last[:] = -1
    for i in range(words.size):
        word = words[i]
        if not word:
            continue
        x = word | (word >> np.uint64(32))
        x |= x >> np.uint64(16)
        y = x
        x |= x >> np.uint64(8)
        x |= x >> np.uint64(4)
        for k in range(4):
            if (x >> np.uint64(k)) & _ONE:
                first[0] = min(first[0], 4 * blocks[i, 0] + k)
                last[0] = max(last[0], 4 * blocks[i, 0] + k)
            if (y >> np.uint64(4 * k)) & np.uint64(15):
                first[1] = min(first[1], 4 * blocks[i, 1] + k)
                last[1] = max(last[1], 4 * blocks[i, 1] + k)
            if (word >> np.uint64(16 * k)) & np.uint64(0xFFFF):
                first[2] = min(first[2], 4 * blocks[i, 2] + k)
                last[2] = max(last[2], 4 * blocks[i, 2] + k)


@kernel
def column_runs(directory, depth, xy, starts, runs):
    """
    Find the runs of set cells in columns, top to bottom.

    Parameters
    ----------
    directory : (m, 2) array of uint64
        The levels.
    depth : int
        Number of levels.
    xy : (n, 2) array of int64
        Cells x, y of the columns; negative: none there.
    starts : (n + 1,) array of int64
        Set: which of the runs are a column's.
    runs : (k, 2) array of int64
        Set as far as there is room: lowest and highest cell z of each run.

    Returns
    -------
    n_runs : int64
        Of all columns; more than k if there was not room.
    """
    n_runs = np.int64(0)
    row_of = np.zeros(depth, np.int64)
    z_of = np.zeros(depth, np.int64)
    next_of = np.zeros(depth, np.int64)
    for i in range(xy.shape[0]):
        starts[i] = n_runs
        x, y = xy[i]
        if x < 0 or y < 0:
            continue
        above = np.int64(-2)  # lowest cell of the run at hand
        level = 0
        row_of[0] = 0
        z_of[0] = 0
        next_of[0] = 3
        while level >= 0:
            lz = next_of[level]
            if lz < 0:
                level -= 1
                continue
            next_of[level] = lz - 1
            shift = 2 * (depth - 1 - level)
            bit = ((x >> shift) & 3) | (((y >> shift) & 3) << 2) | (lz << 4)
            child = child_row(directory, row_of[level], bit)
            if child < 0:
                continue
            z = 4 * z_of[level] + lz
            if level < depth - 1:
                level += 1
                row_of[level] = child
                z_of[level] = z
                next_of[level] = 3
                continue
            if z != above - 1:
                n_runs += 1
                if n_runs <= runs.shape[0]:
                    runs[n_runs - 1, 1] = z
            if n_runs <= runs.shape[0]:
                runs[n_runs - 1, 0] = z
            above = z
    starts[xy.shape[0]] = n_runs
    return n_runs
