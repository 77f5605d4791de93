"""GDAL's own tools on our elevation models, where they are installed."""

from __future__ import annotations

import json
import shutil
import subprocess
from fractions import Fraction
from pathlib import Path

import pytest
from rio_cogeo import cog_validate

import volatool as vt

SAMPLES = Path(__file__).resolve().parents[2] / "data_samples"


def gdal(*command):
    if shutil.which(command[0]) is None:
        pytest.skip(f"{command[0]} is not installed")
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    return done.stdout


@pytest.fixture(scope="module")
def town(tmp_path_factory):
    """Elevation model of the sample town with all layers, at a cell that needs overviews."""
    folder = tmp_path_factory.mktemp("town")
    options = {"cell": "0.25m", "dense": "never", "layers": ("count", "flag", "distance")}
    report = vt.convert(SAMPLES / "town.laz", folder, **options)
    return folder, report


def test_gdalinfo_shows_crs_with_heights_unit_nodata_and_range(town):
    folder, report = town
    info = json.loads(gdal("gdalinfo", "-json", folder / "town.dem.tif"))
    assert info["coordinateSystem"]["wkt"].startswith("COMPOUNDCRS[")
    assert 'ID["EPSG",7837]' in info["coordinateSystem"]["wkt"]
    band = info["bands"][0]
    assert (band["type"], band["noDataValue"], band["unit"]) == ("Float32", -9999.0, "metre")
    assert band["minimum"] == pytest.approx(report.dem["z_min"], abs=1e-3)
    assert band["maximum"] == pytest.approx(report.dem["z_max"], abs=1e-3)
    assert len(band["overviews"]) >= 1
    assert info["metadata"][""]["AREA_OR_POINT"] == "Area"
    assert info["metadata"]["IMAGE_STRUCTURE"]["LAYOUT"] == "COG"


def test_every_raster_is_a_strict_cog(town):
    folder, _ = town
    rasters = sorted(folder.glob("*.tif"))
    assert len(rasters) == 4
    for raster in rasters:
        valid, errors, warnings = cog_validate(raster, strict=True)
        assert (valid, errors, warnings) == (True, [], []), raster


def test_gdaldem_takes_the_model(town, tmp_path):
    folder, _ = town
    gdal("gdaldem", "hillshade", "-q", folder / "town.dem.tif", tmp_path / "shade.tif")


def test_models_of_abutting_tiles_mesh(shared, tmp_path):
    """Delft: both grids lie on multiples of the cell, so a VRT over them has no gap or overlap."""
    places = []
    for name in ("ahn3_cropped_1", "ahn3_cropped_2"):
        report = vt.convert(shared / "tiles" / f"{name}.laz", tmp_path, cell=1, dense="never")
        info = json.loads(gdal("gdalinfo", "-json", tmp_path / f"{name}.dem.tif"))
        left, width, _, top, _, height = info["geoTransform"]
        assert (width, height) == (1, -1)
        assert report.dem["cell"] == 1
        assert Fraction(left).denominator == Fraction(top).denominator == 1
        places.append((left, left + info["size"][0]))
    assert places[0][1] == places[1][0] == 85000
    gdal("gdalbuildvrt", "-q", tmp_path / "both.vrt", *tmp_path.glob("*.dem.tif"))
    assert json.loads(gdal("gdalinfo", "-json", tmp_path / "both.vrt"))["size"][0] == (
        places[1][1] - places[0][0]
    )
