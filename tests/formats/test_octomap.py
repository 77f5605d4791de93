"""OctoMap's binary tree: bytes against a naive writer, the real library, and files that are bad."""

from __future__ import annotations

import struct

import naive_octomap as naive
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from volatool.errors import FormatError, OptionError, ResourceError, TruncatedError
from volatool.formats.octomap import HALF, encode_bt, parse_bt

HEADER = b"# Octomap OcTree binary file\nid OcTree\nsize %d\nres 0.5\ndata\n"


def split(data):
    """Size in the header and the bytes after it."""
    head, _, body = data.partition(b"\ndata\n")
    fields = dict(line.split(" ", 1) for line in head.decode().split("\n") if line[0] != "#")
    return int(fields["size"]), body


def ordered(cells):
    return sorted(map(tuple, np.asarray(cells).tolist()))


def file_of(*nodes, size):
    return HEADER % size + struct.pack(f"<{len(nodes)}H", *nodes)


cell_sets = st.lists(st.tuples(*[st.integers(-4, 3)] * 3), max_size=60)


@given(cell_sets, st.booleans(), st.booleans())
@settings(max_examples=40, deadline=None)
def test_bytes_are_those_of_the_naive_writer(cells, has_block, is_free):
    """With repeats, with a block that is pruned, with the rest of a cube free or unknown."""
    if has_block:
        cells = cells + [(x, y, z) for x in range(-4, 0) for y in range(4) for z in range(2)]
    # eight voxels a side about 0 are no node: the cube is that of the octant with the key 0
    shifted = [tuple(v + 4 - HALF for v in cell) for cell in cells]
    free = ((-HALF,) * 3, 8) if is_free else None
    size, body = split(encode_bt(np.array(shifted).reshape(-1, 3), 0.25, free_cube=free))
    keys = {tuple(v + 4 for v in cell) for cell in cells}
    assert (size, body) == naive.body(keys, free=((0, 0, 0), 8) if is_free else None)


@given(cell_sets)
@settings(max_examples=40, deadline=None)
def test_what_was_written_is_read(cells):
    data = encode_bt(np.array(cells).reshape(-1, 3), 0.1, comments=["one", "volatool {}"])
    tree = parse_bt(data)
    assert ordered(tree.cells()) == sorted(set(cells))
    assert tree.n_cells == len(set(cells))
    assert tree.resolution == 0.1
    assert tree.comments == ("one", "volatool {}")
    assert len(tree.free) == 0


def test_leaves_are_those_of_the_naive_reader():
    rng = np.random.default_rng(1)
    cells = np.vstack([rng.integers(-20, 20, (300, 3)), np.argwhere(np.ones((8, 8, 8)))])
    cube = ((-32, -32, -32), 32)
    inside = (cells < 0).all(axis=1) & (cells >= -32).all(axis=1)
    data = encode_bt(cells[inside], 1.0, free_cube=cube)
    occupied, free = naive.leaves(split(data)[1])
    tree = parse_bt(data)
    for found, expected in ((tree.occupied, occupied), (tree.free, free)):
        keys = found + np.array([HALF, HALF, HALF, 0])
        assert ordered(keys) == sorted(expected)
    # free and occupied fill the cube, no voxel twice
    edges = np.vstack([tree.occupied, tree.free])[:, 3].astype(int)
    assert (edges**3).sum() == 32**3


def test_a_full_block_is_one_leaf_and_the_size_counts_it():
    """All of an aligned 4 x 4 x 4: the way down from the root, and one leaf."""
    cells = np.argwhere(np.ones((4, 4, 4)))
    size, body = split(encode_bt(cells, 1.0))
    assert size == 14 + 1
    assert len(body) == 2 * 14
    tree = parse_bt(encode_bt(cells, 1.0))
    assert tree.occupied.tolist() == [[0, 0, 0, 4]]
    np.testing.assert_array_equal(np.unique(tree.cells(), axis=0), np.unique(cells, axis=0))
    assert tree.centers().min() == 0.5


