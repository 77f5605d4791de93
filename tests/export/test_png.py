"""Pictures of layers and from the top, read by Pillow and placed as rasterio understands them."""

from __future__ import annotations

import numpy as np
import pyproj
import pytest
import rasterio
from making_exports import FEET, FULL, full_volume, toolkit_volume
from making_volumes import random_volume, volume_of
from PIL import Image

import volatool as vt
from volatool.cube import Cube
from volatool.errors import OptionError, ResourceError
from volatool.export.png import Frame
from volatool.model import Bounds


def picture(path):
    return np.asarray(Image.open(path))


def test_each_layer_is_a_picture_with_north_up(tmp_path):
    volume = full_volume()
    done = vt.export_volume(volume, tmp_path / "t.png")
    voxels = volume.voxels()
    layers = np.unique(voxels[:, 2])
    names = [path.name for path in done.paths]
    endings = (".png", ".pgw", ".png.aux.xml")
    assert names == [f"t.z{layer:02d}{ending}" for layer in layers for ending in endings]
    (x0, y0), (x1, y1) = voxels[:, :2].min(axis=0), voxels[:, :2].max(axis=0)
    colours = np.column_stack([volume.channel(name) / 256 for name in ("red", "green", "blue")])
    for layer in layers[::10]:
        expected = np.zeros((y1 - y0 + 1, x1 - x0 + 1, 4), np.uint8)
        for (x, y, z), colour in zip(voxels, colours, strict=True):
            if z == layer:
                expected[y1 - y, x - x0] = (*colour, 255)
        assert np.array_equal(picture(tmp_path / f"t.z{layer:02d}.png"), expected)


def test_the_top_is_the_highest_voxel_of_each_column(tmp_path):
    volume = full_volume()
    (path, *_) = vt.export_volume(volume, tmp_path / "t.png", slices="top").paths
    assert path.name == "t.top.png"
    found = picture(path)
    top = {}
    for (x, y, z), word in zip(volume.voxels().tolist(), volume.metadata().tolist(), strict=True):
        if (x, y) not in top or z > top[x, y][0]:
            top[x, y] = (z, [word & 255, word >> 8 & 255, word >> 16 & 255, 255])
    low = volume.voxels()[:, 0].min()
    high = volume.voxels()[:, 1].max()
    assert (found[..., 3] > 0).sum() == len(top)
    for (x, y), (_, colour) in top.items():
        assert found[high - y, x - low].tolist() == colour


@pytest.mark.parametrize("slices", ["all", "top"])
def test_gis_finds_the_place_and_the_crs(tmp_path, slices):
    """Every opaque pixel's centre, back in the volume, is a voxel's column."""
    volume = full_volume()
    done = vt.export_volume(volume, tmp_path / "t.png", slices=slices, level=2)
    assert done.warnings == ()
    with rasterio.open(done.paths[0]) as file:
        assert pyproj.CRS(file.crs.to_wkt()).sub_crs_list[0].to_epsg() == 2994
        rows, cols = np.nonzero(file.read(4))
        x, y = rasterio.transform.xy(file.transform, rows, cols)
        tags = file.tags()
    columns = {tuple(row) for row in volume.voxels(2)[:, :2].tolist()}
    ratio = float(FEET.z_ratio)
    if slices == "all":
        low, high = float(tags["z_low"]), float(tags["z_high"])
        layer = int(done.paths[0].name.split(".z")[1][:2])
        assert np.isclose((high - low) * ratio, volume.cell(2))
        assert np.isclose(low * ratio, volume.cube.origin[2] + layer * volume.cell(2))
        columns = {(a, b) for a, b, c in volume.voxels(2).tolist() if c == layer}
    place = np.column_stack([x, y]) - volume.cube.origin[:2]
    assert {tuple(row) for row in np.floor(place / volume.cell(2)).astype(int)} == columns


def test_without_colours_layers_are_ink_and_the_top_shows_heights(tmp_path):
    volume = volume_of([(0, 0, 0), (1, 0, 0), (1, 0, 3), (3, 3, 1)], 1, metadata=False)
    (path, *_) = vt.export_volume(volume, tmp_path / "a.png").paths
    ink = (34, 38, 44, 255)
    assert [tuple(pixel) for pixel in picture(path)[3, :3]] == [ink, ink, (0, 0, 0, 0)]
    (path, *_) = vt.export_volume(volume, tmp_path / "a.png", slices="top").paths
    found = picture(path)
    assert found[3, 0].tolist() != found[3, 1].tolist() != found[0, 3].tolist()
    assert (found[..., 3] > 0).sum() == 3


def test_a_toolkit_file_is_placed_round_its_points(tmp_path):
    volume = toolkit_volume()
    done = vt.export_volume(volume, tmp_path / "a.png", slices="top")
    with rasterio.open(done.paths[0]) as file:
        rows, cols = np.nonzero(file.read(4))
        x, y = rasterio.transform.xy(file.transform, rows, cols)
        assert pyproj.CRS(file.crs.to_wkt()).to_epsg() == 28992
    centers = {tuple(row) for row in np.round(volume.centers()[:, :2], 6)}
    assert {tuple(row) for row in np.round(np.column_stack([x, y]), 6)} == centers


def test_too_many_layers_take_a_coarser_level_and_say_so(tmp_path, monkeypatch):
    monkeypatch.setattr("volatool.export.png.MOST_AT_ONCE", 16)
    volume = volume_of([(k, k, k) for k in range(0, 64, 3)], 3, metadata=False, info=FULL)
    done = vt.export_volume(volume, tmp_path / "a.png")
    assert [one.code for one in done.warnings] == ["W_LEVEL"]
    assert "level 2 of 3 is shown, 16 layers" in done.warnings[0].message
    assert len(done.paths) == 3 * 16
    assert done.paths[0].name == "a.z00.png"
    assert vt.export_volume(volume, tmp_path / "b.png", slices="top").warnings == ()


def test_pictures_over_the_limit_are_refused(tmp_path):
    volume = random_volume()
    size = Frame.of(volume).size_bytes(1)
    with pytest.raises(ResourceError, match="coarser --level"):
        vt.export_volume(volume, tmp_path / "a.png", slices="top", level=3, limit=size - 1)
    vt.export_volume(volume, tmp_path / "a.png", slices="top", level=3, limit=size)
    wide = volume_of([(0, 0, 0), (4**8 - 1, 0, 0)], 8, metadata=False)
    with pytest.raises(ResourceError, match=r"65536 x 1 pixels"):
        vt.export_volume(wide, tmp_path / "b.png", level=8)
    assert vt.export_volume(wide, tmp_path / "b.png").warnings[0].code == "W_LEVEL"


def test_a_crop_has_its_own_extent(tmp_path):
    volume = full_volume()
    x, y, _ = volume.cube.origin
    bounds = Bounds(x + 2, y + 2, x + 5, y + 5)
    (path, *_) = vt.export_volume(volume, tmp_path / "a.png", slices="top", bounds=bounds).paths
    with rasterio.open(path) as file:
        assert file.bounds.left >= x + 2 - volume.cell()
        assert file.bounds.top <= y + 5 + volume.cell()


def test_one_place_is_no_picture(tmp_path):
    volume = volume_of([(0, 0, 0)], 1, cube=Cube((1.0, 2.0, 3.0), 0.0), info=FULL)
    with pytest.raises(OptionError, match="a picture needs cells with an edge"):
        vt.export_volume(volume, tmp_path / "a.png")
    assert not list(tmp_path.iterdir())
