"""Ways through free space, against Dijkstra on the whole grid."""

from __future__ import annotations

import itertools
import math

import making_volumes as making
import naive_space as naive
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

import volatool as vt
from volatool.cube import Cube
from volatool.errors import OptionError, ResourceError
from volatool.kernels import gridpath, roam
from volatool.vola.path import PathEndError, find_path
from volatool.vola.straighten import length_of
from volatool.vola.tree import tree_of
from volatool.vola.volume import Volume, VolumeInfo

WALL = [(7, y, z) for y in range(16) for z in range(16)]
"""A wall across the middle of a cube of depth 2."""


def unit_volume(cells, depth=2):
    """A volume whose cells are the lattice's: corner 0, edge 1."""
    cube = Cube((0.0, 0.0, 0.0), float(4**depth))
    if not cells:
        words = (np.zeros(1, np.uint64), *[np.zeros(0, np.uint64)] * (depth - 1))
        return Volume(words, None, cube, VolumeInfo())
    return making.volume_of(cells, depth, metadata=False, cube=cube, info=VolumeInfo())


def middle(cell):
    return np.array(cell) + 0.5


def hold(path, volume, a, b, clearance):
    """The ends, length and clearance are those of the line, looked at closely."""
    assert np.array_equal(path.points[[0, -1]], [a, b])
    steps = np.diff(path.points, axis=0)
    np.testing.assert_allclose(path.length, np.sqrt((steps**2).sum(axis=1)).sum(), rtol=1e-12)
    t = np.linspace(0, 1, 41)[:, None]
    places = np.vstack([p + t * s for p, s in zip(path.points[:-1], steps, strict=True)])
    least = volume.clearance(places).min()
    assert path.clearance <= least + 1e-9
    assert path.clearance >= clearance * (1 - 1e-8)
    assert path.clearance >= min(least - np.abs(steps).max() / 40, least)


def passes(path, point, within):
    """Tell whether a path comes so near to a point on each axis."""
    t = np.linspace(0, 1, 201)[:, None]
    pieces = zip(path.points[:-1], path.points[1:], strict=True)
    return any(abs(p + t * (q - p) - point).max(axis=1).min() <= within for p, q in pieces)


