"""Volumes as binvox grids: the same voxels in the same places, read by us and by trimesh."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
import pytest
from making_volumes import CUBE, INFO, random_volume, volume_of

import volatool as vt
from volatool.cube import Cube
from volatool.errors import OptionError, ResourceError
from volatool.formats.binvox import parse_binvox
from volatool.model import Bounds
from volatool.vola.volume import VolumeInfo
from volatool.vola.window import half_open


def exported(volume, folder, **options):
    done = vt.export_volume(volume, folder / "out.binvox", overwrite=True, **options)
    return parse_binvox(done.paths[0].read_bytes()), done.warnings


def places(xyz):
    """Rows in one order, whatever the order was, to a millionth."""
    return sorted(map(tuple, np.round(xyz, 6).tolist()))


def world(volume):
    """Middles of the cells, z in the horizontal unit as cubes have it."""
    return volume.centers() * [1, 1, float(volume.crs.z_ratio)]


@pytest.mark.parametrize("depth", [1, 2, 3, 5])
def test_the_whole_cube_is_written(depth, tmp_path):
    volume = random_volume(depth)
    grid, _ = exported(volume, tmp_path)
    assert grid.shape == (4**depth,) * 3
    assert grid.translate == volume.cube.origin
    assert grid.scale == volume.cube.side
    assert set(map(tuple, grid.cells().tolist())) == set(map(tuple, volume.voxels().tolist()))
    assert places(grid.centers()) == places(world(volume))


def test_the_voxels_of_a_real_volume_come_back(real, tmp_path):
    grid, _ = exported(real, tmp_path)
    x, y, z = real.voxels().T
    ordered = real.voxels()[np.lexsort((y, z, x))]  # as binvox has them, y fastest
    np.testing.assert_array_equal(grid.cells(), ordered)
    assert grid.translate == real.cube.origin


def test_a_part_is_a_window_in_its_own_place(tmp_path):
    volume = random_volume(3, 2000)
    x, y, _ = CUBE.origin
    bounds = Bounds(x + 2.0, y + 4.0, x + 5.0, y + 9.0)
    grid, _ = exported(volume, tmp_path, bounds=bounds)
    side = grid.shape[0]
    assert grid.shape == (side,) * 3
    part = vt.export_volume(volume, tmp_path / "part.vol", bounds=bounds)
    centers = world(vt.open(part.paths[0]))
    assert len(centers) < len(volume)
    assert places(grid.centers()) == places(centers)
    corner = np.array(grid.translate) - CUBE.origin
    assert (corner >= -1e-9).all()
    assert (corner + grid.scale <= CUBE.side + 1e-9).all()
    assert side == 64  # all heights are in it
    low, _ = exported(volume, tmp_path, bounds=bounds, z=(401.0, 402.0))
    assert low.shape[0] < 40


def test_deep_cubes_give_a_window_or_are_refused_with_what_to_do(tmp_path):
    corner = {(4096 + x, 5000, 16000 + z) for x in range(3) for z in (0, 9)}
    volume = volume_of(corner, 7, cube=Cube((0.0, 0.0, 0.0), 1638.4))
    grid, _ = exported(volume, tmp_path)
    assert grid.shape == (10, 10, 10)
    np.testing.assert_allclose(grid.translate, (409.6, 500.0, 1600.0))
    assert grid.n_cells == 6
    wide = volume_of({(0, 0, 0), (1024, 0, 0)}, 6)
    with pytest.raises(ResourceError, match=r"1025 cells a side.*--level") as caught:
        exported(wide, tmp_path)
    assert caught.value.code == "E_SIZE"
    assert exported(wide, tmp_path, level=5)[0].n_cells == 2


def test_limits_hold_before_and_after_writing(tmp_path):
    volume = random_volume(3, 400)
    size = len((vt.export_volume(volume, tmp_path / "a.binvox").paths[0]).read_bytes())
    exported(volume, tmp_path, limit=size)
    for limit in (size - 1, 100):
        with pytest.raises(ResourceError, match=f"--limit is {limit}"):
            vt.export_volume(volume, tmp_path / "b.binvox", limit=limit)
    assert not (tmp_path / "b.binvox").exists()


def test_local_coordinates_begin_at_the_cube(tmp_path):
    grid, (warning,) = exported(random_volume(2), tmp_path, local=True)
    assert grid.translate == (0.0, 0.0, 0.0)
    assert warning.code == "W_SHIFTED"
    assert "add 637000.01, 4850000.5, 400 " in warning.message


def test_what_cannot_be_kept_is_told(tmp_path):
    _, warnings = exported(random_volume(2), tmp_path)
    assert [warning.code for warning in warnings] == ["W_NO_CRS", "W_Z_UNIT"]
    assert "EPSG:2994" in warnings[0].message
    assert "divide z by 1.000002" in warnings[1].message
    assert exported(random_volume(2, info=VolumeInfo()), tmp_path)[1][0].message.startswith(
        "the volume has no CRS"
    )


def test_points_of_the_toolkit_are_middles_of_cells(tmp_path):
    volume = random_volume(2, 30, info=replace(INFO, quantizer="toolkit"))
    grid, _ = exported(volume, tmp_path)
    assert grid.translate == half_open(volume).cube.origin
    assert places(grid.centers()) == places(world(volume))


def test_a_cube_without_extent_is_refused(tmp_path):
    volume = volume_of({(0, 0, 0)}, 1, cube=Cube((1.0, 2.0, 3.0), 0.0))
    with pytest.raises(OptionError, match="no extent"):
        exported(volume, tmp_path)


def test_trimesh_finds_the_same_cells(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    volume = random_volume(3, 700)
    path = vt.export_volume(volume, tmp_path / "a.binvox").paths[0]
    grid = trimesh.exchange.binvox.load_binvox(io.BytesIO(path.read_bytes()))
    expected = sorted(map(tuple, volume.voxels().tolist()))
    assert list(map(tuple, np.argwhere(grid.matrix).tolist())) == expected


def test_the_same_volume_gives_the_same_bytes(tmp_path):
    paths = [
        vt.export_volume(random_volume(3), tmp_path / f"{k}.binvox").paths[0] for k in range(2)
    ]
    assert paths[0].read_bytes() == paths[1].read_bytes()
