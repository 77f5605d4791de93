"""A pyproj CRS from GeoTIFF keys: by code where there is one, else from the parameters."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any

import pyproj
from pyproj.crs import GeographicCRS, ProjectedCRS
from pyproj.crs import coordinate_operation as operation
from pyproj.crs.datum import CustomDatum, CustomEllipsoid
from pyproj.crs.datum import Ellipsoid as _Ellipsoid  # type: ignore[attr-defined]

from volatool.points import geokeys as gk
from volatool.points.geokeys import Value
from volatool.points.units import BY_EPSG, FOOT, US_SURVEY_FOOT, linear_unit

_OLD_VERTICAL = {5101: 5701, 5102: 5702, 5103: 5703}
"""Codes of GeoTIFF 1.0 (vertical datums) and the vertical CRS in metres or feet that is meant."""

_NAVD88 = {US_SURVEY_FOOT[1]: 6360, FOOT[1]: 8228, Fraction(1): 5703}

_DEGREES = {9101: 180 / math.pi, 9105: 0.9}
"""Angular units other than degrees: radian, grad."""


def crs_from_keys(keys: dict[int, Value]) -> pyproj.CRS | None:
    """
    Return the CRS that GeoTIFF keys describe.

    Parameters
    ----------
    keys : dict
        Of `read_geokeys`.

    Returns
    -------
    crs : pyproj.CRS or None
        Compound when the keys name a vertical part; None when they name no CRS at all.

    Raises
    ------
    ValueError, pyproj.exceptions.CRSError
        The keys name something unknown or leave out what is needed.
    """
    horizontal = _horizontal(keys)
    if horizontal is None:
        return None
    vertical = _vertical(keys)
    if vertical is None or len(horizontal.axis_info) != 2:
        return horizontal
    return compound(horizontal, vertical)


def compound(horizontal: pyproj.CRS, vertical: pyproj.CRS) -> pyproj.CRS:
    """Return the compound CRS of two parts."""
    name = f"{horizontal.name} + {vertical.name}"
    return pyproj.crs.CompoundCRS(name=name, components=[horizontal, vertical])


def unit_of_key(keys: dict[int, Value], key: int) -> tuple[str, Fraction] | None:
    """Return the unit that a key's EPSG code names."""
    value = keys.get(key)
    return BY_EPSG.get(value) if isinstance(value, int) else None


def _horizontal(keys: dict[int, Value]) -> pyproj.CRS | None:
    model = keys.get(gk.GT_MODEL_TYPE)
    projected = gk.code(keys, gk.PROJECTED_TYPE)
    if projected is not None and model != 2:
        return _in_unit(pyproj.CRS.from_epsg(projected), _file_unit(keys))
    if (model != 2 and gk.PROJECTED_TYPE in keys) or gk.COORD_TRANS in keys:
        private = keys.get(gk.PROJECTED_TYPE, gk.USER_DEFINED)
        if private != gk.USER_DEFINED and gk.COORD_TRANS not in keys:
            raise ValueError(f"projected CRS {private} is not defined")
        return _projected(keys)
    if gk.GEOGRAPHIC_TYPE in keys or model == 2:
        return _geographic(keys)
    embedded = gk.citation(keys, gk.GT_CITATION, gk.PROJECTED_CITATION)
    if "PROJCS[" in embedded:  # ESRI writes its own text into the citation
        return pyproj.CRS.from_wkt(embedded[embedded.index("PROJCS[") :])
    return None


def _file_unit(keys: dict[int, Value]) -> tuple[str, Fraction] | None:
    unit = unit_of_key(keys, gk.LINEAR_UNITS)
    size = gk.number(keys, gk.LINEAR_UNIT_SIZE)
    if unit is None and keys.get(gk.LINEAR_UNITS) == gk.USER_DEFINED and size > 0:
        return linear_unit("unknown", size)
    return unit


def _in_unit(
    crs: pyproj.CRS, unit: tuple[str, Fraction] | None, called: str | None = None
) -> pyproj.CRS:
    """Return the CRS with its axes in another unit: the keys' unit outranks that of the code."""
    axes = crs.axis_info
    if unit is None or not axes or not (crs.is_projected or crs.is_vertical):
        return crs
    name, metres = unit
    if all(linear_unit(a.unit_name, a.unit_conversion_factor)[1] == metres for a in axes):
        return crs
    described: dict[str, Any] = crs.to_json_dict()
    described.pop("id", None)
    described["name"] = called or f"{crs.name} ({name})"
    json_unit = {"type": "LinearUnit", "name": name, "conversion_factor": float(metres)}
    for axis in described["coordinate_system"]["axis"]:
        axis["unit"] = "metre" if metres == 1 else json_unit
    return pyproj.CRS.from_json_dict(described)


