"""Sums per block and class against dictionaries of Python integers."""

from __future__ import annotations

from collections import defaultdict
from fractions import Fraction

import naive_vola as naive
import numpy as np
import pytest

from volatool.kernels import reduce


def some_rows(seed, n, n_blocks=40):
    rng = np.random.default_rng(seed)
    rows = rng.integers(0, 1000, (n, 8))
    rows[:, 0] = (rng.integers(0, n_blocks, n) << 8) | rng.integers(0, 5, n)
    rows[:, 1] += 1
    rows = rows[np.argsort(rows[:, 0], kind="stable")]
    return reduce.fold_rows(rows, 0)


def as_dict(rows, shift=0):
    sums = defaultdict(lambda: np.zeros(7, np.int64))
    for row in rows:
        block, code = divmod(int(row[0]), 256)
        sums[(block >> shift) * 256 + code] += row[1:]
    return {key: total.tolist() for key, total in sums.items()}


def check_rows(rows, expected):
    """Strictly increasing keys and the expected sums."""
    assert (np.diff(rows[:, 0]) > 0).all()
    assert {int(row[0]): row[1:].tolist() for row in rows} == expected


@pytest.mark.parametrize("digits", [0, 1, 2])
def test_coarser_blocks_are_sums_of_their_children(digits):
    """Also from rows that repeat a key or have classes out of order inside a block."""
    rows = some_rows(1, 400, n_blocks=5000)
    twice = np.repeat(rows, 2, axis=0)
    twice[::2, 0] ^= 1  # another class, before the one that it follows
    check_rows(reduce.fold_rows(rows, digits), as_dict(rows, 6 * digits))
    check_rows(reduce.fold_rows(twice, digits), as_dict(twice, 6 * digits))


@pytest.mark.parametrize(("n", "m"), [(0, 0), (0, 9), (9, 0), (200, 200), (3, 500)])
def test_merging_adds_equal_keys(n, m):
    """The union of the rows."""
    left, right = some_rows(2, n), some_rows(3, m)
    check_rows(reduce.merge_rows(left, right), as_dict(np.concatenate([left, right])))


def test_means_are_rounded_half_up_without_overflow():
    """Byte by byte against rationals, for sums near the ends of what files can hold."""
    rng = np.random.default_rng(4)
    for _ in range(300):
        n = int(rng.integers(1, 2 ** int(rng.integers(1, 40))))
        low, high = sorted(int(v) for v in rng.integers(-(2**31), 2**31, 2))
        whole = int(rng.integers(low, high + 1))
        total = min(n * whole + int(rng.integers(0, n)), n * high)
        if abs(total) >= 2**62:
            continue
        rows = np.zeros((1, 8), np.int64)
        rows[0, 1], rows[0, 5] = n, total
        scaling = np.array([[0, 0, 1]] * 3 + [[low, 255, max(high - low, 1)]] + [[0, 0, 1]] * 2)
        word = int(reduce.encode_rows(rows, scaling, False)[0])
        expected = naive.half_up((Fraction(total, n) - low) * 255 / max(high - low, 1))
        assert word == expected << 24 | 1 << 56


def test_halves_go_up_and_ends_are_limited():
    """1.5 is 2, 2.5 is 3; below 0 is 0, above 255 is 255."""
    scaling = np.array([[0, 1, 1]] * 3 + [[0, 0, 1], [1, 255, 6], [0, 0, 1]])
    rows = np.array([[0, 2, 3, 5, 600, 0, 0, 0]])  # means 1.5, 2.5, 300; returns 0
    assert int(reduce.encode_rows(rows, scaling, False)[0]).to_bytes(8, "little") == bytes(
        [2, 3, 255, 0, 0, 0, 0, 1]
    )


def test_the_most_frequent_class_wins_and_the_lowest_of_equals():
    """Counts of points, not of rows."""
    scaling = np.array([[0, 0, 1]] * 6)
    rows = np.zeros((5, 8), np.int64)
    rows[:, 0] = [(1 << 8) | 2, (1 << 8) | 6, (7 << 8) | 3, (7 << 8) | 4, (7 << 8) | 250]
    rows[:, 1] = [5, 5, 1, 2, 9]
    words = reduce.encode_rows(rows, scaling, True)
    assert [int(word) >> 48 & 255 for word in words] == [2, 250]
    assert [int(word) >> 48 & 255 for word in reduce.encode_rows(rows, scaling, False)] == [0, 0]
