"""Utility functions, errors and ranges."""

from __future__ import annotations

import numpy as np
import pytest

from volatool.papers import emap_scores as scores
from volatool.papers.emap_scene import Nodes

SENSOR = np.array([0.8, 0.0, 2.0])


@pytest.fixture
def r():
    return Nodes.around(SENSOR).distance(SENSOR)


def test_utilities_at_known_distances():
    at = np.array([0.0, 0.2, 0.25, 4.0, 6.0, 20.0])
    np.testing.assert_array_equal(scores.raw(at), 1)
    np.testing.assert_array_equal(scores.nearest(at), [1, 1, 0, 0, 0, 0])
    np.testing.assert_allclose(scores.gaussian(at)[[3, 4]], [np.exp(-2), 1])
    np.testing.assert_allclose(scores.cdf(at)[[0, 3, 5]], [1, 0.5, 0], atol=1e-4)


def test_cdf_is_that_of_the_normal_distribution():
    special = pytest.importorskip("scipy.special")
    at = np.linspace(0, 10, 50)
    np.testing.assert_allclose(scores.cdf(at), 1 - special.ndtr(at - 4), atol=1e-14)


def test_what_is_wrong_with_the_printed_formulas(r):
    """C16 to C18: no Gaussian weight, a CDF that is never 0 or 1, rows that can't be of a grid."""
    assert scores.gaussian_as_printed(r).max() < 1.6e-8
    printed = scores.cdf_as_printed(np.linspace(0, 20, 99))
    assert (printed.min(), printed.max()) == pytest.approx((0.146, 0.854), abs=1e-3)
    assert (scores.gaussian(r) ** 2 + scores.cdf(r) ** 2).min() > 0.19
    table = {row.key: row for row in scores.SCENARIOS}
    raw, gauss, cdf = table["raw"], table["gaussian"], table["cdf"]
    assert (gauss.paper_octomap[0] + cdf.paper_octomap[0]) / raw.paper_octomap[0] < 0.03
    assert table["nearest"].paper_emap[0] > raw.paper_emap[0]


def test_the_papers_per_cents_follow_from_its_table():
    for row in scores.SCENARIOS:
        printed = scores.percent(row.paper_emap[0], row.paper_octomap[0])
        assert printed == pytest.approx(row.paper_percent, abs=0.1)


def test_mse_is_a_mean_over_nodes():
    errors = np.zeros((2, 2, 2))
    errors[1] = [[1, 2], [3, 4]]
    weights = np.array([[1, 0.5], [0, 1]])
    np.testing.assert_allclose(scores.weighted_mse(errors, weights), [0, (1 + 1 + 0 + 16) / 4])


def test_range_is_the_largest_radius_within_the_threshold():
    r = np.array([[1.0, 2.0], [2.0, 3.0]])
    errors = np.array([[0.1, 0.3], [0.1, 9.0]])
    assert scores.range_within(errors, r, 0.2) == 2.0  # both at 2 m: sqrt(.11 / 3) = 0.19
    assert scores.range_within(errors, r, 0.15) == 1.0
    assert scores.range_within(errors, r, 0.05) == 0.0
    assert scores.range_within(errors, r, 10.0) == 3.0


def test_the_spread_of_one_run_is_nothing():
    assert scores.spread(np.array([3.0])) == 0
    assert scores.spread(np.array([1.0, 3.0])) == pytest.approx(np.sqrt(2))
