"""What a CRS is called and its units; pyproj is imported only by the crs modules."""

from __future__ import annotations

import functools
import math
import warnings as python_warnings
from fractions import Fraction
from typing import Any, TypeAlias

import pyproj
import pyproj.database
from pyproj.exceptions import CRSError as ForeignCRSError
from pyproj.exceptions import ProjError

from volatool.errors import CRSError
from volatool.model import CrsInfo
from volatool.points.units import linear_unit

CrsLike: TypeAlias = str | CrsInfo | None


def crs_from_user(text: str, source: str = "override") -> CrsInfo:
    """
    Return the CRS that a user names.

    Parameters
    ----------
    text : str
        ``"EPSG:2994"``, ``"EPSG:2994+5703"`` (with the vertical part), WKT, PROJ.
    source : str
        What `CrsInfo.source` is to say.

    Raises
    ------
    CRSError
        ``E_CRS``: PROJ does not know it.
    """
    try:
        with python_warnings.catch_warnings():
            python_warnings.simplefilter("ignore")
            crs = pyproj.CRS.from_user_input(text.strip())
            if (crs.is_vertical and not crs.is_compound) or crs.is_geocentric:
                kind = "geocentric" if crs.is_geocentric else "vertical"
                raise CRSError(
                    f"CRS {text!r} is {kind}; give a projected one, with the vertical part behind "
                    "it: EPSG:x+y"
                )
            return describe(crs, source)
    except (ForeignCRSError, ProjError) as error:
        told = str(error).splitlines()[0]
        raise CRSError(
            f"CRS {text!r} is not known: {told}; give EPSG:x, EPSG:x+y or WKT"
        ) from error


def describe(crs: pyproj.CRS, source: str) -> CrsInfo:
    """
    Return what we keep of a pyproj CRS.

    Parameters
    ----------
    crs : pyproj.CRS
        Any kind: projected, geographic, compound, 3-D, geocentric, bound, local.
    source : str
        For `CrsInfo.source`.
    """
    crs = unbound(crs)
    horizontal, vertical = split(crs)
    axes = horizontal.axis_info
    unit_xy, metres_xy = _axis_unit(axes[0]) if axes else (None, None)
    unit_z, metres_z, vertical_name = None, None, None
    if vertical is not None:
        vertical_name = _name(vertical)
        if vertical.axis_info:
            unit_z, metres_z = _axis_unit(vertical.axis_info[0])
    elif len(axes) == 3:
        unit_z, metres_z = _axis_unit(axes[2])
        vertical_name = None if horizontal.is_geocentric else "ellipsoidal height"
    return CrsInfo(
        wkt2=_wkt2(crs),
        horizontal=_name(horizontal),
        vertical=vertical_name,
        epsg=_epsg(horizontal),
        unit_xy=unit_xy,
        unit_z=unit_z,
        metres_per_unit_xy=metres_xy,
        metres_per_unit_z=metres_z,
        is_geographic=horizontal.is_geographic,
        source=source,
    )


def database_version() -> str:
    """Return the versions of PROJ and of its EPSG data, for `doctor`."""
    epsg = pyproj.database.get_database_metadata("EPSG.VERSION")
    return f"PROJ {pyproj.proj_version_str}, EPSG {epsg or 'unknown'}"


def split(crs: pyproj.CRS) -> tuple[pyproj.CRS, pyproj.CRS | None]:
    """Return the horizontal and the vertical part."""
    if crs.is_compound and len(crs.sub_crs_list) >= 2:
        return unbound(crs.sub_crs_list[0]), unbound(crs.sub_crs_list[1])
    return crs, None


def unbound(crs: pyproj.CRS) -> pyproj.CRS:
    """Return the CRS without a transformation to another (TOWGS84) tied to it."""
    while crs.is_bound and crs.source_crs is not None:
        crs = crs.source_crs
    if crs.is_compound and any(part.is_bound for part in crs.sub_crs_list):
        parts = [unbound(part) for part in crs.sub_crs_list]
        return pyproj.crs.CompoundCRS(name=crs.name, components=parts)
    return crs


def difference(one: CrsInfo, other: CrsInfo) -> str | None:
    """
    Tell in what two coordinate reference systems differ, so that their numbers can't be compared.

    Parameters
    ----------
    one, other : CrsInfo
        What is not known of either is taken to be as the other says; but heights of an unknown unit
        count as being in that of x and y, as everywhere.

    Returns
    -------
    difference : str or None
        ``"EPSG:25832 and EPSG:25833"``, for people; None if there is none. The name or code of a
        CRS is believed before its text: WKT of two programs is seldom the same.
    """
    metres = one.metres_per_unit_xy, other.metres_per_unit_xy
    if None not in metres and metres[0] != metres[1]:
        return f"x and y in {one.unit_xy} and in {other.unit_xy}"
    if one.z_ratio != other.z_ratio:
        units = [crs.unit_z or crs.unit_xy or "an unknown unit" for crs in (one, other)]
        return f"heights in {units[0]} and in {units[1]}"
    pairs = ((one.horizontal, other.horizontal), (one.vertical, other.vertical))
    for i, (name, another) in enumerate(pairs):
        if name is None or another is None or name == another:
            continue
        if one.wkt2 is None or other.wkt2 is None:  # a header alone: only codes can be compared
            is_same = not (name.startswith("EPSG:") and another.startswith("EPSG:"))
        else:
            is_same = _are_equal(_part(one.wkt2, i), _part(other.wkt2, i))
        if not is_same:
            return f"{name} and {another}"
    return None


