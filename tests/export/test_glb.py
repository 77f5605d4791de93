"""Volumes as glTF: read by trimesh, turned as glTF wants, and back to the same voxels."""

from __future__ import annotations

import json
import struct
from dataclasses import replace

import numpy as np
import pytest
from making_exports import full_volume, toolkit_volume
from making_volumes import CRS, INFO, random_volume, volume_of

import volatool as vt
from volatool.cube import Cube
from volatool.errors import OptionError
from volatool.export.colours import colours_of, linear
from volatool.formats import trailer
from volatool.vola.volume import VolumeInfo
from volatool.vola.window import half_open

trimesh = pytest.importorskip("trimesh")


def exported(volume, folder, **options):
    """Return the mesh, the JSON part and the warnings."""
    done = vt.export_volume(volume, folder / "out.glb", overwrite=True, **options)
    data = done.paths[0].read_bytes()
    magic, version, length, n_json = struct.unpack_from("<4sIII", data)
    assert (magic, version, length) == (b"glTF", 2, len(data))
    scene = trimesh.load(done.paths[0], process=False)
    (mesh,) = scene.geometry.values()
    return mesh, json.loads(data[20 : 20 + n_json]), done.warnings


def undone(mesh, content):
    """Coordinates of the CRS by what the file says, z in the vertical unit."""
    told = content["asset"]["extras"]["volatool"]
    gx, gy, gz = np.asarray(mesh.vertices).T / told["metres_per_unit"]
    x, y, z = told["shift"]
    return np.column_stack([gx + x, -gz + y, (gy + z) / told["z_ratio"]])


def test_the_mesh_has_the_volume_of_the_voxels_in_cubic_metres(tmp_path):
    volume = full_volume(3, 300)
    mesh, _, _ = exported(volume, tmp_path)
    assert mesh.volume == pytest.approx(len(volume) * (volume.cell() * 0.3048) ** 3, rel=1e-5)


def test_the_json_part_holds_against_the_schema_of_gltf(tmp_path):
    _, content, _ = exported(full_volume(2, 40), tmp_path)
    trimesh.exchange.gltf.validate(content)


def test_a_volume_in_one_piece_is_watertight(tmp_path):
    """A box, as trimesh counts its edges; elsewhere long edges meet several short ones."""
    box = {tuple(map(int, row)) for row in np.argwhere(np.ones((5, 3, 2)))}
    volume = volume_of(box, 2, metadata=False)
    mesh, _, _ = exported(volume, tmp_path)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert len(mesh.faces) == 12
    assert mesh.volume == pytest.approx(30 * (volume.cell() * 0.3048) ** 3)


def test_the_volume_of_a_real_tile_is_that_of_its_voxels(real, tmp_path):
    part = real.truncated(4)
    mesh, _, _ = exported(part, tmp_path, colour="none")
    metres = float(part.crs.metres_per_unit_xy or 1)
    assert mesh.volume == pytest.approx(len(part) * (part.cell() * metres) ** 3, rel=1e-5)


def test_up_is_y_and_north_is_minus_z(tmp_path):
    """Three voxels: at the corner, to the north of it, and above it."""
    volume = volume_of(
        {(0, 0, 0), (0, 3, 0), (0, 0, 2)}, 1, cube=Cube((5.0, 6.0, 7.0), 4.0), info=VolumeInfo()
    )
    mesh, content, _ = exported(volume, tmp_path, colour="none")
    assert mesh.bounds.tolist() == [[0, 0, -4], [1, 3, 0]]
    boxes = sorted(part.bounds.tolist() for part in mesh.split(only_watertight=False))
    north = [[0, 0, -4], [1, 1, -3]]
    corner = [[0, 0, -1], [1, 1, 0]]
    above = [[0, 2, -1], [1, 3, 0]]
    assert boxes == sorted([north, corner, above])
    assert content["asset"]["extras"]["volatool"]["axes"] == "x east, y up, z south"


def test_what_the_file_says_gives_the_coordinates_of_the_crs_back(tmp_path):
    volume = full_volume(3, 100)
    mesh, content, (warning,) = exported(volume, tmp_path)
    cell, ratio = volume.cell(), float(volume.crs.z_ratio)
    half = cell / 2 / np.array([1, 1, ratio])
    xyz, centers = undone(mesh, content), volume.centers()
    np.testing.assert_allclose(xyz.min(axis=0), centers.min(axis=0) - half, atol=1e-5)
    np.testing.assert_allclose(xyz.max(axis=0), centers.max(axis=0) + half, atol=1e-5)
    assert warning.code == "W_SHIFTED"
    told = content["asset"]["extras"]["volatool"]
    assert told["crs"] == "EPSG:2994"
    cube, info = trailer.recall(told["origin"])
    assert cube.exact == volume.cube.exact
    assert info.crs == volume.crs


