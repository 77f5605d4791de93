"""The way from stored integers to cells is exact, whatever the scales, offsets and cubes."""

from __future__ import annotations

from fractions import Fraction

import naive_vola as naive
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from volatool.cube import OUTSIDE, Cube, Quantizer
from volatool.errors import OptionError, ResourceError
from volatool.kernels import quantize

FOOT = Fraction(3048, 10000)
US_FOOT = Fraction(1200, 3937)


def check_exact(cube, scale, offset, depth, points, z_ratio=Fraction(1)):
    """Compare a Quantizer with plain rationals, point by point."""
    points = np.asarray(points, np.int32).reshape(-1, 3)
    quantizer = Quantizer(cube, scale, offset, depth, z_ratio)
    keys = quantizer.keys(*(np.ascontiguousarray(column) for column in points.T))
    expected = naive.path_keys(points.tolist(), scale, offset, cube.exact, depth, z_ratio)
    assert keys.dtype == np.uint64
    assert keys.tolist() == expected
    return quantizer


def box_of(points, scale, offset, z_ratio=Fraction(1)):
    """Exact box of stored points, z in the horizontal unit."""
    ratios = (1, 1, z_ratio)
    columns = [
        [(int(v) * naive.decimal(scale[a]) + naive.decimal(offset[a])) * ratios[a] for v in column]
        for a, column in enumerate(np.asarray(points).T)
    ]
    return [min(c) for c in columns] + [max(c) for c in columns]


def points_and_edges(rng, n=300, low=-50_000, high=90_000):
    """Random points with the corners of their box among them."""
    points = rng.integers(low, high, (n, 3))
    points[0], points[1] = points.min(axis=0), points.max(axis=0)
    return points


CASES = {
    "equal scales": ((0.01, 0.01, 0.01), (637291.0, 851210.0, 511.0), Fraction(1)),
    "unequal scales": ((0.01, 0.001, 0.1), (0.0, 1000.5, -3.25), Fraction(1)),
    "odd scales": ((0.0123456789, 0.01, 0.00370000001), (1.1, -2.7, 0.0), Fraction(1)),
    "fine offset": ((0.0001,) * 3, (131999.984125, 457000.015875, -0.000125), Fraction(1)),
    "feet against metres": ((0.01, 0.01, 0.01), (400000.0, 5e6, 0.0), FOOT),
    "metres against US feet": ((0.001, 0.001, 0.01), (2e6, 7e5, 100.0), 1 / US_FOOT),
    "huge coordinates": ((0.01,) * 3, (1.2345678901e12, -9.87e14, 1e9), Fraction(1)),
    "coarse": ((1.0, 1.0, 1.0), (0.0, 0.0, 0.0), Fraction(1)),
    "negative scale": ((-0.01, 0.01, -0.0173), (10.0, 0.0, 55.5), Fraction(1)),
}


@pytest.mark.parametrize("depth", [1, 3, 8])
@pytest.mark.parametrize("case", CASES)
def test_cells_are_exact(case, depth):
    """The cell is floor(S (p - min) / L) on rationals, the last one closed."""
    scale, offset, ratio = CASES[case]
    points = points_and_edges(np.random.default_rng(7))
    cube = Cube.around(box_of(points, scale, offset, ratio))
    check_exact(cube, scale, offset, depth, points, ratio)


