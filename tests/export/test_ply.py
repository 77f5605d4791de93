"""Volumes as PLY, read by plyfile: points with metadata, cubes as closed surfaces."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from making_exports import full_volume, quantized, toolkit_volume
from making_volumes import INFO, random_volume, volume_of

import volatool as vt
from volatool.cube import Cube
from volatool.errors import OptionError, ResourceError
from volatool.export.colours import colours_of
from volatool.formats.origin import find_origin
from volatool.vola.volume import VolumeInfo
from volatool.vola.window import half_open

plyfile = pytest.importorskip("plyfile")


def exported(volume, folder, **options):
    done = vt.export_volume(volume, folder / "out.ply", overwrite=True, **options)
    return plyfile.PlyData.read(done.paths[0]), done.warnings


def xyz_of(data):
    vertex = data["vertex"]
    return np.column_stack([vertex[name] for name in "xyz"])


def quads_of(data):
    """Corners of the faces, (m, 4, 3)."""
    return xyz_of(data)[np.stack(data["face"]["vertex_indices"])]


def measures(quads):
    """Area, and volume by the divergence theorem."""
    quads = quads - quads.reshape(-1, 3).min(axis=0)
    normal = np.cross(quads[:, 1] - quads[:, 0], quads[:, 2] - quads[:, 0])
    return np.linalg.norm(normal, axis=1).sum(), (quads[:, 0] * normal).sum() / 3


def n_faces(volume):
    """Faces between a voxel and none, counted in a dense grid."""
    size = 4**volume.depth
    grid = np.zeros((size + 2,) * 3, np.int8)
    grid[tuple(volume.voxels().T + 1)] = 1
    return sum(int(np.abs(np.diff(grid, axis=axis)).sum()) for axis in range(3))


def test_points_are_the_centres_with_what_the_metadata_say(tmp_path):
    volume = full_volume()
    data, warnings = exported(volume, tmp_path)
    assert warnings == ()
    assert data.byte_order == "<"
    vertex = data["vertex"]
    assert [p.name for p in vertex.properties] == [
        *("x", "y", "z", "red", "green", "blue"),
        *("number_of_returns", "intensity", "classification"),
    ]
    assert vertex["x"].dtype == np.float64
    np.testing.assert_allclose(xyz_of(data), volume.centers(), rtol=1e-15)
    words = volume.metadata()
    for byte, name in enumerate(("red", "green", "blue")):
        np.testing.assert_array_equal(vertex[name], words >> np.uint64(8 * byte) & np.uint64(255))
    np.testing.assert_array_equal(vertex["intensity"], np.rint(volume.channel("intensity")))
    np.testing.assert_array_equal(vertex["classification"], volume.channel("class"))
    np.testing.assert_array_equal(vertex["number_of_returns"], np.rint(volume.channel("returns")))


def test_voxels_of_points_come_back_exactly(tmp_path):
    volume = full_volume(4, 2000)
    data, _ = exported(volume, tmp_path)
    np.testing.assert_array_equal(quantized(xyz_of(data), volume), volume.voxels())
    origin = find_origin(data.comments)
    assert origin.cube.exact == volume.cube.exact
    assert (origin.depth, origin.corner) == (volume.depth, (0, 0, 0))
    assert origin.info.crs == volume.info.crs


def test_voxels_of_a_real_volume_come_back(real, tmp_path):
    data, _ = exported(real, tmp_path)
    np.testing.assert_array_equal(real.cell_indices(xyz_of(data)), real.voxels())


def test_local_coordinates_are_single_precision_and_the_shift_is_told(tmp_path):
    volume = full_volume()
    data, (warning,) = exported(volume, tmp_path, local=True)
    assert data["vertex"]["x"].dtype == np.float32
    shift = next(line for line in data.comments if line.startswith("shift "))
    corner = np.array(list(map(float, shift.split()[1:])))
    np.testing.assert_allclose(xyz_of(data) + corner, volume.centers(), atol=1e-6)
    assert warning.code == "W_SHIFTED"
    assert f"{corner[0]:.12g}, {corner[1]:.12g}, {corner[2]:.12g}" in warning.message
    assert "crs EPSG:2994+EPSG:6360" in data.comments


def test_no_line_of_the_header_is_too_long_for_meshlab(tmp_path):
    """It has room for 512 characters, others for 256 or 1024."""
    path = vt.export_volume(full_volume(), tmp_path / "a.ply").paths[0]
    header = path.read_bytes().partition(b"end_header\n")[0]
    assert b"volatool+" in header
    assert max(map(len, header.split(b"\n"))) < 256
    assert header.isascii()


@pytest.mark.parametrize("options", [{}, {"colour": "rgb"}, {"colour": "class"}, {"local": True}])
def test_cubes_have_the_voxels_volume_and_area_and_are_closed(options, tmp_path):
    volume = full_volume(2, 40)
    data, _ = exported(volume, tmp_path, shape="cubes", **options)
    area, content = measures(quads_of(data).astype(np.float64))
    cell, ratio = volume.cell(), float(volume.crs.z_ratio)
    tolerance = 1e-5 if options.get("local") else 1e-8
    assert content == pytest.approx(len(volume) * cell**3 / ratio, rel=tolerance)
    assert area == pytest.approx(n_faces(volume) * cell**2, rel=1e-5)  # z in feet of the survey


def test_cubes_lie_in_the_crs(tmp_path):
    volume = full_volume(3, 100)
    data, warnings = exported(volume, tmp_path, shape="cubes", colour="none")
    assert warnings == ()
    half = volume.cell() / 2 / np.array([1, 1, float(volume.crs.z_ratio)])
    np.testing.assert_allclose(xyz_of(data).min(axis=0), volume.centers().min(axis=0) - half)
    np.testing.assert_allclose(xyz_of(data).max(axis=0), volume.centers().max(axis=0) + half)
    assert find_origin(data.comments).depth == 3


def test_cubes_of_a_real_volume_are_fewer_than_its_faces(real, tmp_path):
    part = real.truncated(4)
    data, _ = exported(part, tmp_path, shape="cubes", colour="none")
    quads = quads_of(data)
    area, content = measures(quads)
    assert content == pytest.approx(len(part) * part.cell() ** 3)
    assert area == pytest.approx(n_faces(part) * part.cell() ** 2)
    assert len(quads) < 0.9 * n_faces(part)


def test_each_cube_has_its_own_colour(tmp_path):
    """Every corner of a quad has the colour of the voxel behind it."""
    volume = full_volume(2, 40)
    for choice in ("rgb", "height", "intensity", "class"):
        data, _ = exported(volume, tmp_path, shape="cubes", colour=choice)
        expected = colours_of(volume, choice)
        lookup = {tuple(c): e for c, e in zip(volume.voxels().tolist(), expected, strict=True)}
        vertex = data["vertex"]
        seen = np.column_stack([vertex[name] for name in ("red", "green", "blue")])
        xyz = xyz_of(data) * [1, 1, float(volume.crs.z_ratio)] - volume.cube.origin
        for quad in data["face"]["vertex_indices"]:
            corners = xyz[quad] / volume.cell()
            normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
            inside = corners[0] + (corners[2] - corners[0]) * 1e-3 - 0.5 * np.sign(np.rint(normal))
            cell = tuple(np.floor(inside).astype(int).tolist())
            assert (seen[quad] == lookup[cell]).all()


def test_auto_is_rgb_where_it_is_known_and_none_elsewhere(tmp_path):
    assert "red" in exported(full_volume(), tmp_path)[0]["vertex"]
    assert "red" not in exported(full_volume(), tmp_path, colour="none")[0]["vertex"]
    assert "red" not in exported(random_volume(), tmp_path)[0]["vertex"]


def test_colours_that_are_not_there_are_refused(tmp_path):
    with pytest.raises(OptionError, match=r"--colour class.*metadata are height") as caught:
        exported(random_volume(), tmp_path, colour="class")
    assert caught.value.code == "E_NO_METADATA"
    with pytest.raises(OptionError, match="nothing that is known"):
        exported(random_volume(metadata=False), tmp_path, colour="rgb")
    assert not list(tmp_path.iterdir())


def test_files_of_the_toolkit_have_points_where_it_rounded_and_its_colours_when_asked(tmp_path):
    volume = toolkit_volume()
    data, warnings = exported(volume, tmp_path)
    np.testing.assert_allclose(xyz_of(data), volume.centers(), rtol=1e-15)
    assert [warning.code for warning in warnings] == ["W_CHANNELS"]
    data, warnings = exported(volume, tmp_path, colour="rgb")
    np.testing.assert_array_equal(
        data["vertex"]["green"], volume.metadata() >> np.uint64(8) & np.uint64(255)
    )
    assert warnings == ()
    cubes, _ = exported(volume, tmp_path, shape="cubes")
    middles = half_open(volume).centers()
    np.testing.assert_allclose(xyz_of(cubes).min(0) + half_open(volume).cell() / 2, middles.min(0))


def test_a_single_place_is_a_point_but_no_cube(tmp_path):
    volume = volume_of(
        {(0, 0, 0)}, 1, cube=Cube((1.0, 2.0, 3.0), 0.0), info=replace(INFO, crs=full_volume().crs)
    )
    data, _ = exported(volume, tmp_path)
    assert len(data["vertex"].data) == 1
    assert find_origin(data.comments) is None
    with pytest.raises(OptionError, match="no extent"):
        exported(volume, tmp_path, shape="cubes")


def test_a_volume_without_a_crs_is_told(tmp_path):
    volume = volume_of({(0, 0, 0)}, 1, info=VolumeInfo(), metadata=False)
    data, warnings = exported(volume, tmp_path)
    assert [warning.code for warning in warnings] == ["W_NO_CRS"]
    assert not any(line.startswith("crs") for line in data.comments)


@pytest.mark.parametrize("shape", ["points", "cubes"])
def test_the_same_volume_gives_the_same_bytes(shape, tmp_path):
    paths = [
        vt.export_volume(full_volume(), tmp_path / f"{k}.ply", shape=shape).paths[0]
        for k in range(2)
    ]
    assert paths[0].read_bytes() == paths[1].read_bytes()


def test_volumes_deeper_than_any_import_are_points_without_a_grid(tmp_path):
    volume = volume_of({(4**11 - 1, 0, 5)}, 11, metadata=False)
    data, _ = exported(volume, tmp_path)
    np.testing.assert_allclose(xyz_of(data), volume.centers())
    assert find_origin(data.comments) is None
    with pytest.raises(ResourceError, match="coarser level"):
        exported(volume, tmp_path, shape="cubes")