def horizontal_difference(one: str, other: str) -> tuple[str, str] | None:
    """
    Return the names of the horizontal parts of two CRS if they differ.

    Parameters
    ----------
    one, other : str
        WKT. Parts with one code are the same, whatever else their text says.
    """
    both = (pyproj.CRS.from_wkt(wkt) for wkt in (one, other))
    a, b = (crs.sub_crs_list[0] if crs.is_compound else crs for crs in both)
    codes = a.to_authority(), b.to_authority()
    if a.equals(b, ignore_axis_order=True) or (None not in codes and codes[0] == codes[1]):
        return None
    return a.name, b.name


def _part(wkt: str, which: int) -> pyproj.CRS | None:
    """Return the horizontal (0) or vertical (1) part of a CRS."""
    try:
        return split(unbound(pyproj.CRS.from_wkt(wkt)))[which]
    except ForeignCRSError:
        return None


def _are_equal(one: pyproj.CRS | None, other: pyproj.CRS | None) -> bool:
    if one is None or other is None:
        return False
    return bool(one.equals(other, ignore_axis_order=True))


def _wkt2(crs: pyproj.CRS) -> str | None:
    """Return WKT2:2019, or the older WKT of what can't be written so."""
    for version in ("WKT2_2019", "WKT2_2019_SIMPLIFIED", "WKT1_GDAL"):
        try:
            return str(crs.to_wkt(version))
        except (ForeignCRSError, ProjError):
            continue
    return None


def _axis_unit(axis: Any) -> tuple[str, Fraction | None]:
    """Return the name of an axis's unit and its length, None for angles."""
    name, factor = str(axis.unit_name), float(axis.unit_conversion_factor)
    if abs(factor - math.pi / 180) < 1e-9:
        return "degree", None
    if name in ("grad", "radian") or not factor > 0:
        return name, None
    return linear_unit(name, factor)


def _name(crs: pyproj.CRS) -> str | None:
    epsg = _epsg(crs)
    return f"EPSG:{epsg}" if epsg is not None else (crs.name or None)


def _epsg(crs: pyproj.CRS) -> int | None:
    return _epsg_of_wkt(crs.to_wkt("WKT2_2019"))


@functools.lru_cache(maxsize=64)
def _epsg_of_wkt(wkt: str) -> int | None:
    """
    Return the EPSG code that the text has, else the one that PROJ finds (0.1 s).

    Its own goes first: old WKT of northing-easting systems (EPSG:31467) is written and stored the
    other way round, and PROJ would name another code for that (5677).
    """
    try:
        crs = pyproj.CRS.from_wkt(wkt)
        named = crs.to_json_dict().get("id", {})
        code = named.get("code") if named.get("authority") == "EPSG" else crs.to_epsg()
    except (ForeignCRSError, ProjError):
        return None
    return None if code is None else int(code)


def las_wkt(crs: CrsInfo) -> str | None:
    """
    Return the WKT of a CRS for a LAS file.

    Parameters
    ----------
    crs : CrsInfo
        With WKT, or with a name that PROJ knows (files of the original toolkit have no more).

    Returns
    -------
    wkt : str or None
        WKT 1, as LAS 1.4 asks for, where it says the same; else WKT 2. None if there is no CRS.
    """
    found = _found(crs)
    if found is None:
        return None
    wanted = describe(found, crs.source)
    with python_warnings.catch_warnings():
        python_warnings.simplefilter("ignore")  # it may lose what we compare next
        try:
            wkt = str(found.to_wkt("WKT1_GDAL"))
            if _is_alike(describe(pyproj.CRS.from_wkt(wkt), crs.source), wanted):
                return wkt
        except (ForeignCRSError, ProjError):
            pass
    return wanted.wkt2


def known_wkt(crs: CrsInfo) -> str | None:
    """
    Return the WKT 2 of a CRS, also of one of which only the code is known.

    Parameters
    ----------
    crs : CrsInfo
        As for `las_wkt`.
    """
    found = _found(crs)
    return None if found is None else _wkt2(found)


def _found(crs: CrsInfo) -> pyproj.CRS | None:
    """Return a CRS by its WKT or its name; None if there is none, or PROJ does not know it."""
    try:
        if crs.wkt2 is not None:
            return pyproj.CRS.from_wkt(crs.wkt2)
        return None if crs.horizontal is None else pyproj.CRS.from_user_input(crs.horizontal)
    except ForeignCRSError:
        return None


def _is_alike(a: CrsInfo, b: CrsInfo) -> bool:
    names = ("horizontal", "vertical", "metres_per_unit_xy", "metres_per_unit_z", "is_geographic")
    return all(getattr(a, name) == getattr(b, name) for name in names)
