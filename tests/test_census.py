"""Counts, boxes, covered area and isolated heights."""

from fractions import Fraction

import numpy as np
import pytest

from volatool.census import Census, area_cell_for, box_corners, header_box
from volatool.model import PointChunk

SCALE = (0.01, 0.01, 0.01)


def chunk(x, y, z, **attributes):
    arrays = [np.asarray(values, np.int32) for values in (x, y, z)]
    return PointChunk(0, *arrays, SCALE, (0.0, 0.0, 0.0), attributes)


def census_of(heights, box=None):
    heights = np.asarray(heights, np.int32)
    places = np.arange(len(heights), dtype=np.int32)
    box = box or (0, 0, int(heights.min()), len(heights), len(heights), int(heights.max()))
    census = Census(box, (10, 10))
    census.add(chunk(places, places, heights), None)
    return census


def test_counts_are_of_points_read_and_of_points_used():
    census = Census((0, 0, 0, 999, 999, 999), (100, 100))
    codes = np.array([2, 2, 7, 5], np.uint8)
    numbers = np.array([1, 2, 1, 1], np.uint8)
    points = chunk(
        [0, 50, 999, 200], [0, 50, 999, 0], [1, 2, 3, 4], classification=codes,
        return_number=numbers,
    )  # fmt: skip
    census.add(points, np.array([True, True, False, True]))
    document = census.to_dict(SCALE)
    assert (document["points_read"], document["points_used"]) == (4, 3)
    assert document["classes"] == {"2": 2, "5": 1, "7": 1}
    assert document["returns"] == {"1": 3, "2": 1}
    assert (census.box, census.box_used) == ((0, 0, 1, 999, 999, 4), (0, 0, 1, 200, 50, 4))
    # two cells of 1 x 1 are covered by the three points used, two of them first returns
    assert document["density"]["all_per_area_occupied"] == pytest.approx(1.5)
    assert document["density"]["first_per_area_occupied"] == pytest.approx(1.0)
    assert document["density"]["all_per_area_bbox"] == pytest.approx(4 / 9.99**2)


@pytest.mark.parametrize("far", [-100_000, 1_000_000, 10_000])
def test_a_bird_is_isolated_and_a_hill_is_not(far):
    heights = np.random.default_rng(0).integers(0, 2000, 5000)
    assert census_of(heights).isolated() is None
    found = census_of([*heights, far]).isolated()
    assert found is not None
    assert found.n_points == 1
    assert (far < found.low) if far < 0 else (far > found.high)
    assert found.low <= 0
    assert found.high >= 1999


def test_both_tails_are_found():
    heights = np.random.default_rng(0).integers(0, 2000, 5000)
    assert census_of([*heights, -90_000, 90_000, 90_001]).isolated().n_points == 3


def test_two_terraces_are_not_noise():
    rng = np.random.default_rng(0)
    heights = np.concatenate([rng.integers(0, 100, 5000), rng.integers(9000, 9100, 500)])
    assert census_of(heights).isolated() is None


def test_a_header_box_that_can_not_be_is_none():
    good = (0.0, 0.0, 0.0, 1.0, 2.0, 3.0)
    assert header_box(good, SCALE, (0.0, 0.0, 0.0)) == (0, 0, 0, 100, 200, 300)
    for bad in ((5.0, *good[1:]), (float("nan"), *good[1:]), (*good[:5], 1e30)):
        assert header_box(bad, SCALE, (0.0, 0.0, 0.0)) is None


def test_corners_are_exact():
    corners = box_corners((1, 2, 3, 4, 5, 6), SCALE, (0.1, 0.0, 0.0), Fraction(1, 3))
    assert corners[0] == Fraction(11, 100)
    assert corners[5] == Fraction(2, 100)


def test_cells_of_covered_area_are_10_m_but_never_too_many():
    assert area_cell_for((0, 0, 0, 10**6, 10**6, 1), SCALE, Fraction(1)) == (1000, 1000)
    assert area_cell_for((0, 0, 0, 1000, 1000, 1), SCALE, Fraction(1)) == (10, 10)
    cell = area_cell_for((-(2**31), 0, 0, 2**31 - 1, 2**31 - 1, 1), (1.0, 1.0, 1.0), None)
    assert (2**32 // cell[0]) * (2**31 // cell[1]) <= 1 << 24
    assert area_cell_for((5, 5, 5, 5, 5, 5), SCALE, Fraction(1)) == (1000, 1000)
