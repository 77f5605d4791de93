"""Elevation models: the middle of each cell at its height, the CRS kept."""

from __future__ import annotations

import numpy as np
import pytest
import rasterio
import rasterio.shutil
from making_imports import opened, points_of
from rasterio.transform import Affine

from volatool.errors import FormatError, InputError, TruncatedError
from volatool.imports import text

HEIGHTS = np.array([[1.5, 2.25, -9999.0], [4.0, 5.0, 6.5]])
EXPECTED = [
    (10.5, 21.5, 1.5),
    (11.5, 21.5, 2.25),
    (10.5, 20.5, 4),
    (11.5, 20.5, 5),
    (12.5, 20.5, 6.5),
]
VALUES = "1.5 2.25 -9999\n4 5 6.5\n"
CORNER = "ncols 3\nnrows 2\nxllcorner 10\nyllcorner 20\ncellsize 1\nNODATA_value -9999\n"


@pytest.mark.parametrize(
    "header",
    [
        CORNER,
        CORNER.upper().replace("\n", "\r\n"),
        CORNER.replace("llcorner 10", "llcenter 10.5").replace("llcorner 20", "llcenter 20.5"),
        CORNER.replace("cellsize 1", "dx 1\ndy 1"),
        CORNER.replace("NODATA_value -9999\n", ""),
    ],
)
@pytest.mark.parametrize("size", [16, 1 << 22])
def test_an_ascii_grid_is_read(tmp_path, monkeypatch, header, size):
    """Its corner or centre, any case, rows from the north; nodata is left out and counted."""
    monkeypatch.setattr(text, "BLOCK_BYTES", size)
    (tmp_path / "a.asc").write_text(header + VALUES)
    xyz, _ = points_of(tmp_path / "a.asc", 2)
    assert list(map(tuple, xyz.tolist())) == EXPECTED
    source = opened(tmp_path / "a.asc")
    assert source.format == "asc"
    assert {w.code: w.count for w in source.warnings}["W_NODATA"] == 1


def test_a_prj_file_beside_names_the_crs(tmp_path):
    import pyproj

    (tmp_path / "a.asc").write_text(CORNER + VALUES)
    (tmp_path / "a.prj").write_text(pyproj.CRS("EPSG:28992").to_wkt("WKT1_ESRI"))
    assert opened(tmp_path / "a.asc").crs.epsg == 28992
    assert opened(tmp_path / "a.asc", crs="EPSG:25832").crs.epsg == 25832
    (tmp_path / "a.prj").write_text("nonsense")
    assert opened(tmp_path / "a.asc").crs.epsg is None


def test_asc_may_be_columns(tmp_path):
    (tmp_path / "a.asc").write_text("1 2 3\n4 5 6\n")
    assert opened(tmp_path / "a.asc").format == "xyz"
    assert opened(tmp_path / "a.asc").n_points == 2


@pytest.mark.parametrize(
    ("content", "message", "kind"),
    [
        (CORNER + "1 2 3\n4 5\n", "ends at value 5 of 6", TruncatedError),
        (CORNER + VALUES + "7\n", "more values than 2 rows of 3", FormatError),
        (CORNER + "1 2 3\n4 x 6\n", "line 8: ", FormatError),
        (CORNER + "1 2 3\n4 inf 6\n", "are not finite", FormatError),
        (CORNER.replace("ncols 3", "ncols 3000000000") + VALUES, "more than its", TruncatedError),
        (CORNER.replace("ncols 3", "ncols 2.5") + VALUES, "no positive number", FormatError),
        (CORNER.replace("ncols 3", "ncols three") + VALUES, "line 1: ", FormatError),
        (CORNER.replace("cellsize 1\n", "") + VALUES, "header lacks", FormatError),
    ],
)
def test_damaged_grids_are_refused(tmp_path, content, message, kind):
    (tmp_path / "a.asc").write_text(content)
    with pytest.raises(kind, match=message):
        opened(tmp_path / "a.asc")


def write(path, heights=HEIGHTS, transform=None, nodata=-9999.0, crs="EPSG:28992", **more):
    profile = {"driver": "GTiff", "count": 1, "dtype": heights.dtype, "nodata": nodata, **more}
    height, width = heights.shape
    transform = transform or Affine(1.0, 0, 10.0, 0, -1.0, 22.0)
    with rasterio.open(
        path, "w", width=width, height=height, transform=transform, crs=crs, **profile
    ) as file:
        for band in range(profile["count"]):
            file.write(heights, band + 1)


@pytest.mark.parametrize("dtype", ["float32", "float64", "int16"])
def test_a_geotiff_is_read_with_its_crs(tmp_path, dtype):
    heights = (HEIGHTS if dtype != "int16" else np.rint(HEIGHTS)).astype(dtype)
    write(tmp_path / "a.tif", heights)
    xyz, _ = points_of(tmp_path / "a.tif", 2)
    expected = np.array(EXPECTED)
    if dtype == "int16":
        expected[:, 2] = np.rint(expected[:, 2])
    assert np.array_equal(xyz, expected)
    source = opened(tmp_path / "a.tif")
    assert (source.crs.epsg, source.format) == (28992, "tif")
    assert {w.code: w.count for w in source.warnings}["W_NODATA"] == 1


def test_nan_is_nodata_and_cells_need_not_be_square(tmp_path):
    heights = np.where(HEIGHTS < 0, np.nan, HEIGHTS)
    write(tmp_path / "a.tif", heights, Affine(2.0, 0, 0, 0, -0.5, 1.0), nodata=None, crs=None)
    xyz, _ = points_of(tmp_path / "a.tif")
    assert xyz[0].tolist() == [1.0, 0.75, 1.5]
    assert len(xyz) == 5


def test_other_rasters_are_refused(tmp_path):
    write(tmp_path / "a.tif", transform=Affine(1.0, 0.1, 10, 0, -1, 20))
    with pytest.raises(FormatError, match="not a raster of one band, north up"):
        opened(tmp_path / "a.tif")
    write(tmp_path / "b.tif", count=3)
    with pytest.raises(FormatError, match="not a raster of one band"):
        opened(tmp_path / "b.tif")
    data = (tmp_path / "b.tif").read_bytes()
    (tmp_path / "c.tif").write_bytes(b"no TIFF at all")
    with pytest.raises(InputError, match="not a readable GeoTIFF"):
        opened(tmp_path / "c.tif")
    (tmp_path / "d.tif").write_bytes(data[:60])
    with pytest.raises(InputError, match="not a r"):
        opened(tmp_path / "d.tif")


def test_what_gdal_writes_as_ascii_grid_is_the_raster(tmp_path):
    """An independent writer, with its file of the CRS beside."""
    write(tmp_path / "a.tif", HEIGHTS.astype("float32"))
    rasterio.shutil.copy(tmp_path / "a.tif", tmp_path / "b.asc", driver="AAIGrid")
    assert np.array_equal(points_of(tmp_path / "b.asc")[0], points_of(tmp_path / "a.tif")[0])
    assert opened(tmp_path / "b.asc").crs.epsg == 28992
