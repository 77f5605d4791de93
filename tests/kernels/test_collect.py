"""Keys and sums of points, taken from the stream, against plain Python."""

from __future__ import annotations

from collections import defaultdict
from fractions import Fraction

import numpy as np
import pytest

from volatool.cube import OUTSIDE, Cube, Quantizer
from volatool.kernels import collect

SCALE, OFFSET = (0.01,) * 3, (0.0,) * 3


def quantizer_of(kind, depth=3):
    """Of a cube of 1000 stored units a side, by ratio or by table."""
    side = Fraction(10) if kind == "affine" else Fraction(10) + Fraction(1, 10**13 + 37)
    quantizer = Quantizer(Cube.from_exact([Fraction(0)] * 3, side), SCALE, OFFSET, depth)
    assert quantizer.plan[0] == (kind == "affine")
    return quantizer


def some_points(n, seed=0, high=1100):
    """Points, a tenth of them outside the cube and some of them twice in a row."""
    rng = np.random.default_rng(seed)
    xyz = np.repeat(rng.integers(0, high, (n, 3)), rng.integers(1, 4, n), axis=0)[:n]
    return [np.ascontiguousarray(column, np.int32) for column in xyz.T]


def nowhere():
    return np.repeat([2**62, -(2**62)], 3)


def naive(quantizer, points):
    """Keys, box and points outside, by the quantizer's own array of keys."""
    keys = quantizer.keys(*points)
    inside = keys != OUTSIDE
    kept = [column[inside] for column in points]
    box = [*(int(c.min()) for c in kept), *(int(c.max()) for c in kept)] if inside.any() else None
    return keys, inside, box


@pytest.mark.parametrize("kind", ["affine", "table"])
@pytest.mark.parametrize("n", [1, collect.BLOCK, 3 * collect.BLOCK + 5])
def test_keys_inside_are_written_and_the_others_counted(kind, n):
    """A key that follows an equal one may be missing, nothing else."""
    quantizer, points = quantizer_of(kind), some_points(n)
    keys, inside, box = naive(quantizer, points)
    found, tally, found_box = np.empty(n, np.uint64), np.zeros(4, np.int64), nowhere()
    collect.collect_keys(*points, *quantizer.plan, 3, found, tally, found_box)
    written = found[: tally[collect.KEYS]]
    assert set(written.tolist()) == set(keys[inside].tolist())
    assert len(written) <= inside.sum()
    if n > 1:
        assert len(written) < inside.sum()
    assert tally[collect.OUT] == n - inside.sum()
    assert found_box.tolist() == (box or nowhere().tolist())


def test_points_all_outside_change_nothing():
    quantizer = quantizer_of("affine")
    points = [np.full(5, 5000, np.int32)] * 3
    found, tally, box = np.empty(5, np.uint64), np.zeros(4, np.int64), nowhere()
    collect.collect_keys(*points, *quantizer.plan, 3, found, tally, box)
    assert tally.tolist() == [0, 0, 5, 0]
    assert box.tolist() == nowhere().tolist()


def as_dict(rows):
    assert len({int(row[0]) for row in rows}) == len(rows)
    return {int(row[0]): row[1:].tolist() for row in rows}


@pytest.mark.parametrize("kind", ["affine", "table"])
@pytest.mark.parametrize("digits", [1, 2, 3])
def test_sums_are_those_of_plain_python(kind, digits):
    """All classes, the ends of every range, stops for want of rows, coarser blocks, order."""
    n = 2 * collect.BLOCK + 77
    rng = np.random.default_rng(digits)
    quantizer, points = quantizer_of(kind), some_points(n)
    code = rng.integers(0, 256, n).astype(np.uint8) if digits == 2 else np.full(n, 7, np.uint8)
    red, green, blue, intensity = rng.integers(0, 2**16, (4, n)).astype(np.uint16)
    height = rng.integers(-(2**31), 2**31, n).astype(np.int32)
    returns = rng.integers(0, 16, n).astype(np.uint8)
    keys, inside, box = naive(quantizer, points)
    expected = defaultdict(lambda: np.zeros(7, np.int64))
    columns = np.column_stack([np.ones(n, np.int64), red, green, blue, height, returns, intensity])
    for i in np.flatnonzero(inside):
        expected[((int(keys[i]) >> (6 * digits)) << 8) | int(code[i])] += columns[i]

    capacity, n_stops = 8, 0
    rows, slots = np.empty((capacity, 8), np.int64), np.full(16, collect.EMPTY)
    found, tally, found_box = np.empty(n, np.uint64), np.zeros(4, np.int64), nowhere()
    ranges = np.array([2**62, -(2**62), 0, 0])
    while True:
        collect.collect_sums(
            *points, *quantizer.plan, 3, found, tally, found_box, digits,
            code, red, green, blue, height, returns, intensity, slots, rows, ranges,
        )  # fmt: skip
        n_rows = int(tally[collect.ROWS])
        if tally[collect.NEXT] == n:
            break
        assert n_rows == capacity  # only then does it stop
        n_stops += 1
        capacity *= 2
        rows, slots = np.concatenate([rows, rows]), np.empty(2 * capacity, np.int32)
        assert collect.regroup(rows, n_rows, 0, slots) == n_rows
    assert n_stops == (0 if len(expected) <= 8 else int(np.ceil(np.log2(len(expected) / 8))))
    assert as_dict(rows[:n_rows]) == {key: total.tolist() for key, total in expected.items()}
    assert set(found[: tally[collect.KEYS]].tolist()) == set(keys[inside].tolist())
    assert tally[collect.OUT] == n - inside.sum()
    assert found_box.tolist() == box
    assert ranges.tolist() == [
        height[inside].min(),
        height[inside].max(),
        max(c[inside].max() for c in (red, green, blue)),
        intensity[inside].max(),
    ]

    coarser = defaultdict(lambda: np.zeros(7, np.int64))
    for key, total in expected.items():
        coarser[(key >> 14 << 8) | key & 255] += total
    n_rows = int(collect.regroup(rows, n_rows, 1, slots))
    assert as_dict(rows[:n_rows]) == {key: total.tolist() for key, total in coarser.items()}
    before = rows[:n_rows].copy()
    collect.permute_rows(rows[:n_rows], np.argsort(before[:, 0]))
    assert rows[:n_rows].tolist() == sorted(before.tolist())
