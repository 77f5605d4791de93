"""Set algebra on the words of volumes, level by level: cells of two side by side, and pruning."""

from __future__ import annotations

import numpy as np

from volatool.kernels._jit import kernel

_ONE = np.uint64(1)


@kernel
def keep_bits(words, alive):
    """
    Clear the bits whose cells are gone.

    Parameters
    ----------
    words : (n,) array of uint64
        Occupancy words of a level.
    alive : (m,) array of bool
        For each set bit in order, whether its cell stays.

    Returns
    -------
    kept : (n,) array of uint64
        The words with the other bits only.
    """
    kept = np.empty(words.size, np.uint64)
    place = 0
    for i in range(words.size):
        word = words[i]
        result = np.uint64(0)
        while word:
            low = word & (~word + _ONE)
            if alive[place]:
                result |= low
            place += 1
            word ^= low
        kept[i] = result
    return kept


@kernel
def box_bits(words, blocks, first, last):
    """
    Clear the bits of cells outside a box of cells.

    Parameters
    ----------
    words : (n,) array of uint64
        Occupancy words of a level.
    blocks : (n, 3) array of int32
        x, y, z of their blocks.
    first, last : (3,) arrays of int64
        Cells of the box at the level of the bits, both included; empty if one is above the other.

    Returns
    -------
    kept : (n,) array of uint64
        The words with the bits inside only.
    """
    kept = np.empty(words.size, np.uint64)
    for i in range(words.size):
        mask = ~np.uint64(0)
        for axis in range(3):
            start = 4 * np.int64(blocks[i, axis])
            part = np.uint64(0)
            for digit in range(4):
                if first[axis] <= start + digit <= last[axis]:
                    # the slab of cells with this digit on the axis
                    if axis == 0:
                        part |= np.uint64(0x1111111111111111) << np.uint64(digit)
                    elif axis == 1:
                        part |= np.uint64(0x000F000F000F000F) << np.uint64(4 * digit)
                    else:
                        part |= np.uint64(0xFFFF) << np.uint64(16 * digit)
            mask &= part
        kept[i] = words[i] & mask
    return kept
