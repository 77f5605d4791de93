"""The word kernels against their plain twins."""

from __future__ import annotations

import naive_formats as naive
import numpy as np
import pytest

from volatool.kernels import words as kernels
from volatool.vola.words import count_level, frozen

EDGES = [0, 1, 1 << 63, (1 << 64) - 1, 0x8000_0000_0000_0001, 0x5555_5555_5555_5555]


def random_words(n: int, seed: int = 1) -> np.ndarray:
    rng = np.random.default_rng(seed)
    sparse = rng.integers(0, 2**64, n, np.uint64) & rng.integers(0, 2**64, n, np.uint64)
    return np.concatenate([np.array(EDGES, np.uint64), sparse])


def test_child_keys_and_cells_are_the_set_bits_in_order() -> None:
    """Bit j of block k is cell j of it; both kernels walk them lowest bit first."""
    words = frozen(random_words(50))
    rng = np.random.default_rng(2)
    blocks = rng.integers(0, 64, (len(words), 3)).astype(np.int32)
    keys = rng.integers(0, 2**30, len(words)).astype(np.uint64)
    expected = [
        (
            int(key) << 6 | bit,
            tuple(4 * b + c for b, c in zip(block, naive.cell((bit,)), strict=True)),
        )
        for word, key, block in zip(words.tolist(), keys, blocks.tolist(), strict=True)
        for bit in range(64)
        if word >> bit & 1
    ]
    n_cells = len(expected)
    assert kernels.child_keys(words, keys, n_cells).tolist() == [key for key, _ in expected]
    cells = kernels.child_cells(words, blocks, n_cells)
    assert [tuple(row) for row in cells.tolist()] == [cell for _, cell in expected]


@pytest.mark.parametrize("seed", range(5))
def test_mean_words_round_half_up_and_vote_on_the_class(seed: int) -> None:
    """Each group's word is the naive mean; single words stay as they are."""
    rng = np.random.default_rng(seed)
    words = rng.integers(0, 2**64, 200, np.uint64)
    few_classes = np.uint64(3 << 48) | np.uint64(0xFF00_FFFF_FFFF_FFFF)
    words &= few_classes
    starts = np.concatenate([[0, 1, 2], np.sort(rng.choice(np.arange(3, 200), 40, False))])
    means = kernels.mean_words(words, starts.astype(np.int64))
    groups = np.split(words, starts[1:])
    assert means.tolist() == [naive.mean_word([int(w) for w in group]) for group in groups]


def test_mean_words_of_nothing_is_nothing() -> None:
    """No groups, no words."""
    assert len(kernels.mean_words(np.empty(0, np.uint64), np.empty(0, np.int64))) == 0


def test_count_level_counts_bits_and_pairs() -> None:
    """Histogram and face-sharing pairs agree with counting them one by one."""
    words = random_words(100)
    counts = count_level(words)
    histogram = np.bincount([int(word).bit_count() for word in words.tolist()], minlength=65)
    assert counts.blocks == len(words)
    assert counts.histogram.tolist() == histogram.tolist()
    assert counts.contiguous_pairs == sum(map(naive.contiguous_pairs, words.tolist()))
    assert count_level(np.array([2**64 - 1], np.uint64)).contiguous_pairs == 144
    assert count_level(np.empty(0, np.uint64)).blocks == 0
