"""Connected components, exact across blocks."""

from __future__ import annotations

import itertools

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
from volatool.kernels import adjacent
from volatool.vola.volume import Volume, VolumeInfo


def hold_against_scipy(volume, level=None):
    """The same partition as scipy's, with the sizes and boxes of scipy's labels."""
    voxels = volume.voxels(level)
    corner = voxels.min(axis=0)
    grid = np.zeros(voxels.max(axis=0) - corner + 1, bool)
    places = tuple((voxels - corner).T)
    grid[places] = True
    for connectivity, rank in ((6, 1), (26, 3)):
        found = volume.components(connectivity, level)
        labels, n = ndimage.label(grid, ndimage.generate_binary_structure(3, rank))
        assert len(found) == n
        pairs = np.unique(np.column_stack([labels[places] - 1, found.labels]), axis=0)
        assert len(pairs) == n, "one label of ours for one of scipy's"
        assert np.array_equal(np.bincount(found.labels, minlength=n), found.sizes)
        slices = ndimage.find_objects(labels)
        theirs, ours = pairs.T
        boxes = [
            [s.start + c for s, c in zip(slices[i], corner, strict=True)]
            + [s.stop - 1 + c for s, c in zip(slices[i], corner, strict=True)]
            for i in theirs.tolist()
        ]
        assert found.boxes[ours].tolist() == boxes
        # the largest first, equals by their first voxel
        first = np.unique(found.labels, return_index=True)[1]
        keys = list(zip((-found.sizes).tolist(), first.tolist(), strict=True))
        assert keys == sorted(keys)


@pytest.mark.parametrize(
    ("depth", "n"), [(1, 9), (2, 100), (2, 1500), (3, 3000), (3, 60000), (4, 40000)]
)
def test_components_of_random_volumes_are_scipys(depth, n):
    """Thin and thick volumes of depths 1 to 4, every level of them."""
    rng = np.random.default_rng(n)
    cells = np.unique(rng.integers(0, 4**depth, (n, 3)), axis=0)
    volume = making.volume_of(list(map(tuple, cells.tolist())), depth, metadata=False)
    for level in range(1, depth + 1):
        hold_against_scipy(volume, level)


def test_a_snake_through_many_blocks_is_one_component():
    """Parts of one block that only hang together elsewhere are united by way of the others."""
    combs = [(x, y, 2 * z) for z in range(8) for y in (0, 15) for x in range(16)]
    combs += [(0, y, 2 * z) for z in range(8) for y in range(16)]
    joined = combs + [(15, 15, z) for z in range(16)]
    for cells, n in ((combs, 8), (joined, 1)):
        volume = making.volume_of(sorted(set(cells)), 2, metadata=False)
        for connectivity in (6, 26):
            assert len(volume.components(connectivity)) == n


@pytest.mark.parametrize("step", naive.DIRECTIONS)
@pytest.mark.parametrize("depth", [2, 3, 4])
def test_blocks_that_touch_in_each_of_26_directions(step, depth):
    """Two voxels to both sides of the middle of the cube: of one node, or of different ones."""
    middle = 4**depth // 2
    here = tuple(middle if d < 0 else middle - 1 for d in step)
    cells = [here, tuple(k + d for k, d in zip(here, step, strict=True))]
    volume = making.volume_of(cells, depth, metadata=False)
    assert len(volume.components(26)) == 1
    assert len(volume.components(6)) == (1 if sum(map(abs, step)) == 1 else 2)


def test_opposite_faces_of_the_cube_are_not_neighbours():
    """Nothing wraps round: cells at both ends of each axis are components of their own."""
    ends = [(0, 5, 5), (15, 5, 5), (5, 0, 5), (5, 15, 5), (5, 5, 0), (5, 5, 15)]
    volume = making.volume_of(ends, 2, metadata=False)
    assert len(volume.components(26)) == 6


def test_full_single_empty_and_checkerboard():
    """The extremes: one component of all, one of one, none, and as many as can be."""
    grid = list(itertools.product(range(16), repeat=3))
    full = making.volume_of(grid, 2, metadata=False).components(6)
    assert (full.sizes.tolist(), full.boxes.tolist()) == ([4096], [[0, 0, 0, 15, 15, 15]])
    single = making.volume_of([(3, 9, 12)], 2, metadata=False).components()
    assert (single.sizes.tolist(), single.boxes.tolist()) == ([1], [[3, 9, 12, 3, 9, 12]])
    for levels in (1, 3):
        words = (np.zeros(1, np.uint64), *[np.zeros(0, np.uint64)] * (levels - 1))
        empty = Volume(words, None, making.CUBE).components()
        assert (len(empty), empty.labels.shape, empty.bounds.shape) == (0, (0,), (0, 6))
        assert empty.rows() == []
    board = making.volume_of([c for c in grid if sum(c) % 2], 2, metadata=False)
    assert len(board.components(6)) == 2048
    assert board.components(6).labels.tolist() == list(range(2048))
    assert len(board.components(26)) == 1


