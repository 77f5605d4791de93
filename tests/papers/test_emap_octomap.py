"""The baseline read from the real OctoMap library."""

from __future__ import annotations

import numpy as np
import pytest

from volatool.errors import OptionError
from volatool.kernels import octree
from volatool.papers import emap_octomap
from volatool.papers.emap_octomap import OctoMapTop
from volatool.papers.emap_scene import Drive, Nodes, scans


@pytest.fixture(scope="module")
def built():
    """Map of some scans, with the scans."""
    pytest.importorskip("pyoctomap")
    drive = Drive(duration_s=3)
    top, all_scans = OctoMapTop(0.1), list(scans(drive, 2))
    for scan in all_scans:
        top.update(scan.sensor, scan.points)
    return top, all_scans


def test_topmost_voxels_are_those_that_the_library_finds(built):
    """Against the library's own leaves, one by one."""
    top, _ = built
    places, heights = top.columns((5.01, 5.01, 7.99, 7.99))
    expected = {}
    tree = top.tree
    for leaf in tree.begin_leafs_bbx(np.array([5.0, 5, -3]), np.array([8.0, 8, 3])):
        if tree.isNodeOccupied(leaf):
            (x, y, z), half = leaf.getCoordinate(), leaf.getSize() / 2 - 0.05
            n = round(half / 0.05) + 1
            for dx in np.linspace(-half, half, n):
                for dy in np.linspace(-half, half, n):
                    key = (round((x + dx) / 0.1 - 0.5), round((y + dy) / 0.1 - 0.5))
                    expected[key] = max(expected.get(key, -9), z + half)
    found = {
        (round(x / 0.1 - 0.5), round(y / 0.1 - 0.5)): h
        for (x, y), h in zip(places, heights, strict=True)
    }
    expected = {key: h for key, h in expected.items() if 50 <= min(key) <= max(key) < 80}
    assert len(found) > 100
    assert found.keys() == expected.keys()
    assert max(abs(found[key] - expected[key]) for key in found) < 1e-5


def test_lazy_insertion_gives_the_same_surface(built):
    import pyoctomap

    top, all_scans = built
    eager = OctoMapTop(0.1)
    eager.tree = pyoctomap.OcTree(0.1)
    for scan in all_scans:
        eager.tree.insertPointCloud(scan.points, scan.sensor, -1.0, False)
    nodes = Nodes.around(all_scans[-1].sensor)
    np.testing.assert_array_equal(top.heights(nodes, 10.0), eager.heights(nodes, 10.0))


def test_a_node_has_the_height_of_the_nearest_column(built):
    top, all_scans = built
    nodes = Nodes.around(all_scans[-1].sensor)
    z = top.heights(nodes, 10.0)
    places, heights = top.columns((-15, -15, 20, 20))
    x, y = nodes.places()
    for r, q in [(0, 0), (20, 20), (39, 7), (11, 30)]:
        distances = np.hypot(places[:, 0] - x[r, q], places[:, 1] - y[r, q])
        near = heights[distances <= distances.min() + 1e-9]
        assert z[r, q] in near


def test_an_empty_map_has_no_heights():
    pytest.importorskip("pyoctomap")
    top = OctoMapTop(0.1)
    top.update(np.array([0, 0, 2.0]), np.empty((0, 3)))
    assert np.isnan(top.heights(Nodes.around(np.zeros(3)), 1.0)).all()


def test_pruned_leaves_stand_for_all_their_voxels():
    """Root with two leaves half its size: one occupied below, one free above."""
    value = np.array([1.0, -1.0], "<f4")
    root = value[:1].tobytes() + bytes([0b00010001])
    nodes = np.frombuffer(root + value[:1].tobytes() + b"\0" + value[1:].tobytes() + b"\0", "u1")
    top = np.empty((4, 5), np.int64)
    assert octree.topmost(nodes, 0.0, 3, -1, 2, top) == len(nodes)
    expected = np.full((4, 5), -1)
    expected[:2, 1:] = 3
    np.testing.assert_array_equal(top, expected)


@pytest.mark.parametrize("cut", [0, 4, 9, 14])
def test_a_cut_tree_is_noticed(cut):
    value = np.array([1.0], "<f4").tobytes()
    nodes = np.frombuffer((value + b"\x03" + (value + b"\0") * 2)[:cut], "u1")
    assert octree.topmost(nodes, 0.0, 3, 0, 0, np.empty((2, 2), np.int64)) != 15


def test_without_the_package_the_message_says_what_to_install(monkeypatch):
    monkeypatch.setattr(emap_octomap, "is_available", lambda: False)
    with pytest.raises(OptionError, match=r"volatool\[octomap\]"):
        OctoMapTop()
