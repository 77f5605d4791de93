"""binvox and OctoMap: the exact cube of the header or the comment, its voxels and no others."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from making_imports import opened, points_of

import volatool as vt
from volatool.errors import FormatError, ResourceError, TruncatedError
from volatool.formats.binvox import encode_binvox
from volatool.formats.octomap import encode_bt

CELLS = np.array([[0, 0, 0], [1, 2, 3], [15, 14, 0], [7, 7, 7]])


def voxels(path, **options):
    report = vt.import_points(path, path.parent / "out", overwrite=True, dense="never", **options)
    volume = vt.open(report.paths[0])
    return volume, sorted(map(tuple, volume.voxels().tolist()))


def test_a_binvox_grid_keeps_its_cube(tmp_path):
    """Of 16 cells a side: depth 2, whatever part of the grid is filled."""
    data = encode_binvox(CELLS[1:], 16, (5.0, -3.0, 0.1), 8.0)
    (tmp_path / "a.binvox").write_bytes(data)
    volume, found = voxels(tmp_path / "a.binvox")
    assert (volume.depth, volume.cube.origin, volume.cube.side) == (2, (5.0, -3.0, 0.1), 8.0)
    assert found == sorted(map(tuple, CELLS[1:].tolist()))
    assert voxels(tmp_path / "a.binvox", depth=1)[0].depth == 1
    assert voxels(tmp_path / "a.binvox", cube="100")[0].cube.side == 100.0


def test_a_grid_of_other_sides_gets_the_next_cube(tmp_path):
    data = encode_binvox(np.array([[9, 4, 1]]), 10, (0.0, 0.0, 0.0), 1.0)
    (tmp_path / "a.binvox").write_bytes(data)
    volume, found = voxels(tmp_path / "a.binvox")
    assert found == [(9, 4, 1)]
    assert volume.cube.exact[3] == Fraction(16, 10)


def test_y_up_grids_are_turned_with_their_cube(tmp_path):
    data = encode_binvox(CELLS, 16, (5.0, -3.0, 0.1), 8.0)
    (tmp_path / "a.binvox").write_bytes(data)
    volume, found = voxels(tmp_path / "a.binvox", swap_yz=True)
    assert volume.cube.origin == (5.0, 0.1, -3.0)
    assert found == sorted(map(tuple, CELLS[:, [0, 2, 1]].tolist()))


def test_a_foreign_octomap_gets_a_cube_at_its_lowest_voxel(tmp_path):
    (tmp_path / "a.bt").write_bytes(encode_bt(CELLS - 5, 0.05))
    volume, found = voxels(tmp_path / "a.bt")
    assert (volume.depth, volume.cube.origin, volume.cube.side) == (2, (-0.25,) * 3, 0.8)
    assert found == sorted(map(tuple, CELLS.tolist()))


def test_pruned_leaves_are_filled(tmp_path):
    cells = np.argwhere(np.ones((4, 4, 4)))
    (tmp_path / "a.bt").write_bytes(encode_bt(cells, 1.0))
    assert len(voxels(tmp_path / "a.bt")[1]) == 64


def test_our_own_octomap_keeps_cube_depth_and_crs(tmp_path, small_volume):
    volume, data = small_volume
    (tmp_path / "a.bt").write_bytes(data)
    found, cells = voxels(tmp_path / "a.bt")
    assert (found.cube, found.depth) == (volume.cube, volume.depth)
    assert cells == sorted(map(tuple, volume.voxels().tolist()))
    assert (found.crs.wkt2, found.crs.z_ratio) == (volume.crs.wkt2, volume.crs.z_ratio)


@pytest.fixture(scope="module")
def small_volume(tmp_path_factory):
    """A volume with heights in feet over metres, and its OctoMap."""
    from volatool.export.api import export_volume

    folder = tmp_path_factory.mktemp("volume")
    rng = np.random.default_rng(2)
    low = np.array([5e5, 4e6, 30.0])
    low = np.array([5e5, 4e6, 30.0])
    np.savetxt(folder / "a.xyz", np.round(low + rng.uniform(0, 90, (300, 3)), 2))
    report = vt.import_points(folder / "a.xyz", folder, depth=3, crs="EPSG:26910+6360")
    volume = vt.open(report.paths[0])
    assert volume.crs.z_ratio != 1
    target = folder / "a.bt"
    export_volume(volume, target)
    return volume, target.read_bytes()


def test_damaged_grids_are_refused(tmp_path, small_volume):
    data = encode_binvox(CELLS, 16, (0.0, 0.0, 0.0), 8.0)
    (tmp_path / "a.binvox").write_bytes(data[:-2])
    with pytest.raises(FormatError, match=r"a\.binvox: "):
        opened(tmp_path / "a.binvox")
    (tmp_path / "a.binvox").write_bytes(data.replace(b"dim 16", b"dim 99999999"))
    with pytest.raises((FormatError, ResourceError)):
        opened(tmp_path / "a.binvox")
    (tmp_path / "a.bt").write_bytes(small_volume[1][:-2])
    with pytest.raises(TruncatedError, match=r"a\.bt: the file ends inside its tree"):
        opened(tmp_path / "a.bt")
    (tmp_path / "a.bt").write_bytes(small_volume[1].replace(b'"depth":3', b'"depth":1'))
    with pytest.raises(FormatError, match="outside the cube that its comment names"):
        opened(tmp_path / "a.bt")


def test_a_huge_leaf_is_not_expanded(tmp_path):
    """A root without children stands for 2**48 voxels."""
    (tmp_path / "a.bt").write_bytes(
        b"# Octomap OcTree binary file\nid OcTree\nsize 1\nres 0.1\ndata\n\0\0"
    )
    with pytest.raises(ResourceError, match="voxels"):
        points_of(tmp_path / "a.bt")


def test_a_tree_of_octomap_itself_is_read(tmp_path):
    """An independent writer; free voxels along the rays are no points."""
    pyoctomap = pytest.importorskip("pyoctomap")
    tree = pyoctomap.OcTree(0.5)
    places = (CELLS + 0.5) * 0.5
    for place in places:
        tree.updateNode(place.tolist(), True)
    tree.updateNode([20.0, 20.0, 20.0], False)
    tree.updateInnerOccupancy()
    assert tree.writeBinary(str(tmp_path / "a.bt"))
    xyz, _ = points_of(tmp_path / "a.bt")
    assert sorted(map(tuple, xyz.tolist())) == sorted(map(tuple, places.tolist()))
