"""Distance to the nearest occupied voxel."""

from __future__ import annotations

import gc
import itertools
import weakref

import making_volumes as making
import naive_space as naive
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

import volatool as vt
from volatool.cube import Cube
from volatool.errors import OptionError
from volatool.vola.clearance import segment_clearance
from volatool.vola.tree import lattice_of, tree_of
from volatool.vola.volume import Volume, VolumeInfo

UNIT = VolumeInfo()
"""No CRS: all axes in one unit."""


def unit_volume(cells, depth):
    """A volume whose cells are the lattice's: corner 0, edge 1."""
    cube = Cube((0.0, 0.0, 0.0), float(4**depth))
    return making.volume_of(cells, depth, metadata=False, cube=cube, info=UNIT)


@settings(max_examples=40, deadline=None)
@given(
    cells=st.sets(st.tuples(*[st.integers(0, 63)] * 3), min_size=1, max_size=40),
    points=st.lists(st.tuples(*[st.integers(-40, 300).map(lambda k: k / 4)] * 3), min_size=1),
)
def test_clearance_is_that_of_all_voxels_one_by_one(cells, points):
    """To boxes and to centres, for points in, on, about and outside voxels and cube: exactly."""
    volume = unit_volume(cells, 3)
    for to, inset in (("box", 0.0), ("centre", 0.5)):
        expected = [naive.clearance(cells, point, inset) for point in points]
        assert volume.clearance(points, to=to).tolist() == expected


@pytest.mark.parametrize(("depth", "n"), [(1, 3), (2, 60), (3, 500)])
def test_centre_distances_are_scipys_distance_transform(depth, n):
    """From cell centre to cell centre the two definitions agree."""
    rng = np.random.default_rng(n)
    cells = np.unique(rng.integers(0, 4**depth, (n, 3)), axis=0)
    volume = unit_volume(list(map(tuple, cells.tolist())), depth)
    free = np.ones((4**depth,) * 3, bool)
    free[tuple(cells.T)] = False
    centres = np.argwhere(np.ones_like(free)) + 0.5
    expected = ndimage.distance_transform_edt(free).ravel()
    np.testing.assert_allclose(volume.clearance(centres, to="centre"), expected, rtol=1e-15)
    boxes = volume.clearance(centres)
    assert (boxes[~free.ravel()] == 0).all()
    assert (boxes[free.ravel()] >= 0.5).all()
    assert (boxes <= np.maximum(expected - 0.5, 0)).all()


def test_clearance_is_in_the_horizontal_unit_and_heights_count_z_ratio_times():
    """Feet and survey feet: a height of one survey foot is 1.000002 feet of clearance."""
    volume = making.volume_of([(0, 0, 0)], 2)
    x, y, z = volume.cube.origin
    ratio, cell = float(volume.crs.z_ratio), volume.cell()
    points = [
        (x + cell / 2, y + cell / 2, (z + cell) / ratio + 1),
        (x + cell + 3, y, z / ratio),
        (x - 3, y - 4, z / ratio),
        (x, y, z / ratio),
    ]
    assert ratio != 1
    np.testing.assert_allclose(volume.clearance(points), [ratio, 3, 5, 0], atol=1e-8)


def test_levels_have_larger_cells():
    """The cells of a coarse level hold those below: no distance is larger."""
    volume = making.random_volume(3, 30)
    points = making.random_volume(3, 200).centers()
    by_level = [volume.clearance(points, level) for level in (1, 2, 3)]
    assert (by_level[0] <= by_level[1]).all()
    assert (by_level[1] <= by_level[2]).all()
    assert (volume.clearance(volume.centers(2), 2) == 0).all()


@pytest.mark.parametrize("level", [1, 2])
def test_voxels_of_the_toolkit_are_centred_on_their_places(level):
    """Place k is at 2 k here; the cell of level 1 holds the places 4 k to 4 k + 3."""
    volume = making.volume_of(
        [(5, 5, 5)], 2, cube=Cube((0.0, 0.0, 0.0), 30.0), info=VolumeInfo(quantizer="unknown")
    )
    points = [(10.0, 10.0, 10.0), (13.0, 10.0, 10.0), (-1.0, 10.0, 10.0), (10.0, 10.0, 30.0)]
    expected = {2: [0, 2, 10, 19], 1: [0, 0, 8, 15]}[level]
    np.testing.assert_allclose(volume.clearance(points, level), expected, atol=1e-12)


