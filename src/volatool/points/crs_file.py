"""The CRS of a LAS file: from its WKT and GeoTIFF records, whichever can be read and believed."""

from __future__ import annotations

import functools
import math
import warnings as python_warnings
from dataclasses import replace
from fractions import Fraction

import pyproj
import pyproj.aoi
import pyproj.database
import pyproj.enums
from pyproj.exceptions import CRSError as ForeignCRSError
from pyproj.exceptions import ProjError

from volatool.errors import CodedWarning
from volatool.model import CrsInfo
from volatool.points.crs import CrsLike, crs_from_user, describe, split, unbound
from volatool.points.crs_keys import compound, crs_from_keys, unit_of_key
from volatool.points.crs_places import latlon
from volatool.points.geokeys import LINEAR_UNITS, VERTICAL_UNITS, Value, read_geokeys
from volatool.points.header import LasHeader

PROJECTION = "LASF_Projection"
MISMATCH_M = 5.0
"""Two descriptions of one CRS may put a point this far apart (datum realisations)."""

_EARTH_RADII_M = (6.2e6, 6.5e6)


def crs_of(
    header: LasHeader, crs: CrsLike, crs_default: CrsLike, warnings: list[CodedWarning]
) -> CrsInfo:
    """
    Return the CRS of a file: the override, else what the file says, else the default.

    Parameters
    ----------
    header : LasHeader
        With the records of the file.
    crs, crs_default : str, CrsInfo or None
        Override; used if the file says nothing usable.
    warnings : list of CodedWarning
        Appended to: ``W_CRS_BROKEN``, ``W_CRS_MISMATCH``, ``W_WKT_FLAG``, ``W_NO_CRS``,
        ``W_Z_UNIT``.

    Raises
    ------
    CRSError
        The override or the default is not known.
    """
    if crs is not None:
        return _resolved(crs, "override")
    default = None if crs_default is None else _resolved(crs_default, "default")
    found = _from_file(header, warnings)
    if found.wkt2 is None and default is not None:
        return default
    if found.wkt2 is None:
        text = "the file names no CRS (--crs or --crs-default gives one); lengths are in file units"
        warnings.append(CodedWarning("W_NO_CRS", text))
    elif (
        found.unit_z is None and not found.is_geographic and found.metres_per_unit_xy != Fraction(1)
    ):
        text = f"the unit of heights is not recorded; taken as the horizontal one ({found.unit_xy})"
        warnings.append(CodedWarning("W_Z_UNIT", text))
    return found


def _from_file(header: LasHeader, warnings: list[CodedWarning]) -> CrsInfo:
    """Return the CRS of the file's records: WKT, then GeoTIFF keys, then libLAS's copy of WKT."""
    wkt = _first_wkt(header, PROJECTION, warnings)
    keys = _keys(header)
    geotiff = _from_geokeys(keys, header, wkt, warnings) if keys else None
    if wkt is None and geotiff is None:
        wkt = _first_wkt(header, "liblas", warnings)
    _check_flag(header, wkt is not None, geotiff is not None, warnings)
    unit_xy, unit_z = unit_of_key(keys, LINEAR_UNITS), unit_of_key(keys, VERTICAL_UNITS)
    chosen = wkt or geotiff
    if chosen is None:
        # a lone unit is worth keeping: odd/test_noepsg_043500_629205_IGN69.laz
        return CrsInfo(
            unit_xy=unit_xy and unit_xy[0],
            metres_per_unit_xy=unit_xy and unit_xy[1],
            unit_z=unit_z and unit_z[0],
            metres_per_unit_z=unit_z and unit_z[1],
        )
    if wkt is not None and geotiff is not None:
        if not _agree(wkt, geotiff, header):
            text = f"WKT says {wkt.horizontal}, the GeoTIFF keys {geotiff.horizontal}; WKT is used"
            warnings.append(CodedWarning("W_CRS_MISMATCH", text))
        elif wkt.vertical is None and geotiff.vertical is not None:
            chosen = _with_vertical(wkt, geotiff)
    if chosen.unit_z is None and unit_z is not None and not chosen.is_geographic:
        chosen = replace(chosen, unit_z=unit_z[0], metres_per_unit_z=unit_z[1])
    elif chosen.unit_z is None and unit_z is not None:
        chosen = replace(chosen, unit_z=unit_z[0])
    return _identified(chosen, header)


