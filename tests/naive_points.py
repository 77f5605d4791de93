"""LAS files made by hand, and a slow reader of them, for the tests of `volatool.points`."""

from __future__ import annotations

import io
import struct
from typing import Any

import laspy
import numpy as np

RECORD = {0: 20, 1: 28, 2: 26, 3: 34, 4: 57, 5: 63, 6: 30, 7: 36, 8: 38, 9: 59, 10: 67}


def vlr(user_id: str, record_id: int, data: bytes) -> bytes:
    """Return a variable length record."""
    return struct.pack("<H16sHH32s", 0, user_id.encode(), record_id, len(data), b"") + data


def geokeys(*keys: tuple[int, int, int, int]) -> bytes:
    """Return a GeoTIFF directory record."""
    flat = [word for key in keys for word in key]
    return vlr(
        "LASF_Projection", 34735, struct.pack(f"<{4 + len(flat)}H", 1, 1, 0, len(keys), *flat)
    )


def las_bytes(
    points: Any = ((1, 2, 3),),
    *,
    minor: int = 2,
    point_format: int = 0,
    vlrs: tuple[bytes, ...] = (),
    scale: tuple[float, float, float] = (0.01, 0.01, 0.01),
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0),
    box: tuple[float, ...] | None = None,
    n_points: int | None = None,
    n_legacy: int | None = None,
    n_vlrs: int | None = None,
    encoding: int = 0,
    record_bytes: int | None = None,
    tail: bytes = b"",
) -> bytes:
    """Return an uncompressed file; stored x, y, z from `points`, other fields zero."""
    size = {4: 375, 3: 235}.get(minor, 227)
    record = record_bytes or RECORD[point_format]
    n = len(points) if n_points is None else n_points
    stored = np.asarray(points, dtype=np.int64).reshape(-1, 3)
    if box is None:
        xyz = stored * np.array(scale) + np.array(offset)
        box = (*xyz.min(0), *xyz.max(0)) if len(xyz) else (0.0,) * 6
    body = b"".join(vlrs)
    legacy = (n if n_legacy is None else n_legacy) & 0xFFFFFFFF
    head = bytearray(size)
    head[:4] = b"LASF"
    struct.pack_into("<H", head, 6, encoding)
    head[24:26] = bytes((1, minor))
    struct.pack_into("<H", head, 94, size)
    n_records = len(vlrs) if n_vlrs is None else n_vlrs
    struct.pack_into("<IIBHI", head, 96, size + len(body), n_records, point_format, record, legacy)
    struct.pack_into("<6d", head, 131, *scale, *offset)
    x0, y0, z0, x1, y1, z1 = box
    struct.pack_into("<6d", head, 179, x1, x0, y1, y0, z1, z0)
    if minor >= 4:
        struct.pack_into("<QIQ", head, 235, 0, 0, n)
    records = b"".join(struct.pack("<3i", *row) + bytes(record - 12) for row in stored.tolist())
    return bytes(head) + body + records + tail


def random_las(point_format: int, n: int = 5000, seed: int = 1) -> laspy.LasData:
    """Return a file in memory with random values in all the fields that we read."""
    rng = np.random.default_rng(seed)
    header = laspy.LasHeader(point_format=point_format, version="1.4")
    header.scales, header.offsets = np.array([0.01, 0.001, 0.1]), np.array([1000.0, -5.0, 0.0])
    las = laspy.LasData(header)
    las.points = laspy.ScaleAwarePointRecord.zeros(n, header=header)
    for axis in "XYZ":
        las[axis] = rng.integers(-(2**31), 2**31, n)
    las.intensity = rng.integers(0, 2**16, n)
    las.return_number = rng.integers(0, 8 if point_format < 6 else 16, n)
    las.number_of_returns = rng.integers(0, 8 if point_format < 6 else 16, n)
    las.classification = rng.integers(0, 32 if point_format < 6 else 256, n)
    for flag in ("synthetic", "key_point", "withheld"):
        las[flag] = rng.integers(0, 2, n)
    if "red" in header.point_format.dimension_names:
        for colour in ("red", "green", "blue"):
            las[colour] = rng.integers(0, 2**16, n)
    return las


def written(las: laspy.LasData, compress: bool) -> bytes:
    """Return the bytes of a file."""
    stream = io.BytesIO()
    las.write(stream, do_compress=compress)
    return stream.getvalue()


def naive_outside(stored: int, scale: str, offset: str, low: str, high: str) -> bool:
    """Whether a coordinate is outside a closed interval, in decimal arithmetic."""
    from decimal import Decimal

    value = stored * Decimal(scale) + Decimal(offset)
    return not Decimal(low) <= value <= Decimal(high)
