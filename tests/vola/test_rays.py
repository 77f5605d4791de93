"""Rays and lines of sight against every voxel looked at."""

from __future__ import annotations

import itertools
import math

import making_volumes as making
import naive_queries as naive
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import volatool as vt
from volatool.cube import Cube
from volatool.errors import OptionError
from volatool.model import CrsInfo
from volatool.vola.frame import Frame
from volatool.vola.volume import VolumeInfo

UNIT = Cube((0.0, 0.0, 0.0), 16.0)
PLAIN = VolumeInfo(crs=CrsInfo())


def in_cells(voxels, depth=2):
    """Volume whose cells are the units of its coordinates."""
    return making.volume_of(voxels, depth, cube=Cube((0.0,) * 3, 4.0**depth), info=PLAIN)


def expected_hits(volume, origins, directions, limit=math.inf, skip=()):
    voxels = [tuple(row) for row in volume.voxels().tolist()]
    size = 4**volume.depth
    return [
        naive.first_hit(voxels, o, d, size, limit, skip)
        for o, d in zip(origins.tolist(), directions.tolist(), strict=True)
    ]


def check(volume, origins, directions):
    hits = volume.ray(origins, directions)
    found = expected_hits(volume, origins, directions)
    for i, hit in enumerate(found):
        case = (origins[i].tolist(), directions[i].tolist())
        if hit is None:
            assert not hits.is_hit[i], case
            assert hits.distance[i] == math.inf
            continue
        t, voxel = hit
        assert tuple(hits.voxels[i].tolist()) == voxel, case
        distance = t * math.hypot(*directions[i])
        assert hits.distance[i] == pytest.approx(distance, rel=1e-12, abs=1e-9), case
        assert tuple(volume.voxels()[hits.index[i]].tolist()) == voxel
    return hits


@pytest.mark.parametrize("depth", [1, 2, 3])
@pytest.mark.parametrize("n", [1, 30, 400])
def test_random_rays_meet_the_voxel_whose_box_comes_first(depth, n):
    rng = np.random.default_rng(depth * 1000 + n)
    size = 4**depth
    volume = in_cells({tuple(map(int, row)) for row in rng.integers(0, size, (n, 3))}, depth)
    origins = rng.uniform(-size, 2 * size, (150, 3))
    targets = rng.uniform(0, size, (150, 3))
    hits = check(volume, origins, targets - origins)
    assert n == 1 or hits.is_hit.any()
    inside = rng.uniform(0, size, (100, 3))
    check(volume, inside, rng.normal(size=(100, 3)))


coordinate = st.integers(-2, 10).map(lambda k: k / 2)
component = st.sampled_from([-2.0, -1.0, -0.5, 0.0, 0.0, 0.5, 1.0, 3.0])
cells = st.sets(st.tuples(*[st.integers(0, 3)] * 3), min_size=1, max_size=12)


@settings(max_examples=400, deadline=None)
@given(cells, st.tuples(*[coordinate] * 3), st.tuples(*[component] * 3).filter(any))
def test_rays_along_faces_edges_and_corners(voxels, origin, direction):
    """Dyadic places and slopes: the t of planes tie exactly, and the rule of ties decides."""
    check(in_cells(voxels, 1), np.array([origin]), np.array([direction]))


@settings(max_examples=150, deadline=None)
@given(
    st.sets(st.tuples(*[st.integers(0, 15)] * 3), min_size=1, max_size=30),
    st.tuples(*[st.integers(-2, 34).map(lambda k: k / 2)] * 3),
    st.tuples(*[component] * 3).filter(any),
)
def test_a_step_over_an_empty_block_is_many_small_ones(voxels, origin, direction):
    check(in_cells(voxels, 2), np.array([origin]), np.array([direction]))


