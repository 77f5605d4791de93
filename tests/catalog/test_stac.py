"""STAC pages judged by pystac, and by what they are made of."""

from __future__ import annotations

import json
from datetime import UTC, datetime

import numpy as np
import pystac
import pytest
from making_volumes import random_volume

import volatool as vt
from volatool.catalog.footprint import footprint
from volatool.catalog.index import index_folder
from volatool.catalog.stac import Period
from volatool.cube import Cube
from volatool.encodings import Encoding, write_volume
from volatool.errors import OptionError
from volatool.model import Bounds, CrsInfo
from volatool.points.crs import crs_from_user
from volatool.points.crs_places import latlon
from volatool.vola.info import VolumeInfo

UTM = crs_from_user("EPSG:25832+7837")
WHO = {
    "author": "City",
    "license": "CC-BY-4.0",
    "licenseurl": "https://creativecommons.org/licenses/by/4.0/",
    "info": "A town",
}


@pytest.fixture
def folder(tmp_path):
    """Two tiles with a place, a preview beside one."""
    folder = tmp_path / "set"
    folder.mkdir()
    for name, x in (("a", 500000.0), ("b", 500100.0)):
        box = (x + 10, 5400000.0, 300.0, x + 90, 5400070.0, 350.0)
        channels = ({"byte": 5, "name": "intensity", "scale": 1.0, "offset": 0.0, "unit": None,
                     "reduction": "mean"},)  # fmt: skip
        info = VolumeInfo(crs=UTM, epsg=25832, box=box, n_points=1234, channels=channels)
        volume = random_volume(cube=Cube((x, 5400000.0, 300.0), 100.0), info=info)
        with (folder / f"{name}.vol.gz").open("wb") as stream:
            write_volume(stream, volume, Encoding("sparse", 2, "gzip"))
    (folder / "a.preview.png").write_bytes(b"png")
    (folder / "a.stats.json").write_text(
        json.dumps({"input": {"density": {"all_per_area_bbox": 7.5}}})
    )
    index_folder(folder, attribution=WHO, period=Period.parse("2019-05-01/2019-06-30"))
    return folder


@pytest.mark.filterwarnings("ignore:``LocalValidator``:DeprecationWarning")
def test_items_and_collection_are_valid_stac(folder):
    """By pystac: links resolve, required fields, the core schema, extensions' own readers."""
    from pystac.extensions.file import FileExtension
    from pystac.extensions.pointcloud import PointcloudExtension
    from pystac.extensions.projection import ProjectionExtension
    from pystac.validation.local_validator import LocalValidator

    collection = pystac.Collection.from_file(str(folder / "collection.json"))
    assert (collection.license, collection.providers[0].name) == ("CC-BY-4.0", "City")
    assert collection.extent.temporal.intervals == [
        [datetime(2019, 5, 1, tzinfo=UTC), datetime(2019, 6, 30, 23, 59, 59, tzinfo=UTC)]
    ]
    items = list(collection.get_items())
    assert [item.id for item in items] == ["a", "b"]
    check = LocalValidator()
    for page in ("collection", "a.stac", "b.stac"):
        document = json.loads((folder / f"{page}.json").read_text())
        validator = {"Feature": check.item_validator, "Collection": check.collection_validator}
        faults = list(validator[document["type"]]("1.1.0").iter_errors(document))
        assert not faults, faults
    cloud = PointcloudExtension.ext(items[0])
    assert (cloud.count, cloud.type, cloud.encoding, cloud.density) == (1234, "lidar", "VOLA", 7.5)
    assert [(one.name, one.size) for one in cloud.schemas] == [
        ("X", 8), ("Y", 8), ("Z", 8), ("intensity", 1),
    ]  # fmt: skip
    assert [one.position for one in cloud.statistics] == [0, 1, 2]
    assert cloud.statistics[2].maximum == 350.0
    projection = ProjectionExtension.ext(items[0])
    assert projection.code == "EPSG:25832"
    assert "7837" in projection.wkt2
    assert projection.bbox == [500010.0, 5400000.0, 300.0, 500090.0, 5400070.0, 350.0]
    assert set(items[0].assets) == {"volume", "preview", "report"}
    asset = items[0].assets["volume"]
    size = (folder / "a.vol.gz").stat().st_size
    assert FileExtension.ext(asset).size == size
    assert (folder / asset.href).exists()


