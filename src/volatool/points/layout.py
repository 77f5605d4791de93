"""Where the attributes stand in a point record of each format, and how to take them out."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from volatool.model import I32

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


def take_apart(
    records: NDArray[np.uint8], names: Iterable[str], point_format: int
) -> tuple[I32, I32, I32, dict[str, NDArray[Any]]]:
    """
    Return coordinates and attributes of records as contiguous arrays of their own.

    Parameters
    ----------
    records : (n, record_bytes) array of uint8, C-contiguous, writable
        Of the point format.
    names : iterable of str
        Attribute names of `PointChunk` that the format has.
    point_format : int
        0 to 10.

    Returns
    -------
    x, y, z : (n,) arrays of int32
        Stored integers.
    attributes : dict of str to (n,) array
        Types as `PointChunk` says.
    """
    from volatool.kernels.records import split

    n = len(records)
    x, y, z = (np.empty(n, np.int32) for _ in range(3))
    places = {name: _wide_at(name, point_format) for name in names}
    large = {name: at for name, at in places.items() if at is not None}
    small = [name for name in places if name not in large]
    parts = np.array([_part(name, point_format < 6) for name in small], np.int64).reshape(-1, 3)
    narrow, wide = np.empty((len(small), n), np.uint8), np.empty((len(large), n), np.uint16)
    split(records, x, y, z, parts, narrow, np.array([*large.values()], np.int64), wide)
    taken: dict[str, NDArray[Any]] = dict(zip(large, wide, strict=True))
    for name, values in zip(small, narrow, strict=True):
        taken[name] = values.view(np.bool_) if name in _FLAG_BIT else values
    return x, y, z, taken


def _wide_at(name: str, point_format: int) -> int | None:
    """Return where an attribute of two bytes is; None for those within a byte."""
    if name in COLOURS:
        return _RGB_AT[point_format] + 2 * COLOURS.index(name)
    return 12 if name == "intensity" else None


def _part(name: str, is_legacy: bool) -> tuple[int, int, int]:
    """Return the byte of an attribute, the bits below it, and the mask of its bits then."""
    if name == "return_number":
        return (14, 0, 0x07 if is_legacy else 0x0F)
    if name == "number_of_returns":
        return (14, 3, 0x07) if is_legacy else (14, 4, 0x0F)
    if name == "classification":
        return (15, 0, 0x1F) if is_legacy else (16, 0, 0xFF)
    # legacy: the flags are bits 5 to 7 of the class byte
    return (15, _FLAG_BIT[name] + (5 if is_legacy else 0), 1)
