"""Queries of volumes at the ends: nothing in them, one level, fifteen levels."""

from __future__ import annotations

import making_volumes as making
import numpy as np
import pytest

from volatool.cube import Cube
from volatool.errors import FormatError
from volatool.model import CrsInfo
from volatool.vola.polygons import read_polygons
from volatool.vola.volume import Volume, VolumeInfo

PLAIN = VolumeInfo(crs=CrsInfo())


def deep(voxel, depth):
    """Return a volume of one voxel, in a cube whose cells are units."""
    levels = []
    for level in range(depth):
        x, y, z = (c >> (2 * (depth - 1 - level)) & 3 for c in voxel)
        levels.append(np.array([1 << (x + 4 * y + 16 * z)], np.uint64))
    return Volume(tuple(levels), None, Cube((0.0,) * 3, float(4**depth)), PLAIN)


@pytest.mark.parametrize("depth", [1, 4])
def test_a_volume_without_voxels_answers_that_there_are_none(depth):
    empty = tuple(np.zeros(int(level == 0), np.uint64) for level in range(depth))
    volume = Volume(empty, empty, Cube((0.0,) * 3, 4.0**depth), making.INFO)
    assert not volume.contains([[1, 1, 1]]).any()
    assert volume.find([[1, 1, 1]]).tolist() == [-1]
    assert not volume.ray([-1, 0.5, 0.5], [1, 0, 0]).is_hit.any()
    assert volume.sight([0, 0, 0], [3, 3, 3]).is_clear.all()
    assert not volume.box([0, 0, 0], [9, 9, 9])
    assert len(volume.column(0.5, 0.5)) == 0
    assert volume.census(bands=[0, 1]).bands[0].voxels == 0
    assert volume.neighbours([[1, 1, 1]]).tolist() == [0]
    assert volume.neighbour_error().share == 1.0


@pytest.mark.parametrize("depth", [1, 2, 11, 15])
def test_one_voxel_of_a_volume_of_any_depth_is_found(depth):
    size = 4**depth
    voxel = tuple(int(c) for c in np.random.default_rng(depth).integers(0, size, 3))
    volume = deep(voxel, depth)
    middle = np.array(voxel) + 0.5
    assert volume.contains([middle, middle + 1]).tolist() == [True, False]
    assert volume.find([voxel]).tolist() == [0]
    corner = volume.ray([-1.0, -1.0, -1.0], middle + 1)
    assert corner.voxels.tolist() == [list(voxel)]
    assert corner.blocks[0] <= 40 * depth
    assert list(volume.column(*middle[:2])) == [(voxel[2], voxel[2] + 1)]
    found = volume.box([-np.inf] * 3, [np.inf] * 3)
    assert (found.voxels, found.cells) == (1, size**3)
    assert found.low.tolist() == list(voxel)
    assert volume.census().low.tolist() == list(voxel)
    beside = middle - np.array([0, 0, 1 if voxel[2] else -1])
    assert volume.neighbours([middle, beside], connectivity=6).tolist() == [0, 1]


def test_polygons_are_read_with_what_the_file_says_of_them(tmp_path):
    """Lines and points are left out, a bow tie becomes its two halves."""
    (tmp_path / "areas.geojson").write_text(
        """{"type": "FeatureCollection", "crs": {"type": "name", "properties":
        {"name": "urn:ogc:def:crs:EPSG::25832"}}, "features": [
        {"type": "Feature", "properties": {"Name": "yard", "n": 3}, "geometry":
         {"type": "Polygon", "coordinates": [[[0, 0], [2, 2], [2, 0], [0, 2], [0, 0]]]}},
        {"type": "Feature", "properties": {"Name": "wall", "n": null}, "geometry":
         {"type": "LineString", "coordinates": [[0, 0], [1, 1]]}},
        {"type": "Feature", "properties": {"Name": null, "n": 4}, "geometry":
         {"type": "Polygon", "coordinates": [[[5, 5, 9], [6, 5, 9], [6, 6, 9], [5, 5, 9]]]}}
        ]}"""
    )
    found = read_polygons(str(tmp_path / "areas.geojson"), CrsInfo())
    assert [shape.area for shape in found.shapes] == [2.0, 0.5]
    assert [fields["name"] for fields in found.fields] == ["yard", None]
    assert [fields["n"] for fields in found.fields] == [3, 4]
    assert [warning.code for warning in found.warnings] == ["W_VECTOR_CRS"]
    bow = read_polygons("POLYGON ((0 0, 2 2, 2 0, 0 2, 0 0))", CrsInfo())
    assert bow.shapes[0].area == 2.0


def test_a_vector_file_without_polygons_is_refused(tmp_path):
    (tmp_path / "line.geojson").write_text('{"type": "LineString", "coordinates": [[0,0],[1,1]]}')
    with pytest.raises(FormatError, match="has no polygons") as caught:
        read_polygons(str(tmp_path / "line.geojson"), CrsInfo())
    assert caught.value.code == "E_NOT_VECTOR"
