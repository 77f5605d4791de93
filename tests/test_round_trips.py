"""Real tiles: LAS -> VOLA -> another format -> VOLA gives the same voxels, in the same place."""

from __future__ import annotations

import numpy as np
import pytest

import volatool as vt

pytestmark = pytest.mark.shared

TILES = {
    "metres": ("tiles/ahn3_cropped_1.laz", {}),
    "US survey feet": ("tiles/4_6_crop.las", {}),
    "heights in feet over metres": ("tiles/4_6_crop.las", {"crs": "EPSG:26913+6360"}),
}
"""File and options by what they are in."""

BY_THEMSELVES = {
    "bt": {},
    "npz": {},
    "ply": {},
    "ply local": {"local": True},
}
"""Formats that keep cube, depth and CRS, and how they are exported."""

ON_THE_SAME_GRID = {
    "las": {},
    "laz": {},
    "xyz": {},
    "csv": {},
    "npy": {},
    "binvox": {},
}
"""Formats that need ``--cube-from`` for some of it."""


@pytest.fixture(scope="module", params=TILES)
def tile(request, shared, tmp_path_factory):
    """Volume of a real tile, four levels, and its path."""
    folder = tmp_path_factory.mktemp("tile")
    name, options = TILES[request.param]
    report = vt.convert(shared / name, folder, dem=False, dense="never", depth=4, **options)
    path = next(path for path in report.paths if path.name.endswith(".vol.gz"))
    volume = vt.open(path)
    assert (volume.crs.z_ratio == 1) == (request.param != "heights in feet over metres")
    return path, volume


def back(path, folder, **options):
    """Return the volume of an exported file."""
    make = vt.convert if path.suffix in (".las", ".laz") else vt.import_points
    report = make(path, folder, dem=False, dense="never", **options)
    found = next(path for path in report.paths if path.name.endswith(".vol.gz"))
    return vt.open(found), report


@pytest.mark.parametrize("what", BY_THEMSELVES)
def test_cube_depth_crs_and_voxels_come_back(tile, tmp_path, what):
    _, volume = tile
    name = f"t.{what.split()[0]}"
    (made,) = vt.export_volume(volume, tmp_path / name, **BY_THEMSELVES[what]).paths
    found, report = back(made, tmp_path / "back")
    assert (found.cube, found.depth) == (volume.cube, volume.depth)
    assert found.crs.wkt2 == volume.crs.wkt2
    assert np.array_equal(found.keys(), volume.keys())
    assert report.input["crs"]["wkt2"] == volume.crs.wkt2
    if what == "npz":  # the bytes that are no means of means
        assert np.array_equal(found.channel("class"), volume.channel("class"))


@pytest.mark.parametrize("suffix", ON_THE_SAME_GRID)
def test_voxels_come_back_on_the_grid_of_the_first(tile, tmp_path, suffix):
    path, volume = tile
    options = ON_THE_SAME_GRID[suffix]
    (made,) = vt.export_volume(volume, tmp_path / f"t.{suffix}", **options).paths
    found, _ = back(made, tmp_path / "back", cube_from=str(path))
    assert (found.cube, found.depth) == (volume.cube, volume.depth)
    assert found.crs.z_ratio == volume.crs.z_ratio
    assert found.crs.horizontal == volume.crs.horizontal
    assert np.array_equal(found.keys(), volume.keys())


def test_a_binvox_grid_comes_back_in_a_cube_of_floats(tile, tmp_path):
    """By itself: the same cells, from a corner that is the nearest float."""
    _, volume = tile
    (made,) = vt.export_volume(volume, tmp_path / "t.binvox").paths
    found, _ = back(made, tmp_path / "back", crs=volume.crs.wkt2)
    assert found.cube.origin == volume.cube.origin
    assert found.cube.side == volume.cube.side
    assert np.array_equal(found.keys(), volume.keys())
