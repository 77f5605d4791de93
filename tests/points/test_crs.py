"""CRS and units per axis from WKT and GeoTIFF keys: both, one, broken, none, wrong."""

from __future__ import annotations

import io
import struct
from fractions import Fraction
from typing import Any

import pyproj
import pytest
from naive_points import geokeys, las_bytes, vlr

from volatool.errors import CodedWarning, CRSError
from volatool.model import Bounds, CrsInfo
from volatool.points import crs_file
from volatool.points.crs import crs_from_user, describe
from volatool.points.crs_places import latlon, utm_for
from volatool.points.geokeys import read_geokeys
from volatool.points.reader import open_points

FOOT, US_FOOT = Fraction(3048, 10000), Fraction(1200, 3937)
UTM = ((500_000_00, 5_400_000_00, 100), (500_100_00, 5_400_100_00, 900))


def wkt(code: str, version: str = "WKT1_GDAL") -> bytes:
    text = pyproj.CRS.from_user_input(code).to_wkt(version)
    return vlr("LASF_Projection", 2112, text.encode() + b"\0")


def crs_of(
    *vlrs: bytes, points: Any = UTM, crs: str | None = None, default: str | None = None, **las: Any
) -> tuple[CrsInfo, list[str]]:
    data = las_bytes(points, vlrs=vlrs, **las)
    with open_points(io.BytesIO(data), crs=crs, crs_default=default) as source:
        return source.crs, [w.code for w in source.warnings]


def test_no_crs() -> None:
    """A warning; everything is unknown; heights count like lengths."""
    crs, codes = crs_of()
    assert codes == ["W_NO_CRS"]
    assert crs == CrsInfo()
    assert crs.z_ratio == 1


@pytest.mark.parametrize("version", ["WKT1_GDAL", "WKT1_ESRI", "WKT2_2015", "WKT2_2019"])
def test_wkt_of_any_age(version: str) -> None:
    """Comes out as WKT2:2019."""
    crs, codes = crs_of(wkt("EPSG:32632", version))
    assert (crs.horizontal, crs.epsg, crs.source) == ("EPSG:32632", 32632, "wkt")
    assert crs.wkt2 is not None
    assert crs.wkt2.startswith("PROJCRS")
    assert (crs.unit_xy, crs.metres_per_unit_xy) == ("metre", 1)
    assert codes == []


def test_compound_with_mixed_units() -> None:
    """Metres in plan, US survey feet in height: the ratio is exact."""
    crs, codes = crs_of(wkt("EPSG:26910+6360"))
    assert (crs.horizontal, crs.vertical) == ("EPSG:26910", "EPSG:6360")
    assert crs.wkt2 is not None
    assert crs.wkt2.startswith("COMPOUNDCRS")
    assert (crs.unit_xy, crs.unit_z) == ("metre", "US survey foot")
    assert crs.z_ratio == US_FOOT
    assert codes == []


@pytest.mark.parametrize(
    ("code", "unit", "metres"),
    [("EPSG:2994", "foot", FOOT), ("EPSG:2903", "US survey foot", US_FOOT)],
)
def test_feet_are_exact_and_told_apart(code: str, unit: str, metres: Fraction) -> None:
    """They differ by two parts in a million; the unit of heights is not recorded."""
    crs, codes = crs_of(wkt(code, "WKT1_ESRI"))
    assert (crs.unit_xy, crs.metres_per_unit_xy) == (unit, metres)
    assert codes == ["W_Z_UNIT"]


def test_geotiff_code() -> None:
    """The plain case."""
    crs, codes = crs_of(geokeys((1024, 0, 1, 1), (3072, 0, 1, 32632), (3076, 0, 1, 9001)))
    assert (crs.horizontal, crs.source, codes) == ("EPSG:32632", "geotiff", [])


def test_geotiff_vertical_of_the_old_specification() -> None:
    """5103 is NAVD 88; in US survey feet that is EPSG:6360 (tiles/4_6_crop.las)."""
    crs, codes = crs_of(
        geokeys((3072, 0, 1, 2903), (4096, 0, 1, 5103), (4099, 0, 1, 9003)), points=((1, 2, 3),)
    )
    assert (crs.horizontal, crs.vertical) == ("EPSG:2903", "EPSG:6360")
    assert (crs.unit_z, codes) == ("US survey foot", [])


