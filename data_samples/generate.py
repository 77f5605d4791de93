"""Make the sample tiles, or like ones of any size: ``python generate.py town big.laz --points N``.

Without arguments it writes the two samples beside itself. The same arguments give the same points
on every machine, and the tile is never held in memory as a whole.
"""

from __future__ import annotations

import argparse
import datetime
import json
import struct
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import laspy
import numpy as np
from chance import between, normal
from forest import Forest
from laspy.header import GpsTimeType
from scanner import Flight, Returns, estimate, scan
from scene import Scene
from town import Town

HERE = Path(__file__).resolve().parent
US_SURVEY_FOOT = 1200 / 3937
TOWN_WKT = (
    'COMPD_CS["ETRS89 / UTM zone 32N + DHHN2016 height",PROJCS["ETRS89 / UTM zone 32N",'
    'GEOGCS["ETRS89",DATUM["European_Terrestrial_Reference_System_1989",'
    'SPHEROID["GRS 1980",6378137,298.257222101,AUTHORITY["EPSG","7019"]],'
    'AUTHORITY["EPSG","6258"]],PRIMEM["Greenwich",0,AUTHORITY["EPSG","8901"]],'
    'UNIT["degree",0.0174532925199433,AUTHORITY["EPSG","9122"]],AUTHORITY["EPSG","4258"]],'
    'PROJECTION["Transverse_Mercator"],PARAMETER["latitude_of_origin",0],'
    'PARAMETER["central_meridian",9],PARAMETER["scale_factor",0.9996],'
    'PARAMETER["false_easting",500000],PARAMETER["false_northing",0],'
    'UNIT["metre",1,AUTHORITY["EPSG","9001"]],AXIS["Easting",EAST],AXIS["Northing",NORTH],'
    'AUTHORITY["EPSG","25832"]],VERT_CS["DHHN2016 height",'
    'VERT_DATUM["Deutsches Haupthoehennetz 2016",2005,AUTHORITY["EPSG","1170"]],'
    'UNIT["metre",1,AUTHORITY["EPSG","9001"]],AXIS["Gravity-related height",UP],'
    'AUTHORITY["EPSG","7837"]]]'
)
FOREST_CITATION = "NAD83 / California zone 1 (ftUS)|"
FOREST_KEYS = (
    (1024, 0, 1, 1),  # projected
    (1025, 0, 1, 1),  # pixel is area
    (1026, 34737, len(FOREST_CITATION), 0),
    (3072, 0, 1, 2225),  # NAD83 / California zone 1, US survey feet
    (3076, 0, 1, 9003),
    (4096, 0, 1, 6360),  # NAVD88 height, US survey feet
    (4099, 0, 1, 9003),
)


@dataclass(frozen=True)
class Sample:
    """
    A kind of tile.

    Parameters
    ----------
    scene : type
        Class of the scene, made from width and height in metres.
    flight : Flight
        How the sample is flown; larger tiles are flown likewise.
    corner : tuple of 2 float
        The tile's south-west corner, in units of the CRS.
    unit : float
        Metres per unit of the CRS, on all axes.
    """

    scene: type[Any]
    flight: Flight
    corner: tuple[float, float]
    unit: float


SAMPLES = {
    "town": Sample(Town, Flight(240, 200, 300, 180, 20, 95, 0.56, 0.52), (523400, 5398200), 1.0),
    "forest": Sample(
        Forest,
        Flight(112, 92, 1240, 200, 17, 75, 0.42, 0.42),
        (6181000, 2301000),
        US_SURVEY_FOOT,
    ),
}


def town_header() -> laspy.LasHeader:
    """Return a LAS 1.4 header, point format 7, compound CRS as WKT."""
    header = laspy.LasHeader(version="1.4", point_format=7)
    header.scales, header.offsets = np.array([0.01, 0.01, 0.01]), np.array([523000, 5398000, 0])
    header.global_encoding.wkt = True
    header.global_encoding.gps_time_type = GpsTimeType.STANDARD
    header.vlrs.append(
        laspy.VLR("LASF_Projection", 2112, "OGC COORDINATE SYSTEM WKT", TOWN_WKT.encode() + b"\0")
    )
    return header