def test_colours_are_linear_bytes_of_the_voxel_behind(tmp_path):
    volume = full_volume(2, 40)
    mesh, content, _ = exported(volume, tmp_path)
    (primitive,) = content["meshes"][0]["primitives"]
    accessor = content["accessors"][primitive["attributes"]["COLOR_0"]]
    assert (accessor["componentType"], accessor["type"]) == (5121, "VEC4")
    assert accessor["normalized"] is True
    seen = np.asarray(mesh.visual.vertex_attributes["color"])
    assert (seen[:, 3] == 255).all()
    expected = linear(colours_of(volume, "rgb"))
    lookup = dict(zip(map(tuple, volume.voxels().tolist()), expected.tolist(), strict=True))
    step = volume.cell() * 0.3048
    for triangle in mesh.faces:
        corners = np.asarray(mesh.vertices)[triangle]
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        inside = corners.mean(axis=0) * 0.98 + corners[1] * 0.02
        inside = inside / step - 0.5 * normal / np.linalg.norm(normal)
        # the middle of a joined triangle may lie on a border of cells: any cell behind will do
        cell = np.floor(inside[[0, 2, 1]] * [1, -1, 1]).astype(int)
        assert lookup[tuple(cell.tolist())] == seen[triangle[0]][:3].tolist()


def test_linear_is_the_curve_of_srgb():
    assert linear(np.array([[0, 255, 188]], np.uint8)).tolist() == [[0, 255, 128]]
    assert linear(np.array([[10, 11, 55]], np.uint8)).tolist() == [[1, 1, 10]]


def test_without_colours_the_material_is_grey_and_no_metal(tmp_path):
    _, content, _ = exported(random_volume(), tmp_path)
    (primitive,) = content["meshes"][0]["primitives"]
    assert set(primitive["attributes"]) == {"POSITION"}
    pbr = content["materials"][primitive["material"]]["pbrMetallicRoughness"]
    assert pbr["metallicFactor"] == 0
    assert pbr["baseColorFactor"][0] < 1


def test_coordinates_of_the_crs_only_where_single_precision_holds_them(tmp_path):
    metres = VolumeInfo(crs=replace(CRS, metres_per_unit_xy=None, metres_per_unit_z=None))
    near = random_volume(2, 20, cube=Cube((100.0, 200.0, -5.0), 8.0), info=metres)
    mesh, content, warnings = exported(near, tmp_path, local=False)
    assert warnings == ()
    assert content["asset"]["extras"]["volatool"]["shift"] == [0, 0, 0]
    np.testing.assert_allclose(
        undone(mesh, content).min(axis=0), near.centers().min(axis=0) - near.cell() / 2, atol=1e-4
    )
    with pytest.raises(OptionError, match=r"steps of 0\.5 at these.*leave out --world"):
        exported(random_volume(3, info=INFO), tmp_path, local=False)


def test_heights_in_another_unit_are_told_in_coordinates_of_the_crs(tmp_path):
    volume = random_volume(1, 9, cube=Cube((10.0, 20.0, 30.0), 8.0))
    _, _, (warning,) = exported(volume, tmp_path, local=False)
    assert warning.code == "W_Z_UNIT"


def test_volumes_of_the_toolkit_are_cells_around_its_points(tmp_path):
    volume = toolkit_volume()
    mesh, content, _ = exported(volume, tmp_path)
    cells = half_open(volume)
    expected = cells.centers().min(axis=0) - cells.cell() / 2
    np.testing.assert_allclose(undone(mesh, content).min(axis=0), expected, atol=1e-5)


def test_a_cube_without_extent_is_refused(tmp_path):
    volume = volume_of({(0, 0, 0)}, 1, cube=Cube((1.0, 2.0, 3.0), 0.0))
    with pytest.raises(OptionError, match="no extent"):
        exported(volume, tmp_path)


def test_the_same_volume_gives_the_same_bytes(tmp_path):
    paths = [vt.export_volume(full_volume(), tmp_path / f"{k}.glb").paths[0] for k in range(2)]
    assert paths[0].read_bytes() == paths[1].read_bytes()