def test_no_voxels_are_a_tree_without_nodes():
    data = encode_bt(np.empty((0, 3)), 1.0)
    assert split(data) == (0, b"")
    assert parse_bt(data).n_cells == 0
    freed = parse_bt(encode_bt(np.empty((0, 3)), 1.0, free_cube=((0, 0, 0), 64)))
    assert freed.free.tolist() == [[0, 0, 0, 64]]


@pytest.mark.parametrize("corner", [-HALF, HALF - 1])
def test_the_corners_of_the_space_are_kept(corner):
    tree = parse_bt(encode_bt([[corner] * 3], 2.0))
    assert tree.cells().tolist() == [[corner] * 3]


@pytest.mark.parametrize("outside", [-HALF - 1, HALF])
def test_voxels_outside_the_space_are_refused(outside):
    with pytest.raises(ResourceError, match="65536 voxels an axis") as caught:
        encode_bt([[0, outside, 0]], 1.0)
    assert caught.value.code == "E_SIZE"


@pytest.mark.parametrize("resolution", [0.0, -1.0, float("nan"), float("inf")])
def test_voxels_without_an_edge_are_refused(resolution):
    with pytest.raises(OptionError, match="with an edge"):
        encode_bt([[0, 0, 0]], resolution)


@pytest.mark.parametrize(
    ("cube", "message"),
    [
        (((0, 0, 0), 3), "power of 2"),
        (((1, 0, 0), 2), "aligned"),
        (((HALF, 0, 0), 2), "does not fit"),
        (((64, 0, 0), 64), "outside the cube"),
    ],
)
def test_a_free_cube_that_is_no_node_is_refused(cube, message):
    with pytest.raises(OptionError, match=message):
        encode_bt([[0, 0, 0]], 1.0, free_cube=cube)


def test_a_comment_of_two_lines_is_refused():
    with pytest.raises(OptionError, match="one line"):
        encode_bt([[0, 0, 0]], 1.0, comments=["a\nid OcTree"])


GOOD = encode_bt(np.random.default_rng(5).integers(-9, 9, (50, 3)), 0.5, comments=["x"])


@pytest.mark.parametrize("length", [*range(0, len(GOOD), 23), len(GOOD) - 1, len(GOOD) - 2])
def test_every_cut_is_noticed(length):
    with pytest.raises(FormatError) as caught:
        parse_bt(GOOD[:length])
    assert caught.value.code in ("E_NOT_OCTOMAP", "E_TRUNCATED")
    assert "offset" in str(caught.value)
    if length > 40:
        assert isinstance(caught.value, TruncatedError)


@pytest.mark.parametrize(
    ("data", "code", "message"),
    [
        (b"", "E_NOT_OCTOMAP", "empty"),
        (b"LASF" + bytes(300), "E_NOT_OCTOMAP", "found b'LASF"),
        (b"# Octomap OcTree file\nid OcTree\n", "E_NOT_OCTOMAP", r"\.ot"),
        (GOOD.replace(b"id OcTree", b"id ColorOcTree"), "E_NOT_OCTOMAP", "ColorOcTree"),
        (GOOD.replace(b"res 0.5", b"res nan"), "E_CORRUPT", "resolution is 'nan'"),
        (GOOD.replace(b"res 0.5", b"res -1"), "E_CORRUPT", "resolution is '-1'"),
        (GOOD.replace(b"res 0.5", b"rex 0.5"), "E_CORRUPT", "found 'rex 0.5' .offset"),
        (GOOD.replace(b"size ", b"size 9"), "E_CORRUPT", "the tree has"),
        (GOOD.replace(b"size ", b"size -"), "E_CORRUPT", "number of nodes is '-"),
        (GOOD + b"more", "E_CORRUPT", "4 bytes follow the tree"),
        (file_of(*[3] * 17, size=17), "E_CORRUPT", "below level 16"),
        (file_of(3, 0, size=2), "E_CORRUPT", "has none .offset 61"),
        (file_of(*[0xFFFF] * 90, size=91), "E_CORRUPT", "below level 16"),
        (file_of(*[0xFFFF] * 9, size=91), "E_TRUNCATED", "inside its tree"),
        (HEADER % 3, "E_TRUNCATED", "should begin"),
        (b"# Octomap OcTree binary file\n" + b"#" * (3 << 20), "E_TRUNCATED", "'data'"),
    ],
)
def test_bad_files_are_refused_with_a_reason(data, code, message):
    with pytest.raises(FormatError, match=message) as caught:
        parse_bt(data)
    assert caught.value.code == code