def forest_header() -> laspy.LasHeader:
    """Return a LAS 1.2 header, point format 1, CRS as GeoTIFF keys."""
    header = laspy.LasHeader(version="1.2", point_format=1)
    header.scales, header.offsets = np.array([0.01, 0.01, 0.01]), np.array([6180000, 2300000, 0])
    keys = struct.pack("<4H", 1, 1, 0, len(FOREST_KEYS))
    keys += b"".join(struct.pack("<4H", *key) for key in FOREST_KEYS)
    header.vlrs.append(laspy.VLR("LASF_Projection", 34735, "GeoKeyDirectoryTag", keys))
    header.vlrs.append(
        laspy.VLR("LASF_Projection", 34737, "GeoAsciiParamsTag", FOREST_CITATION.encode() + b"\0")
    )
    return header


def record(header: laspy.LasHeader, found: Returns, sample: Sample) -> laspy.ScaleAwarePointRecord:
    """Return points as records of a header's format."""
    points = laspy.ScaleAwarePointRecord.zeros(len(found), header=header)
    places = (found.u / sample.unit, found.v / sample.unit, found.z / sample.unit)
    for axis, place in enumerate(places):
        start = (*sample.corner, 0.0)[axis] - header.offsets[axis]
        points["XYZ"[axis]] = np.rint((start + place) / header.scales[axis]).astype(np.int32)
    # LAS 1.2 has room for returns 1 to 7; five is the most that a pulse gives here
    points["return_number"], points["number_of_returns"] = found.number, found.count
    points["intensity"], points["point_source_id"] = found.intensity, found.strip
    points["scan_direction_flag"], points["edge_of_flight_line"] = found.direction, found.is_edge
    points["gps_time"] = found.time + (314_000_000.0 if header.point_format.id == 7 else 302_400.0)
    if header.point_format.id == 7:
        points["classification"], points["overlap"] = found.code, found.is_overlap
        points["withheld"] = found.is_withheld
        points["scan_angle"] = np.rint(found.angle / 0.006).astype(np.int16)
        for band, name in enumerate(("red", "green", "blue")):
            points[name] = found.colour[:, band].astype(np.uint16) * 256
    else:  # never classified
        points["classification"] = np.ones(len(found), np.uint8)
        points["scan_angle_rank"] = np.rint(found.angle).astype(np.int8)
    return points


def generate(kind: str, path: Path, n_points: int | None = None) -> int:
    """
    Scan a scene into a LAS or LAZ file.

    Parameters
    ----------
    kind : str
        ``"town"`` or ``"forest"``.
    path : Path
        Output; compressed when its name ends in ``.laz``.
    n_points : int, optional
        Points wanted: the tile grows or shrinks at the same density, and is cut off there.
        By default the sample's own size, whole.

    Returns
    -------
    n_written : int
    """
    sample = SAMPLES[kind]
    flight, limit = sample.flight, sys.maxsize
    scene: Scene = sample.scene(flight.width, flight.height)
    if n_points is not None:
        limit = n_points
        for _ in range(4):  # woods give more points than lakes, so the size is found by trying
            grow = (1.01 * n_points / max(estimate(scene, flight), 1.0)) ** 0.5
            flight = replace(flight, width=flight.width * grow, height=flight.height * grow)
            scene = sample.scene(flight.width, flight.height)
    header = town_header() if kind == "town" else forest_header()
    header.creation_date = datetime.date(2026, 1, 1)
    header.system_identifier = "volatool made-up scene"
    header.generating_software = "data_samples/generate.py"
    n_written = 0
    backend = laspy.LazBackend.LazrsParallel if path.suffix == ".laz" else None
    with laspy.open(path, mode="w", header=header, laz_backend=backend) as writer:
        for found in scan(scene, flight):
            points = record(header, found, sample)[: limit - n_written]
            writer.write_points(points)
            n_written += len(points)
            if n_written == limit:
                break
    return n_written


