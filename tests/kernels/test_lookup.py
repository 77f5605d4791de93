"""The look-ups and counts that volatool's own are compared with, against plain twins."""

from __future__ import annotations

import naive_paper as naive
import naive_vola
import numpy as np
import pytest
from making_volumes import random_volume

from volatool.kernels import contiguity, lookup
from volatool.vola.words import popcount

EDGES = [0, 1, 1 << 63, (1 << 64) - 1, 0x5555_5555_5555_5555, 0x5A5A_A5A5_5A5A_A5A5]


def some_words(n=60):
    rng = np.random.default_rng(3)
    words = [rng.integers(0, 2**64, n, np.uint64) for _ in range(3)]
    return np.concatenate(
        [np.array(EDGES, np.uint64), words[0], words[0] & words[1], words[0] & words[1] & words[2]]
    )


def test_pairs_and_components_are_those_of_cells_one_by_one():
    """A checkerboard has 32 components and no pair, a full block 1 and 144."""
    words = some_words()
    pairs, parts = (np.empty(len(words), np.int64) for _ in range(2))
    contiguity.count_each(words, pairs, parts)
    assert pairs.tolist() == [naive_vola.pairs(word) for word in words.tolist()]
    assert parts.tolist() == [naive.components(word) for word in words.tolist()]
    assert (pairs[3], parts[3]) == (144, 1)
    board = sum(1 << bit for bit, cell in enumerate(naive.CELLS) if sum(cell) % 2)
    assert (contiguity.components(np.uint64(board)), naive_vola.pairs(board)) == (32, 0)


@pytest.mark.parametrize("depth", [1, 2, 3])
def test_dense_and_counting_look_ups_find_what_the_volume_has(depth):
    """All cells of a small volume, and random ones of a deeper one."""
    volume = random_volume(depth, 40)
    side = 4**depth
    held = {tuple(cell) for cell in volume.voxels().tolist()}
    cells = np.random.default_rng(depth).integers(0, side, (3000, 3))
    cells[:40] = volume.voxels()[np.arange(40) % len(held)]
    expected = [tuple(cell) in held for cell in cells.tolist()]
    found = np.empty(len(cells), np.bool_)
    words = np.array(naive.dense_has(held, side), np.uint64)
    lookup.dense(words, cells, 2 * depth, found)
    assert found.tolist() == expected
    assert any(expected)
    found[:] = ~found
    starts = np.cumsum([0, *map(len, volume.levels)])
    lookup.counting(np.concatenate(volume.levels), starts, cells, found)
    assert found.tolist() == expected


def test_descend_ranks_set_bits_and_loses_the_others():
    """A set cell becomes its rank, an unset one -1, and what is lost stays lost."""
    words = some_words(3)
    ranks = np.concatenate([[0], np.cumsum(np.bitwise_count(words))[:-1]]).astype(np.int64)
    bits = np.tile(np.arange(64), len(words))
    cells = np.array([naive.CELLS[bit] for bit in bits], np.int64)
    here = np.repeat(np.arange(len(words)), 64).astype(np.int64)
    here[5] = -1
    expected = [
        int(ranks[word]) + (int(words[word]) & ((1 << bit) - 1)).bit_count()
        if word >= 0 and int(words[word]) >> bit & 1
        else -1
        for word, bit in zip(here.tolist(), bits.tolist(), strict=True)
    ]
    lookup.descend(words, ranks, cells, 0, here)
    assert here.tolist() == expected


def test_bits_by_table_and_by_arithmetic():
    words = some_words()
    table = np.array([number.bit_count() for number in range(1 << 16)], np.uint8)
    assert lookup.count_by_table(words, table) == popcount(words)
    assert lookup.count_by_arithmetic(words) == sum(word.bit_count() for word in words.tolist())
