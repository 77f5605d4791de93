"""Occupancy words in bulk, without compiled code: bits set, counts of a level."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from volatool.model import I64, U64, LevelCounts

_SLAB = 1 << 18
_X_PAIRS = np.uint64(0x7777777777777777)
_Y_PAIRS = np.uint64(0x0FFF0FFF0FFF0FFF)
_Z_PAIRS = np.uint64(0x0000FFFFFFFFFFFF)


def count_level(words: U64) -> LevelCounts:
    """
    Count one level.

    Parameters
    ----------
    words : (n,) array of uint64
        Its occupancy words.

    Returns
    -------
    counts : LevelCounts
        Exact.
    """
    histogram = np.zeros(65, np.int64)
    pairs = 0
    for start in range(0, len(words), _SLAB):
        w = words[start : start + _SLAB]
        histogram += np.bincount(np.bitwise_count(w), minlength=65)
        for shift, mask in ((1, _X_PAIRS), (4, _Y_PAIRS), (16, _Z_PAIRS)):
            both = w & (w >> np.uint64(shift)) & mask
            pairs += int(np.bitwise_count(both).sum(dtype=np.int64))
    return LevelCounts(len(words), histogram, pairs)


def frozen(words: NDArray[np.uint64]) -> U64:
    """Return a read-only view."""
    view = np.ascontiguousarray(words, np.uint64).view()
    view.flags.writeable = False
    return view


def ranks_of(words: U64) -> I64:
    """Return the set bits before each word: where the children of its cells begin."""
    ranks = np.zeros(len(words), np.int64)
    np.cumsum(np.bitwise_count(words[:-1]), out=ranks[1:], dtype=np.int64)
    return ranks


def popcount(words: U64) -> int:
    """Set bits, in pieces so that a level of a gigabyte needs no eighth of it more."""
    return sum(
        int(np.bitwise_count(words[start : start + _SLAB]).sum(dtype=np.int64))
        for start in range(0, len(words), _SLAB)
    )