def _first_wkt(header: LasHeader, user_id: str, warnings: list[CodedWarning]) -> CrsInfo | None:
    """Return the first WKT record that parses and fits the coordinates."""
    for vlr in header.find(user_id, 2112):
        text = vlr.data.decode("utf-8", "replace").split("\0")[0].strip()
        if not text:
            continue
        try:
            with python_warnings.catch_warnings():
                python_warnings.simplefilter("ignore")
                found = pyproj.CRS.from_wkt(text)
                crs = describe(found, "wkt")
        except (ForeignCRSError, ProjError) as error:
            told = f"the WKT can't be parsed: {str(error).splitlines()[0][:200]}"
            warnings.append(CodedWarning("W_CRS_BROKEN", told))
            continue
        if _is_possible(found, crs.horizontal, header, warnings):
            return crs
    return None


def _keys(header: LasHeader) -> dict[int, Value]:
    records = [header.find(PROJECTION, record_id) for record_id in (34735, 34736, 34737)]
    directory, doubles, text = (found[0].data if found else b"" for found in records)
    return read_geokeys(directory, doubles, text)


def _from_geokeys(
    keys: dict[int, Value], header: LasHeader, wkt: CrsInfo | None, warnings: list[CodedWarning]
) -> CrsInfo | None:
    """Return the CRS of the GeoTIFF keys; that of the WKT itself if they say the same."""
    try:
        with python_warnings.catch_warnings():
            python_warnings.simplefilter("ignore")
            found = crs_from_keys(keys)
            if found is not None and wkt is not None and _is_that_of(wkt, found):
                return wkt  # to describe it and to compare places takes 0.2 s
            crs = None if found is None else describe(found, "geotiff")
    except (ForeignCRSError, ProjError, ValueError) as error:
        told = f"the GeoTIFF keys make no CRS: {str(error).splitlines()[0][:200]}"
        warnings.append(CodedWarning("W_CRS_BROKEN", told))
        return None
    if found is None or crs is None:
        return None
    return crs if _is_possible(found, crs.horizontal, header, warnings) else None


def _is_that_of(crs: CrsInfo, found: pyproj.CRS) -> bool:
    known = pyproj.CRS.from_wkt(crs.wkt2 or "")
    return bool(known.equals(unbound(found), ignore_axis_order=True))


def _is_possible(
    crs: pyproj.CRS, name: str | None, header: LasHeader, warnings: list[CodedWarning]
) -> bool:
    """
    Refuse labels that the coordinates prove wrong.

    Real files (tiles/lone-star.copc.laz, odd/lone-star-las11-crs4326.laz) say degrees or geocentric
    where the coordinates are eastings and northings. Only both corners of the header's box outside
    the possible count, for the box is often wrong too.
    """
    x0, y0, z0, x1, y1, z1 = header.box
    horizontal, _ = split(unbound(crs))
    if not all(map(math.isfinite, header.box)) or (x0, y0) == (x1, y1) == (0.0, 0.0):
        return True
    if horizontal.is_geographic:
        per_degree = 180 / math.pi * horizontal.axis_info[0].unit_conversion_factor
        wrong = all(
            abs(x) * per_degree > 540 or abs(y) * per_degree > 180 for x, y in ((x0, y0), (x1, y1))
        )
        what = "degrees"
    elif horizontal.is_geocentric:
        low, high = _EARTH_RADII_M
        wrong = not any(low < math.hypot(*p) < high for p in ((x0, y0, z0), (x1, y1, z1)))
        what = "geocentric coordinates"
    else:
        return True
    if wrong:
        text = f"the file's CRS ({name}) says {what}, which its coordinates are not; it is ignored"
        warnings.append(CodedWarning("W_CRS_BROKEN", text))
    return not wrong


def _check_flag(
    header: LasHeader, has_wkt: bool, has_keys: bool, warnings: list[CodedWarning]
) -> None:
    """Note a header flag that disagrees with the records (LAS 1.4 only: the flag is new there)."""
    if header.version != "1.4":
        return
    if header.has_wkt_flag and has_keys and not has_wkt:
        text = "the header says that the CRS is WKT, but it is in GeoTIFF keys"
    elif has_wkt and not has_keys and not header.has_wkt_flag:
        text = "the CRS is WKT, but the header does not say so"
    elif header.point_format >= 6 and has_keys and not has_wkt:
        text = f"point format {header.point_format} asks for WKT, the CRS is in GeoTIFF keys"
    else:
        return
    warnings.append(CodedWarning("W_WKT_FLAG", text + "; read nevertheless"))


