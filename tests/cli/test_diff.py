"""``volatool diff``."""

from __future__ import annotations

import json
from importlib.resources import files

import jsonschema
import making_volumes as making
import numpy as np
import pytest
from click.testing import CliRunner

from volatool.cube import Cube
from volatool.encodings import Encoding, write_volume
from volatool.points.crs import crs_from_user
from volatool.points.crs_places import lonlat
from volatool.vola.volume import VolumeInfo
from volatool_cli.main import cli

CUBE = Cube((500000.0, 5400000.0, 200.0), 32.0)
CRS = crs_from_user("EPSG:25832+7837")
GROUND = {(x, y, 20) for x in range(40) for y in range(40)}
HOUSE = {(x, y, z) for x in range(12, 22) for y in range(17, 25) for z in range(21, 27)}


def write(path, voxels, *, crs=CRS, cube=CUBE, depth=3, **info):
    volume = making.volume_of(voxels, depth, metadata=False, cube=cube,
                              info=VolumeInfo(crs=crs, epsg=crs.epsg, **info))  # fmt: skip
    with path.open("wb") as stream:
        write_volume(stream, volume, Encoding("sparse", 1, "gzip"))
    return str(path)


@pytest.fixture
def epochs(tmp_path, monkeypatch):
    """Ground before, ground with a house and a bird after."""
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "may.vol.gz", GROUND, source_name="may.laz", n_points=3)
    write(tmp_path / "june.vol.gz", GROUND | HOUSE | {(30, 30, 50)})
    return tmp_path


def run(*arguments):
    return CliRunner().invoke(cli, ["diff", *map(str, arguments)])


def is_valid(document):
    schema = json.loads(files("volatool").joinpath("diff.schema.json").read_text(encoding="utf-8"))
    jsonschema.validate(document, schema)
    return True


def test_the_document_has_counts_and_volumes(epochs):
    done = run("may.vol.gz", "june.vol.gz")
    assert done.exit_code == 0, done.output
    assert done.stderr == ""
    document = json.loads(done.stdout)
    assert is_valid(document)
    assert document["a"] == {"name": "may.vol.gz", "source": "may.laz", "points": 3,
                             "voxels": 1600, "volume": 200.0, "volume_m3": 200.0}  # fmt: skip
    assert document["both"]["voxels"] == 1600
    assert document["added"]["voxels"] == 481
    assert document["added"]["significant"]["voxels"] == 401
    assert document["removed"]["voxels"] == 0
    places = document["places"]
    assert (places["changed"], places["significant"], places["edge"]) == (10, 9, 2.0)
    assert places["added"] == {"voxels": 480, "volume": 60.0, "volume_m3": 60.0}
    surface = document["surface"]
    assert (surface["columns_both"], surface["columns_added"]) == (1600, 0)
    assert surface["raised"]["volume"] == 60.0 + 30 / 8  # and the bird
    assert document["grid"]["crs"]["horizontal"] == "EPSG:25832"
    assert run("may.vol.gz", "june.vol.gz").stdout == done.stdout


def test_cubic_feet_become_cubic_metres(tmp_path):
    feet = crs_from_user("EPSG:2994")
    a = write(tmp_path / "a.vol.gz", GROUND, crs=feet)
    b = write(tmp_path / "b.vol.gz", GROUND | HOUSE, crs=feet)
    document = json.loads(run(a, b).stdout)
    assert document["added"]["volume"] == 60.0
    assert document["added"]["volume_m3"] == pytest.approx(60 * 0.3048**3)


def test_geojson_is_rectangles_in_degrees(epochs):
    """RFC 7946: longitude and latitude, rings counterclockwise and closed; GDAL's reader agrees."""
    done = run("may.vol.gz", "june.vol.gz", "--format", "geojson")
    collection = json.loads(done.stdout)
    assert len(done.stdout.splitlines()) == 10 + 2
    assert "crs" not in collection
    assert is_valid(collection["volatool"])
    features = collection["features"]
    assert [f["properties"]["significant"] for f in features].count(True) == 9
    total = 0
    for feature in features:
        (ring,) = feature["geometry"]["coordinates"]
        assert ring[0] == ring[-1]
        assert len(ring) == 5
        x, y = np.array(ring).T
        assert 0 < np.sum((x[1:] - x[:-1]) * (y[1:] + y[:-1])) * -0.5 < 1e-9
        properties = feature["properties"]
        total += properties["added"]
        assert properties["significance"] == pytest.approx(
            properties["significant_added"] / properties["added"], abs=1e-4
        )
        block = np.array(properties["block"]) * 2.0
        corner = lonlat(CRS, np.array([500000 + block[0]]), np.array([5400000 + block[1]]))
        assert ring[0] == pytest.approx([corner[0][0], corner[1][0]], abs=1e-8)
    assert total == 481
    assert features[0]["properties"]["z_min"] == 210.5
    assert features[0]["properties"]["z_max"] == 213.5
    assert features[0]["properties"]["volume_added"] == features[0]["properties"]["added"] / 8


