"""The DEM file: a valid COG with all that GIS programs look for, the same bytes every time."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
import rasterio
from making_dems import gather, ground, hills
from rio_cogeo import cog_validate

from volatool.dem.geotiff import write_dem, write_layer
from volatool.dem.raster import read_dem, read_profile
from volatool.dem.recheck import check_dem
from volatool.dem.surfaces import make_dem
from volatool.errors import FormatError, InputNotFoundError, OutputError
from volatool.model import CrsInfo
from volatool.scratch import Scratch


def crs_info(code="EPSG:25832+7837"):
    import pyproj

    return CrsInfo(
        wkt2=pyproj.CRS(code).to_wkt("WKT2_2019"),
        unit_xy="metre",
        unit_z="metre",
        metres_per_unit_xy=Fraction(1),
        metres_per_unit_z=Fraction(1),
    )


@pytest.fixture(scope="module")
def dem():
    """Hills of 700 x 600 cells, more than one tile, with a void in a corner."""
    x, y, z = hills(20_000, 70.0)
    keep = (x + y < 120) & (y < 60)
    points = ground(x[keep] + 500_000, y[keep] + 100_000, z[keep], offset=100_000.0)
    return make_dem(points, crs_info(), 0.1)


def test_file_is_a_valid_cog(dem, tmp_path):
    """rio cogeo's strict check passes for heights and layers, ours too; nothing else is left."""
    paths = [tmp_path / "a.dem.tif"]
    write_dem(paths[0], dem)
    for kind in ("flag", "count", "distance"):
        paths.append(tmp_path / f"a.dem.{kind}.tif")
        write_layer(paths[-1], dem, kind)
    for path in paths:
        assert cog_validate(path, strict=True) == (True, [], [])
        assert check_dem(path) == []
    assert sorted(tmp_path.iterdir()) == sorted(paths)


def test_file_says_what_it_is(dem, tmp_path):
    """Compound CRS, unit, nodata, statistics, area, provenance, overviews, transform."""
    path = tmp_path / "a.dem.tif"
    write_dem(path, dem, {"source": "a.laz"})
    with rasterio.open(path) as file:
        assert file.nodata == -9999
        assert file.dtypes == ("float32",)
        assert file.units == ("metre",)
        assert file.descriptions == ("elevation, bare earth",)
        assert file.tags()["AREA_OR_POINT"] == "Area"
        assert file.tags()["source"] == "a.laz"
        assert file.overviews(1) == [2]
        assert file.block_shapes == [(512, 512)]
        assert "DHHN2016" in file.crs.to_wkt()
        assert file.bounds.left == dem.grid.left
        assert file.bounds.top == dem.grid.top
        z = file.read(1, masked=True)
        statistics = {name[11:]: float(value) for name, value in file.tags(1).items()}
    known = z.compressed().astype(float)
    assert statistics["MINIMUM"] == pytest.approx(known.min(), rel=1e-9)
    assert statistics["MAXIMUM"] == pytest.approx(known.max(), rel=1e-9)
    assert statistics["MEAN"] == pytest.approx(known.mean(), rel=1e-9)
    assert statistics["STDDEV"] == pytest.approx(known.std(), rel=1e-6)
    assert statistics["VALID_PERCENT"] == pytest.approx(100 * len(known) / z.size, abs=0.01)


def test_file_reads_back(dem, tmp_path):
    """The same heights, grid and CRS; overviews don't mix nodata in."""
    path = tmp_path / "a.dem.tif"
    write_dem(path, dem)
    back = read_dem(path)
    np.testing.assert_array_equal(back.z, dem.z)
    assert (back.grid.left, back.grid.top, back.grid.cell) == (
        dem.grid.left, dem.grid.top, dem.grid.cell
    )  # fmt: skip
    assert back.unit == "metre"
    facts = read_profile(path)
    assert facts["crs_name"] == "ETRS89 / UTM zone 32N + DHHN2016 height"
    assert (facts["width"], facts["cell"], facts["layout"]) == (dem.grid.width, 0.1, "COG")
    assert facts["statistics"] == back.statistics
    assert back.wkt is not None
    assert back.wkt.startswith("COMPOUNDCRS")
    with rasterio.open(path, overview_level=0) as file:
        small = file.read(1, masked=True)
    assert dem.z_min <= small.min() <= small.max() <= dem.z_max


