"""Models from VOLA files: the voxels' centres, in the right units, with the right names."""

from __future__ import annotations

import math

import jsonschema
import numpy as np
import pytest
from making_tiles import write_las

from volatool.dem.raster import read_dem
from volatool.errors import CRSError, FormatError, OptionError, ResourceError
from volatool.options import ConvertOptions
from volatool.report import schema
from volatool.tile import convert_tile

CRS = "EPSG:25832"


def slope(path, *, code=2, n=60_000, crs=CRS, per_unit=(1.0, 1.0)):
    """Write points of z = 50 + 0.3 x - 0.2 y (m) on 64 m x 64 m; per_unit: metres per unit."""
    rng = np.random.default_rng(0)
    x, y = rng.uniform(0, 64, (2, n))
    z = 50 + 0.3 * x - 0.2 * y
    xyz = np.column_stack([x / per_unit[0], y / per_unit[0], z / per_unit[1]])
    codes = np.full(n, code, np.uint8)
    return write_las(path, np.round(xyz * 100), crs=crs, classification=codes)


def volume(tile, **options):
    """Convert a tile to volumes; return the report and the folder."""
    options = {"depth": 3, "dem": False, "dense": "always", **options}
    return convert_tile(tile, ConvertOptions(**options), outdir=tile.parent, overwrite=True)


def model(path, **options):
    """Return report and model of a VOLA file."""
    report = convert_tile(
        path, ConvertOptions(**options), kind="dem", outdir=path.parent / "out", overwrite=True
    )
    jsonschema.validate(report.to_dict(), schema())
    return report, read_dem(report.paths[0])


def truth(dem):
    row, col = np.mgrid[: dem.grid.height, : dem.grid.width]
    x = dem.grid.left + dem.grid.cell * (col + 0.5)
    y = dem.grid.top - dem.grid.cell * (row + 0.5)
    return 50 + 0.3 * x - 0.2 * y


@pytest.mark.parametrize("suffix", [".vol.gz", ".dvol.gz", ".vol", ".dvol"])
def test_a_slope_is_found_to_half_a_voxel(tmp_path, suffix):
    """Of every kind of file; void where the points are none."""
    made = volume(slope(tmp_path / "t.las"), gzip=suffix.endswith("gz"))
    edge = made.choice["cell"]
    report, dem = model(tmp_path / f"t{suffix}", cell=1)
    assert np.abs(dem.z - truth(dem)).max() < edge / 2
    assert (dem.grid.width, dem.grid.height) == (64, 64)  # of the points' box, not of the cube
    assert report.dem["noise_sigma"] == pytest.approx(edge / math.sqrt(12))
    assert (report.dem["surface"], report.dem["ground_source"]) == ("dtm", "voxels (class 2)")
    assert report.cube["side"] == made.cube["side"]
    assert report.warnings == ()
    assert dem.wkt.startswith("PROJCRS[")


@pytest.mark.parametrize(
    ("surface", "source", "off"),
    [
        ("dsm", "top voxels", 0.8),
        ("min", "lowest voxel per cell", 1.0),
        ("max", "highest voxel per cell", 1.0),
        ("mean", "mean of the voxels per cell", 0.5),
        ("idw", "voxels (class 2)", 0.5),
        ("tin", "voxels (class 2)", 0.75),
    ],
)
def test_surfaces_have_honest_names(tmp_path, surface, source, off):
    made = volume(slope(tmp_path / "t.las"))
    report, dem = model(tmp_path / "t.vol.gz", cell=2, surface=surface)
    assert (report.dem["surface"], report.dem["ground_source"]) == (surface, source)
    edge = made.choice["cell"]
    assert np.nanmax(np.abs(dem.z - truth(dem))) < edge * off + 0.5 * (surface in ("min", "max"))


def test_dsm_is_the_top_of_each_column(tmp_path):
    """A roof over ground: dsm is the roof, bare earth the ground."""
    rng = np.random.default_rng(0)
    x, y = rng.uniform(0, 64, (2, 40_000))
    roof = (x > 20) & (x < 44) & (y > 20) & (y < 44) & (rng.random(len(x)) < 0.7)
    xyz = np.round(np.column_stack([x, y, np.where(roof, 12.3, 2.1)]) * 100)
    codes = np.where(roof, 6, 2).astype(np.uint8)
    volume(write_las(tmp_path / "t.las", xyz, crs=CRS, classification=codes))
    inside = slice(26, 38), slice(26, 38)
    for surface, height in (("dsm", 12.3), ("dtm", 2.1), ("max", 12.3), ("min", 2.1)):
        found = model(tmp_path / "t.vol.gz", cell=1, surface=surface)[1].z[inside]
        assert abs(np.median(found) - height) <= 0.51, surface
    volume(tmp_path / "t.las", meta=())
    report, dem = model(tmp_path / "t.vol.gz", cell=1)
    assert report.dem["ground_source"] == "ground filter on voxels"
    assert np.abs(dem.z[inside] - 2.1).max() < 0.6
    (warning,) = report.warnings
    assert warning.code == "W_NO_GROUND_CLASS"
    assert "no voxel has" in warning.message


