"""Grids: snapped, meshing, exact at the cells' edges."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from volatool.dem.grid import Grid, grid_for
from volatool.errors import OptionError, ResourceError
from volatool.model import Bounds, as_fraction


@pytest.mark.parametrize("cell", [0.1, 0.5, 1.0, 3.0, Fraction(1250, 381)])
def test_abutting_grids_mesh(cell):
    """Grids of neighbours share their lines: corners are multiples of the cell, exactly."""
    a = grid_for(Bounds(1000.3, 5000.7, 1100.2, 5100.1), cell)
    b = grid_for(Bounds(1100.2, 5000.1, 1177.7, 5099.9), cell)
    for grid in (a, b):
        left, top, edge = grid.exact
        assert left % edge == 0
        assert top % edge == 0
        assert left <= as_fraction(grid.left) + Fraction(1, 10**9)
    shift = (b.exact[0] - a.exact[0]) / a.exact[2]
    assert shift.denominator == 1
    assert 0 <= a.width - shift <= 1


def test_grid_covers_its_bounds_tightly():
    """No cell more than needed; a point or line gives one cell."""
    grid = grid_for(Bounds(0.0, 0.0, 10.0, 5.0), 1.0)
    assert (grid.width, grid.height, grid.left, grid.top) == (10, 5, 0.0, 5.0)
    assert grid.bounds == Bounds(0.0, 0.0, 10.0, 5.0)
    assert grid.transform == (1.0, 0.0, 0.0, 0.0, -1.0, 5.0)
    point = grid_for(Bounds(2.0, 3.0, 2.0, 3.0), 1.0)
    assert (point.width, point.height, point.left, point.top) == (1, 1, 2.0, 4.0)
    assert grid_for(Bounds(-0.1, -0.1, 0.1, 0.1), 1.0).bounds == Bounds(-1.0, -1.0, 1.0, 1.0)


@given(
    st.lists(st.integers(-(2**31), 2**31 - 1), min_size=1, max_size=20),
    st.sampled_from([0.01, 0.001, 0.025, 1e-7, 0.3048, 1 / 3]),
    st.sampled_from([0.0, 1000.0, 637290.12, -3.3]),
    st.sampled_from([Fraction(1, 2), Fraction(1), Fraction(1250, 381), Fraction(7, 10)]),
)
@settings(max_examples=100, deadline=None)
def test_places_are_exact(stored, scale, offset, cell):
    """The cell of a stored integer is floor on rationals (17-digit scales: to 2e-5)."""
    rows = np.array([(x, x, 0) for x in stored], np.int32)
    values = [x * as_fraction(scale) + as_fraction(offset) for x in stored]
    grid = grid_for((values[0], values[0], values[0] + 100 * cell, values[0] + 100 * cell), cell)
    col, row = grid.places(rows, (scale, scale, scale), (offset, offset, offset))
    left, top, edge = grid.exact
    for k, value in enumerate(values):
        for found, exact in ((col[k], (value - left) / edge), (row[k], (top - value) / edge)):
            if abs(exact) > 1000:
                continue
            assert abs(found - float(exact)) < 2e-5
            if scale != 1 / 3:
                assert math.floor(found) == math.floor(exact)


def test_padded_grid_keeps_its_lines():
    """A ring of cells moves the corner by whole cells."""
    grid = Grid(10.0, 20.0, 0.1, 5, 4).padded(2)
    assert (grid.width, grid.height) == (9, 8)
    assert grid.exact == (Fraction(98, 10), Fraction(202, 10), Fraction(1, 10))


def test_impossible_grids_are_refused():
    """Zero cells, NaN corners and far outliers end in errors with codes, before allocation."""
    with pytest.raises(OptionError, match="greater than zero"):
        grid_for(Bounds(0, 0, 1, 1), 0.0)
    with pytest.raises(OptionError, match="finite"):
        Grid(math.nan, 0.0, 1.0, 1, 1)
    with pytest.raises(OptionError, match="needs cells"):
        Grid(0.0, 0.0, 1.0, 0, 1)
    with pytest.raises(ResourceError, match="lie far off") as error:
        grid_for(Bounds(0, 0, 1e9, 1e9), 0.5)
    assert error.value.code == "E_SIZE"
