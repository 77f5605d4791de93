"""Volumes as OctoMap trees: the real library answers as the volume does, and we read them back."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from making_volumes import CRS, INFO, random_volume, same, volume_of

import volatool as vt
from volatool.cube import Cube
from volatool.errors import OptionError, ResourceError
from volatool.export.placing import shift_of
from volatool.formats.octomap import HALF, parse_bt
from volatool.formats.origin import find_origin
from volatool.vola.build import from_keys
from volatool.vola.volume import VolumeInfo
from volatool.vola.window import half_open

CORNER = (0, 0, 0)
DEEP = (-HALF,) * 3


def exported(volume, folder, **options):
    """Write a volume; return path, tree and origin."""
    path = vt.export_volume(volume, folder / "out.bt", overwrite=True, **options).paths[0]
    tree = parse_bt(path.read_bytes())
    return path, tree, find_origin(tree.comments)


def points_around(volume, n, seed):
    """Points in and around a volume's voxels, in the CRS; half of them near voxels."""
    rng = np.random.default_rng(seed)
    x, y, z = volume.cube.origin
    side, ratio = volume.cube.side, float(volume.crs.z_ratio)
    low, high = np.array([x, y, z]) - side / 9, np.array([x, y, z]) + side * 10 / 9
    anywhere = rng.uniform(low, high, (n - n // 2, 3)) / [1, 1, ratio]
    centers = volume.centers()
    near = centers[rng.integers(0, len(centers), n // 2)]
    near += rng.normal(0, volume.cell(), near.shape) / [1, 1, ratio]
    return np.vstack([anywhere, near])


def library_says(path, local):
    """Occupancy of points by the OctoMap library, one by one."""
    pyoctomap = pytest.importorskip("pyoctomap", reason="the extra octomap is not installed")
    tree = pyoctomap.OcTree(1.0)
    assert tree.readBinary(str(path))  # False when the header's size is not that of the tree
    nodes = map(tree.search, local)
    return np.array([node is not None and tree.isNodeOccupied(node) for node in nodes])


def agreement(volume, folder, n=100_000, corner=CORNER, **options):
    """Ask both; return the answers of the volume, which are those of the library."""
    points = points_around(volume, n, n)
    path, _, _ = exported(volume, folder, **options)
    local = points * [1, 1, float(volume.crs.z_ratio)]
    local = local - shift_of(half_open(volume), corner)
    # around points that were rounded to, the outermost cells reach half a cell out of the cube
    ours = half_open(volume).contains(points)
    inside = (volume.cell_indices(points) >= 0).all(axis=1)
    np.testing.assert_array_equal(ours[inside], volume.contains(points)[inside])
    np.testing.assert_array_equal(library_says(path, local), ours)
    return ours


def test_the_library_answers_as_a_random_volume_does(tmp_path):
    """100,000 points; heights in another unit than x and y; with blocks that are pruned."""
    rng = np.random.default_rng(0)
    voxels = {tuple(map(int, row)) for row in rng.integers(0, 64, (3000, 3))}
    voxels |= {tuple(map(int, row)) for row in np.argwhere(np.ones((32, 16, 16)))}
    volume = volume_of(voxels, 3, cube=Cube((637000.0, 4850000.0, 400.0), 100.0))
    assert volume.crs.z_ratio != 1
    ours = agreement(volume, tmp_path)
    assert 10_000 < ours.sum() < 90_000


def test_the_library_answers_as_a_real_volume_does(real, tmp_path):
    """100,000 points on each of two real tiles."""
    ours = agreement(real, tmp_path)
    assert 1000 < ours.sum() < 90_000


@pytest.mark.parametrize(
    "volume",
    [
        random_volume(2, 30, info=replace(INFO, quantizer="toolkit")),
        random_volume(2, 30, info=replace(INFO, quantizer="unknown")),
        random_volume(1, 9),
        random_volume(7, 500),
    ],
    ids=["toolkit", "unknown", "depth 1", "depth 7"],
)
def test_the_library_answers_as_other_volumes_do(volume, tmp_path):
    agreement(volume, tmp_path, 2000)


def test_level_8_is_put_around_zero(tmp_path):
    volume = random_volume(8, 500)
    agreement(volume, tmp_path, 2000, DEEP)
    _, tree, origin = exported(volume, tmp_path)
    assert origin.corner == DEEP
    assert tree.occupied[:, :3].min() < 0


def test_deeper_levels_are_refused_with_what_to_do(tmp_path):
    volume = random_volume(9, 20)
    with pytest.raises(ResourceError, match="give --level 8") as caught:
        vt.export_volume(volume, tmp_path / "a.bt")
    assert caught.value.code == "E_SIZE"
    assert not (tmp_path / "a.bt").exists()
    assert vt.export_volume(volume, tmp_path / "a.bt", level=8).n_voxels <= 20


def restored(tree, origin):
    """Return the volume that a tree and its comment describe."""
    cells = (tree.cells() - np.array(origin.corner)).astype(np.int64)
    keys = np.zeros(len(cells), np.uint64)
    for level in range(origin.depth):
        shift = 2 * (origin.depth - 1 - level)
        digit = (cells >> shift & 3) @ [1, 4, 16]
        keys = keys << np.uint64(6) | digit.astype(np.uint64)
    return from_keys(keys, origin.depth, origin.cube, origin.info)


@pytest.mark.parametrize("depth", [1, 3, 5, 8])
def test_what_is_read_back_is_the_same_volume(depth, tmp_path):
    """Voxels, the cube to the last digit, CRS and units."""
    volume = random_volume(depth)
    again = restored(*exported(volume, tmp_path)[1:])
    assert same(volume, again, metadata=False)
    assert again.info.crs == volume.info.crs
    assert again.info.box == volume.info.box


def test_what_is_read_back_of_a_real_volume_is_the_same(real, tmp_path):
    again = restored(*exported(real, tmp_path)[1:])
    assert same(real, again, metadata=False)
    assert again.crs == real.crs


def test_volumes_of_the_toolkit_come_back_as_cells_around_its_points(tmp_path):
    volume = random_volume(2, 30, info=replace(INFO, quantizer="toolkit"))
    again = restored(*exported(volume, tmp_path)[1:])
    assert again.info.quantizer == "floor"
    np.testing.assert_allclose(again.centers(), volume.centers(), rtol=0, atol=1e-9)


def test_the_rest_of_the_cube_is_free_when_asked_for(tmp_path):
    volume = random_volume(3, 400)
    path, tree, _ = exported(volume, tmp_path, free=True)
    edges = np.vstack([tree.occupied, tree.free])[:, 3].astype(int)
    assert (edges**3).sum() == 64**3
    pyoctomap = pytest.importorskip("pyoctomap")
    library = pyoctomap.OcTree(1.0)
    assert library.readBinary(str(path))
    inside = np.random.default_rng(1).uniform(0, volume.cube.side, (500, 3))
    assert None not in map(library.search, inside)
    assert library.search(np.array([-0.1, 1.0, 1.0])) is None
    assert b"taken to be free" in path.read_bytes()


def snapped(x, y, z, side, depth=2):
    info = VolumeInfo(crs=replace(CRS, metres_per_unit_z=CRS.metres_per_unit_xy))
    cube = Cube((x, y, z), side, is_snapped=True)
    return random_volume(depth, 40, cube=cube, info=info)


def test_coordinates_of_the_crs_are_kept_where_the_cube_lies_on_the_grid(tmp_path):
    volume = snapped(-32.0, 16.0, 480.0, 16.0)
    done = vt.export_volume(volume, tmp_path / "w.bt", local=False)
    assert done.warnings == ()
    tree = parse_bt(done.paths[0].read_bytes())
    order = np.lexsort(tree.centers().T)
    mine = volume.centers()
    np.testing.assert_array_equal(tree.centers()[order], mine[np.lexsort(mine.T)])
    assert find_origin(tree.comments).corner == (-32, 16, 480)


@pytest.mark.parametrize(
    ("volume", "message"),
    [
        (snapped(0.5, 0.0, 0.0, 16.0), "not on a multiple of its cells"),
        (snapped(40000.0, 0.0, 0.0, 16.0), "40000 cells from 0.*coarser"),
    ],
)
def test_other_cubes_are_not_put_in_coordinates_of_the_crs(volume, message, tmp_path):
    with pytest.raises(OptionError, match=message) as caught:
        vt.export_volume(volume, tmp_path / "w.bt", local=False)
    assert caught.value.code == "E_CUBE"


def test_a_cube_without_extent_has_no_voxels_for_octomap(tmp_path):
    volume = volume_of({(0, 0, 0)}, 1, cube=Cube((1.0, 2.0, 3.0), 0.0))
    with pytest.raises(OptionError, match="no extent") as caught:
        vt.export_volume(volume, tmp_path / "w.bt")
    assert caught.value.code == "E_CUBE"


def test_the_shift_is_told_and_written(tmp_path):
    volume = random_volume(3)
    done = vt.export_volume(volume, tmp_path / "a.bt")
    (warning,) = done.warnings
    assert warning.code == "W_SHIFTED"
    assert "add 637000.01, 4850000.5, 400 for those of EPSG:2994" in warning.message
    assert "divide z by 1.000002" in warning.message
    text = done.paths[0].read_bytes().partition(b"\ndata\n")[0].decode("ascii")
    assert "# coordinates of EPSG:2994: add 637000.01 4850000.5 400.0" in text
    assert "is unknown" in text


def test_the_same_volume_gives_the_same_bytes(tmp_path):
    first = exported(random_volume(3), tmp_path)[0].read_bytes()
    assert exported(random_volume(3), tmp_path)[0].read_bytes() == first


def test_the_exact_cube_is_kept(tmp_path):
    cube = Cube.from_exact([Fraction(1, 3), Fraction(2, 7), Fraction(0)], Fraction(22, 7))
    _, _, origin = exported(random_volume(2, 20, cube=cube), tmp_path)
    assert origin.cube.exact == cube.exact
