"""How many of the cells around a cell are set."""

from __future__ import annotations

import numpy as np

from volatool.kernels._jit import kernel
from volatool.kernels.contiguity import popcount
from volatool.kernels.locate import row_of


@kernel
def count(directory, depth, cells, offsets, masks, counts):
    """
    Set cells around cells.

    Parameters
    ----------
    directory : (m, 2) array of uint64
        The levels, see `volatool.kernels.locate`.
    depth : int
        Number of levels.
    cells : (n, 3) array of int64
        x, y, z, set or not; negative for none.
    offsets : (k, 3) array of int64
        Blocks that may hold neighbours, from the block of a cell.
    masks : (64, k) array of uint64
        For each number of a cell in its block, which cells of those blocks are its neighbours.
    counts : (n,) array of int64
        Set; -1 where there is no cell.

    Notes
    -----
    A block costs one look-up and one popcount, however many of its cells are neighbours: the count
    in the block itself is the paper's [Byrne2018]_, sections 6 and 7.
    """
    size = np.int64(1) << (2 * (depth - 1))
    for i in range(counts.size):
        x, y, z = cells[i]
        if (x | y | z) < 0:
            counts[i] = -1
            continue
        bit = (x & 3) | ((y & 3) << 2) | ((z & 3) << 4)
        n = np.int64(0)
        for k in range(offsets.shape[0]):
            mask = masks[bit, k]
            if not mask:
                continue
            bx = (x >> 2) + offsets[k, 0]
            by = (y >> 2) + offsets[k, 1]
            bz = (z >> 2) + offsets[k, 2]
            if (bx | by | bz) < 0 or bx >= size or by >= size or bz >= size:
                continue
            row = row_of(directory, depth - 1, bx, by, bz)
            if row >= 0:
                n += popcount(directory[row, 0] & mask)
        counts[i] = n
