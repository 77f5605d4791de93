"""Mosaics of models: what GDAL reads through the VRT is what the files hold."""

from __future__ import annotations

import json
import shutil
import subprocess

import numpy as np
import pytest
import rasterio
from making_tiles import hills, write_las

from volatool.dem.raster import read_dem
from volatool.dem.vrt import mosaic
from volatool.errors import FormatError
from volatool.options import ConvertOptions
from volatool.tile import convert_tile


@pytest.fixture(scope="module")
def tiles(tmp_path_factory):
    """Two models side by side, a third elsewhere on the grid."""
    folder = tmp_path_factory.mktemp("vrt")
    xyz = hills(20_000)
    pieces = {
        "a": xyz[xyz[:, 0] < 2500],
        "b": xyz[xyz[:, 0] >= 2500],
        "c": xyz + np.array([9000, -3000, 0]),
    }
    for name, points in pieces.items():
        codes = np.full(len(points), 2, np.uint8)
        path = folder / f"{name}.las"
        tile = write_las(path, points, crs="EPSG:25832+7837", classification=codes)
        convert_tile(tile, ConvertOptions(cell="1m", layers=("flag",)), kind="dem")
    return folder


def test_a_mosaic_holds_each_model_at_its_place(tiles):
    """Cells, nodata, CRS, unit and description; void between them; readable by rasterio."""
    paths = [tiles / f"{name}.dem.tif" for name in "abc"]
    (tiles / "all.vrt").write_bytes(mosaic(paths))
    with rasterio.open(tiles / "all.vrt") as file:
        whole = file.read(1)
        assert file.nodata == -9999
        assert file.units == ("metre",)
        assert all(code in file.crs.to_wkt() for code in ("25832", "7837"))
        assert file.tags()["AREA_OR_POINT"] == "Area"
        n_valid = 0
        for path in paths:
            with rasterio.open(path) as model:
                z = model.read(1)
                row, col = file.index(model.bounds.left + 0.5, model.bounds.top - 0.5)
            part = whole[row : row + z.shape[0], col : col + z.shape[1]]
            known = z != -9999
            if path is paths[-1]:  # nothing lies on the last one
                np.testing.assert_array_equal(part, z)
            assert (part[known] != -9999).all()
            n_valid += np.count_nonzero(known)
        assert 0 < np.count_nonzero(whole != -9999) <= n_valid
    (tiles / "all.flag.vrt").write_bytes(mosaic([tiles / f"{n}.dem.flag.tif" for n in "abc"]))
    with rasterio.open(tiles / "all.flag.vrt") as file:
        assert set(np.unique(file.read(1))) <= {0, 1, 2}


def test_gdal_agrees(tiles):
    """gdalinfo reads it; gdalbuildvrt gives the same size, transform and cells."""
    if shutil.which("gdalbuildvrt") is None:
        pytest.skip("gdal-bin is not installed")
    paths = [tiles / f"{name}.dem.tif" for name in "abc"]
    (tiles / "ours.vrt").write_bytes(mosaic(paths))
    subprocess.run(["gdalbuildvrt", "-q", tiles / "theirs.vrt", *paths], check=True)
    facts = [
        json.loads(subprocess.check_output(["gdalinfo", "-json", "-checksum", tiles / name]))
        for name in ("ours.vrt", "theirs.vrt")
    ]
    for key in ("size", "geoTransform"):
        assert facts[0][key] == facts[1][key]
    assert facts[0]["bands"][0]["checksum"] == facts[1]["bands"][0]["checksum"]


def test_one_model_is_a_mosaic_too(tiles):
    path = tiles / "a.dem.tif"
    (tiles / "one.vrt").write_bytes(mosaic([path]))
    with rasterio.open(tiles / "one.vrt") as file, rasterio.open(path) as model:
        np.testing.assert_array_equal(file.read(1), model.read(1))
        assert file.transform == model.transform


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"cell": "2m"}, "their cells differ"),
        ({"cell": "1m", "crs": "EPSG:25833+7837"}, "their CRS differ"),
    ],
)
def test_models_that_do_not_mesh_are_refused(tiles, tmp_path, options, says):
    """Both files are named, and what to do."""
    convert_tile(tiles / "b.las", ConvertOptions(**options), kind="dem", outdir=tmp_path)
    with pytest.raises(FormatError, match=says) as caught:
        mosaic([tiles / "a.dem.tif", tmp_path / "b.dem.tif"])
    assert caught.value.code == "E_GRID"
    assert "a.dem.tif" in str(caught.value)
    assert "--params-from" in str(caught.value)


def test_models_off_the_lattice_are_refused(tiles, tmp_path):
    """Half a cell beside each other: no resampling behind the user's back."""
    with rasterio.open(tiles / "a.dem.tif") as model:
        profile, z = model.profile, model.read(1)
        unit = model.units[0]
    a, b, c, *rest = profile["transform"][:6]
    profile.update(transform=rasterio.Affine(a, b, c + 0.5, *rest))
    with rasterio.open(tmp_path / "x.tif", "w", **profile) as file:
        file.write(z, 1)
        file.units = (unit,)
    assert read_dem(tmp_path / "x.tif").z.shape == z.shape
    with pytest.raises(FormatError, match=r"0\.5 of a cell beside") as caught:
        mosaic([tiles / "a.dem.tif", tmp_path / "x.tif"])
    assert caught.value.code == "E_GRID"