def test_the_place_is_that_of_the_points(folder):
    """Corners by PROJ, counterclockwise, points along the sides."""
    item = json.loads((folder / "a.stac.json").read_text())
    (ring,) = item["geometry"]["coordinates"]
    ring = np.array(ring)
    assert ring[0].tolist() == ring[-1].tolist()
    assert len(ring) == 33
    lat, lon = latlon(UTM, 500010.0, 5400000.0)
    np.testing.assert_allclose(ring[0], [lon, lat], atol=1e-8)
    x, y = ring.T
    assert np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]) > 0
    assert item["bbox"] == [x.min(), y.min(), x.max(), y.max()]


def test_a_volume_without_crs_has_no_geometry(tmp_path):
    with (tmp_path / "a.vol").open("wb") as stream:
        volume = random_volume(metadata=False, info=VolumeInfo())
        write_volume(stream, volume, Encoding("sparse", 1, "none"))
    indexed = index_folder(tmp_path, attribution=WHO, period=Period.parse("2019-05-01"), name="x")
    assert [warning.code for warning in indexed.warnings] == ["W_STAC_PLACE"]
    item = json.loads((tmp_path / "a.stac.json").read_text())
    assert item["geometry"] is None
    assert "bbox" not in item
    assert item["properties"]["pc:count"] == volume.n_voxels
    assert item["properties"]["datetime"] == "2019-05-01T00:00:00Z"
    assert pystac.Item.from_dict(item).datetime == datetime(2019, 5, 1, tzinfo=UTC)


def test_a_file_without_a_trailer_is_counted_and_placed(tmp_path):
    """As the original writes it: the voxels are counted, the EPSG code gives the place."""
    info = VolumeInfo(crs=UTM, epsg=25832, box=(500000.0, 5400000.0, 0.0, 500100.0, 5400100.0, 9.0))
    volume = random_volume(cube=Cube((500000.0, 5400000.0, 0.0), 100.0), info=info)
    (path,) = vt.export_volume(volume, tmp_path / "a.vol", "vol1").paths
    assert vt.open(path).info.quantizer == "unknown"
    index_folder(tmp_path, attribution=WHO, period=Period.parse("2019-05-01"), name="x")
    item = json.loads((tmp_path / "a.stac.json").read_text())
    properties = item["properties"]
    assert properties["pc:count"] == properties["vola:voxels"] == volume.n_voxels
    assert properties["proj:code"] == "EPSG:25832"
    assert "25832" in properties["proj:wkt2"]
    lat, lon = latlon(UTM, 500000.0, 5400000.0)
    np.testing.assert_allclose(item["bbox"][:2], [lon, lat], atol=1e-5)


def test_a_tile_across_the_antimeridian_is_cut_there():
    """RFC 7946: two polygons, west greater than east; together as large as the tile."""
    crs = crs_from_user("EPSG:32760")
    x, y = 834000.0, 7900000.0  # Fiji: the 180th meridian is near x = 817,000 here
    place = footprint(crs, Bounds(x - 30000, y, x, y + 10000))
    assert place.geometry["type"] == "MultiPolygon"
    west, south, east, north = place.bbox
    assert west > 0 > east
    rings = [np.array(polygon[0]) for polygon in place.geometry["coordinates"]]
    assert rings[0][:, 0].max() == 180
    assert rings[1][:, 0].min() == -180
    width = sum(np.ptp(ring[:, 0]) for ring in rings)
    assert width == pytest.approx(
        30000 / (111320 * np.cos(np.radians((south + north) / 2))), rel=0.02
    )


def test_no_place_on_the_globe():
    assert footprint(CrsInfo(), Bounds(0, 0, 1, 1)) is None
    assert footprint(UTM, Bounds(1e12, 1e12, 2e12, 2e12)) is None


@pytest.mark.parametrize(
    ("text", "start", "end"),
    [
        ("2019-05-01", "2019-05-01T00:00:00Z", None),
        ("2019-05-01T12:00:00+02:00", "2019-05-01T10:00:00Z", None),
        ("2019-05-01/2019-05-01", "2019-05-01T00:00:00Z", "2019-05-01T23:59:59Z"),
    ],
)
def test_periods(text, start, end):
    found = Period.parse(text).to_properties()
    assert (found.get("start_datetime") or found["datetime"]) == start
    assert found.get("end_datetime") == end


@pytest.mark.parametrize(
    "text", ["", "May", "2019-05-02/2019-05-01", "2019/2020/2021", "2019-13-01"]
)
def test_what_is_no_period(text):
    with pytest.raises(OptionError):
        Period.parse(text)
