"""Sorted keys: duplicates, merging, counting and folding against plain Python."""

from __future__ import annotations

import naive_vola as naive
import numpy as np
import pytest

from volatool.kernels import contiguity, levels


def some_keys(seed, n, depth=3):
    return np.random.default_rng(seed).integers(0, 64**depth, n).astype(np.uint64)


def test_the_block_kernels_agree_with_a_count_cell_by_cell():
    """Bits set and face-sharing pairs of random, empty and full words."""
    rng = np.random.default_rng(1)
    words = rng.integers(0, 2**64, 300, np.uint64)
    words[:100] &= rng.integers(0, 2**64, 100, np.uint64) & rng.integers(0, 2**64, 100, np.uint64)
    words = np.concatenate([words, np.array([0, 1, 2**63, 2**64 - 1], np.uint64)])
    for word in words:
        assert contiguity.popcount(word) == int(word).bit_count()
        assert contiguity.contiguous_pairs(word) == naive.pairs(int(word))
    assert contiguity.contiguous_pairs(words[-1]) == 144


def test_words_are_counted_by_their_bits():
    """The histogram and the pairs add up over calls."""
    words = np.random.default_rng(2).integers(0, 2**64, 500, np.uint64)
    counts = np.zeros(66, np.int64)
    levels.count_words(words[:200], counts)
    levels.count_words(words[200:], counts)
    bits = [int(word).bit_count() for word in words]
    assert counts[:65].tolist() == np.bincount(bits, minlength=65).tolist()
    assert counts[65] == sum(naive.pairs(int(word)) for word in words)


@pytest.mark.parametrize("n", [0, 1, 2, 1000])
def test_repeats_are_dropped(n):
    """What stays at the front is the sorted set."""
    keys = np.sort(some_keys(3, n, depth=1))
    kept = levels.drop_repeats(keys.copy())
    work = keys.copy()
    levels.drop_repeats(work)
    assert work[:kept].tolist() == sorted(set(keys.tolist()))


@pytest.mark.parametrize(("n", "m"), [(0, 0), (0, 5), (5, 0), (1, 1), (300, 900), (900, 3)])
def test_merging_is_the_union(n, m):
    """Keys in both come out once."""
    left, right = (np.array(sorted(set(some_keys(s, k, 2).tolist())), np.uint64)
                   for s, k in ((4, n), (5, m)))  # fmt: skip
    merged = levels.merge_keys(left, right)
    assert merged.tolist() == sorted({*left.tolist(), *right.tolist()})


@pytest.mark.parametrize("n", [0, 1, 2000])
def test_prefixes_are_counted_at_every_level(n):
    """Distinct cells of each level, repeated keys included."""
    keys = np.sort(some_keys(6, n))
    counts = levels.prefix_counts(keys, 3)
    assert counts.tolist() == [len({k >> (6 * (3 - i)) for k in keys.tolist()}) for i in range(4)]


@pytest.mark.parametrize("piece", [1, 7, 5000])
def test_folding_does_not_depend_on_the_pieces(piece):
    """A block that goes on in the next piece is not cut in two."""
    keys = np.array(sorted(set(some_keys(7, 3000, 2).tolist())), np.uint64)
    state = np.zeros(2, np.uint64)
    found = []
    for start in range(0, len(keys), piece):
        part = keys[start : start + piece]
        blocks, words = np.empty(len(part) + 1, np.uint64), np.empty(len(part) + 1, np.uint64)
        n = levels.fold_keys(part, state, blocks, words)
        found += zip(blocks[:n].tolist(), words[:n].tolist(), strict=True)
    found.append((int(state[0]), int(state[1])))
    assert [word for _, word in found] == naive.level_words(keys.tolist(), 2)[1]
    assert [block for block, _ in found] == sorted({int(k) >> 6 for k in keys})