def test_the_rule_of_ties():
    """A face belongs to the cell above it, an edge and a corner to the cell above on each axis."""
    volume = in_cells([(1, 1, 0)], 1)
    along = [1.0, 0.0, 0.0]
    assert volume.ray([0, 1, 0.5], along).is_hit.all()  # on the voxel's lower face
    assert not volume.ray([0, 2, 0.5], along).is_hit.any()  # on its upper face: the next cell's
    hit = volume.ray([0, 2, 0.5], [1, -1, 0])  # through the lower edge of cell (1, 1)
    assert hit.is_hit.all()
    assert hit.points.tolist() == [[1, 1, 0.5]]
    assert not volume.ray([1, 3, 0.5], [1, -1, 0]).is_hit.any()  # (2, 2) belongs to another
    last = in_cells([(3, 3, 3)], 1)
    assert last.ray([4, 4, 4], [0, 0, -1]).distance.tolist() == [0.0]  # the cube's far corner
    assert last.ray([4, 4, 9], [0, 0, -1]).distance.tolist() == [5.0]


def test_a_ray_that_starts_in_a_voxel_has_met_it():
    volume = in_cells([(1, 1, 1), (3, 1, 1)], 1)
    hits = volume.ray([1.5, 1.5, 1.5], [[1, 0, 0], [-1, 0, 0]])
    assert hits.voxels.tolist() == [[1, 1, 1]] * 2
    assert hits.distance.tolist() == [0.0, 0.0]
    assert hits.points.tolist() == [[1.5, 1.5, 1.5]] * 2


def test_the_largest_distance_is_inclusive():
    volume = in_cells([(3, 0, 0)], 1)
    hits = volume.ray([[0.5, 0.5, 0.5]] * 2, [2, 0, 0], max_distance=[2.5, np.nextafter(2.5, 0)])
    assert hits.is_hit.tolist() == [True, False]
    with pytest.raises(OptionError, match="0 or more"):
        volume.ray([0, 0, 0], [1, 0, 0], max_distance=-1)
    with pytest.raises(OptionError, match="0 or more"):
        volume.ray([0, 0, 0], [1, 0, 0], max_distance=math.nan)
    with pytest.raises(OptionError, match="1 rays have 2"):
        volume.ray([0, 0, 0], [1, 0, 0], max_distance=[1, 2])


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_meets_nothing_and_zero_is_refused(bad):
    volume = in_cells([(0, 0, 0)], 1)
    for axis in range(3):
        origin, direction = [0.5] * 3, [1.0] * 3
        origin[axis] = bad
        assert not volume.ray(origin, [1, 1, 1]).is_hit.any()
        direction[axis] = bad
        assert not volume.ray([0.5] * 3, direction).is_hit.any()
        sights = volume.sight(origin, [3, 3, 3])
        assert not sights.is_clear.any()
        assert not sights.blockers.is_hit.any()
    with pytest.raises(OptionError, match="not zero"):
        volume.ray([0, 0, 0], [[1, 0, 0], [0, 0, 0]])


def test_sight_over_distances_whose_squares_overflow():
    volume = in_cells([(2, 0, 0)], 1)
    ends = [[1e308, 0.5, 0.5], [0.5, 0.5, 1e308], [0.5, 1e200, 1e200]]
    sights = volume.sight([0.5, 0.5, 0.5], ends)
    assert sights.is_clear.tolist() == [False, True, True]
    assert sights.blockers.distance[0] == pytest.approx(1.5)
    np.testing.assert_allclose(sights.length, [1e308, 1e308, math.sqrt(2) * 1e200])
    beyond = volume.sight([-1.7e308, 0.5, 0.5], [1.7e308, 0.5, 0.5])  # no number has its length
    assert (beyond.is_clear[0], beyond.blockers.is_hit[0]) == (False, False)


def test_shapes_of_rays():
    volume = in_cells([(0, 0, 0)], 1)
    with pytest.raises(OptionError, match="as many or one"):
        volume.ray(np.zeros((2, 3)), np.ones((3, 3)))