def test_geotiff_unit_outranks_the_unit_of_the_code() -> None:
    """EPSG:26995 is in metres, the file in US survey feet (odd/las_mvk-thin.las)."""
    crs, _ = crs_of(
        geokeys((1024, 0, 1, 1), (3072, 0, 1, 26995), (3076, 0, 1, 9003), (4099, 0, 1, 9003)),
        points=((2_400_000_00, 300_000_00, 0), (2_400_100_00, 300_100_00, 0)),
    )
    assert crs.metres_per_unit_xy == crs.metres_per_unit_z == US_FOOT
    assert crs.horizontal == "EPSG:2255"  # the same projection in feet, found by comparison


def test_geotiff_parameters_without_a_code() -> None:
    """A Lambert projection written out is found to be EPSG:2994 (odd/las_prec3.las)."""
    keys = geokeys(
        (1024, 0, 1, 1),
        (2050, 0, 1, 6152),
        (3072, 0, 1, 32767),
        (3075, 0, 1, 8),
        (3076, 0, 1, 9002),
        (3078, 34736, 1, 2),
        (3079, 34736, 1, 3),
        (3084, 34736, 1, 1),
        (3085, 34736, 1, 0),
        (3086, 34736, 1, 4),
    )
    numbers = vlr(
        "LASF_Projection",
        34736,
        struct.pack("<5d", 41.75, -120.5, 43.0, 45.5, 1312335.958),
    )
    crs, _ = crs_of(
        keys, numbers, points=((637_000_00, 850_000_00, 0), (638_000_00, 851_000_00, 0))
    )
    assert crs.horizontal == "EPSG:2994"


@pytest.mark.parametrize("method", [1, 9, 10, 11])
def test_other_methods_by_parameters(method: int) -> None:
    """Transverse Mercator, Lambert 1SP and azimuthal, Albers: no crash, right unit."""
    keys = geokeys(
        (1024, 0, 1, 1), (2048, 0, 1, 4326), (3072, 0, 1, 32767), (3075, 0, 1, method),
        (3076, 0, 1, 9001), (3078, 34736, 1, 0), (3079, 34736, 1, 1), (3080, 34736, 1, 2),
        (3081, 34736, 1, 0), (3082, 34736, 1, 3), (3092, 34736, 1, 4),
    )  # fmt: skip
    numbers = vlr("LASF_Projection", 34736, struct.pack("<5d", 45.0, 50.0, 9.0, 5e5, 0.9996))
    crs, codes = crs_of(keys, numbers)
    assert crs.wkt2 is not None
    assert (crs.unit_xy, codes) == ("metre", [])


def test_a_lone_unit_is_kept() -> None:
    """Keys without a CRS but with units (odd/test_noepsg_043500_629205_IGN69.laz)."""
    crs, codes = crs_of(geokeys((3076, 0, 1, 9003), (4099, 0, 1, 9001)))
    assert (crs.wkt2, crs.unit_xy, crs.unit_z) == (None, "US survey foot", "metre")
    assert codes == ["W_NO_CRS"]


def test_both_agree() -> None:
    """No warning; the vertical part of the keys completes the WKT."""
    keys = geokeys((3072, 0, 1, 32632), (4096, 0, 1, 5783), (4099, 0, 1, 9001))
    crs, codes = crs_of(keys, wkt("EPSG:32632"))
    assert (crs.horizontal, crs.vertical, codes) == ("EPSG:32632", "EPSG:5783", [])


def test_both_disagree() -> None:
    """WKT is used and it is said."""
    crs, codes = crs_of(geokeys((3072, 0, 1, 32631)), wkt("EPSG:32632"))
    assert (crs.horizontal, codes) == ("EPSG:32632", ["W_CRS_MISMATCH"])


def test_names_may_differ_when_the_places_agree() -> None:
    """ETRS89 and WGS 84 zone 32 are the same to a metre: no warning."""
    crs, codes = crs_of(geokeys((3072, 0, 1, 32632)), wkt("EPSG:25832"))
    assert (crs.horizontal, codes) == ("EPSG:25832", [])


