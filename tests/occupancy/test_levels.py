"""The level table: every column by hand, and the paper's printed sizes."""

from __future__ import annotations

import json
from fractions import Fraction

import numpy as np
import pytest

from volatool.model import LevelCounts
from volatool.occupancy.levels import (
    add_counts,
    counts_from_rows,
    dense_bytes,
    expected_pairs,
    level_rows,
)


def counts_of(*bits_and_numbers, pairs=0):
    histogram = np.zeros(65, np.int64)
    for bits, number in bits_and_numbers:
        histogram[bits] += number
    return LevelCounts(int(histogram.sum()), histogram, pairs)


COUNTS = [counts_of((4, 1), pairs=3), counts_of((64, 1), (16, 3), pairs=144 + 3 * 20)]


def test_every_column_is_what_it_says():
    """Two levels of a cube of side 100 with 224 points."""
    first, second = level_rows(COUNTS, 100.0, 224)
    assert (first.level, first.cell, first.blocks, first.voxels) == (1, 25.0, 1, 4)
    assert (second.level, second.cell, second.blocks, second.voxels) == (2, 6.25, 4, 112)
    assert second.occupancy == 112 / 256
    assert second.occupancy_voxel_weighted == (64 * 64 + 3 * 16 * 16) / (64 * 112)
    assert second.occupancy_histogram[16] == 3
    assert sum(second.occupancy_histogram) == 4
    assert second.contiguous_pairs_mean == 204 / 4
    assert second.contiguous_fraction == 204 / 4 / 144
    assert second.contiguous_expected == pytest.approx(
        (144 + 3 * 144 * 16 * 15 / (64 * 63)) / 4, rel=1e-15
    )
    assert (second.block_fill, second.voxel_fill) == (4 / 64, 112 / 4096)
    assert (first.points_per_voxel, second.points_per_voxel) == (56, 2)
    assert (first.dense_bytes, second.dense_bytes) == (8, 520)
    assert (first.sparse_bytes, second.sparse_bytes) == (8, 40)
    assert second.reduction == 13


def test_a_full_volume_has_no_reduction_and_all_pairs():
    """Dense and sparse are equal when everything is set (paper, section 5.1)."""
    rows = level_rows([counts_of((64, 64**i), pairs=144 * 64**i) for i in range(3)], 1)
    for row in rows:
        assert row.occupancy == row.occupancy_voxel_weighted == row.reduction == 1
        assert row.contiguous_fraction == row.block_fill == row.voxel_fill == 1
        assert row.contiguous_pairs_mean == row.contiguous_expected == 144
        assert row.points_per_voxel is None


def test_an_empty_volume_has_a_table():
    """One empty root, nothing below; no division by zero."""
    rows = level_rows([counts_of((0, 1)), counts_of()], 0, 0)
    assert [(r.blocks, r.voxels, r.occupancy, r.cell) for r in rows] == [(1, 0, 0, 0), (0, 0, 0, 0)]
    assert rows[1].points_per_voxel is None


def test_rows_are_json_and_come_back_as_counts():
    """A report's levels can be added up again."""
    rows = level_rows(COUNTS, Fraction(1, 3), 10)
    loaded = json.loads(json.dumps([row.to_dict() for row in rows]))
    back = counts_from_rows(loaded)
    for before, after in zip(COUNTS, back, strict=True):
        assert (before.blocks, before.contiguous_pairs) == (after.blocks, after.contiguous_pairs)
        assert np.array_equal(before.histogram, after.histogram)


def test_tiles_add_up():
    """Sums down to the deepest common level; fills and dense sizes are those of all cubes."""
    total = add_counts([COUNTS, COUNTS, COUNTS[:1]])
    assert len(total) == 1
    row = level_rows(total, 100.0, 30, tiles=3)[0]
    assert (row.blocks, row.voxels, row.dense_bytes, row.sparse_bytes) == (3, 12, 24, 24)
    assert (row.block_fill, row.voxel_fill, row.points_per_voxel) == (1, 12 / 192, 2.5)
    assert add_counts([]) == []


@pytest.mark.parametrize(
    ("tiles", "depth", "printed_mb", "digits"),
    [
        (234_887, 1, "1.87", 2),
        (234_887, 2, "122.14", 2),
        (234_887, 3, "7818.92", 2),
        (234_887, 4, "500412.66", 2),
        (356, 5, "48539.947", 3),
    ],
)
def test_the_papers_dense_sizes_follow_from_the_tile_counts(tiles, depth, printed_mb, digits):
    """Tables 2 and 5: all levels, decimal MB, no header, printed cut off or rounded."""
    exact = Fraction(dense_bytes(depth, tiles), 10**6)
    unit = Fraction(1, 10**digits)
    assert abs(exact - Fraction(printed_mb)) < unit


@pytest.mark.parametrize(
    ("tiles", "sizes"),
    [
        (234_887, [1_879_096, 122_141_240, 7_818_918_456, 500_412_660_280]),
        (86_804, [694_432, 45_138_080, 2_889_531_552, 184_930_713_760]),
        (66_299, [530_392, 34_475_480, 2_206_961_112, 141_246_041_560]),
        (356, [2_848, 185_120, 11_850_528, 758_436_640, 48_539_947_808]),
    ],
)
def test_dense_sizes_of_the_four_data_sets_to_the_byte(tiles, sizes):
    """All 17 rows of the dense columns of Tables 2 to 5: tiles x 8 x (1 + 64 + ...)."""
    assert [dense_bytes(depth, tiles) for depth in range(1, len(sizes) + 1)] == sizes
    summed = [tiles * 8 * sum(64**i for i in range(depth)) for depth in range(1, len(sizes) + 1)]
    assert summed == sizes


@pytest.mark.parametrize(
    ("n", "expected"), [(64, 144), (48, 80.57), (32, 35.43), (16, 8.57), (7, 1.5), (1, 0), (0, 0)]
)
def test_the_papers_contiguity_is_the_random_expectation(n, expected):
    """Table 6 in closed form, and sampled."""
    assert expected_pairs(n) == pytest.approx(expected, abs=0.005)


def test_random_blocks_have_the_expected_contiguity():
    """10,000 random blocks of 32 cells, counted by the kernel."""
    from volatool.kernels import levels

    rng = np.random.default_rng(1)
    bits = rng.permuted(np.tile(np.arange(64) < 32, (10_000, 1)), axis=1)
    words = (bits.astype(np.uint64) << np.arange(64, dtype=np.uint64)).sum(axis=1, dtype=np.uint64)
    counts = np.zeros(66, np.int64)
    levels.count_words(words, counts)
    row = level_rows([LevelCounts(10_000, counts[:65], int(counts[65]))], 1.0)[0]
    assert row.contiguous_pairs_mean == pytest.approx(row.contiguous_expected, abs=0.1)