@st.composite
def mazes(draw):
    """Free and occupied cells of a cube of depth 2, dense enough to have pockets."""
    seed, n = draw(st.integers(0, 2**32 - 1)), draw(st.integers(600, 3400))
    rng = np.random.default_rng(seed)
    cells = {divmod(int(k), 256) for k in rng.choice(4096, n, replace=False)}
    cells = {(x, rest // 16, rest % 16) for x, rest in cells}
    free = sorted(set(itertools.product(range(16), repeat=3)) - cells)
    a, b = (free[int(k)] for k in rng.integers(0, len(free), 2))
    return cells, a, b, rng


@settings(max_examples=12, deadline=None)
@given(maze=mazes(), factor=st.sampled_from([1.0, 1.2, 1.5]), smooth=st.booleans())
def test_a_path_is_found_exactly_when_there_is_one_and_within_the_factor(maze, factor, smooth):
    """Existence and length against Dijkstra; what is proved of the length is true."""
    cells, a, b, rng = maze
    volume = unit_volume(cells)
    allowed = naive.allowed_cells(cells, 16, 0)
    start, goal = (middle(cell) + rng.uniform(-0.4, 0.4, 3) for cell in (a, b))
    best = naive.shortest(
        allowed, {a: math.dist(start, middle(a))}, {b: math.dist(middle(b), goal)}
    )
    path = volume.path(start, goal, factor=factor, smooth=smooth)
    assert (path is None) == math.isinf(best)
    if path is not None:
        hold(path, volume, start, goal, 0.0)
        assert path.length <= factor * best * (1 + 1e-9)
        assert path.length <= path.factor * best * (1 + 1e-9)
        assert path.factor <= factor * (1 + 1e-9)
        assert path.clearance >= 0.1 - 1e-9  # nowhere nearer than the ends


@settings(max_examples=10, deadline=None)
@given(
    cells=st.sets(st.tuples(*[st.integers(0, 15)] * 3), min_size=1, max_size=8),
    clearance=st.sampled_from([0.7, 1.0, 1.5, 2.5, 4.0]),
    picks=st.tuples(*[st.integers(0, 10**6)] * 2),
)
def test_clearance_is_kept_all_along_and_no_way_that_keeps_it_is_missed(cells, clearance, picks):
    """Also distances that some centres keep exactly."""
    allowed = naive.allowed_cells(cells, 16, clearance)
    if not allowed:
        return
    a, b = (sorted(allowed)[pick % len(allowed)] for pick in picks)
    best = naive.shortest(allowed, {a: 0.0}, {b: 0.0})
    volume = unit_volume(cells)
    for smooth in (False, True):
        path = volume.path(middle(a), middle(b), clearance, factor=1.0, smooth=smooth)
        # a straight line may pass where no way over centres does
        assert path is not None or math.isinf(best)
        assert smooth or (path is None) == math.isinf(best)
        if path is not None:
            hold(path, volume, middle(a), middle(b), clearance)
            assert path.length <= best * (1 + 1e-9)


@settings(max_examples=10, deadline=None)
@given(maze=mazes())
def test_the_search_over_cells_finds_dijkstras_length(maze):
    """Neither longer nor shorter, with the cells of the way each a step apart."""
    cells, a, b, _ = maze
    tree = tree_of(unit_volume(cells), 2)
    best = naive.shortest(naive.allowed_cells(cells, 16, 0), {a: 0.5}, {b: 0.25})
    ends = (np.array([a]), np.array([0.5]), np.array([b]), np.array([0.25]))
    nodes = (tree.words, tree.first, tree.depth, np.array([0.25, -np.inf, np.inf]))
    status, way, looked_at, least = gridpath.walk(*nodes, *ends, 1.0, np.inf, 1 << 14)
    assert (status == roam.FOUND) == math.isfinite(best)
    if status != roam.FOUND:
        assert status == roam.EXHAUSTED
        return
    assert (tuple(way[0]), tuple(way[-1])) == (a, b)
    assert len(way) <= looked_at <= 4096 - len(cells)
    np.testing.assert_allclose(length_of(way + 0.5) + 0.75, best, rtol=1e-12)
    np.testing.assert_allclose(least, best, rtol=1e-12)
    assert np.abs(np.diff(way, axis=0)).max(initial=0) <= 1
    assert {tuple(cell) for cell in way.tolist()}.isdisjoint(cells)
    # nothing shorter than the shortest; and what a search that is cut short says is true
    status = gridpath.walk(*nodes, *ends, 1.0, best * (1 - 1e-9), 1 << 14)[0]
    assert status == roam.EXHAUSTED
    status, _, _, least = gridpath.walk(*nodes, *ends, 1.0, np.inf, 64)
    assert status == roam.FOUND or least <= best


@settings(max_examples=8, deadline=None)
@given(maze=mazes(), band=st.tuples(st.integers(0, 6), st.integers(9, 16)))
def test_heights_bound_the_whole_line(maze, band):
    """Cells count whose centre is between them; half a cell of the ends' may be cut off."""
    cells, a, b, _ = maze
    low, high = band[0] + 0.25, band[1] - 0.25
    allowed = {cell for cell in naive.allowed_cells(cells, 16, 0) if low <= cell[2] + 0.5 <= high}
    volume = unit_volume(cells)
    if not {a, b} <= allowed:
        with pytest.raises(PathEndError, match="not between the heights"):
            volume.path(middle(a), middle(b), z=(low, high))
        return
    best = naive.shortest(allowed, {a: 0.0}, {b: 0.0})
    for factor in (1.0, 1.5):
        path = volume.path(middle(a), middle(b), z=(low, high), factor=factor)
        assert (path is None) == math.isinf(best)
        if path is not None:
            assert path.length <= factor * best * (1 + 1e-9)
            assert low <= path.points[:, 2].min() <= path.points[:, 2].max() <= high


def test_corners_are_not_cut():
    """Two cells that touch at an edge or a corner close the gap between them."""
    hole = [cell for cell in WALL if cell not in {(7, 8, 8)}]
    path = unit_volume(hole).path([2.5, 2.5, 8.5], [12.5, 2.5, 8.5], smooth=False, factor=1.0)
    assert passes(path, [7.5, 8.5, 8.5], 1e-9)
    # the gap is offset: only diagonal steps would pass
    stairs = [(7, y, z) for y in range(9) for z in range(16)]
    stairs += [(8, y, z) for y in range(9, 16) for z in range(16)]
    assert unit_volume(stairs).path([2.5, 2.5, 8.5], [12.5, 12.5, 8.5]) is None


def test_a_wall_with_a_hole_decides_by_its_width():
    """A square hole of three cells lets clearances to 1.5 pass, and none above."""
    hole = {(7, y, z) for y in (8, 9, 10) for z in (8, 9, 10)}
    volume = unit_volume([cell for cell in WALL if cell not in hole])
    a, b = [3.5, 3.5, 8.5], [12.5, 3.5, 8.5]
    assert volume.path(a, b, 1.5).clearance == pytest.approx(1.5, rel=1e-8)
    assert volume.path(a, b, 1.6) is None
    assert unit_volume(WALL).path(a, b) is None


def test_a_sealed_pocket_is_told_without_a_search_of_the_whole_cube():
    """From whichever end is shut in: a few cells are looked at, not the 16.7 million free ones."""
    shell = [(x, y, z) for x, y, z in itertools.product(range(100, 105), repeat=3)
             if 100 in (x, y, z) or 104 in (x, y, z)]  # fmt: skip
    volume = unit_volume(shell, 4)
    inside, outside = [102.5, 102.5, 102.5], [10.5, 10.5, 10.5]
    for a, b in ((inside, outside), (outside, inside)):
        assert volume.path(a, b, max_cells=1 << 14) is None
    assert volume.path(outside, [200.5, 200.5, 200.5]).length == pytest.approx(
        math.dist(outside, [200.5] * 3), rel=0.01
    )


def test_coarse_cells_lead_through_the_open():
    """Across an empty cube of 1024 cells a side around one voxel: a handful of cells."""
    volume = unit_volume([(512, 512, 512)], 5)
    path = volume.path([1.5, 1.5, 1.5], [1022.5, 1022.5, 1022.5], 3.0, smooth=False)
    assert sum(path.plan.values()) < 60
    assert min(path.plan) == 1
    assert path.clearance >= 3
    empty = unit_volume([], 2).path([0, 0, 0], [16, 16, 16], smooth=False)
    assert (empty.plan, empty.clearance) == ({0: 1}, math.inf)
    assert empty.to_dict()["clearance"] is None


def test_a_level_of_a_volume_has_its_cells():
    """A coarse level is safe: what it finds is free at the deepest too."""
    volume = making.random_volume(3, 30, cube=Cube((0.0, 0.0, 0.0), 64.0), info=VolumeInfo())
    free = np.argwhere(volume.clearance(np.argwhere(np.ones((16,) * 3)) * 4 + 2.0, 2) > 0)
    path = None
    for i, j in itertools.combinations(free[:: len(free) // 8, 0].tolist(), 2):
        a, b = (np.array(np.unravel_index(k, (16,) * 3)) * 4 + 2.0 for k in (i, j))
        path = volume.path(a, b, level=2)
        if path is not None:
            hold(path, volume.truncated(2), a, b, 0.0)
            assert path.clearance <= volume.path(a, b, path.clearance, level=2).clearance
            assert set(path.plan) <= {0, 1, 2}
    assert path is not None


def test_feet_and_survey_feet():
    """Heights go through z_ratio on the way in and out, lengths are in the horizontal unit."""
    volume = making.volume_of([(7, y, z) for y in range(16) for z in range(12)], 2)
    x, y, z = volume.cube.origin
    ratio, cell = float(volume.crs.z_ratio), volume.cell()
    a = np.array([x + 2.5 * cell, y + 8.5 * cell, (z + 2.5 * cell) / ratio])
    b = a + np.array([10 * cell, 0, 0])
    path = volume.path(a, b)
    assert np.array_equal(path.points[[0, -1]], [a, b])
    steps = np.diff(path.points, axis=0) * [1, 1, ratio]
    np.testing.assert_allclose(path.length, np.sqrt((steps**2).sum(axis=1)).sum(), rtol=1e-9)
    assert path.points[:, 2].max() * ratio - z >= 12.4 * cell
    top = (z + 12 * cell) / ratio  # of the wall: half a cell more than that is needed
    assert volume.path(a, b, z=(0, top + 0.4 * cell / ratio)) is None
    assert volume.path(a, b, z=(0, top + 0.6 * cell / ratio)) is not None
    assert volume.clearance(path.points).min() >= 0.49 * cell
    toolkit = making.volume_of(
        WALL[:-1], 2, cube=Cube((0.0, 0.0, 0.0), 30.0), info=VolumeInfo(quantizer="unknown")
    )
    path = toolkit.path([2, 2, 2], [28, 2, 2])
    assert passes(path, [14, 30, 30], 1.01)


def test_ends_where_no_path_can_be():
    """Outside, occupied, too near: each says so, and which end it is."""
    volume = unit_volume([(7, 7, 7)])
    good = [1.5, 1.5, 1.5]
    for bad, words in (
        ([16.5, 1, 1], "outside"),
        ([np.nan, 1, 1], "outside"),
        ([7.5, 7.5, 7.5], "occupied"),
        ([7.5, 7.5, 9.0], "too near: a voxel is 1 away, less than 2"),
    ):
        for ends, name in (((bad, good), "start"), ((good, bad), "goal")):
            with pytest.raises(PathEndError, match=f"{name} {words}") as caught:
                volume.path(*ends, clearance=2.0)
            assert caught.value.code == "E_PATH_END"
    point = making.volume_of([(0, 0, 0)], 1, cube=Cube((0.0, 0.0, 0.0), 0.0), info=VolumeInfo())
    with pytest.raises(PathEndError, match="outside"):
        point.path([0, 0, 0], [0, 0, 0])


def test_ends_whose_own_cell_is_too_near_go_to_a_neighbouring_centre():
    """An end may keep a clearance that its cell's centre does not."""
    volume = unit_volume([(0, y, z) for y in range(16) for z in range(16)])
    a, b = np.array([2.9, 8.5, 8.5]), np.array([2.95, 2.5, 8.5])
    for smooth in (False, True):
        hold(volume.path(a, b, 1.8, smooth=smooth), volume, a, b, 1.8)
    same = volume.path(a, a, 1.8)
    assert (same.length, len(same.points)) == (0, 2)


def test_ends_on_the_faces_of_voxels_and_of_the_cube():
    """A place on a face belongs to the cell above: its other side may be a voxel, or nothing."""
    volume = unit_volume([(6, 7, 7), (8, 7, 7)])
    on_face = [7.0, 7.5, 7.5]  # of (6, 7, 7) and (7, 7, 7)
    for ends in ((on_face, [16.0, 16, 16]), ([0.0, 0, 0], on_face)):
        path = volume.path(*ends)
        assert path.points[[0, -1]].tolist() == [list(end) for end in ends]
        assert path.clearance == 0
        assert path.length < 1.2 * math.dist(*ends)
    # a rounding error below the face of a voxel
    below = [np.nextafter(7.0, 0), 7.5, 7.5]
    assert volume.path(below, [0, 0, 0]).clearance == 0
    with pytest.raises(PathEndError, match="occupied"):
        volume.path([8.0, 7.5, 7.5], [0, 0, 0])


def test_options_that_make_no_sense_are_refused():
    """Clearances, factors, levels, shapes; volumes that are too deep."""
    volume = unit_volume([(7, 7, 7)])
    a = [1.5, 1.5, 1.5]
    for options, words in (
        ({"clearance": -1}, "clearance is 0 or more"),
        ({"clearance": math.nan}, "clearance is 0 or more"),
        ({"factor": 0.5}, "factor is 1 or more"),
        ({"factor": math.nan}, "factor is 1 or more"),
        ({"level": 3}, "levels 1 to 2"),
        ({"z": (3, 2)}, "heights are the lower and the higher, not 3 and 2"),
        ({"z": (math.nan, 2)}, "heights are the lower"),
    ):
        with pytest.raises(OptionError, match=words):
            find_path(volume, a, a, **options)
    with pytest.raises(OptionError, match="start is three numbers"):
        volume.path([1, 2], a)
    deep = unit_volume([(0, 0, 0)], 11)
    with pytest.raises(ResourceError, match="end at level 10, not 11"):
        deep.path([9e5, 9e5, 9e5], [9e5, 9e5, 8e5])
    assert deep.path([9e5, 9e5, 9e5], [9e5, 9e5, 8e5], level=10).length == 1e5


def test_a_search_that_is_too_large_says_so():
    """Two halves of a cube of rubble, a wall between: undecided within 1,024 cells."""
    rng = np.random.default_rng(5)
    cells = {tuple(map(int, row)) for row in rng.integers(0, 64, (20000, 3))}
    cells |= {(31, y, z) for y in range(64) for z in range(64)}
    cells -= {(5, 5, 5), (60, 60, 60)}
    volume = unit_volume(cells, 3)
    with pytest.raises(ResourceError, match=r"looking at 1024 cells.*coarser level") as caught:
        volume.path([5.5, 5.5, 5.5], [60.5, 60.5, 60.5], max_cells=1500)
    assert caught.value.code == "E_SIZE"
    assert volume.path([5.5, 5.5, 5.5], [60.5, 60.5, 60.5]) is None


def test_a_path_says_what_is_proved_of_its_length():
    """The way is soon known; that nothing is shorter is only known with room enough."""
    volume = unit_volume(
        [(31, y, z) for y in range(64) for z in range(64) if (y, z) != (60, 60)], 3
    )
    ends = [20.5, 5.5, 5.5], [45.5, 5.5, 5.5]
    best = volume.path(*ends, factor=1.0)
    short = volume.path(*ends, factor=1.0, max_cells=1 << 15)
    free = volume.path(*ends, factor=math.inf)
    assert best.factor == 1
    assert short.length == free.length >= best.length
    assert 1 < short.factor < free.factor
    assert best.length >= short.length / short.factor
    # twice from an end to the hole, by steps along axes and diagonals
    assert best.length <= 2 * (11 * math.sqrt(3) + 44 * math.sqrt(2)) + 1


@pytest.mark.parametrize("name", ["laserchicken-AHN3.laz", "pyfor-osbs-test.laz"])
def test_ways_in_real_tiles_exist_where_the_free_space_hangs_together(shared, name, tmp_path):
    """Against scipy's labels of the cells that keep a clearance, for places all over the tile."""
    report = vt.convert(shared / "tiles" / name, tmp_path, depth=3, dem=False)
    volume = vt.open(next(path for path in report.paths if ".vol" in path.name))
    ratio, cell = float(volume.crs.z_ratio), volume.cell()
    centres = volume.cube.corners(np.argwhere(np.ones((64,) * 3)), 3) + cell / 2
    centres[:, 2] /= ratio
    rng = np.random.default_rng(2)
    for clearance in (0.0, 1.4 * cell):
        keeps = (volume.clearance(centres) >= max(clearance, 0.4 * cell)).reshape((64,) * 3)
        labels = ndimage.label(keeps)[0].ravel()
        places = np.flatnonzero(labels)
        near = places[volume.clearance(centres[places]) < 3 * cell]
        for i, j in rng.choice(near, (25, 2)).tolist():
            a, b = centres[i], centres[j]
            path = volume.path(a, b, clearance, smooth=False)
            assert (path is not None) == (labels[i] == labels[j])
            if path is not None:
                straight = math.dist(a * [1, 1, ratio], b * [1, 1, ratio])
                assert path.length >= straight * (1 - 1e-9)
                assert path.clearance >= max(clearance, 0.49 * cell) * (1 - 1e-6)