def test_empty_volumes_single_places_and_points_that_are_none():
    """Infinity, plain distances, NaN."""
    points = [[0.0, 0, 0], [np.nan, 0, 0], [0, np.inf, 0], [3, 4, 0]]
    nothing = (np.zeros(1, np.uint64), np.zeros(0, np.uint64))
    for side in (10.0, 0.0):
        empty = Volume(nothing, None, Cube((0.0, 0.0, 0.0), side), UNIT)
        np.testing.assert_array_equal(empty.clearance(points), [np.inf, np.nan, np.nan, np.inf])
    place = making.volume_of([(0, 0, 0)], 2, cube=Cube((0.0, 0.0, 0.0), 0.0), info=UNIT)
    np.testing.assert_array_equal(place.clearance(points), [0, np.nan, np.nan, 5])
    assert place.clearance([3.0, 4.0, 0.0]).tolist() == [5]
    assert place.clearance(np.empty((0, 3))).tolist() == []


def test_what_is_no_point_is_refused():
    """Shapes, targets and levels."""
    volume = making.random_volume(2, 5)
    with pytest.raises(OptionError, match=r"shape \(2, 2\)"):
        volume.clearance([[1, 2], [3, 4]])
    with pytest.raises(OptionError, match="box or centre, not 'edge'"):
        volume.clearance([[1, 2, 3]], to="edge")
    with pytest.raises(OptionError, match="levels 1 to 2"):
        volume.clearance([[1, 2, 3]], 3)


@settings(max_examples=40, deadline=None)
@given(
    cells=st.sets(st.tuples(*[st.integers(0, 15)] * 3), min_size=1, max_size=10),
    ends=st.tuples(*[st.tuples(*[st.integers(-8, 72).map(lambda k: k / 4)] * 3)] * 2),
)
def test_a_segments_clearance_is_the_least_along_it(cells, ends):
    """Never above any of many places on it, and reached by one of them but for their spacing."""
    volume = unit_volume(cells, 2)
    start, end = np.array(ends)
    found = segment_clearance(tree_of(volume, 2), start[None], end[None])[0]
    places = start + np.linspace(0, 1, 201)[:, None] * (end - start)
    along = volume.clearance(places)
    assert found <= along.min() + 1e-12
    assert found >= along.min() - np.linalg.norm(end - start) / 400 - 1e-12


def test_a_volumes_tree_is_kept_and_let_go():
    """Made once, and not what keeps a volume in memory."""
    volume = making.random_volume(2, 20)
    assert tree_of(volume, 2) is tree_of(volume, 2)
    assert tree_of(volume, 1).words.tolist() == volume.levels[0].tolist()
    assert lattice_of(volume, 1).size == 4
    seen = weakref.ref(volume)
    del volume
    gc.collect()
    assert seen() is None


@pytest.mark.parametrize("name", ["laserchicken-AHN3.laz", "pyfor-osbs-test.laz"])
def test_clearance_in_real_tiles_is_that_of_all_voxels(shared, name, tmp_path):
    """A few hundred places in, above and outside the tile, against every voxel."""
    report = vt.convert(shared / "tiles" / name, tmp_path, depth=4, dem=False)
    volume = vt.open(next(path for path in report.paths if ".vol" in path.name))
    rng = np.random.default_rng(1)
    side, cell = volume.cube.side, volume.cell()
    points = np.array(volume.cube.origin) + rng.uniform(-0.2, 1.2, (300, 3)) * side
    low = volume.cube.corners(volume.voxels(), volume.depth)
    expected = [
        np.sqrt((np.maximum(np.maximum(low - p, p - low - cell), 0) ** 2).sum(axis=1).min())
        for p in points
    ]
    points[:, 2] /= float(volume.crs.z_ratio)
    np.testing.assert_allclose(volume.clearance(points), expected, rtol=1e-9, atol=1e-9)


def test_a_full_cube_leaves_no_room():
    """Inside 0, outside the distance to the cube."""
    volume = unit_volume(list(itertools.product(range(4), repeat=3)), 1)
    assert volume.clearance([[2, 2, 2], [4, 4, 4], [5, 4, 2], [2, -2.5, 2]]).tolist() == [
        0, 0, 1, 2.5,
    ]  # fmt: skip