@given(st.binary(max_size=200))
@settings(max_examples=200, deadline=None)
def test_any_bytes_are_read_or_refused(noise):
    """Never another exception, never a hang."""
    for size in (3, 40):
        try:
            tree = parse_bt(HEADER % size + noise)
        except FormatError:
            continue
        assert len(tree.occupied) + len(tree.free) < size


def test_a_few_bytes_that_stand_for_a_universe_are_not_expanded():
    """One leaf of the first level: 32768 voxels a side."""
    tree = parse_bt(file_of(2, size=2))
    assert tree.occupied.tolist() == [[-HALF, -HALF, -HALF, HALF]]
    assert tree.n_cells == HALF**3
    with pytest.raises(ResourceError, match="35184372088832 voxels") as caught:
        tree.cells()
    assert caught.value.code == "E_SIZE"
    with pytest.raises(ResourceError):
        parse_bt(file_of(0, size=1)).cells()


def library_tree(data, path):
    pyoctomap = pytest.importorskip("pyoctomap")
    path.write_bytes(data)
    tree = pyoctomap.OcTree(1.0)
    assert tree.readBinary(str(path))  # False when the number of nodes is not `size`
    return tree


@pytest.mark.parametrize("is_free", [False, True])
def test_the_library_reads_what_we_write(tmp_path, is_free):
    """Same leaves, same size, and its own writer gives our bytes back."""
    rng = np.random.default_rng(3)
    cells = np.vstack([rng.integers(0, 64, (2000, 3)), np.argwhere(np.ones((16, 16, 16)))])
    cube = ((0, 0, 0), 64) if is_free else None
    data = encode_bt(cells, 0.05, comments=['volatool {"a":1}'], free_cube=cube)
    tree = library_tree(data, tmp_path / "ours.bt")
    assert tree.size() == split(data)[0]
    assert tree.getResolution() == 0.05
    assert split(tree.writeBinary()) == split(data)


def test_we_read_what_the_library_writes(tmp_path):
    """Rays from a sensor: occupied, free and pruned leaves."""
    pyoctomap = pytest.importorskip("pyoctomap")
    tree = pyoctomap.OcTree(0.1)
    rng = np.random.default_rng(2)
    tree.insertPointCloud(rng.normal(0, 3, (500, 3)), np.zeros(3), -1.0, True)
    tree.updateNodes(np.argwhere(np.ones((8, 8, 8))) * 0.1 - 4.75, True)
    ours = parse_bt(tree.writeBinary())
    expected = {True: [], False: []}
    for leaf in tree.begin_leafs():
        half = leaf.getSize() / 2
        corner = np.rint((np.array(leaf.getCoordinate()) - half) / 0.1).astype(int)
        edge = round(leaf.getSize() / 0.1)
        expected[bool(tree.isNodeOccupied(leaf))].append((*corner.tolist(), edge))
    assert max(leaf[3] for leaf in expected[True]) > 1
    assert len(expected[False]) > 1000
    assert ordered(ours.occupied) == sorted(expected[True])
    assert ordered(ours.free) == sorted(expected[False])
