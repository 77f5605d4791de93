"""Set algebra on the words of volumes, level by level: cells of two side by side, and pruning."""

from __future__ import annotations

import numpy as np

from volatool.kernels._jit import kernel
from volatool.kernels.contiguity import popcount
from volatool.kernels.regions import range_mask

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
        kept[i] = words[i] & range_mask(blocks[i], first, last)
    return kept


@kernel
def pair_words(words_a, words_b, blocks_a, blocks_b, mode):
    """
    Words of the blocks of two volumes, side by side, as one.

    Parameters
    ----------
    words_a, words_b : (n,), (m,) arrays of uint64
        Occupancy words of a level.
    blocks_a, blocks_b : (k,) arrays of int64
        Which word of each is that of a block, -1 where the volume has no such block.
    mode : int
        0 ``a | b``, 1 ``a & b``, 2 ``a ^ b``, 3 ``a & ~b``, 4 ``a``.

    Returns
    -------
    words : (k,) array of uint64
    """
    words = np.empty(blocks_a.size, np.uint64)
    for i in range(blocks_a.size):
        a = words_a[blocks_a[i]] if blocks_a[i] >= 0 else np.uint64(0)
        b = words_b[blocks_b[i]] if blocks_b[i] >= 0 else np.uint64(0)
        if mode == 0:
            words[i] = a | b
        elif mode == 1:
            words[i] = a & b
        elif mode == 2:
            words[i] = a ^ b
        elif mode == 3:
            words[i] = a & ~b
        else:
            words[i] = a
    return words


@kernel
def part_words(words, words_a, blocks_a):
    """
    Part the bits of blocks into those that a volume has, and the others.

    Parameters
    ----------
    words : (k,) array of uint64
        The bits.
    words_a : (n,) array of uint64
        Occupancy words of a level.
    blocks_a : (k,) array of int64
        Which word is that of a block, -1 where the volume has no such block.

    Returns
    -------
    own, others : (k,) arrays of uint64
    """
    own, others = np.empty(words.size, np.uint64), np.empty(words.size, np.uint64)
    for i in range(words.size):
        a = words_a[blocks_a[i]] if blocks_a[i] >= 0 else np.uint64(0)
        own[i] = words[i] & a
        others[i] = words[i] & ~a
    return own, others


@kernel
def pair_children(words, words_a, words_b, blocks_a, blocks_b, n_cells):
    """
    Where two volumes have the cells of their common blocks: one step down both trees at once.

    Parameters
    ----------
    words : (k,) array of uint64
        The bits to follow, as `pair_words` returned them.
    words_a, words_b : (n,), (m,) arrays of uint64
        Occupancy words of the level.
    blocks_a, blocks_b : (k,) arrays of int64
        As in `pair_words`; those that are not -1 ascend.
    n_cells : int
        Set bits of `words`.

    Returns
    -------
    cells_a, cells_b : (n_cells,) arrays of int64
        For each bit in order the block of the next level in either volume, -1 where it has none.
    """
    cells_a = np.empty(n_cells, np.int64)
    cells_b = np.empty(n_cells, np.int64)
    place = at_a = at_b = rank_a = rank_b = np.int64(0)
    for i in range(words.size):
        a = b = np.uint64(0)
        if blocks_a[i] >= 0:
            while at_a < blocks_a[i]:
                rank_a += popcount(words_a[at_a])
                at_a += 1
            a = words_a[at_a]
        if blocks_b[i] >= 0:
            while at_b < blocks_b[i]:
                rank_b += popcount(words_b[at_b])
                at_b += 1
            b = words_b[at_b]
        word = words[i]
        while word:
            low = word & (~word + _ONE)
            below = low - _ONE
            cells_a[place] = rank_a + popcount(a & below) if a & low else np.int64(-1)
            cells_b[place] = rank_b + popcount(b & below) if b & low else np.int64(-1)
            place += 1
            word ^= low
    return cells_a, cells_b


@kernel
def pair_means(words_a, words_b, blocks_a, blocks_b, table_a, table_b):
    """
    Metadata words of the blocks of two volumes: those of the one that has it, or their mean.

    Parameters
    ----------
    words_a, words_b : (n,), (m,) arrays of uint64
        Metadata words of a level.
    blocks_a, blocks_b : (k,) arrays of int64
        As in `pair_words`; one of both is not -1.
    table_a, table_b : (8, 256) arrays of uint8
        What each byte of theirs becomes in the common scaling.

    Returns
    -------
    words : (k,) array of uint64
        Byte by byte the mean, halves up; of two classes (byte 6) the lower code.
    """
    words = np.empty(blocks_a.size, np.uint64)
    for i in range(blocks_a.size):
        has_a, has_b = blocks_a[i] >= 0, blocks_b[i] >= 0
        a = words_a[blocks_a[i]] if has_a else np.uint64(0)
        b = words_b[blocks_b[i]] if has_b else np.uint64(0)
        word = np.uint64(0)
        for byte in range(8):
            shift = np.uint64(8 * byte)
            left = np.int64(table_a[byte, (a >> shift) & np.uint64(255)])
            right = np.int64(table_b[byte, (b >> shift) & np.uint64(255)])
            if not has_b:
                value = left
            elif not has_a:
                value = right
            elif byte == 6:
                value = min(left, right)
            else:
                value = (left + right + 1) >> 1
            word |= np.uint64(value) << shift
        words[i] = word
    return words
