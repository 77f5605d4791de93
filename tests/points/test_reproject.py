"""Reprojecting while streaming: same interface, exact box, heights left alone or moved."""

from __future__ import annotations

import io
from fractions import Fraction
from typing import Any

import numpy as np
import pyproj
import pytest
from naive_points import las_bytes

from volatool.errors import CRSError, FormatError
from volatool.points.reader import open_points
from volatool.points.reproject import Reprojected

DELFT = (
    (84_900_000, 446_000_000, 1234),
    (85_000_000, 446_100_000, -500),
    (84_950_123, 446_050_456, 7),
)
MM = (0.001, 0.001, 0.001)


def moved(to: str, crs: str | None = "EPSG:28992", **las: Any) -> Reprojected:
    las = {"points": DELFT, "scale": MM, **las}
    return Reprojected(open_points(io.BytesIO(las_bytes(**las)), crs=crs), to)


def test_coordinates_are_those_of_proj() -> None:
    """To half a millimetre; heights bit for bit."""
    transformer = pyproj.Transformer.from_crs("EPSG:28992", "EPSG:32631", always_xy=True)
    with moved("EPSG:32631") as source:
        chunks = list(source.chunks(("classification",), chunk_points=2))
    assert [c.start for c in chunks] == [0, 2]
    xyz = np.vstack([c.xyz() for c in chunks])
    for row, (x, y, z) in zip(xyz, DELFT, strict=True):
        assert row[:2] == pytest.approx(transformer.transform(x / 1000, y / 1000), abs=0.00051)
        assert row[2] == z * 0.001
    assert chunks[0].z.tolist() == [1234, -500]
    assert set(chunks[0].attributes) == {"classification"}


def test_the_box_is_exact() -> None:
    """One pass of tile.py is enough."""
    with moved("utm") as source:
        xyz = np.vstack([c.xyz() for c in source.chunks()])
        assert source.header.box == (*xyz.min(0), *xyz.max(0))
        assert (source.crs.horizontal, source.crs.source) == ("EPSG:32631", "to-crs")
        assert source.header.offset[0] % 1_000_000 == source.header.offset[1] % 1_000_000 == 0
        assert source.header.scale == MM


def test_degrees_to_utm_and_back() -> None:
    """Geographic targets are stored to 1e-7 degrees."""
    with moved("EPSG:4326") as source:
        xyz = np.vstack([c.xyz() for c in source.chunks()])
        assert xyz[0, :2] == pytest.approx((4.3664, 51.9979), abs=1e-3)
        assert source.crs.is_geographic
    degrees = {"points": ((43728, 519960, 5),), "scale": (0.0001, 0.0001, 0.01)}
    with moved("utm", crs="EPSG:4326", **degrees) as source:
        assert source.crs.horizontal == "EPSG:32631"


def test_the_vertical_part_is_kept() -> None:
    """A target without one leaves the heights and their name."""
    with moved("EPSG:32631", crs="EPSG:28992+5709") as source:
        assert (source.crs.horizontal, source.crs.vertical) == ("EPSG:32631", "EPSG:5709")


def test_feet_stay_feet() -> None:
    """Heights of unrecorded unit were in the old horizontal unit, not in the new one."""
    feet = {"points": ((637_000_00, 850_000_00, 400_00),), "scale": (0.01,) * 3}
    with moved("EPSG:32610", crs="EPSG:2994", **feet) as source:
        assert source.crs.metres_per_unit_xy == 1
        assert source.crs.metres_per_unit_z == Fraction(3048, 10000)


def test_heights_are_moved_when_asked() -> None:
    """NAVD 88 from US survey feet to metres."""
    feet = {"points": ((1_600_000_00, 1_500_000_00, 1000_00),), "scale": (0.01,) * 3}
    with moved("EPSG:2903+5703", crs="EPSG:2903+6360", **feet) as source:
        (chunk,) = source.chunks()
    assert chunk.xyz()[0, 2] == pytest.approx(1000 * 1200 / 3937, abs=0.001)


def test_what_cannot_be_done_is_said() -> None:
    """No CRS; unknown target; unknown heights."""
    with pytest.raises(CRSError, match="give it by --crs"):
        moved("EPSG:32631", crs=None)
    with pytest.raises(CRSError, match="is not known"):
        moved("EPSG:99999")
    with pytest.raises(CRSError, match="own vertical CRS is unknown"):
        moved("EPSG:32631+5709")


def test_points_without_a_place_are_named() -> None:
    """E_BAD_COORDINATE with the number of the point."""
    points = ((4_0000, 52_0000, 0), (4_0000, 95_0000, 0))
    with pytest.raises(FormatError, match="point 1 ") as caught:
        moved("EPSG:32631", crs="EPSG:4326", points=points, scale=(0.0001, 0.0001, 0.01))
    assert caught.value.code == "E_BAD_COORDINATE"


def test_no_points() -> None:
    """Nothing to do, nothing fails."""
    with moved("EPSG:32631", points=()) as source:
        assert list(source.chunks()) == []
        assert source.n_points == 0
