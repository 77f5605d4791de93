"""Table 6: exact, sampled and printed."""

from __future__ import annotations

from math import sqrt

import naive_paper as naive
import numpy as np
import pytest

from volatool.occupancy.levels import PAIRS, expected_pairs
from volatool.papers import vola_contiguity as table


def test_faces_and_pairs_of_faces_with_a_common_cell():
    """The two numbers that the formula hangs on, counted."""
    assert len(naive.FACES) == PAIRS
    shared = sum(len({*one, *other}) == 3 for one in naive.FACES for other in naive.FACES)
    assert shared == table.SHARING


@pytest.mark.parametrize("n", [0, 1, 2, 3, 7, 16, 48, 63, 64])
def test_mean_and_deviation_are_those_over_all_pairs_of_faces(n):
    mean, square = naive.moments(n)
    assert expected_pairs(n) == pytest.approx(mean, abs=1e-9)
    assert table.deviation_of_pairs(n) == pytest.approx(sqrt(max(square - mean**2, 0)), abs=1e-5)


def test_two_and_three_cells_by_counting_them_all():
    """Of the 2,016 pairs of cells 144 share a face: no formula in it."""
    assert expected_pairs(2) == pytest.approx(len(naive.FACES) / 2016)
    share = len(naive.FACES) / 2016
    assert table.deviation_of_pairs(2) == pytest.approx(sqrt(share * (1 - share)))


def test_random_blocks_have_so_many_cells_and_any_cell_as_often():
    words = table.random_blocks(6, 8000, np.random.default_rng(5))
    assert set(np.bitwise_count(words).tolist()) == {6}
    often = [(words >> np.uint64(bit) & np.uint64(1)).mean() for bit in range(64)]
    assert np.abs(np.array(often) - 6 / 64).max() < 5 * sqrt(6 / 64 * 58 / 64 / 8000)


def test_the_sample_is_within_its_error_and_the_same_each_time():
    """Means within four standard errors, deviations within a few per cent."""
    rows = table.table_6(samples=20_000, seed=1)
    assert rows == table.table_6(samples=20_000, seed=1)
    assert rows[1:] != table.table_6(samples=20_000, seed=2)[1:]
    for row in rows:
        exact, sampled = row["exact"], row["sampled"]
        assert abs(sampled["pairs"] - exact["pairs"]) <= 4 * sampled["standard_error"]
        assert sampled["deviation"] == pytest.approx(exact["deviation"], rel=0.03)
        assert 1 <= sampled["components"] <= min(row["cells"], 32)


def test_a_row_does_not_depend_on_the_size_of_the_pieces(monkeypatch):
    """Pieces keep the memory down; the draws are the same."""
    whole = table.sampled(16, 3000, 1)
    monkeypatch.setattr(table, "_PIECE", 1000)
    assert table.sampled(16, 3000, 1) == pytest.approx(whole)


def test_printed_pairs_follow_the_formula_and_the_tenth_is_of_two_minds():
    """C3: pairs of 7 cells, per cent of 6; deviations as in USERS.md."""
    rows = table.table_6(samples=2, seed=0)
    assert [row["cells"] for row in rows] == [64, 48, 32, 16, 7, 6]
    assert [row["pairs_agree"] for row in rows] == [True] * 5 + [False]
    assert [row["percent_agree"] for row in rows] == [None] * 4 + [False, True]
    deviations = [row["exact"]["deviation"] for row in rows]
    assert deviations == pytest.approx([0, 3.16, 3.41, 2.29, 1.101, 0.944], abs=0.005)
    assert rows[5]["exact"]["percent"] == pytest.approx(0.744, abs=0.001)