def write_lake(path: Path) -> int:
    """
    Write the town's lake as a GeoJSON polygon, its shore drawn through the sides of 1 m squares.

    Returns
    -------
    n_corners : int
    """
    from rasterio.features import shapes
    from town import LAKE

    sample = SAMPLES["town"]
    scene = sample.scene(sample.flight.width, sample.flight.height)
    width, height = int(sample.flight.width), int(sample.flight.height)
    u, v = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    is_wet = (scene.terrain(u.ravel(), v.ravel()) < LAKE).reshape(u.shape).astype(np.uint8)
    found = [shape["coordinates"][0] for shape, value in shapes(is_wet) if value]
    corners = np.array(max(found, key=len))
    ring = [corners[0]]
    for corner in corners[1:]:  # metre by metre
        n = int(np.abs(corner - ring[-1]).max())
        ring += [ring[-1] + (corner - ring[-1]) * k / n for k in range(1, n + 1)]
    sides = np.array(ring)
    middles = (sides[1:] + sides[:-1]) / 2 + sample.corner  # cuts the corners of the squares
    places = [[round(x, 2), round(y, 2)] for x, y in [*middles.tolist(), middles[0].tolist()]]
    feature = {
        "type": "Feature",
        "properties": {"natural": "lake"},
        "geometry": {"type": "Polygon", "coordinates": [places]},
    }
    document = {
        "type": "FeatureCollection",
        "crs": {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::25832"}},
        "features": [feature],
    }
    path.write_text(json.dumps(document) + "\n", encoding="utf-8", newline="\n")
    return len(places)


def checkpoints(path: Path, n: int = 48) -> None:
    """
    Write checkpoints of the town: its terrain in the open, surveyed to 2 cm.

    Parameters
    ----------
    path : pathlib.Path
        CSV with id, easting, northing, elevation.
    n : int
        How many; places on roofs, under trees and on the lake are passed over.
    """
    sample = SAMPLES["town"]
    town = sample.scene(sample.flight.width, sample.flight.height)
    number = np.arange(20 * n)
    u = between(5, sample.flight.width - 5, 71, number)
    v = between(5, sample.flight.height - 5, 72, number)
    ground = town.terrain(u, v)
    found = town.surface(u, v, np.zeros(len(u), bool))
    crown, *_ = town.trees.crowns(u, v)
    is_open = (found.code == 2) & ~(town.roof(u, v) > ground) & ~(crown > ground)
    lines = ["id,easting,northing,elevation"]
    heights = found.height + 0.02 * normal(73, number)
    for k in np.flatnonzero(is_open)[:n]:
        x, y = sample.corner[0] + u[k], sample.corner[1] + v[k]
        lines.append(f"CP{len(lines):02d},{x:.3f},{y:.3f},{heights[k]:.3f}")
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def main(arguments: list[str] | None = None) -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kind", nargs="?", choices=sorted(SAMPLES))
    parser.add_argument("output", nargs="?", type=Path)
    parser.add_argument("--points", type=int, help="grow the tile to this many points")
    options = parser.parse_args(arguments)
    jobs = (
        [(kind, HERE / f"{kind}.laz") for kind in SAMPLES]
        if options.kind is None
        else [(options.kind, options.output or Path(f"{options.kind}.laz"))]
    )
    for kind, path in jobs:
        n_written = generate(kind, path, options.points)
        print(f"{path.name}: {n_written} points, {path.stat().st_size} bytes")
    if options.kind is None:
        path = HERE / "town-lake.geojson"
        print(f"{path.name}: {write_lake(path)} corners, {path.stat().st_size} bytes")
        checkpoints(HERE / "town-checkpoints.csv")


if __name__ == "__main__":
    main()
