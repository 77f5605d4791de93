"""The ground filter's kernels against their plain twins."""

from __future__ import annotations

import naive_ground as naive
import numpy as np
import pytest

from volatool.kernels import ground


def cells(seed, shape=(23, 31), empty=0.2):
    """Lowest points of cells with holes, pits of several sizes and a cliff."""
    rng = np.random.default_rng(seed)
    z = rng.integers(0, 300, shape) + 1000 * (np.arange(shape[1]) > 20)
    for size in (1, 2, 3, 4):
        r, q = rng.integers(0, 18, 2)
        z[r : r + size, q : q + size] -= rng.integers(200, 900)
    counts = (rng.random(shape) >= empty).astype(np.uint32)
    best = np.zeros((*shape, 3), np.int32)
    best[:, :, 2] = np.where(counts, z, 12345)
    return best, counts


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("empty", [0.0, 0.2, 0.9])
def test_limits_are_those_of_the_window_percentile(seed, empty):
    """Counting first, sorting only where needed, gives what sorting everywhere gives."""
    best, counts = cells(seed, empty=empty)
    limits = np.zeros(counts.shape, np.int64)
    for start in range(0, 23, 7):  # any strips
        ground.low_limits(best, counts, 300.5, 5, 0.1, start, min(start + 7, 23), limits)
    lowest = np.where(counts > 0, best[:, :, 2], np.nan)
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
    col, row = rng.uniform(0, 9, 200), rng.uniform(0, 7, 200)
    out = np.empty(200)
    for first, last in ((0, 3), (3, 7)):
        ground.slopes(z, col, row, 2.0, first, last, out)
    wanted = [naive.slope(z, *place, 2.0) for place in zip(col, row, strict=True)]
    np.testing.assert_allclose(out, wanted, rtol=1e-12)
    r, q = np.mgrid[:7, :9]
    ground.slopes(3.0 * q + 4.0 * r, col, row, 2.0, 0, 7, out)
    np.testing.assert_allclose(out, 2.5)


def test_pulls_fall_off_above_and_never_below():
    """1 up to tau, a quarter at twice tau, and steep slopes count as 1."""
    rise = np.array([-100.0, 0.0, 0.5, 1.0, 1.6, 3.2])
    slope = np.array([0.0, 0.0, 0.0, 0.0, 1.0, 9.0])
    out = np.empty(6)
    ground.pulls(rise, slope, 0.5, 0.3, out)
    over = np.array([1.0, (1.6 - 0.8) / 0.8, (3.2 - 0.8) / 0.8])
    np.testing.assert_allclose(out, [1, 1, 1, *(1 / (1 + over**2) ** 2)])
    assert out[3] == 0.25


def test_points_below_their_cells_limit_are_dropped():
    """Only in the rows asked for; points on the far edge count to the last cell."""
    limits = np.array([[10, naive.NOTHING], [20, 30]])
    rows = np.array([[0, 0, 9], [0, 0, 10], [0, 0, -99], [0, 0, 19], [0, 0, 29]], np.int32)
    col, row = np.array([0.5, 0.9, 1.5, 0.0, 2.0]), np.array([0.0, 0.5, 0.5, 1.5, 2.0])
    keep = np.ones(5, bool)
    ground.not_low(rows, col, row, limits, 0, 1, keep)
    assert keep.tolist() == [False, True, True, True, True]
    ground.not_low(rows, col, row, limits, 1, 2, keep)
    assert keep.tolist() == [False, True, True, False, False]