def test_large_and_small_components_are_in_one_order():
    """Sizes on both sides of the one from which on they are sorted, equal ones by first voxel."""
    bars = {}
    for row, length in enumerate([3, 1023, 1024, 1, 1025, 1024, 1023, 3]):
        bars[row] = [(k % 64, 4 * row, k // 64) for k in range(length)]
    cells = [cell for bar in bars.values() for cell in bar]
    volume = making.volume_of(cells, 3, metadata=False)
    hold_against_scipy(volume)
    sizes = [1025, 1024, 1024, 1023, 1023, 3, 3, 1]
    found = volume.components(6)
    assert found.sizes.tolist() == sizes
    assert found.boxes[:, 1].tolist() == [4 * row for row in (4, 2, 5, 1, 6, 0, 7, 3)]


def test_a_long_way_inside_a_block_is_one_part():
    """A way through a block longer than the steps that all blocks are flooded."""
    way = [(x, 0, 0) for x in range(4)] + [(3, 1, 0), (3, 2, 0), (2, 2, 0), (1, 2, 0), (0, 2, 0)]
    way += [(0, 3, 0), (0, 3, 1), (0, 3, 2), (1, 3, 2), (2, 3, 2), (3, 3, 2), (3, 2, 2), (3, 1, 2)]
    volume = making.volume_of([*way, (1, 1, 3)], 1, metadata=False)
    assert volume.components(6).sizes.tolist() == [len(way), 1]
    hold_against_scipy(volume)


@pytest.mark.parametrize("is_26", [False, True])
def test_meetings_are_all_pairs_of_blocks_around_a_node(is_26):
    """Each cell and direction once; what touches across the side, forth and back."""
    directions = np.concatenate([adjacent.FACES, adjacent.NOT_FACES])
    starts, nodes, ways = adjacent.meetings(directions, is_26)
    pairs = 0
    for at, direction in enumerate(directions.tolist()):
        step = np.array([direction % 3 - 1, direction // 3 % 3 - 1, direction // 9 - 1])
        for k in range(starts[at], starts[at + 1]):
            around = np.array([nodes[k] % 3 - 1, nodes[k] // 3 % 3 - 1, nodes[k] // 9 - 1])
            for bit in range(64):
                flag = np.uint64(1 << bit)
                cell = np.array([bit & 3, bit >> 2 & 3, bit >> 4])
                there = cell + step - 4 * around
                if ways[k, adjacent.CELLS] & flag:
                    pairs += 1
                    to = adjacent.moved(flag, ways[k, adjacent.UP], ways[k, adjacent.DOWN])
                    assert to == 1 << int(there @ [1, 4, 16])
                expected = sum(
                    1 << other
                    for other in range(64)
                    for away in [
                        np.array([other & 3, other >> 2 & 3, other >> 4]) + 4 * step - cell
                    ]
                    if abs(away).max() == 1 and (is_26 or abs(away).sum() == 1)
                )
                if is_26 or direction in adjacent.FACES:
                    assert adjacent.touched(flag, ways, k) == expected
                    opposite = directions.tolist().index(26 - direction)
                    back = adjacent.touching(flag, ways, starts[opposite])
                    assert back == expected
    assert pairs == 64 * 26


@settings(max_examples=25, deadline=None)
@given(
    cells=st.sets(st.tuples(*[st.integers(0, 15)] * 3), min_size=1, max_size=120),
    connectivity=st.sampled_from([6, 26]),
)
def test_components_are_those_of_a_flood_cell_by_cell(cells, connectivity):
    """Sizes, order and labels of the plain twin."""
    volume = making.volume_of(cells, 2, metadata=False)
    voxels = [tuple(row) for row in volume.voxels().tolist()]
    expected = sorted(naive.components(voxels, connectivity), key=len, reverse=True)
    found = volume.components(connectivity)
    assert found.sizes.tolist() == [len(part) for part in expected]
    for voxel, label in zip(voxels, found.labels.tolist(), strict=True):
        assert voxel in expected[label]


def test_bounds_are_in_units_of_the_crs():
    """z in the vertical unit; a toolkit volume's cells reach half a step about their places."""
    volume = making.volume_of([(0, 0, 0), (1, 1, 1), (15, 15, 15)], 2)
    found = volume.components()
    x, y, z = volume.cube.origin
    cell, ratio = volume.cell(), float(volume.crs.z_ratio)
    top = [x + 2 * cell, y + 2 * cell, (z + 2 * cell) / ratio]
    np.testing.assert_allclose(found.bounds[0], [x, y, z / ratio, *top], rtol=1e-12)
    assert found.volumes.tolist() == [2 * cell**3, cell**3]
    assert [row["rank"] for row in found.rows()] == [1, 2]
    assert found.rows(1)[0]["voxels"] == 2
    toolkit = making.volume_of(
        [(15, 0, 0)], 2, cube=Cube((0.0, 0.0, 0.0), 30.0), info=VolumeInfo(quantizer="toolkit")
    )
    assert toolkit.components().bounds.tolist() == [[29.0, -1.0, -1.0, 31.0, 1.0, 1.0]]
    assert toolkit.components(level=1).bounds.tolist() == [[23.0, -1.0, -1.0, 31.0, 7.0, 7.0]]


def test_what_is_not_there_is_refused():
    """Other connectivities, and levels beyond the volume's."""
    volume = making.random_volume(2, 20)
    with pytest.raises(OptionError, match="6 or 26, not 18"):
        volume.components(18)
    with pytest.raises(OptionError, match="levels 1 to 2"):
        volume.components(level=3)


@pytest.mark.parametrize("name", ["laserchicken-AHN3.laz", "pyfor-osbs-test.laz"])
def test_components_of_real_tiles_are_scipys(shared, name, tmp_path):
    """Levels 1 to 4 of tiles of trees, ground and roofs."""
    report = vt.convert(shared / "tiles" / name, tmp_path, depth=4, dem=False)
    volume = vt.open(next(path for path in report.paths if ".vol" in path.name))
    for level in (2, 4):
        hold_against_scipy(volume, level)