def test_keys_that_say_what_the_wkt_says_are_not_looked_up(monkeypatch) -> None:
    """To find their code takes longer than all else; other keys are."""
    described = []

    def counted(crs: pyproj.CRS, source: str) -> CrsInfo:
        described.append(source)
        return describe(crs, source)

    monkeypatch.setattr(crs_file, "describe", counted)
    record = wkt("EPSG:25832")
    crs, codes = crs_of(geokeys((3072, 0, 1, 25832)), record)
    assert (crs.horizontal, crs.source, codes) == ("EPSG:25832", "wkt", [])
    assert described == ["wkt"]
    crs_of(geokeys((3072, 0, 1, 32632)), record)
    assert described == ["wkt", "wkt", "geotiff"]


@pytest.mark.parametrize("text", [b"PROJCS[broken", b"\xff\xfe\xfd", b"hello"])
def test_broken_wkt_falls_back_to_the_keys(text: bytes) -> None:
    """With a warning."""
    broken = vlr("LASF_Projection", 2112, text)
    crs, codes = crs_of(geokeys((3072, 0, 1, 32632)), broken)
    assert (crs.horizontal, codes) == ("EPSG:32632", ["W_CRS_BROKEN"])
    crs, codes = crs_of(broken)
    assert (crs.wkt2, codes) == (None, ["W_CRS_BROKEN", "W_NO_CRS"])


@pytest.mark.parametrize(
    "directory",
    [
        b"",
        b"\x01",
        struct.pack("<4H", 1, 1, 0, 9999),
        struct.pack("<8H", 1, 1, 0, 1, 2062, 34736, 9, 9),
    ],
)
def test_broken_key_directories(directory: bytes) -> None:
    """Rows that point nowhere are left out."""
    crs, codes = crs_of(vlr("LASF_Projection", 34735, directory))
    assert (crs.wkt2, codes) == (None, ["W_NO_CRS"])
    assert read_geokeys(directory) == {}


@pytest.mark.parametrize("code", [65535, 12345, 32800])
def test_codes_that_do_not_exist(code: int) -> None:
    """odd/test_pdalfail_0643_6319_LA93_IGN69.laz has 65535."""
    crs, codes = crs_of(geokeys((3072, 0, 1, code)))
    assert (crs.wkt2, codes) == (None, ["W_CRS_BROKEN", "W_NO_CRS"])


@pytest.mark.parametrize("code", ["EPSG:4326", "EPSG:4978"])
def test_labels_that_the_coordinates_disprove(code: str) -> None:
    """Degrees and geocentric labels on eastings and northings (tiles/lone-star.copc.laz)."""
    crs, codes = crs_of(wkt(code))
    assert (crs.wkt2, codes) == (None, ["W_CRS_BROKEN", "W_NO_CRS"])


def test_degrees() -> None:
    """Are reported as such, with the zone to give to --to-crs."""
    crs, codes = crs_of(wkt("EPSG:4326"), points=((430, 5200, 1),))
    assert (crs.is_geographic, crs.unit_xy, codes) == (True, "degree", [])
    assert crs.metres_per_unit_xy is None
    assert utm_for(crs, Bounds(4.3, 52.0, 4.3, 52.0)) == "EPSG:32631"


def test_flag_of_the_header() -> None:
    """LAS 1.4 says in a bit whether the CRS is WKT; both disagreements are warned of."""
    _, codes = crs_of(wkt("EPSG:32632"), minor=4, point_format=6, encoding=0)
    assert codes == ["W_WKT_FLAG"]
    _, codes = crs_of(wkt("EPSG:32632"), minor=4, point_format=6, encoding=16)
    assert codes == []
    _, codes = crs_of(geokeys((3072, 0, 1, 32632)), minor=4, point_format=3, encoding=16)
    assert codes == ["W_WKT_FLAG"]
    _, codes = crs_of(geokeys((3072, 0, 1, 32632)), minor=4, point_format=6)
    assert codes == ["W_WKT_FLAG"]


def test_override_and_default_differ() -> None:
    """One outranks the file, the other serves only without a CRS in it."""
    crs, codes = crs_of(wkt("EPSG:32632"), crs="EPSG:28992+5709")
    assert (crs.horizontal, crs.vertical, crs.source) == ("EPSG:28992", "EPSG:5709", "override")
    assert codes == []
    crs, _ = crs_of(wkt("EPSG:32632"), default="EPSG:28992")
    assert (crs.horizontal, crs.source) == ("EPSG:32632", "wkt")
    crs, codes = crs_of(default="EPSG:28992")
    assert (crs.horizontal, crs.source, codes) == ("EPSG:28992", "default", [])