@pytest.mark.parametrize("far", [1e6, 1e12, 1e18, 1e200])
def test_rays_from_far_away_end(far):
    """t is coarse there; the walk still goes on from plane to plane."""
    volume = in_cells([(0, 0, 0), (15, 15, 15), (7, 8, 9)], 2)
    offsets = np.array(list(itertools.product([-far, 0.5, far], repeat=3)))
    offsets = offsets[(np.abs(offsets) == far).any(axis=1)]
    check(volume, offsets, 0.5 - offsets)
    tiny = volume.ray([0.5, 0.5, 0.5], [[5e-324, 0, 0], [1e308, 1e308, 1e308], [1e-300, 1, 0]])
    assert tiny.distance.tolist() == [0.0] * 3


def test_coordinates_are_those_of_the_crs_and_distances_horizontal():
    """Feet against survey feet: an entry point lies on a face of its voxel."""
    volume = making.random_volume(3, 300)
    frame = Frame.of(volume)
    assert frame.z_ratio != 1
    rng = np.random.default_rng(3)
    low, high = volume.centers().min(0), volume.centers().max(0)
    origins, targets = rng.uniform(low - 5, high + 5, (2, 300, 3))
    targets[:200] = volume.centers()[rng.integers(0, len(volume), 200)]
    hits = volume.ray(origins, targets - origins)
    assert hits.is_hit[:200].all()
    chosen = hits.is_hit & (hits.distance > 0)
    places = frame.places(hits.points[chosen]) - hits.voxels[chosen]
    assert (np.abs(places - 0.5) < 0.5 + 1e-6).all()
    assert (np.abs(np.abs(places - 0.5).max(axis=1) - 0.5) < 1e-6).all()
    away = (hits.points - origins)[chosen] * [1, 1, frame.z_ratio]
    assert hits.distance[chosen] == pytest.approx(np.linalg.norm(away, axis=1), rel=1e-6)
    # a point in a voxel is met by a ray from it, at once
    started = volume.ray(volume.centers(), [1, 2, 3])
    assert (started.distance == 0).all()
    assert (started.index == np.arange(len(volume))).all()


def test_rays_agree_with_contains_on_faces():
    """Rays that start on a face that rounding has moved are in the cell that `contains` says."""
    cube = Cube((637000.01, 4850000.53, 0.07), 25.6)
    rng = np.random.default_rng(5)
    voxels = {tuple(map(int, row)) for row in rng.integers(0, 16, (600, 3))}
    volume = making.volume_of(voxels, 2, cube=cube, info=PLAIN)
    corners = cube.corners(rng.integers(0, 17, (400, 3)).astype(np.int32), 2)
    nothing = volume.ray(corners, [0, 0, 1], max_distance=0)
    assert (nothing.is_hit == volume.contains(corners)).all()


@pytest.mark.parametrize("quantizer", ["unknown", "toolkit"])
def test_cells_of_the_toolkit_lie_around_the_points_it_rounded_to(quantizer):
    info = VolumeInfo(crs=CrsInfo(), quantizer=quantizer)
    volume = making.volume_of([(2, 0, 0), (3, 3, 3)], 1, cube=Cube((0.0,) * 3, 3.0), info=info)
    assert volume.centers().tolist() == [[2, 0, 0], [3, 3, 3]]
    hits = volume.ray([[-1, 0, 0], [2, 0, 1]], [[1, 0, 0], [0, 0, -1]])
    assert hits.points.tolist() == [[1.5, 0, 0], [2, 0, 0.5]]


def test_a_cube_that_is_one_place():
    volume = making.volume_of([(0, 0, 0)], 2, cube=Cube((5.0, 5.0, 5.0), 0.0), info=PLAIN)
    assert volume.ray([5, 5, 5], [1, 0, 0]).distance.tolist() == [0.0]
    assert volume.ray([5, 5, 6], [1, 0, 0]).is_hit.tolist() == [False]


