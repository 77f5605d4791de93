"""GeoTIFF keys (records 34735 to 34737) as a plain dictionary; nothing here knows of PROJ.

The directory record is rows of four u16: key, where the value is (0 in the row itself, 34736 among
the doubles, 34737 in the text), how many, value or index. The first row is a version and the
number of keys (OGC 19-008r4, 7.1).
"""

from __future__ import annotations

import struct
from typing import TypeAlias

DOUBLES, TEXT = 34736, 34737

Value: TypeAlias = int | float | str

GT_MODEL_TYPE = 1024
GT_CITATION = 1026
GEOGRAPHIC_TYPE = 2048
GEOG_CITATION = 2049
GEODETIC_DATUM = 2050
ANGULAR_UNITS = 2054
ELLIPSOID = 2056
SEMI_MAJOR_AXIS = 2057
INV_FLATTENING = 2059
PROJECTED_TYPE = 3072
PROJECTED_CITATION = 3073
COORD_TRANS = 3075
LINEAR_UNITS = 3076
LINEAR_UNIT_SIZE = 3077
STD_PARALLEL_1 = 3078
STD_PARALLEL_2 = 3079
NAT_ORIGIN_LONG = 3080
NAT_ORIGIN_LAT = 3081
FALSE_EASTING = 3082
FALSE_NORTHING = 3083
FALSE_ORIGIN_LONG = 3084
FALSE_ORIGIN_LAT = 3085
FALSE_ORIGIN_EASTING = 3086
FALSE_ORIGIN_NORTHING = 3087
CENTER_LONG = 3088
CENTER_LAT = 3089
SCALE_AT_NAT_ORIGIN = 3092
VERTICAL_TYPE = 4096
VERTICAL_CITATION = 4097
VERTICAL_UNITS = 4099

USER_DEFINED = 32767


def read_geokeys(directory: bytes, doubles: bytes = b"", text: bytes = b"") -> dict[int, Value]:
    """
    Return the keys that can be read; rows that point outside their records are left out.

    Parameters
    ----------
    directory, doubles, text : bytes
        Content of the records 34735, 34736 and 34737.

    Returns
    -------
    keys : dict of int to int, float or str
        Of several doubles the first; texts without their final bar; no undefined (0) codes.

    Examples
    --------
    >>> read_geokeys(struct.pack("<8H", 1, 1, 0, 1, 3072, 0, 1, 2154))
    {3072: 2154}
    """
    n_words = len(directory) // 2
    words = struct.unpack_from(f"<{n_words}H", directory)
    numbers = struct.unpack_from(f"<{len(doubles) // 8}d", doubles)
    keys: dict[int, Value] = {}
    n_keys = words[3] if n_words >= 4 else 0
    for row in range(1, min(n_keys, n_words // 4 - 1) + 1):
        key, location, count, value = words[4 * row : 4 * row + 4]
        if location == 0 and value:
            keys[key] = value
        elif location == DOUBLES and value < len(numbers):
            keys[key] = numbers[value]
        elif location == TEXT and value < len(text):
            raw = text[value : value + count].split(b"\0")[0]
            keys[key] = raw.decode("ascii", "replace").rstrip("|").strip()
    return keys


def code(keys: dict[int, Value], key: int) -> int | None:
    """Return a code, None if it is absent, user-defined or not a whole number."""
    value = keys.get(key)
    return value if isinstance(value, int) and value not in (0, USER_DEFINED, 65535) else None


def number(keys: dict[int, Value], *names: int, default: float = 0.0) -> float:
    """Return the first of several keys that is a number."""
    for key in names:
        value = keys.get(key)
        if isinstance(value, int | float):
            return float(value)
    return default


def citation(keys: dict[int, Value], *names: int) -> str:
    """Return the first of several citations that says something."""
    for key in names:
        value = keys.get(key)
        if isinstance(value, str) and value.lower() not in ("", "unnamed", "unknown"):
            return value
    return ""
