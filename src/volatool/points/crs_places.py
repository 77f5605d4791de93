"""Places in a CRS: their longitude and latitude, their UTM zone, and their way into another CRS."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np
import pyproj
from pyproj.exceptions import CRSError as ForeignCRSError
from pyproj.exceptions import ProjError

from volatool.errors import CRSError
from volatool.model import F64, Bounds, CrsInfo
from volatool.points.crs import split


def utm_for(crs: CrsInfo, bounds: Bounds) -> str | None:
    """
    Return the UTM zone (WGS 84) of the middle of a rectangle.

    Parameters
    ----------
    crs : CrsInfo
        Of the bounds; degrees are longitude, latitude.
    bounds : Bounds
        The rectangle.

    Returns
    -------
    code : str or None
        ``"EPSG:32631"``; polar stereographic beyond 84 N and 80 S; None if there is no such place.

    Examples
    --------
    >>> utm_for(CrsInfo(is_geographic=True), Bounds(4.3, 51.9, 4.5, 52.1))
    'EPSG:32631'
    """
    x, y = (bounds.left + bounds.right) / 2, (bounds.bottom + bounds.top) / 2
    place = latlon(crs, x, y)
    if place is None and crs.is_geographic and crs.wkt2 is None:
        place = (y, x)
    if place is None or not (abs(place[0]) <= 90 and abs(place[1]) <= 540):
        return None
    lat, lon = place
    if lat > 84:
        return "EPSG:32661"
    if lat < -80:
        return "EPSG:32761"
    zone = int((lon + 180) // 6) % 60 + 1
    return f"EPSG:{32600 + zone if lat >= 0 else 32700 + zone}"


def latlon(crs: CrsInfo, x: float, y: float) -> tuple[float, float] | None:
    """
    Return a point's latitude and longitude in WGS 84.

    Parameters
    ----------
    crs : CrsInfo
        Of the point.
    x, y : float
        Easting and northing, or longitude and latitude.

    Returns
    -------
    place : (float, float) or None
        Degrees; None without a CRS, for geocentric ones, and where the projection has no inverse.
    """
    if crs.wkt2 is None or not (math.isfinite(x) and math.isfinite(y)):
        return None
    found = lonlat(crs, np.array([x], np.float64), np.array([y], np.float64))
    if found is None:
        return None
    lon, lat = float(found[0][0]), float(found[1][0])
    if not (math.isfinite(lat) and math.isfinite(lon)) or abs(lat) > 90:
        return None
    return lat, lon


def lonlat(crs: CrsInfo, x: F64, y: F64) -> tuple[F64, F64] | None:
    """
    Return longitudes and latitudes in WGS 84, the coordinates of GeoJSON.

    Parameters
    ----------
    crs : CrsInfo
        Of the points; with its text, or at least a code.
    x, y : (n,) arrays of float64
        Easting and northing, or longitude and latitude.

    Returns
    -------
    lon, lat : (n,) arrays of float64, or None
        Degrees, infinite where there is no such place; None without a CRS or way from it.
    """
    text = crs.wkt2 or crs.horizontal
    if text is None:
        return None
    try:
        transformer = _to_degrees(text)
        if transformer is None:
            return None
        lon, lat = transformer.transform(x, y)
    except (ForeignCRSError, ProjError):
        return None
    return np.asarray(lon, np.float64), np.asarray(lat, np.float64)


@functools.lru_cache(maxsize=16)  # making one takes 40 ms, a tile asks some five times
def _to_degrees(text: str) -> pyproj.Transformer | None:
    """Return what moves a CRS to longitude and latitude in WGS 84; None for a geocentric one."""
    horizontal, _ = split(pyproj.CRS.from_user_input(text))
    if horizontal.is_geocentric:
        return None
    return pyproj.Transformer.from_crs(horizontal, "EPSG:4326", always_xy=True)


@dataclass(frozen=True, slots=True)
class Mover:
    """
    Moves places from one CRS into another.

    Parameters
    ----------
    transformer : pyproj.Transformer
        x, y order on both sides.
    is_from_degrees : bool
        The coordinates given are longitude and latitude.
    """

    transformer: pyproj.Transformer
    is_from_degrees: bool

    def __call__(self, x: F64, y: F64) -> tuple[F64, F64]:
        """Return x, y in the other CRS; infinite where there is no such place."""
        moved = self.transformer.transform(x, y)
        return moved[0], moved[1]


def mover(text: str, to: CrsInfo) -> Mover | None:
    """
    Return what moves places into a CRS, horizontally.

    Parameters
    ----------
    text : str
        CRS of the places: WKT, PROJ JSON or a code.
    to : CrsInfo
        With a CRS.

    Returns
    -------
    mover : Mover or None
        None if they are the same.

    Raises
    ------
    CRSError
        ``E_CRS``: one of them is not understood.
    """
    try:
        source, _ = split(pyproj.CRS.from_user_input(text))
        target, _ = split(pyproj.CRS.from_wkt(to.wkt2 or ""))
        if source.equals(target, ignore_axis_order=True):
            return None
        transformer = pyproj.Transformer.from_crs(source, target, always_xy=True)
    except (ForeignCRSError, ProjError) as error:
        raise CRSError(
            f"can't move places from {text[:60]!r} to {to.horizontal}: {error}"
        ) from error
    return Mover(transformer, bool(source.is_geographic))
