"""
One level of a volume as strips of 64 cells along x: the words of dense files.

The cells of a level of side ``s = 4**level`` are one bit array, ``linear = x + y*s + z*s*s``; word
``linear // 64``, bit ``linear % 64``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from volatool.model import I32, I64, U64, Bool
from volatool.vola.volume import Volume


@dataclass(frozen=True, slots=True)
class Strips:
    """
    One level of a dense file, without its empty words.

    Parameters
    ----------
    numbers : (n,) array of uint64
        Which words of the level are not empty, ascending.
    words : (n,) array of uint64
        Their bits.
    metadata : (n,) array of uint64 or None
        Their metadata words.
    """

    numbers: U64
    words: U64
    metadata: U64 | None

    def full(self, level: int) -> tuple[U64, U64 | None]:
        """Return all words of the level as the file has them, and all metadata words."""
        words = np.zeros(64 ** (level - 1), np.uint64)
        words[self.numbers] = self.words
        if self.metadata is None:
            return words, None
        metadata = np.zeros_like(words)
        metadata[self.numbers] = self.metadata
        return words, metadata


def linear_numbers(cells: I32, level: int) -> U64:
    """Return the place of cells in the bit array of their level."""
    x, y, z = cells.T.astype(np.uint64)
    linear: U64 = x | y << np.uint64(2 * level) | z << np.uint64(4 * level)
    return linear


def level_strips(volume: Volume, level: int) -> Strips:
    """Return one level of a volume as strips, metadata averaged."""
    linear = linear_numbers(volume.voxels(level), level)
    order = np.argsort(linear)
    linear = linear[order]
    numbers = linear >> np.uint64(6)
    starts = group_starts(numbers)
    words = np.bitwise_or.reduceat(bit_of(linear), starts) if len(linear) else linear
    metadata = None
    if volume.has_metadata:
        from volatool.kernels.words import mean_words

        metadata = mean_words(volume.metadata(level)[order], starts)
    return Strips(numbers[starts], words, metadata)


def group_starts(sorted_numbers: U64) -> I64:
    """Return where each run of equal numbers begins."""
    changed: Bool = np.ones(len(sorted_numbers), np.bool_)
    np.not_equal(sorted_numbers[1:], sorted_numbers[:-1], out=changed[1:])
    return np.flatnonzero(changed)


def bit_of(numbers: U64) -> U64:
    """Return the word with the bit of each number set."""
    bits: U64 = np.uint64(1) << (numbers & np.uint64(63))
    return bits


def vola_order(strips: Strips, level: int) -> tuple[U64, U64 | None]:
    """Path keys of the cells set, ascending, and the metadata word of each one's strip."""
    from volatool.kernels import quantize, words

    n_each = np.bitwise_count(strips.words)
    linear = words.child_keys(strips.words, strips.numbers, int(n_each.sum(dtype=np.int64)))
    low = np.uint64(4**level - 1)
    axes = [(linear >> np.uint64(2 * level * axis)) & low for axis in range(3)]
    keys = quantize.cell_keys(np.column_stack(axes).astype(np.int32))
    order = np.argsort(keys)
    repeated = None if strips.metadata is None else np.repeat(strips.metadata, n_each)[order]
    return keys[order], repeated
