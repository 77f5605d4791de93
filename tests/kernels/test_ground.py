"""The ground filter's kernels against their plain twins."""

from __future__ import annotations

import naive_ground as naive
import numpy as np
import pytest

from volatool.kernels import ground, spring


def cells(seed, shape=(23, 31), empty=0.2):
    """Lowest points of cells with holes, pits of several sizes and a cliff."""
    rng = np.random.default_rng(seed)
    z = rng.integers(0, 300, shape) + 1000 * (np.arange(shape[1]) > 20)
    for size in (1, 2, 3, 4):
        r, q = rng.integers(0, 18, 2)
        z[r : r + size, q : q + size] -= rng.integers(200, 900)
    best = np.zeros((*shape, 3), np.int32)
    best[:, :, 2] = np.where(rng.random(shape) >= empty, z, ground.NONE)
    return best


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("empty", [0.0, 0.2, 0.9])
def test_limits_are_those_of_the_window_percentile(seed, empty):
    """Counting first, sorting only where needed, gives what sorting everywhere gives."""
    best = cells(seed, empty=empty)
    limits = np.zeros(best.shape[:2], np.int64)
    for start in range(0, 23, 7):  # any strips
        ground.low_limits(best, 300.5, 5, 0.1, start, min(start + 7, 23), limits)
    lowest = np.where(best[:, :, 2] < ground.NONE, best[:, :, 2], np.nan)
    assert np.array_equal(limits, naive.low_limits(lowest, 300.5, 5, 0.1))


@pytest.mark.parametrize("seed", range(6))
def test_large_groups_are_terrain(seed):
    """Groups are joined by sides and corners; only those of at most 12 cells keep limits."""
    rng = np.random.default_rng(seed)
    limits = np.where(rng.random((25, 40)) < 0.25, rng.integers(-50, 50, (25, 40)), naive.NOTHING)
    out = np.zeros(limits.shape, np.int64)
    for start, stop in ((0, 9), (9, 25)):
        ground.spare_large(limits, 12, start, stop, out)
    assert np.array_equal(out, naive.spare_large(limits, 12))
    assert (out != naive.NOTHING).any()


def test_slopes_are_bilinear_means_of_central_differences():
    """Inside, at the rim and beyond it; a plane has its own slope everywhere."""
    rng = np.random.default_rng(0)
    z = rng.normal(size=(7, 9))
    r, q = np.mgrid[:7, :9]
    for col, row in zip(rng.uniform(0, 9, 200), rng.uniform(0, 7, 200), strict=True):
        found = ground.slope_at(z, col, row, 2.0)
        np.testing.assert_allclose(found, naive.slope(z, col, row, 2.0), rtol=1e-12)
        plane = ground.slope_at(3.0 * q + 4.0 * r, col, row, 2.0)
        np.testing.assert_allclose(plane, 2.5)


def test_pulls_fall_off_above_and_never_below():
    """1 up to tau, a quarter at twice tau."""
    rise = np.array([-100.0, 0.0, 0.5, 1.0, 1.5])
    found = [ground.pull_of(value, 0.5) for value in rise]
    np.testing.assert_allclose(found, [1, 1, 1, 0.25, 1 / 25])


LATTICE = np.array([[0, 1, 0, 10], [0, -1, 230, 10]])
"""Cells of 10 steps, 31 columns and 23 rows of them."""


def scattered(n=4000, seed=0):
    """Stored points over the grid, a few beyond it and many of equal height."""
    rng = np.random.default_rng(seed)
    x, y = rng.integers(-5, 316, n), rng.integers(-5, 236, n)
    return np.column_stack([x, y, rng.integers(-40, 10, n)]).astype(np.int32)


def places(rows):
    """Places on the grid of `LATTICE`."""
    return rows[:, 0] / 10, (230 - rows[:, 1]) / 10


def cell_of(rows):
    """Row and column; the far edges count to the last cells."""
    col, row = places(rows)
    inside = (col >= 0) & (col <= 31) & (row >= 0) & (row <= 23)
    return inside, np.minimum(np.floor(row), 22), np.minimum(np.floor(col), 30)


def naive_lowest(rows):
    """The smallest (z, x, y) of each cell."""
    inside, row, col = cell_of(rows)
    best = np.full((23, 31, 3), ground.NONE, np.int32)
    for r in range(23):
        for q in range(31):
            here = rows[inside & (row == r) & (col == q)]
            if len(here):
                best[r, q] = min(here.tolist(), key=lambda p: (p[2], p[0], p[1]))
    return best


def empty_cells():
    return np.full((23, 31, 3), ground.NONE, np.int32)


def test_lowest_points_do_not_depend_on_order_pieces_or_rows():
    """Ties go to the smaller x, then y; rows may be done apart."""
    rows = scattered()
    wanted = naive_lowest(rows)
    for order in (rows, rows[::-1].copy()):
        best = empty_cells()
        for piece in (order[:1000], order[1000:]):
            for first, last in ((0, 9), (9, 23)):
                ground.lowest(best, piece, LATTICE, first, last)
        np.testing.assert_array_equal(best[..., 2], wanted[..., 2])
        some = wanted[..., 2] < ground.NONE
        np.testing.assert_array_equal(best[some], wanted[some])
    taken = np.concatenate([ground.take_lowest(best, 0, 10), ground.take_lowest(best, 10, 23)])
    np.testing.assert_array_equal(taken, wanted[some])


