"""``--like``: the cells of an existing raster, wherever its corner lies."""

from __future__ import annotations

import json
import shutil
import subprocess

import numpy as np
import pytest
from making_tiles import hills, write_las

from volatool.dem.raster import read_dem
from volatool.errors import CRSError, InputError, OptionError, ResourceError, VolatoolError
from volatool.options import ConvertOptions
from volatool.tile import convert_tile

LEFT, TOP, CELL = 10.3, 41.7, 0.75


def raster(path, *, left=LEFT, top=TOP, cell=CELL, size=(30, 20), crs="EPSG:25832"):
    """Write a raster by GDAL's own tool."""
    if shutil.which("gdal_create") is None:
        pytest.skip("gdal_create is not installed")
    right, bottom = left + cell * size[0], top - cell * size[1]
    command = ["gdal_create", "-q", "-outsize", *size, "-a_ullr", left, top, right, bottom]
    command += ["-a_srs", crs] if crs else []
    subprocess.run(list(map(str, [*command, path])), check=True)
    return path


@pytest.fixture
def tile(tmp_path):
    xyz = hills(20_000)
    codes = np.full(len(xyz), 2, np.uint8)
    return write_las(tmp_path / "tile.las", xyz, crs="EPSG:25832", classification=codes)


def run(tile, **options):
    return convert_tile(
        tile, ConvertOptions(**options), kind="dem", outdir=tile.parent / "out", overwrite=True
    )


def test_the_model_has_the_rasters_cells(tile):
    """Corner, cell and size are the raster's, by gdalinfo; heights are those of the points."""
    reference = raster(tile.parent / "ref.tif")
    report = run(tile, like=str(reference))
    out = tile.parent / "out" / "tile.dem.tif"
    done = [
        json.loads(subprocess.run(["gdalinfo", "-json", path], capture_output=True).stdout)
        for path in (reference, out)
    ]
    assert done[0]["geoTransform"] == pytest.approx(done[1]["geoTransform"], abs=1e-12)
    assert done[0]["size"] == done[1]["size"]
    assert (report.dem["width"], report.dem["height"]) == (30, 20)
    assert report.dem["cell"] == pytest.approx(CELL)
    dem = read_dem(out)
    row, col = np.mgrid[:20, :30]
    x, y = LEFT + CELL * (col + 0.5), TOP - CELL * (row + 0.5)
    truth = 10 + x / 10 + 2 * np.sin(y / 7) + 0.095
    assert np.abs(dem.z - truth).max() < 0.25


def test_the_part_equals_the_whole(tile):
    """Inside, the model is that of a larger raster on the same lines: points outside count."""
    small = raster(tile.parent / "small.tif")
    large = raster(
        tile.parent / "large.tif", left=LEFT - 12 * CELL, top=TOP + 9 * CELL, size=(60, 40)
    )
    parts = []
    for reference in (small, large):
        run(tile, like=str(reference))
        parts.append(read_dem(tile.parent / "out" / "tile.dem.tif").z)
    assert np.abs(parts[1][9:29, 12:42] - parts[0]).max() <= 1e-3


def test_beyond_the_points_it_is_void(tile):
    report = run(tile, like=str(raster(tile.parent / "r.tif", left=40.3, size=(40, 20))))
    assert report.dem["cells_void"] > 300
    assert report.dem["cells_measured"] > 100


@pytest.mark.parametrize(
    ("change", "error", "code"),
    [
        ({"left": 500.0}, InputError, "E_INPUT"),
        ({"crs": "EPSG:25833"}, CRSError, "E_CRS"),
        ({"size": (20_000, 20_000), "cell": 0.001}, ResourceError, "E_SIZE"),
    ],
)
def test_what_does_not_fit_is_refused(tile, change, error, code):
    reference = raster(tile.parent / "ref.tif", **change)
    with pytest.raises(error) as caught:
        run(tile, like=str(reference))
    assert caught.value.code == code
    assert not (tile.parent / "out").exists()


def test_what_is_no_raster_is_refused(tile):
    (tile.parent / "not.tif").write_text("no")
    for name, code in (("not.tif", "E_CORRUPT"), ("gone.tif", "E_NOT_FOUND")):
        with pytest.raises(VolatoolError) as caught:
            run(tile, like=str(tile.parent / name))
        assert caught.value.code == code
    with pytest.raises(OptionError, match="leave out --cell"):
        run(tile, like="x.tif", cell=1)


def test_a_raster_without_a_crs_is_taken_at_its_word(tile):
    report = run(tile, like=str(raster(tile.parent / "ref.tif", crs=None)))
    assert report.dem["width"] == 30
