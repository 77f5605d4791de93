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