@pytest.mark.parametrize("text", ["EPSG:99999", "nonsense", "", "EPSG:28992+99999"])
def test_a_crs_that_is_not_known(text: str) -> None:
    """E_CRS with what to give."""
    with pytest.raises(CRSError, match="give EPSG:x") as caught:
        crs_from_user(text)
    assert caught.value.code == "E_CRS"


@pytest.mark.parametrize(
    "text",
    [
        "EPSG:4979",
        'LOCAL_CS["site",UNIT["metre",1]]',
        "+proj=utm +zone=32 +ellps=bessel +towgs84=1,2,3,0,0,0,0 +units=us-ft",
        'ENGCRS["x",EDATUM["d"],CS[Cartesian,2],AXIS["a",unspecified],AXIS["b",unspecified],LENGTHUNIT["metre",1]]',
    ],
)
def test_unusual_kinds_do_not_crash(text: str) -> None:
    """3-D, local, bound."""
    crs = crs_from_user(text)
    assert crs.wkt2
    latlon(crs, 1.0, 2.0)
    utm_for(crs, Bounds(0, 0, 1, 1))


@pytest.mark.parametrize(("text", "kind"), [("EPSG:4978", "geocentric"), ("EPSG:5703", "vertical")])
def test_a_crs_that_is_no_map_is_refused(text: str, kind: str) -> None:
    """Geocentric, or heights alone."""
    with pytest.raises(CRSError, match=f"is {kind}"):
        crs_from_user(text)


def test_bound_crs_keeps_its_horizontal_part() -> None:
    """TOWGS84 in old WKT is not part of the name."""
    text = pyproj.CRS.from_user_input("EPSG:31467").to_wkt("WKT1_GDAL")
    spheroid = 'SPHEROID["Bessel 1841",6377397.155,299.1528128,AUTHORITY["EPSG","7004"]],'
    bound = text.replace(spheroid, spheroid + "TOWGS84[598.1,73.7,418.2,0.202,0.045,-2.455,6.7],")
    assert bound != text
    crs, _ = crs_of(vlr("LASF_Projection", 2112, bound.encode()))
    assert crs.horizontal == "EPSG:31467"


@pytest.mark.parametrize(
    ("lon", "lat", "code"),
    [(-123.07, 44.05, 32610), (9.0, -33.0, 32732), (180.0, 1.0, 32601), (5.0, 86.0, 32661)],
)
def test_utm_zones(lon: float, lat: float, code: int) -> None:
    """Of the middle of the bounds."""
    crs = crs_from_user("EPSG:4326")
    assert utm_for(crs, Bounds(lon, lat, lon, lat)) == f"EPSG:{code}"


def test_places() -> None:
    """Latitude first; None where there is none."""
    place = latlon(crs_from_user("EPSG:28992"), 155_000, 463_000)
    assert place is not None
    assert place == pytest.approx((52.155, 5.387), abs=2e-3)
    assert latlon(CrsInfo(), 1, 2) is None
    assert latlon(crs_from_user("EPSG:28992"), float("nan"), 2) is None
    assert latlon(crs_from_user("EPSG:32632"), 1e30, 1e30) is None


def test_warnings_are_coded() -> None:
    """As objects, for the report."""
    with open_points(io.BytesIO(las_bytes())) as source:
        assert all(isinstance(w, CodedWarning) for w in source.warnings)


def test_areas_of_use_hold_the_places_that_proj_says() -> None:
    """Asked for a cell of a degree and then looked through: the same, in the same order."""
    kind = [pyproj.enums.PJType.PROJECTED_CRS]
    for lon, lat in [(-123.0, 44.0), (180.0, -17.5), (-180.0, -17.5), (9.0, 48.0), (-179.9, 65.0)]:
        here = pyproj.aoi.AreaOfInterest(lon, lat, lon, lat)
        wanted = pyproj.database.query_crs_info("EPSG", kind, here, contains=True)
        assert wanted
        every = pyproj.database.query_crs_info("EPSG", kind)
        held = [one.code for one in every if crs_file._holds(one.area_of_use, lon, lat)]
        assert held == [one.code for one in wanted]
        for one in wanted[::9]:
            text = pyproj.CRS.from_epsg(int(one.code)).to_wkt()
            west, south = min(int(lon // 1), 179), min(int(lat // 1), 89)
            near = crs_file._equals_near(text, west, south)
            assert int(one.code) in [code for code, _ in near]