def test_geojson_is_cut_at_the_antimeridian(tmp_path):
    """RFC 7946, 3.1.9: no rectangle reaches round the globe."""
    import shapely
    from pyproj import Transformer

    to_utm = Transformer.from_crs("EPSG:4326", "EPSG:32760", always_xy=True)
    x, y = to_utm.transform(180.0, -17.0)  # Taveuni, Fiji
    cube = Cube((round(x) - 15.0, round(y) - 15.0, 0.0), 32.0)
    grids = {"crs": crs_from_user("EPSG:32760"), "cube": cube}
    a = write(tmp_path / "a.vol.gz", set(), **grids)
    b = write(tmp_path / "b.vol.gz", {(i, j, 0) for i in range(64) for j in range(64)}, **grids)
    collection = json.loads(run(a, b, "--format", "geojson").stdout)
    kinds = {"Polygon": 0, "MultiPolygon": 0}
    shapes = [shapely.geometry.shape(feature["geometry"]) for feature in collection["features"]]
    for shape in shapes:
        kinds[shape.geom_type] += 1
        parts = getattr(shape, "geoms", [shape])
        assert all(part.is_valid and part.exterior.is_ccw for part in parts)
        assert all(part.bounds[2] - part.bounds[0] < 1e-4 for part in parts)
    assert kinds == {"Polygon": 240, "MultiPolygon": 16}
    one = next(shape.area for shape in shapes if shape.geom_type == "Polygon")
    assert sum(shape.area for shape in shapes) == pytest.approx(256 * one, rel=1e-3)


def test_geojson_in_the_volumes_crs_and_only_what_is_significant(epochs):
    done = run("may.vol.gz", "june.vol.gz", "--format", "geojson", "--keep-crs", "--significant",
               "--by", "block", "--level", 2)  # fmt: skip
    collection = json.loads(done.stdout)
    assert collection["crs"]["properties"]["name"] == "urn:ogc:def:crs:EPSG::25832"
    (first, *_) = collection["features"]
    assert first["geometry"]["coordinates"] == [
        [[500000.0, 5400008.0], [500008.0, 5400008.0], [500008.0, 5400016.0],
         [500000.0, 5400016.0], [500000.0, 5400008.0]]
    ]  # fmt: skip
    assert first["properties"]["block"] == [0, 1, 1]
    assert all(feature["properties"]["significant"] for feature in collection["features"])


def test_gdal_knows_where_it_is(epochs):
    """Both forms, as QGIS opens them."""
    pyogrio = pytest.importorskip("pyogrio")
    x, y = lonlat(CRS, np.array([500000.0]), np.array([5400000.0]))
    for options, crs, corner in (([], "EPSG:4326", (x[0], y[0])),
                                 (["--keep-crs"], "EPSG:25832", (500000, 5400000))):  # fmt: skip
        assert run("may.vol.gz", "june.vol.gz", "--format", "geojson", "-o", "x.geojson",
                   "--overwrite", *options).exit_code == 0  # fmt: skip
        info = pyogrio.read_info("x.geojson")
        assert (info["crs"], info["features"], info["geometry_type"]) == (crs, 10, "Polygon")
        low = np.array(info["total_bounds"][:2])
        assert np.abs(low - corner).max() < (20 if "--keep-crs" in options else 20 / 70_000)


def test_without_a_crs_coordinates_stay_and_it_is_told(tmp_path):
    nothing = making.VolumeInfo().crs
    a = write(tmp_path / "a.vol.gz", GROUND, crs=nothing)
    b = write(tmp_path / "b.vol.gz", HOUSE | GROUND, crs=nothing)
    done = run(a, b, "--format", "geojson")
    assert done.exit_code == 0
    assert done.stderr.startswith("W_NO_CRS: a.vol.gz, b.vol.gz: ")
    collection = json.loads(done.stdout)
    assert "crs" not in collection
    assert collection["features"][0]["geometry"]["coordinates"][0][0][0] >= 500000
    assert json.loads(run(a, b).stdout)["added"]["volume_m3"] is None
    assert "60 unit3" in run(a, b, "--format", "text").stdout
    empty = json.loads(run(a, a, "--format", "geojson").stdout)
    assert empty["features"] == []


