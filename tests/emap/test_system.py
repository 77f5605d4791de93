"""Springs and evidence: the operator is the energy's gradient, evidence only ever adds."""

from __future__ import annotations

import itertools

import naive_dem
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from volatool.emap.system import STRIP_CELLS, Evidence, Springs, apply, strips, windows
from volatool.errors import OptionError
from volatool.kernels import spring
from volatool.scratch import Scratch

SHAPES = [(2, 2), (2, 7), (7, 2), (3, 3), (4, 5), (9, 6), (12, 17)]


def scatter(shape, n=30, seed=0):
    rng = np.random.default_rng(seed)
    h, w = shape
    return rng.uniform(0, w, n), rng.uniform(0, h, n), rng.normal(size=n)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("springs", [Springs(1.3, 0.2, 2.0), Springs(0, 1), Springs(1, 0)])
def test_operator_equals_the_assembled_matrix(shape, springs):
    """Matrix-free H z equals the dense sum over all springs to 1e-12, at every edge."""
    col, row, heights = scatter(shape)
    evidence = Evidence(*shape)
    evidence.add(col, row, heights, springs)
    data, right = naive_dem.data_matrix(col, row, heights, springs.weight, shape)
    matrix = naive_dem.surface_matrix(*shape, springs.kb, springs.km) + data
    z = np.random.default_rng(1).normal(size=shape)
    np.testing.assert_allclose(naive_dem.dense_stencil(evidence.data), data, atol=1e-13)
    np.testing.assert_allclose(evidence.right.ravel(), right, atol=1e-13)
    np.testing.assert_allclose(
        apply(evidence.data, z, springs).ravel(), matrix @ z.ravel(), rtol=1e-12, atol=1e-12
    )


def test_operator_is_symmetric():
    """|u . H v - v . H u| < 1e-9 relative."""
    shape = (40, 33)
    springs = Springs(3.0, 0.1)
    evidence = Evidence(*shape)
    evidence.add(*scatter(shape, 500), springs)
    u, v = np.random.default_rng(2).normal(size=(2, *shape))
    a, b = (
        np.sum(u * apply(evidence.data, v, springs)),
        np.sum(v * apply(evidence.data, u, springs)),
    )
    assert abs(a - b) < 1e-9 * abs(a)


def test_planes_cost_no_bending():
    """A plane is at rest under bending springs alone, to rounding."""
    row, col = np.mgrid[:20, :30]
    force = apply(np.zeros((20, 5, 30)), 0.3 * col - 0.2 * row + 5.0, Springs(1.0, 0.0))
    assert np.abs(force).max() < 1e-12


@given(st.lists(st.integers(0, 60), max_size=4), st.booleans())
@settings(max_examples=20, deadline=None)
def test_evidence_does_not_depend_on_the_split(cuts, is_nearest):
    """The same bytes for any split of the points into calls and of the grid into row windows."""
    shape, springs = (11, 9), Springs(1, 1, 0.7, is_nearest)
    points = scatter(shape, 60)
    whole, parts = Evidence(*shape), Evidence(*shape)
    whole.add(*points, springs)
    borders = [0, *sorted(cuts), 60]
    for window in ((0, 4), (4, 5), (5, 11)):
        for a, b in itertools.pairwise(borders):
            parts.add(*(values[a:b] for values in points), springs, window)
    assert whole.data.tobytes() == parts.data.tobytes()
    assert whole.right.tobytes() == parts.right.tobytes()


def test_evidence_adds():
    """Evidence of two scans is the sum of theirs."""
    shape, springs = (6, 6), Springs(1, 1)
    points = scatter(shape, 40)
    both, first, second = Evidence(*shape), Evidence(*shape), Evidence(*shape)
    both.add(*points, springs)
    first.add(*(values[:15] for values in points), springs)
    second.add(*(values[15:] for values in points), springs)
    first += second
    np.testing.assert_allclose(first.data, both.data, atol=1e-14)
    np.testing.assert_allclose(first.right, both.right, atol=1e-14)


