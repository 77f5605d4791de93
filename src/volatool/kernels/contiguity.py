"""Set cells of a 4 x 4 x 4 block that share a face."""

from __future__ import annotations

import numpy as np

from volatool.kernels._jit import kernel


@kernel
def popcount(word):
    """Return how many bits of a uint64 are set (LLVM makes one instruction of it)."""
    word = word - ((word >> np.uint64(1)) & np.uint64(0x5555555555555555))
    word = (word & np.uint64(0x3333333333333333)) + (
        (word >> np.uint64(2)) & np.uint64(0x3333333333333333)
    )
    word = (word + (word >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return np.int64((word * np.uint64(0x0101010101010101)) >> np.uint64(56))


@kernel
def contiguous_pairs(word):
    """
    Face-sharing pairs of set cells inside one block.

    Parameters
    ----------
    word : uint64
        Bit ``lx + 4 ly + 16 lz``.

    Returns
    -------
    pairs : int64
        0 to 144; the faces to neighbouring blocks don't count [Byrne2018]_, section 7.
    """
    along_x = word & (word >> np.uint64(1)) & np.uint64(0x7777777777777777)  # lx = 3 has no next
    along_y = word & (word >> np.uint64(4)) & np.uint64(0x0FFF0FFF0FFF0FFF)
    along_z = word & (word >> np.uint64(16))  # the shift itself brings in zeros above lz = 2
    return popcount(along_x) + popcount(along_y) + popcount(along_z)


@kernel
def components(word):
    """
    Count the connected components of one block: cells that share faces hang together.

    Parameters
    ----------
    word : uint64
        Bit ``lx + 4 ly + 16 lz``.

    Returns
    -------
    n_components : int64
        0 to 32; what hangs together outside of the block does not count.
    """
    n_components = np.int64(0)
    while word:
        grown = word & (~word + np.uint64(1))  # the lowest cell left
        part = np.uint64(0)
        while grown != part:
            part = grown
            grown |= (part << np.uint64(1)) & np.uint64(0xEEEEEEEEEEEEEEEE)
            grown |= (part >> np.uint64(1)) & np.uint64(0x7777777777777777)
            grown |= (part << np.uint64(4)) & np.uint64(0xFFF0FFF0FFF0FFF0)
            grown |= (part >> np.uint64(4)) & np.uint64(0x0FFF0FFF0FFF0FFF)
            grown |= part << np.uint64(16)
            grown |= part >> np.uint64(16)
            grown &= word
        word ^= part
        n_components += 1
    return n_components


@kernel
def count_each(words, pairs, parts):
    """
    Face-sharing pairs and connected components of each block.

    Parameters
    ----------
    words : (n,) array of uint64
        Occupancy words.
    pairs, parts : (n,) arrays of int64
        Set to `contiguous_pairs` and `components` of each word.
    """
    for i in range(words.size):
        pairs[i] = contiguous_pairs(words[i])
        parts[i] = components(words[i])
