"""One pass over stored points does what places, springs, counts and residuals do one by one."""

from __future__ import annotations

import numpy as np
import pytest

from volatool.kernels import binning, spring, surface

LATTICE = np.array([[-10, 1, 0, 10], [240, -1, 0, 10]])
"""Nodes in cells of 10 steps, 33 columns and 25 rows, of which the outermost make a ring."""


def scattered(n=3000, seed=0):
    rng = np.random.default_rng(seed)
    x, y = rng.integers(-25, 336, n), rng.integers(-25, 256, n)
    return np.column_stack([x, y, rng.integers(-40, 10, n)]).astype(np.int32)


def places(rows):
    return (rows[:, 0] + 10) / 10, (240 - rows[:, 1]) / 10


@pytest.mark.parametrize("nearest", [False, True])
def test_springs_and_counts_are_those_of_places_and_heights(nearest):
    """To the last bit, whatever rows are done apart."""
    rows = scattered()
    col, row = places(rows)
    heights = (rows[:, 2] - np.int64(7)) * 0.01
    wanted = np.zeros((25, 5, 33)), np.zeros((25, 33))
    spring.accumulate(*wanted, col, row, heights, np.full(1, 2.0), nearest, 0, 25)
    counts = np.zeros((23, 31), np.uint32)
    binning.count(col - 1.0, row - 1.0, 0, 23, counts)
    for windows in ([(0, 25)], [(0, 1), (1, 12), (12, 24), (24, 25)]):
        found = np.zeros((25, 5, 33)), np.zeros((25, 33)), np.zeros((23, 31), np.uint32)
        for first, last in windows:
            surface.add_points(*found, rows, LATTICE, 7, 0.01, 2.0, nearest, first, last)
        for one, other in zip(found, (*wanted, counts), strict=True):
            np.testing.assert_array_equal(one, other)
    assert counts.sum() > 0


@pytest.mark.parametrize("nearest", [False, True])
def test_squares_are_those_of_interpolated_heights(nearest):
    """To the last bit; NaN off the grid."""
    rows = scattered()
    col, row = places(rows)
    z = np.random.default_rng(1).normal(size=(25, 33))
    fit = np.empty(len(rows))
    spring.interpolate(z, col, row, nearest, 0, 25, fit)
    wanted = np.square(fit - (rows[:, 2] - np.int64(7)) * 0.01)
    found = np.zeros(len(rows))
    for first, last in ((0, 8), (8, 25)):
        for start, stop in ((0, 1000), (1000, len(rows))):
            about = (LATTICE, 7, 0.01, nearest, first, last, found)
            surface.squares(z, rows, *about, start, stop)
    np.testing.assert_array_equal(found, wanted)
    assert 0 < np.isnan(found).sum() < len(found)


def test_marked_cells_hold_points():
    rows = scattered(200)
    cells, wanted = np.zeros((25, 33), np.uint8), np.zeros((25, 33), np.uint8)
    surface.mark_cells(rows, LATTICE, cells)
    binning.mark(*places(rows), wanted)
    np.testing.assert_array_equal(cells, wanted)


def test_large_terms_give_the_same_places():
    """Where float64 can't hold the terms, whole numbers do."""
    rows = scattered()
    small, large = np.empty((2, len(rows))), np.empty((2, len(rows)))
    binning.places(rows, LATTICE, *small)
    factor = np.array([1, 2**40, 2**40, 2**40])
    binning.places(rows, LATTICE * factor, *large)
    np.testing.assert_allclose(small, places(rows), rtol=0, atol=1e-14)
    np.testing.assert_array_equal(large, small)