def test_text_is_for_people(epochs):
    done = run("may.vol.gz", "june.vol.gz", "--format", "text")
    assert "added (B only)" in done.stdout
    assert "9 of 10 changed columns of 2 metre are significant" in done.stdout
    assert "in them 60 m3 added, 0 m3 removed" in done.stdout


def test_a_gate_for_scripts(epochs):
    """Status 6 above the limit, with the document printed all the same."""
    for limit, status in ((0, 6), (59.9, 6), (60, 0), (1000, 0)):
        done = run("may.vol.gz", "june.vol.gz", "--fail-above", limit)
        assert done.exit_code == status
        assert json.loads(done.stdout)["schema"] == "volatool.diff/1"
    done = run("may.vol.gz", "june.vol.gz", "--fail-above", 10)
    assert "60 cubic units changed" in done.stderr
    assert run("may.vol.gz", "may.vol.gz", "--fail-above", 0).exit_code == 0
    done = run("may.vol.gz", "june.vol.gz", "--fail-above", "nan")
    assert (done.exit_code, done.stdout) == (2, "")
    assert "nan is not in the range x>=0" in done.stderr


def test_a_file_is_written_whole_and_no_input_replaced(epochs):
    done = run("may.vol.gz", "june.vol.gz", "--format", "geojson", "-o", "out.geojson")
    assert (done.exit_code, done.stdout) == (0, "out.geojson\n")
    printed = run("may.vol.gz", "june.vol.gz", "--format", "geojson").stdout
    assert (epochs / "out.geojson").read_text() == printed
    done = run("may.vol.gz", "june.vol.gz", "-o", "out.geojson")
    assert (done.exit_code, done.stderr.split(":")[0]) == (2, "E_OUTPUT_EXISTS")
    assert run("may.vol.gz", "june.vol.gz", "-o", "out.geojson", "--overwrite").exit_code == 0
    done = run("may.vol.gz", "june.vol.gz", "-o", "/proc/none/out.json")
    assert (done.exit_code, done.stderr.split(":")[0]) == (5, "E_WRITE")
    before = (epochs / "may.vol.gz").read_bytes()
    (epochs / "link.vol.gz").symlink_to("may.vol.gz")
    for name in ("may.vol.gz", "link.vol.gz", "./june.vol.gz"):
        done = run("may.vol.gz", "june.vol.gz", "-o", name, "--overwrite")
        assert (done.exit_code, "is an input" in done.stderr) == (2, True)
    assert (epochs / "may.vol.gz").read_bytes() == before


def test_other_grids_depths_and_reference_systems(epochs):
    write(epochs / "moved.vol.gz", HOUSE, cube=Cube((500000.2, 5400000.0, 200.0), 32.0))
    done = run("may.vol.gz", "moved.vol.gz")
    assert (done.exit_code, done.stderr.split(":")[0]) == (4, "E_GRID")
    assert "may.vol.gz and moved.vol.gz" in done.stderr
    done = run("may.vol.gz", "moved.vol.gz", "--resample")
    assert done.exit_code == 0
    assert done.stderr.startswith("W_RESAMPLED: ")
    document = json.loads(done.stdout)
    assert document["grid"]["resampled"]
    assert [w["code"] for w in document["warnings"]] == ["W_RESAMPLED"]
    write(epochs / "coarse.vol.gz", {(1, 1, 1)}, depth=2)
    done = run("may.vol.gz", "coarse.vol.gz")
    assert done.stderr.startswith("W_DEPTH: ")
    assert json.loads(done.stdout)["grid"]["depth"] == 2
    write(epochs / "zone.vol.gz", HOUSE, crs=crs_from_user("EPSG:25833"))
    done = run("may.vol.gz", "zone.vol.gz")
    assert (done.exit_code, done.stderr.split(":")[0]) == (4, "E_CRS")
    done = run("may.vol.gz", "none.vol.gz")
    assert (done.exit_code, done.stderr.split(":")[0]) == (4, "E_NOT_FOUND")
    done = run("may.vol.gz", "june.vol.gz", "--level", 9)
    assert (done.exit_code, done.stderr.split(":")[0]) == (2, "E_OPTION")


def test_files_of_one_name_in_two_folders_are_told_apart(epochs):
    (epochs / "old").mkdir()
    write(epochs / "old" / "may.vol.gz", GROUND)
    document = json.loads(run("old/may.vol.gz", "may.vol.gz").stdout)
    assert (document["a"]["name"], document["b"]["name"]) == ("old/may.vol.gz", "may.vol.gz")
