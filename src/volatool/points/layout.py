"""Where the attributes stand in a point record of each format, and how to take them out."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

RECORD_BYTES = {0: 20, 1: 28, 2: 26, 3: 34, 4: 57, 5: 63, 6: 30, 7: 36, 8: 38, 9: 59, 10: 67}
"""Least bytes of a record by point format (ASPRS LAS 1.4 R15, tables 7 to 17)."""

_RGB_AT = {2: 20, 3: 28, 5: 28, 7: 30, 8: 30, 10: 30}
_COMMON = frozenset(
    {
        "classification",
        "return_number",
        "number_of_returns",
        "intensity",
        "withheld",
        "synthetic",
        "key_point",
    }
)
COLOURS = ("red", "green", "blue")

_FLAG_BIT = {"synthetic": 0, "key_point": 1, "withheld": 2}


def dimensions_of(point_format: int) -> frozenset[str]:
    """Return the attribute names that a point format has."""
    return _COMMON | frozenset(COLOURS) if point_format in _RGB_AT else _COMMON


def record_dtype(point_format: int, record_bytes: int) -> np.dtype[Any]:
    """
    Return the structured type of a record: the fields that we read, at their offsets.

    Parameters
    ----------
    point_format : int
        0 to 10.
    record_bytes : int
        Of a record, extra bytes included.

    Returns
    -------
    dtype : numpy dtype
        x, y, z, intensity, colours, and as raw bytes ``returns``, ``flags``, ``classification``.
    """
    is_legacy = point_format < 6
    fields = {
        "x": ("<i4", 0),
        "y": ("<i4", 4),
        "z": ("<i4", 8),
        "intensity": ("<u2", 12),
        "returns": ("u1", 14),
        "flags": ("u1", 15),
        "classification": ("u1", 15 if is_legacy else 16),
    }
    if point_format in _RGB_AT:
        start = _RGB_AT[point_format]
        fields |= {name: ("<u2", start + 2 * i) for i, name in enumerate(COLOURS)}
    return np.dtype(
        {
            "names": list(fields),
            "formats": [kind for kind, _ in fields.values()],
            "offsets": [at for _, at in fields.values()],
            "itemsize": record_bytes,
        }
    )


def take_attributes(
    records: NDArray[Any], names: Iterable[str], is_legacy: bool
) -> dict[str, NDArray[Any]]:
    """
    Return attributes of records as contiguous arrays of their own.

    Parameters
    ----------
    records : (n,) structured array
        Of type `record_dtype`.
    names : iterable of str
        Attribute names of `PointChunk` that the format has.
    is_legacy : bool
        Point formats 0 to 5: class and flags share a byte, returns have three bits.

    Returns
    -------
    attributes : dict of str to (n,) array
        Types as `PointChunk` says.
    """
    taken: dict[str, NDArray[Any]] = {}
    for name in names:
        if name == "return_number":
            taken[name] = records["returns"] & np.uint8(0x07 if is_legacy else 0x0F)
        elif name == "number_of_returns":
            shifted = records["returns"] >> np.uint8(3 if is_legacy else 4)
            taken[name] = shifted & np.uint8(0x07) if is_legacy else shifted
        elif name == "classification":
            raw = records["classification"]
            taken[name] = raw & np.uint8(0x1F) if is_legacy else raw.copy()
        elif name in _FLAG_BIT:
            # legacy: the flags are bits 5 to 7 of the class byte
            bit = _FLAG_BIT[name] + (5 if is_legacy else 0)
            taken[name] = (records["flags"] & np.uint8(1 << bit)) != 0
        else:
            taken[name] = records[name].copy()
    return taken
