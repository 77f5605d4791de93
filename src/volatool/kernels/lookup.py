"""Ways to look cells up that volatool itself does not use, to compare its own with."""

from __future__ import annotations

import numpy as np

from volatool.kernels._jit import kernel
from volatool.kernels.contiguity import popcount

_ONE = np.uint64(1)


@kernel
def dense(words, cells, bits, found):
    """
    Look cells up in a dense level: the address is arithmetic, one word is read.

    Parameters
    ----------
    words : (n,) array of uint64
        All words of the level, ``linear = x + y s + z s s`` for ``s = 2**bits``.
    cells : (m, 3) array of int64
        x, y, z, inside the grid.
    bits : int
        Two for each level.
    found : (m,) array of bool
        Set.
    """
    for i in range(cells.shape[0]):
        linear = cells[i, 0] | (cells[i, 1] << bits) | (cells[i, 2] << (2 * bits))
        found[i] = (words[linear >> 6] >> np.uint64(linear & 63)) & _ONE


@kernel
def counting(words, starts, cells, found):
    """
    Look cells up in sparse levels without ranks: the bits before a word are counted each time.

    What the original toolkit does [Toolkit]_.

    Parameters
    ----------
    words : (n,) array of uint64
        Occupancy words of all levels, the root first.
    starts : (depth + 1,) array of int64
        Where each level begins, and the end.
    cells : (m, 3) array of int64
        x, y, z at the deepest level, inside the grid.
    found : (m,) array of bool
        Set.
    """
    depth = starts.size - 1
    for i in range(cells.shape[0]):
        block = np.int64(0)
        for level in range(depth):
            shift = 2 * (depth - 1 - level)
            bit = (
                ((cells[i, 0] >> shift) & 3)
                | (((cells[i, 1] >> shift) & 3) << 2)
                | (((cells[i, 2] >> shift) & 3) << 4)
            )
            word = words[starts[level] + block]
            flag = _ONE << np.uint64(bit)
            if not word & flag:
                block = np.int64(-1)
                break
            before = popcount(word & (flag - _ONE))
            for j in range(starts[level], starts[level] + block):
                before += popcount(words[j])
            block = before
        found[i] = block >= 0


@kernel
def descend(words, ranks, cells, shift, here):
    """
    Follow cells one level down, by the set bits before each word.

    Parameters
    ----------
    words : (n,) array of uint64
        Occupancy words of the level.
    ranks : (n,) array of int64
        Set bits before each of them.
    cells : (m, 3) array of int64
        x, y, z at the level that is searched for.
    shift : int
        Two bits for each level between this one and that one.
    here : (m,) array of int64
        In: the word of each cell, -1 when lost. Out: the rank of its bit, -1 when not set.
    """
    for i in range(here.size):
        block = here[i]
        if block < 0:
            continue
        bit = (
            ((cells[i, 0] >> shift) & 3)
            | (((cells[i, 1] >> shift) & 3) << 2)
            | (((cells[i, 2] >> shift) & 3) << 4)
        )
        word = words[block]
        flag = _ONE << np.uint64(bit)
        if word & flag:
            here[i] = ranks[block] + popcount(word & (flag - _ONE))
        else:
            here[i] = -1


@kernel
def count_by_table(words, table):
    """
    Count the bits set by a table.

    Parameters
    ----------
    words : (n,) array of uint64
        Words.
    table : (65536,) array of uint8
        Bits set in each number of 16 bits.

    Returns
    -------
    n_bits : int64
        In all words.
    """
    total = np.int64(0)
    for i in range(words.size):
        word = words[i]
        for part in range(0, 64, 16):
            total += table[(word >> np.uint64(part)) & np.uint64(0xFFFF)]
    return total


@kernel
def count_by_arithmetic(words):
    """
    Count the bits set by `popcount`.

    Parameters
    ----------
    words : (n,) array of uint64
        Words.

    Returns
    -------
    n_bits : int64
        In all words.
    """
    total = np.int64(0)
    for i in range(words.size):
        total += popcount(words[i])
    return total
