"""The depth rule, branch by branch, and the other ways to choose a depth."""

from __future__ import annotations

import numpy as np
import pytest

from volatool.cube import Cube
from volatool.errors import OptionError
from volatool.model import LevelCounts
from volatool.occupancy.depth import (
    budget_depth,
    choose_depth,
    dataset_depth,
    deepest_passing,
    depth_for_resolution,
    fixed_depth,
    resolution_depth,
    stop_level,
)
from volatool.occupancy.levels import occupancy_of

CUBE = Cube((0.0, 0.0, 0.0), 64.0)


def tree(*occupancies):
    """Counts of levels with about these occupancies, each fed by the one above."""
    counts, blocks = [], 100
    for occupancy in occupancies:
        voxels = round(64 * occupancy * blocks)
        low = voxels // blocks
        histogram = np.zeros(65, np.int64)
        histogram[low + 1 if low < 64 else 64] += voxels - low * blocks
        histogram[low] += blocks - (voxels - low * blocks)
        counts.append(LevelCounts(blocks, histogram, 0))
        blocks = max(voxels, 1)
    return counts


MANY = 10**12


def test_levels_stop_at_the_first_with_nearly_as_many_voxels_as_points():
    """More than 0.9 x points, not just 0.9."""
    counts = tree(0.3, 0.3, 0.3, 0.3)
    third = counts[2].voxels
    assert stop_level(counts, int(third / 0.9) - 2) == 3
    assert stop_level(counts, -(-third * 10 // 9) + 1) == 4


def test_levels_stop_at_the_first_below_two_percent():
    """Level 1 is exempt: a long road fills 2 of 64 cells."""
    assert stop_level(tree(0.3, 0.3, 0.019, 0.5), MANY) == 3
    assert stop_level(tree(0.01, 0.3, 0.3, 0.3), MANY) == 4


def test_levels_stop_at_the_greatest_depth():
    """The last one counted, or the one that is the limit."""
    counts = tree(0.5, 0.5, 0.5, 0.5)
    assert stop_level(counts, MANY) == 4
    assert stop_level(counts, MANY, 3) == 3


def test_there_are_never_fewer_than_two_levels():
    """One point stops at once and still has two levels, if two were counted."""
    assert stop_level(tree(1 / 64, 1 / 64, 1 / 64), 1) == 2
    assert stop_level(tree(0.5), 1) == 1


def test_the_deepest_level_that_passes_is_chosen_with_its_margin():
    """Margin, next level and cell are in the choice, and in words."""
    choice = choose_depth(tree(0.05, 0.4, 0.25, 0.1, 0.05), MANY, cube=CUBE)
    assert (choice.depth, choice.rule, choice.threshold, choice.cell) == (3, "occupancy", 0.15, 1)
    assert choice.margin == pytest.approx(0.10, abs=0.001)
    assert (choice.next_level, choice.warnings) == (4, ())
    assert choice.next_occupancy == pytest.approx(0.10, abs=0.001)
    assert "level 4 has 10.00%" in choice.reason
    assert "borderline" not in choice.reason
    assert choice.to_dict()["margin"] == choice.margin


def test_a_level_that_fails_hides_the_ones_below():
    """All levels from 2 down must pass."""
    counts = tree(0.5, 0.3, 0.1, 0.4, 0.4)
    assert choose_depth(counts, MANY, cube=CUBE).depth == 2
    assert choose_depth(counts, MANY, cube=CUBE, threshold=0.09).depth == 5


def test_exactly_the_threshold_passes():
    """At least, not more than."""
    counts = tree(0.5, 0.25, 0.25)
    assert occupancy_of(counts[2]) == 0.25
    choice = choose_depth(counts, MANY, cube=CUBE, threshold=0.25)
    assert (choice.depth, choice.margin) == (3, 0)
    assert "borderline" in choice.reason


def test_no_level_beyond_the_stop_is_chosen():
    """A deep level may pass by chance where there are more voxels than points allow."""
    counts = tree(0.5, 0.5, 0.5, 0.5)
    assert choose_depth(counts, int(counts[2].voxels / 0.95), cube=CUBE).depth == 3
    assert choose_depth(counts, MANY, cube=CUBE, max_depth=2).depth == 2


def test_if_none_passes_it_is_two_with_a_warning():
    """The margin is negative then."""
    choice = choose_depth(tree(0.5, 0.1, 0.5), MANY, cube=CUBE)
    assert choice.depth == 2
    assert choice.margin == pytest.approx(-0.05, abs=0.001)
    assert [warning.code for warning in choice.warnings] == ["W_LOW_OCCUPANCY"]
    assert "no level reaches" in choice.reason


def test_a_single_level_is_taken_without_a_warning():
    """--max-depth 1 leaves no choice; level 1 is exempt from the rule."""
    choice = choose_depth(tree(0.05), MANY, cube=CUBE)
    assert (choice.depth, choice.warnings) == (1, ())


@pytest.mark.parametrize(
    ("name", "printed", "depth"),
    [
        # the papers' levels 4 of the first two are not known to us; they are below 15 %
        ("San Francisco", [0.468, 0.519, 0.297, 0.149], 3),
        ("New York", [0.392, 0.604, 0.313, 0.149], 3),
        ("Montreal", [0.356, 0.625, 0.380, 0.1562], 4),  # the paper itself took 3
        ("Dublin", [0.525, 0.871, 0.483, 0.355, 0.1472], 4),
    ],
)
def test_the_papers_occupancies_give_its_depths(name, printed, depth):
    """Tables 2 to 5: 3, 3, 4 and 4; Montreal passes by 0.62 points and is called borderline."""
    assert deepest_passing(printed) == depth
    if name == "Montreal":
        choice = choose_depth(tree(*printed), MANY, cube=CUBE)
        assert choice.margin == pytest.approx(0.0062, abs=1e-4)
        assert "15.62% against 15.00%, borderline" in choice.reason


def test_no_level_passes_when_the_second_does_not():
    """Level 1 alone is no reason."""
    assert deepest_passing([0.9, 0.1]) is None
    assert deepest_passing([0.9]) is None


@pytest.mark.parametrize(
    ("cell", "depth"), [(100.0, 1), (16.0, 1), (15.9, 2), (4.0, 2), (1.0, 3), (0.5, 4), (0.25, 4)]
)
def test_a_resolution_is_met_by_the_nearest_depth_not_coarser(cell, depth):
    """Cells of 16, 4, 1, 0.25 in a cube of side 64."""
    assert depth_for_resolution(CUBE, cell, 8) == depth
    choice = resolution_depth(CUBE, cell, 8, tree(0.5, 0.5, 0.5, 0.5))
    assert (choice.rule, choice.depth, choice.threshold) == ("resolution", depth, None)
    assert choice.occupancy == pytest.approx(0.5, abs=0.01)


def test_a_resolution_out_of_reach_is_refused():
    """Too fine, zero, NaN."""
    with pytest.raises(OptionError, match="needs more than 4 levels"):
        depth_for_resolution(CUBE, 0.2, 4)
    for cell in (0.0, -1.0, float("nan")):
        with pytest.raises(OptionError, match="greater than zero"):
            depth_for_resolution(CUBE, cell, 4)
    assert depth_for_resolution(Cube((0.0, 0.0, 0.0), 0.0), 0.1, 4) == 1


def test_a_budget_takes_the_deepest_that_fits():
    """The size of the next one is said; too small a budget is an error."""
    sizes = [100, 500, 2500, 12_500]
    choice = budget_depth(lambda depth: sizes[depth - 1], 2500, CUBE, 4)
    assert (choice.rule, choice.depth) == ("budget", 3)
    assert "depth 4 needs 12500" in choice.reason
    assert budget_depth(lambda depth: sizes[depth - 1], 10**6, CUBE, 4).depth == 4
    with pytest.raises(OptionError, match="too small: depth 1 needs 100") as caught:
        budget_depth(lambda depth: sizes[depth - 1], 99, CUBE, 4)
    assert caught.value.code == "E_BUDGET"


def test_fixed_and_data_set_depths_are_reported_with_the_occupancy():
    """No threshold, no margin."""
    counts = tree(0.5, 0.4, 0.3)
    for choice, rule in (
        (fixed_depth(2, CUBE, counts), "fixed"),
        (dataset_depth({"choice": {"depth": 2}}, CUBE, counts), "dataset"),
    ):
        assert (choice.depth, choice.rule, choice.margin, choice.cell) == (2, rule, None, 4)
        assert "occupancy 40.00%" in choice.reason
    assert fixed_depth(5, CUBE, counts).occupancy is None
    for broken in ({}, {"choice": None}, {"choice": {"depth": "3"}}, {"choice": {"depth": True}}):
        with pytest.raises(OptionError, match=r"choice\.depth"):
            dataset_depth(broken, CUBE)