def test_cells_whose_lowest_point_is_too_low_get_the_next():
    """As if points below the limits, which have cells of their own, had never been there."""
    rows = scattered()
    limits = np.where(np.arange(12 * 16).reshape(12, 16) % 3 == 0, -25, naive.NOTHING)
    low_lattice = np.array([[0, 1, 0, 20], [0, -1, 230, 20]])
    col, row = places(rows)
    at = np.clip(np.floor(row / 2), 0, 11), np.clip(np.floor(col / 2), 0, 15)
    kept = rows[rows[:, 2] >= limits[at[0].astype(int), at[1].astype(int)]]
    best, again = empty_cells(), np.zeros((23, 31), np.uint8)
    ground.lowest(best, rows, LATTICE, 0, 23)
    n_again = sum(
        ground.drop_low(best, low_lattice, limits, start, stop, again)
        for start, stop in ((0, 11), (11, 23))
    )
    assert n_again == again.sum() > 0
    for first, last in ((0, 5), (5, 23)):
        ground.lowest_again(best, rows, LATTICE, again, low_lattice, limits, first, last)
    np.testing.assert_array_equal(best, naive_lowest(kept))


def test_far_edges_count_to_the_last_cell_of_the_limits():
    limits = np.array([[10, naive.NOTHING], [20, 30]])
    assert ground.limit_at(limits, 0.5, 0.0) == 10
    assert ground.limit_at(limits, 2.0, 2.0) == 30
    assert ground.limit_at(limits, -0.5, 1.5) == 20


def sheet(seed=0):
    """Heights of nodes about `scattered`, in steps of 0.1."""
    return np.random.default_rng(seed).normal(-1.5, 0.6, (23, 31))


def read(z, rows):
    """Height and slope of a sheet at points."""
    col, row = places(rows)
    fit = np.empty(len(rows))
    spring.interpolate(z, col, row, False, 0, len(z), fit)
    return fit, np.array([naive.slope(z, *place, 1.0) for place in zip(col, row, strict=True)])


def test_evidence_of_a_sheet_is_that_of_weighted_points():
    """Weights by how far points are above the last sheet; rows may be done apart."""
    rows = scattered()
    rows = rows[cell_of(rows)[0]]
    col, row = places(rows)
    z, height = sheet(), (rows[:, 2] + 3) * 0.1
    fit, slope = read(z, rows)
    tau = 0.3 + 0.8 * np.minimum(slope, 1)
    over = np.maximum((height - fit - tau) / tau, 0)
    for last_sheet, weights in (
        (np.empty((0, 0)), np.ones(len(rows))),
        (z, 1 / (1 + over**2) ** 2),
    ):
        wanted = np.zeros((23, 5, 31)), np.zeros((23, 31))
        spring.accumulate(*wanted, col, row, height, weights, False, 0, 23)
        found = np.zeros((23, 5, 31)), np.zeros((23, 31))
        for first, last in ((0, 4), (4, 23)):
            about = (rows, LATTICE, -3, 0.1, last_sheet, 1.0, 0.3, 0.8)
            ground.pull(*found, *about, first, last)
        for one, other in zip(found, wanted, strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12)


def test_points_near_the_sheet_and_not_too_low_are_ground():
    """Bounds grow with the slope; rows and points may be done apart."""
    rows = scattered()
    rows = rows[cell_of(rows)[0]]
    z = sheet()
    fit, slope = read(z, rows)
    rise = (rows[:, 2] + 3) * 0.1 - fit
    wanted = (rise < 0.4 + 0.8 * slope) & (rise > -(1 + slope))
    limits = np.full((1, 1), -20)
    low = np.array([[0, 1, 0, 1000], [0, -1, 230, 1000]])
    for used, is_high in ((np.empty((0, 0), np.int64), True), (limits, rows[:, 2] >= -20)):
        keep = np.zeros(len(rows), bool)
        for first, last in ((0, 9), (9, 23)):
            for start, stop in ((0, 700), (700, len(rows))):
                about = (LATTICE, -3, 0.1, 1.0, (0.4, 0.8, 1.0, 1.0), low, used, keep)
                ground.near(z, rows, *about, first, last, start, stop)
        np.testing.assert_array_equal(keep, wanted & is_high)


@pytest.mark.parametrize("highest", [5, 10**6])
def test_the_lowest_come_to_the_front_in_order_and_none_is_lost(highest):
    rng = np.random.default_rng(highest)
    for _ in range(300):
        values = rng.integers(0, highest, rng.integers(1, 122)).astype(float)
        n_sorted = int(rng.integers(1, len(values) + 1))
        moved = values.copy()
        ground._sort_lowest(moved, len(values), n_sorted)
        ranked = np.sort(values)
        assert np.array_equal(moved[:n_sorted], ranked[:n_sorted])
        assert np.array_equal(np.sort(moved), ranked)