def _geographic(keys: dict[int, Value]) -> pyproj.CRS:
    """Return the geographic CRS: by its code, its datum's code, its ellipsoid."""
    found = gk.code(keys, gk.GEOGRAPHIC_TYPE)
    if found is not None:
        return pyproj.CRS.from_epsg(found)
    datum = gk.code(keys, gk.GEODETIC_DATUM)
    if datum is not None and 6001 <= datum <= 6999:
        return pyproj.CRS.from_epsg(datum - 2000)  # 6269 is the datum of 4269
    name = gk.citation(keys, gk.GEOG_CITATION, gk.GT_CITATION) or "unknown"
    ellipsoid_code = gk.code(keys, gk.ELLIPSOID)
    semi_major = gk.number(keys, gk.SEMI_MAJOR_AXIS)
    if ellipsoid_code is not None:
        ellipsoid: Any = _Ellipsoid.from_epsg(ellipsoid_code)
    elif semi_major > 0:
        flattening = gk.number(keys, gk.INV_FLATTENING)
        ellipsoid = CustomEllipsoid(
            semi_major_axis=semi_major, inverse_flattening=flattening, name="unknown"
        )
    else:
        raise ValueError("neither a geographic CRS nor an ellipsoid is named")
    return GeographicCRS(name=name, datum=CustomDatum(name=name, ellipsoid=ellipsoid))


def _projected(keys: dict[int, Value]) -> pyproj.CRS:
    """Return a projected CRS from its method and parameters."""
    unit = _file_unit(keys) or ("metre", Fraction(1))
    metres = float(unit[1])
    angular = gk.number(keys, gk.ANGULAR_UNITS, default=9102)
    to_degrees = _DEGREES.get(int(angular), 1.0) if math.isfinite(angular) else 1.0

    def degrees(*names: int) -> float:
        return gk.number(keys, *names) * to_degrees

    east = gk.number(keys, gk.FALSE_EASTING, gk.FALSE_ORIGIN_EASTING) * metres
    north = gk.number(keys, gk.FALSE_NORTHING, gk.FALSE_ORIGIN_NORTHING) * metres
    lat = degrees(gk.NAT_ORIGIN_LAT, gk.FALSE_ORIGIN_LAT, gk.CENTER_LAT)
    lon = degrees(gk.NAT_ORIGIN_LONG, gk.FALSE_ORIGIN_LONG, gk.CENTER_LONG)
    natural: dict[str, Any] = {
        "latitude_natural_origin": lat,
        "longitude_natural_origin": lon,
        "false_easting": east,
        "false_northing": north,
    }
    conic: dict[str, Any] = {
        "latitude_first_parallel": degrees(gk.STD_PARALLEL_1),
        "latitude_second_parallel": degrees(gk.STD_PARALLEL_2),
        "latitude_false_origin": lat,
        "longitude_false_origin": lon,
        "easting_false_origin": east,
        "northing_false_origin": north,
    }
    scale = gk.number(keys, gk.SCALE_AT_NAT_ORIGIN, default=1.0)
    method = keys.get(gk.COORD_TRANS)
    conversion: Any
    if method == 1:
        conversion = operation.TransverseMercatorConversion(
            **natural, scale_factor_natural_origin=scale
        )
    elif method == 8:
        conversion = operation.LambertConformalConic2SPConversion(**conic)
    elif method == 9:
        conversion = operation.LambertConformalConic1SPConversion(
            **natural, scale_factor_natural_origin=scale
        )
    elif method == 10:
        conversion = operation.LambertAzimuthalEqualAreaConversion(**natural)
    elif method == 11:
        conversion = operation.AlbersEqualAreaConversion(**conic)
    else:
        raise ValueError(f"projection method {method} is not known")
    name = gk.citation(keys, gk.PROJECTED_CITATION, gk.GT_CITATION) or "unknown"
    projected = ProjectedCRS(conversion, name=name, geodetic_crs=_geographic(keys))
    return _in_unit(projected, unit, name)


def _vertical(keys: dict[int, Value]) -> pyproj.CRS | None:
    """Return the vertical CRS, in the unit that the keys give; None if unknown."""
    unit = unit_of_key(keys, gk.VERTICAL_UNITS)
    found = gk.code(keys, gk.VERTICAL_TYPE)
    found = _OLD_VERTICAL.get(found, found) if found is not None else None
    cited = gk.citation(keys, gk.VERTICAL_CITATION).upper().replace(" ", "")
    if found is None and "NAVD88" in cited:
        found = 5703
    if found is None:
        return None
    if found == 5703 and unit is not None:
        found = _NAVD88.get(unit[1], found)
    try:
        vertical = pyproj.CRS.from_epsg(found)
    except pyproj.exceptions.CRSError:
        return None
    return _in_unit(vertical, unit) if vertical.is_vertical else None