def test_heights_taken_off_are_those_above_the_surface():
    """`subtract` equals points that come with their heights above it; a tether says no height."""
    rng = np.random.default_rng(5)
    col, row, height = rng.uniform(0, 9, 40), rng.uniform(0, 7, 40), rng.normal(size=40)
    springs, z = Springs(1.0, 1.0, 2.0), rng.normal(size=(7, 9))
    evidence, above = Evidence(7, 9), Evidence(7, 9)
    evidence.add(col, row, height, springs)
    evidence.tether(0.5)
    evidence.subtract(z, 0.5)
    below = np.empty(40)
    spring.interpolate(z, col, row, False, 0, 7, below)
    above.add(col, row, height - below, springs)
    np.testing.assert_allclose(evidence.right, above.right, atol=1e-12)


def test_points_outside_are_ignored():
    """Points beyond the grid, and NaN, leave no trace; those on the rim do."""
    springs = Springs(1, 1)
    evidence = Evidence(4, 4)
    evidence.add(
        np.array([-0.1, 4.1, 2.0, np.nan]), np.array([2.0, 2.0, 4.5, 1.0]), np.ones(4), springs
    )
    assert not evidence.data.any()
    evidence.add(np.array([0.0, 4.0]), np.array([0.0, 4.0]), np.ones(2), springs)
    assert evidence.data[0, 0, 0] == evidence.data[3, 0, 3] == 1


def test_spilled_evidence_has_the_same_bytes():
    """Where the arrays live changes nothing."""
    points, springs = scatter((50, 40), 500), Springs(1, 1)
    scratch = Scratch(0)
    kept, spilled = Evidence(50, 40), Evidence(50, 40, scratch)
    assert scratch.is_filed(spilled.data)
    for evidence in (kept, spilled):
        for window in strips(50, 40, cells=400):
            evidence.add(*points, springs, window)
    assert kept.data.tobytes() == spilled.data.tobytes()


def test_windows_take_what_is_left_of_the_budget():
    """The whole grid in RAM; in files half of what is left, at least four strips' worth."""
    scratch = Scratch(9_000_000)
    near, far = (scratch.zeros((2000, 500), np.float64) for _ in range(2))
    assert [scratch.is_filed(array) for array in (near, far)] == [False, True]
    assert windows(scratch, 2000, 500, near) == [(0, 2000)]
    assert windows(scratch, 2000, 500, near, far) == list(strips(2000, 500, 4 * STRIP_CELLS))
    scratch.free(near)
    assert windows(scratch, 2000, 500, far) == [(0, 1125), (1125, 2000)]


def test_springs_follow_the_rule():
    """Stiffness kb c^2 is 0.02 s^2 whatever the cell; tension by ell = 3 s; overrides count."""
    for cell in (0.5, 2.0):
        springs = Springs.emap(cell, 3.0)
        assert springs.kb * cell**2 == pytest.approx(0.02 * 9)
        assert springs.km == pytest.approx(0.02 * 9 / 9**2)
    springs = Springs.emap(1.0, 3.0, k_surface=2.0, k_point=4.0, ell=10.0)
    assert (springs.kb, springs.km, springs.weight) == (2.0, 0.02, 4.0)
    paper = Springs.paper()
    assert (paper.kb, paper.km, paper.is_nearest) == (0.0, 0.1, True)
    with pytest.raises(OptionError, match="finite"):
        Springs(-1.0, 0.0)
    with pytest.raises(OptionError, match="greater than zero"):
        Springs.emap(1.0, 1.0, ell=0.0)


def test_weights_of_their_own_are_factors_of_the_springs_weight():
    """A point of weight 3 is three points; weight 0 is none; windows see the same point's."""
    shape = (12, 17)
    col, row, heights = scatter(shape, 40)
    weights = np.random.default_rng(5).integers(0, 4, 40)
    springs = Springs(1.0, 1.0, 2.0)
    weighted, repeated = Evidence(*shape), Evidence(*shape)
    for window in ((0, 5), (5, 12)):
        weighted.add(col, row, heights, springs, window, weights=weights.astype(float))
    repeated.add(*(np.repeat(values, weights) for values in (col, row, heights)), springs)
    np.testing.assert_allclose(weighted.data, repeated.data, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(weighted.right, repeated.right, rtol=1e-12, atol=1e-12)