def test_bytes_are_deterministic(dem, tmp_path):
    """Two writes give the same bytes."""
    for name in ("a.tif", "b.tif"):
        write_dem(tmp_path / name, dem, {"b": "1", "a": "2"})
    assert (tmp_path / "a.tif").read_bytes() == (tmp_path / "b.tif").read_bytes()


def test_layers_hold_the_arrays(dem, tmp_path):
    """flag, count and distance as in memory."""
    for kind, dtype in (("flag", "uint8"), ("count", "uint32"), ("distance", "float32")):
        path = tmp_path / f"{kind}.tif"
        write_layer(path, dem, kind)
        with rasterio.open(path) as file:
            assert file.dtypes == (dtype,)
            np.testing.assert_array_equal(file.read(1), getattr(dem, kind))


def test_odd_dems_can_be_written(tmp_path):
    """No CRS, all void, a single cell: valid files."""
    for number, points in enumerate((gather(), ground([1.0], [2.0], [3.0]))):
        small = make_dem(points, CrsInfo(), 1.0)
        path = tmp_path / f"{number}.tif"
        write_dem(path, small)
        assert cog_validate(path, strict=True)[0]
        assert check_dem(path) == []
        back = read_dem(path)
        assert back.wkt is None
        assert back.z.shape == (1, 1)
        assert np.isnan(back.z[0, 0]) == (number == 0)
        write_layer(path, small, "distance")


def test_spilled_dem_gives_the_same_file(tmp_path):
    """Where the arrays live changes nothing."""
    x, y, z = hills(500)
    for name, budget in (("a", None), ("b", 0)):
        with Scratch(budget) as scratch:
            points = ground(x, y, z, scratch=scratch)
            write_dem(tmp_path / name, make_dem(points, crs_info(), 0.5, scratch=scratch))
            points.close()
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_failures_are_ours(dem, tmp_path):
    """A folder that isn't there, a CRS that isn't one, a file that is no TIFF, a damaged one."""
    with pytest.raises(OutputError, match="can't be written"):
        write_dem(tmp_path / "none" / "a.tif", dem)
    with pytest.raises(OutputError, match="can't be written"):
        write_dem(tmp_path / "a.tif", replace(dem, crs=CrsInfo(wkt2="nonsense")))
    with pytest.raises(InputNotFoundError):
        read_dem(tmp_path / "a.tif")
    path = tmp_path / "b.tif"
    path.write_bytes(b"nonsense")
    with pytest.raises(FormatError, match="not a readable GeoTIFF"):
        read_dem(path)
    assert [code for code, _, _ in check_dem(path)] == ["E_CORRUPT"]
    write_dem(path, dem)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    assert check_dem(path)[0][0] == "E_CORRUPT"


def test_the_bytes_do_not_depend_on_the_number_of_threads(dem, tmp_path, monkeypatch):
    """Twelve tiles and their overviews, of noise: nothing packs at the same speed."""
    noise = np.random.default_rng(0).normal(size=(3 * 512, 4 * 512)).astype(np.float32)
    noise[:512, :512] = 0
    large = replace(dem, z=noise, grid=replace(dem.grid, width=4 * 512, height=3 * 512))
    written = set()
    for threads in (1, 2, 4, 4):
        monkeypatch.setattr("volatool.resources.n_threads", lambda n=threads: n)
        write_dem(tmp_path / "a.dem.tif", large)
        written.add((tmp_path / "a.dem.tif").read_bytes())
    assert len(written) == 1


@pytest.mark.parametrize(("share", "n"), [("1", 1), ("0", None), ("", None), ("x", None)])
def test_threads_are_the_cores_or_the_share_of_a_pool(monkeypatch, share, n):
    from volatool import resources

    monkeypatch.setenv("RAYON_NUM_THREADS", share)
    assert resources.n_threads() == (n or resources.n_cores())