def _agree(one: CrsInfo, other: CrsInfo, header: LasHeader) -> bool:
    """Whether two descriptions put the middle of the file at the same place, in the same units."""
    if one.epsg is not None and one.epsg == other.epsg:
        return True
    if one.metres_per_unit_xy != other.metres_per_unit_xy:
        return False
    x0, y0, _, x1, y1, _ = header.box
    place, place2 = (latlon(crs, (x0 + x1) / 2, (y0 + y1) / 2) for crs in (one, other))
    if place is None or place2 is None:
        return place == place2
    (lat, lon), (lat2, lon2) = place, place2
    north = (lat - lat2) * 111_320
    east = (lon - lon2) * 111_320 * math.cos(math.radians(lat))
    return math.hypot(north, east) <= MISMATCH_M


def _with_vertical(horizontal: CrsInfo, other: CrsInfo) -> CrsInfo:
    """Return a compound of one CRS and another's vertical part."""
    assert horizontal.wkt2 is not None
    assert other.wkt2 is not None
    _, vertical = split(pyproj.CRS.from_wkt(other.wkt2))
    base = pyproj.CRS.from_wkt(horizontal.wkt2)
    if vertical is None or len(base.axis_info) != 2:
        return horizontal
    return describe(compound(base, vertical), horizontal.source)


def _identified(crs: CrsInfo, header: LasHeader) -> CrsInfo:
    """
    Give a projected CRS without a code the EPSG code of the equal one in use at its place.

    Files often name theirs in a way that PROJ's own search, by name first, does not find:
    tiles/autzen-2010-oregon-10.6M.laz is EPSG:2994. Takes 0.1 s for the first
    tile of a place.
    """
    if crs.epsg is not None or crs.is_geographic or crs.wkt2 is None:
        return crs
    x0, y0, _, x1, y1, _ = header.box
    place = latlon(crs, (x0 + x1) / 2, (y0 + y1) / 2)
    horizontal, vertical = split(pyproj.CRS.from_wkt(crs.wkt2))
    if place is None or not horizontal.is_projected:
        return crs
    lat, lon = place
    near = _equals_near(horizontal.to_wkt(), min(math.floor(lon), 179), min(math.floor(lat), 89))
    equal = [code for code, area in near if _holds(area, lon, lat)]
    if len(equal) != 1:
        return crs
    whole = pyproj.CRS.from_epsg(equal[0])
    if vertical is not None:
        whole = compound(whole, vertical)
    found = describe(whole, crs.source)
    if found.unit_z is None:
        found = replace(found, unit_z=crs.unit_z, metres_per_unit_z=crs.metres_per_unit_z)
    return found


@functools.lru_cache(maxsize=64)
def _equals_near(wkt: str, west: int, south: int) -> tuple[tuple[int, pyproj.aoi.AreaOfUse], ...]:
    """Return code and area of the EPSG's CRS that equal one and are in use in a degree cell."""
    crs, kind = pyproj.CRS.from_wkt(wkt), pyproj.enums.PJType.PROJECTED_CRS
    # a margin, for PROJ may not count areas that only touch
    cell = pyproj.aoi.AreaOfInterest(
        max(west - 0.1, -180.0),
        max(south - 0.1, -90.0),
        min(west + 1.1, 180.0),
        min(south + 1.1, 90.0),
    )
    near = pyproj.database.query_crs_info("EPSG", [kind], cell)
    return tuple(
        (int(known.code), known.area_of_use)
        for known in near
        if known.area_of_use is not None
        and pyproj.CRS.from_epsg(int(known.code)).equals(crs, ignore_axis_order=True)
    )


def _holds(area: pyproj.aoi.AreaOfUse, lon: float, lat: float) -> bool:
    if area.west > area.east:  # across the date line
        is_along = lon >= area.west or lon <= area.east
    else:
        is_along = area.west <= lon <= area.east
    return bool(is_along and area.south <= lat <= area.north)


def _resolved(crs: str | CrsInfo, source: str) -> CrsInfo:
    return replace(crs, source=source) if isinstance(crs, CrsInfo) else crs_from_user(crs, source)