def test_heights_are_in_their_own_unit(tmp_path):
    """Feet over metres and the other way: the cube is scaled, the model is not."""
    foot = 0.3048006096012192
    tile = slope(tmp_path / "t.las", crs="EPSG:25832+6360", per_unit=(1.0, foot))
    made = volume(tile)
    report, dem = model(tmp_path / "t.vol.gz", cell=1)
    edge = made.choice["cell"]
    assert np.abs(dem.z * foot - truth(dem)).max() < edge / 2
    assert report.dem["noise_sigma"] == pytest.approx(edge / foot / math.sqrt(12))
    assert dem.unit == "US survey foot"


def test_the_cell_is_at_least_a_voxel(tmp_path):
    made = volume(slope(tmp_path / "t.las", n=300_000), depth=3)
    assert made.choice["cell"] == pytest.approx(1, rel=0.01)
    assert model(tmp_path / "t.vol.gz")[1].grid.cell == 1
    volume(tmp_path / "t.las", depth=2)
    assert model(tmp_path / "t.vol.gz")[1].grid.cell == 5


def test_a_toolkit_file_has_no_crs_but_takes_one(tmp_path):
    """Without a trailer: file units and W_NO_CRS, the box of the voxels; --crs names it."""
    tile = slope(tmp_path / "t.las")
    convert_tile(
        tile,
        ConvertOptions(compat="toolkit", depth=3, dem=False),
        outdir=tmp_path,
        overwrite=True,
    )
    report, dem = model(tmp_path / "t.vol.gz", cell=1, surface="dsm")
    assert "W_NO_CRS" in [warning.code for warning in report.warnings]
    assert dem.wkt is None
    assert np.nanmax(np.abs(dem.z - truth(dem))) < 1.0
    for name in ("crs", "crs_default"):
        report, dem = model(tmp_path / "t.vol.gz", cell="1m", surface="dsm", **{name: CRS})
        assert report.input["crs"]["horizontal"] == CRS
        assert "W_NO_CRS" not in [warning.code for warning in report.warnings]
        assert dem.wkt.startswith("PROJCRS[")
    with pytest.raises(CRSError) as error:
        model(tmp_path / "t.vol.gz", crs="EPSG:4326")
    assert error.value.code == "E_GEOGRAPHIC"


def test_what_needs_points_is_refused(tmp_path):
    volume(slope(tmp_path / "t.las", n=3000))
    path = tmp_path / "t.vol.gz"
    for options, name in (
        ({"classes": (2,)}, "--class"),
        ({"bounds": (0, 0, 9, 9)}, "--bounds"),
        ({"to_crs": "utm"}, "--to-crs"),
        ({"neighbours": "x", "cell": 1}, "--neighbours"),
    ):
        with pytest.raises(OptionError, match=f"{name}: a volume has no points"):
            model(path, **options)
    with pytest.raises(FormatError, match="`volatool dem` makes") as error:
        convert_tile(path, ConvertOptions(), outdir=tmp_path / "out")
    assert error.value.code == "E_NOT_LAS"
    (tmp_path / "bad.vol.gz").write_bytes(path.read_bytes()[:60])
    with pytest.raises(FormatError):
        model(tmp_path / "bad.vol.gz")
    assert not (tmp_path / "out").exists()


def test_more_voxels_than_memory_are_refused(tmp_path, monkeypatch):
    from volatool.dem import from_volume

    volume(slope(tmp_path / "t.las", n=3000))
    monkeypatch.setattr(from_volume, "VOXEL_BYTES", 1 << 30)
    with pytest.raises(ResourceError, match="smaller --depth") as error:
        model(tmp_path / "t.vol.gz")
    assert error.value.code == "E_MEMORY"
    assert not (tmp_path / "out").exists()


def test_a_volume_without_voxels_is_empty(tmp_path):
    from making_volumes import volume_of

    from volatool.formats.sparse import write

    path = tmp_path / "none.vol"
    with path.open("wb") as file:
        write(file, volume_of([], 1, metadata=False))
    report = convert_tile(path, ConvertOptions(), kind="dem")
    assert (report.status, report.dem, report.paths) == ("empty", None, [])
    assert "W_EMPTY" in [warning.code for warning in report.warnings]


@pytest.mark.shared
def test_a_real_volume_gives_the_model_of_its_points(shared, tmp_path):
    """Voxels of 0.2 ft (0.28 m) of ground-classed tiles: within a third of a voxel, rms."""
    for name in ("tiles/4_6_crop.las", "golden/inputs/lidR-Topography.laz"):
        tile = shared / name
        stem = tile.stem
        options = ConvertOptions(cell="1m", depth=5, dense="never")
        made = convert_tile(tile, options, outdir=tmp_path)
        points = read_dem(tmp_path / f"{stem}.dem.tif")
        _, voxels = model(tmp_path / f"{stem}.vol.gz", cell="1m")
        assert voxels.grid == points.grid
        rise = (voxels.z - points.z)[~np.isnan(voxels.z - points.z)]
        assert np.sqrt(np.mean(rise**2)) < made.choice["cell"] / 3
        assert abs(rise.mean()) < made.choice["cell"] / 20