@pytest.mark.parametrize("case", CASES)
def test_explicit_and_snapped_cubes_are_exact(case):
    """Cubes that are not the points' own: longer sides, snapped corners, too small ones."""
    scale, offset, ratio = CASES[case]
    points = points_and_edges(np.random.default_rng(8))
    box = box_of(points, scale, offset, ratio)
    extent = max(box[3 + a] - box[a] for a in range(3))
    check_exact(Cube.around(box, extent * 2), scale, offset, 5, points, ratio)
    inner = Cube.from_exact([c + extent / 7 for c in box[:3]], extent / 3)
    check_exact(inner, scale, offset, 6, points, ratio)
    from_floats = Cube(tuple(float(c) for c in box[:3]), float(extent) * 1.1)
    check_exact(from_floats, scale, offset, 6, points, ratio)
    for side in (100, 1000, 10_000, 100_000):
        corner = [(c // side) * side for c in box[:3]]
        check_exact(Cube.from_exact(corner, Fraction(side), True), scale, offset, 4, points, ratio)


def test_points_on_cell_borders_belong_to_the_cell_above():
    """Half-open cells, the last one closed; the faces of the cube are inside."""
    cube = Cube((0.0, 0.0, 0.0), 0.64)
    stored = np.arange(-1, 66, dtype=np.int32)
    zero = np.zeros_like(stored)
    keys = Quantizer(cube, (0.01,) * 3, (0.0,) * 3, 3).keys(stored, zero, zero)
    x = quantize.key_cells(keys[1:-1], 3)[:, 0]
    assert keys[0] == keys[-1] == OUTSIDE
    assert x.tolist() == [*range(64), 63]


@pytest.mark.parametrize("offset", [0.0, 0.005, 1e6, 131999.984125])
def test_one_place_is_cell_zero_and_all_else_is_outside(offset):
    """A cube of side 0 holds the points that are exactly there."""
    scale, offsets = (0.01,) * 3, (offset,) * 3
    box = box_of([[7, 8, 9]], scale, offsets)
    cube = Cube.around(box)
    check_exact(cube, scale, offsets, 4, [[7, 8, 9], [7, 8, 10], [6, 8, 9], [7, 8, 9]])
    between = Cube.from_exact([c + Fraction(1, 1000) for c in box[:3]], Fraction(0))
    check_exact(between, scale, offsets, 4, [[7, 8, 9], [8, 9, 10]])


def test_extreme_stored_integers_do_not_overflow():
    """The whole int32 range at the greatest depth."""
    ends = [-(2**31), -(2**31) + 1, -1, 0, 1, 2**31 - 2, 2**31 - 1]
    points = [[a, b, c] for a in ends for b in ends for c in ends]
    for scale in ((0.001,) * 3, (1e-9, 1e-7, 3e-3)):
        cube = Cube.around(box_of(points, scale, (0.0,) * 3))
        check_exact(cube, scale, (0.0,) * 3, 10, points)


@settings(max_examples=60, deadline=None)
@given(
    scale=st.tuples(*[st.sampled_from([0.01, 0.001, 0.25, 1e-7, 0.0137, -0.01, 1 / 3])] * 3),
    offset=st.tuples(*[st.floats(-1e7, 1e7, allow_nan=False)] * 3),
    depth=st.integers(1, 5),
    points=st.lists(st.tuples(*[st.integers(-(2**31), 2**31 - 1)] * 3), min_size=1, max_size=20),
    grow=st.sampled_from([Fraction(1), Fraction(10, 9), Fraction(1, 2)]),
)
def test_any_scale_offset_and_cube_is_exact(scale, offset, depth, points, grow):
    """Random everything, with the cube from the points themselves."""
    box = box_of(points, scale, offset)
    extent = max(box[3 + a] - box[a] for a in range(3)) * grow
    check_exact(Cube.from_exact(box[:3], extent), scale, offset, depth, points)


def test_common_tiles_take_the_fast_way():
    """Equal decimal scales are integer arithmetic; the table is for the odd ones only."""
    cube = Cube((635577.79, 848882.15, 406.14), 4655.51)
    assert Quantizer(cube, (0.01,) * 3, (637291.0, 851210.0, 511.0), 8).plan[0]
    assert not Quantizer(cube, (0.0123456789,) * 3, (0.3, 0.1, 0.7), 8).plan[0]


@pytest.mark.parametrize("depth", [1, 2, 5, 8, 10])
def test_keys_and_cells_are_inverse(depth):
    """Every depth up to 10; keys in order are cells in VOLA order."""
    cells = np.random.default_rng(3).integers(0, 4**depth, (500, 3)).astype(np.int32)
    cells[0], cells[1] = 0, 4**depth - 1
    keys = quantize.cell_keys(cells)
    assert keys.tolist() == [naive.interleave(cell, depth) for cell in cells.tolist()]
    assert np.array_equal(quantize.key_cells(keys, depth), cells)


def test_impossible_depths_and_scales_are_refused():
    """Depth 0 and 11, scale 0, NaN."""
    cube = Cube((0.0, 0.0, 0.0), 1.0)
    for depth in (0, 11):
        with pytest.raises(ResourceError, match="depth must be 1 to 10"):
            Quantizer(cube, (0.01,) * 3, (0.0,) * 3, depth)
    for scale in ((0.0, 1.0, 1.0), (1.0, float("nan"), 1.0)):
        with pytest.raises(OptionError, match="scale"):
            Quantizer(cube, scale, (0.0,) * 3, 3)