def test_sight_is_blocked_by_what_is_between():
    volume = in_cells([(1, 1, 1), (3, 1, 1)], 1)
    left, right = [0.5, 1.5, 1.5], [3.5, 1.5, 1.5]
    blocked = volume.sight(left, [right, [0.5, 3.5, 3.5], [0.9, 1.5, 1.5], left])
    assert blocked.is_clear.tolist() == [False, True, True, True]
    assert blocked.blockers.voxels[0].tolist() == [1, 1, 1]
    assert blocked.blockers.points[0].tolist() == [1, 1.5, 1.5]
    assert blocked.blockers.distance[0] == 0.5
    assert blocked.length.tolist() == [3.0, math.hypot(2, 2), pytest.approx(0.4), 0.0]
    on_both = volume.sight([1.5, 1.5, 1.5], right)
    assert not on_both.is_clear.any()
    assert volume.sight([1.5, 1.5, 1.5], right, ignore_ends=True).is_clear.all()
    assert not volume.sight(left, right, ignore_ends=True).is_clear.any()  # (1, 1, 1) is no end
    assert volume.sight(left, [1, 1.5, 1.5]).is_clear.tolist() == [False]  # ends belong to it
    assert volume.sight([-5, 1.5, 1.5], [9, 1.5, 1.5]).blockers.distance.tolist() == [6.0]


@settings(max_examples=150, deadline=None)
@given(cells, *[st.tuples(*[coordinate] * 3)] * 2)
def test_sight_goes_both_ways(voxels, a, b):
    """Dyadic ends, half apart: the same points lie between them whoever looks."""
    volume = in_cells(voxels, 1)
    there, back = volume.sight(a, b), volume.sight(b, a)
    difference = {abs(x - y) for x, y in zip(a, b, strict=True)} - {0.0}
    if all(math.log2(d).is_integer() for d in difference):  # t of planes are exact then
        assert there.is_clear.tolist() == back.is_clear.tolist()
    skip = {tuple(map(int, volume.cell_indices(end)[0])) for end in (a, b)}
    found = naive.first_hit(voxels, a, np.subtract(b, a).tolist(), 4, 1.0, skip)
    assert volume.sight(a, b, ignore_ends=True).is_clear.tolist() == [found is None]


@pytest.mark.shared
def test_rays_through_a_real_tile_meet_what_every_voxel_says(shared, tmp_path):
    """Feet, mountain forest: slabs of all voxels at once, for rays in all directions."""
    tile = shared / "tiles" / "4_6_crop.las"
    report = vt.convert(tile, tmp_path, depth=4, dem=False, dense="never")
    volume = vt.open(report.paths[0])
    frame, voxels = Frame.of(volume), volume.voxels().astype(float)
    assert frame.z_ratio == 1
    rng = np.random.default_rng(7)
    centers = volume.centers()
    origins = centers[rng.integers(0, len(centers), 80)] + rng.normal(size=(80, 3)) * [50, 50, 20]
    directions = rng.normal(size=(80, 3)) * [1, 1, 0.5]
    directions[40:] = centers[rng.integers(0, len(centers), 40)] - origins[40:]
    directions[:12, 0] = 0  # parallel to planes, and to an axis
    directions[:6, 1] = 0
    hits = volume.ray(origins, directions)
    places = frame.places(origins)
    for i in range(80):
        with np.errstate(divide="ignore"):
            ends = (np.stack([voxels, voxels + 1]) - places[i]) / directions[i]
        low, high = ends.min(axis=0).max(axis=1), ends.max(axis=0).min(axis=1)
        met = (np.maximum(low, 0) < high).nonzero()[0]
        assert hits.is_hit[i] == bool(len(met))
        if len(met):
            first = met[np.maximum(low[met], 0).argmin()]
            assert hits.index[i] == first
            t = max(low[first], 0.0)
            step = frame.step * np.linalg.norm(directions[i])
            assert hits.distance[i] == pytest.approx(t * step, abs=1e-6)
    assert 40 < hits.is_hit.sum() < 80


def test_empty_blocks_are_stepped_over():
    volume = in_cells([(0, 0, 0), (1023, 1023, 1023)], 5)
    hits = volume.ray([[0.5, 0.5, 1023.5]], [[1, 1, 1e-3]])
    assert not hits.is_hit.any()
    assert hits.blocks[0] < 30
