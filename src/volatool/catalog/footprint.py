"""Where a tile lies on the globe: GeoJSON geometry and box in WGS 84 (RFC 7946)."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from volatool.errors import CRSError
from volatool.model import F64, Bounds, CrsInfo
from volatool.points.crs import crs_from_user, known_wkt
from volatool.points.crs_places import mover

_PER_SIDE = 8
_DIGITS = 9  # of a degree: a tenth of a millimetre


@dataclass(frozen=True, slots=True)
class Footprint:
    """
    A rectangle of a CRS in longitude and latitude.

    Parameters
    ----------
    geometry : dict
        GeoJSON Polygon, counterclockwise, with points along its sides; MultiPolygon, cut at the
        antimeridian, if it crosses it.
    bbox : tuple of 4 float
        West, south, east, north; west is greater than east across the antimeridian.
    """

    geometry: dict[str, Any]
    bbox: tuple[float, float, float, float]


def footprint(crs: CrsInfo, bounds: Bounds) -> Footprint | None:
    """
    Return a rectangle's place on the globe.

    Parameters
    ----------
    crs : CrsInfo
        Of the rectangle.
    bounds : Bounds
        The rectangle.

    Returns
    -------
    footprint : Footprint or None
        None without a CRS, and where the projection has no inverse.
    """
    wkt = known_wkt(crs)
    if wkt is None:
        return None
    try:
        move = mover(wkt, crs_from_user("EPSG:4326"))
    except CRSError:
        return None
    ring = _ring(bounds)
    if move is not None:
        ring = np.column_stack(move(ring[:, 0], ring[:, 1]))
    if not np.isfinite(ring).all() or np.abs(ring[:, 1]).max() > 90:
        return None
    boxes = [_box(part) for part in _parts(ring)]
    _, south, _, north = _box(ring)
    return Footprint(geometry_of(ring), (boxes[0][0], south, boxes[-1][2], north))


def geometry_of(ring: F64, digits: int = _DIGITS) -> dict[str, Any]:
    """
    Return a closed ring in degrees as GeoJSON.

    Parameters
    ----------
    ring : (n, 2) array of float64
        Longitude and latitude.
    digits : int
        Decimals that are kept.

    Returns
    -------
    geometry : dict
        Polygon, counterclockwise; MultiPolygon, cut at the antimeridian, if it crosses it.
    """
    rings = [_polygon(part, digits) for part in _parts(ring)]
    if len(rings) == 1:
        return {"type": "Polygon", "coordinates": rings[0]}
    return {"type": "MultiPolygon", "coordinates": rings}


def _parts(ring: F64) -> list[F64]:
    """Return a ring, or what is west and what is east of the antimeridian that it crosses."""
    if np.ptp(ring[:, 0]) <= 180:
        return [ring]
    # the short way round crosses it: count eastwards, cut at 180
    around = np.column_stack([ring[:, 0] % 360, ring[:, 1]])
    west, east = (_clipped(around, 180.0, keep_below=below) for below in (True, False))
    east[:, 0] -= 360
    return [west, east]


def _ring(bounds: Bounds) -> F64:
    """Return the corners and places between them, counterclockwise, closed."""
    corners = np.array(
        [
            (bounds.left, bounds.bottom),
            (bounds.right, bounds.bottom),
            (bounds.right, bounds.top),
            (bounds.left, bounds.top),
            (bounds.left, bounds.bottom),
        ]
    )
    places = np.linspace(0, 4, 4 * _PER_SIDE + 1)
    return np.column_stack([np.interp(places, np.arange(5), corners[:, axis]) for axis in (0, 1)])


def _clipped(ring: F64, limit: float, *, keep_below: bool) -> F64:
    """Return the part of a closed ring on one side of a meridian, closed."""
    sign = 1.0 if keep_below else -1.0
    kept: list[tuple[float, float]] = []
    for (x0, y0), (x1, y1) in pairwise(ring):
        d0, d1 = sign * (limit - x0), sign * (limit - x1)
        if d0 >= 0:
            kept.append((x0, y0))
        if d0 * d1 < 0:
            kept.append((limit, y0 + (y1 - y0) * d0 / (d0 - d1)))
    return np.array([*kept, kept[0]])


def _polygon(ring: F64, digits: int) -> list[list[list[float]]]:
    x, y = ring[:, 0] - ring[0, 0], ring[:, 1] - ring[0, 1]
    if np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]) < 0:  # a CRS with its axes the other way round
        ring = ring[::-1]
    return [np.round(ring, digits).tolist()]


def _box(ring: F64) -> tuple[float, float, float, float]:
    (west, south), (east, north) = (np.round(end, _DIGITS) for end in (ring.min(0), ring.max(0)))
    return float(west), float(south), float(east), float(north)
