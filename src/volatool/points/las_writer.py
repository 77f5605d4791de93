"""
Write points as LAS 1.4 or LAZ: point format 6, or 7 with colours.

The header block is written twice: at first to keep its place, in the end with counts and box.

======  ====  ========  =======================================================
offset  size  type      meaning
======  ====  ========  =======================================================
0       4     bytes     ``LASF``
6       2     u16       global encoding: bit 4, the CRS is WKT
24      2     u8, u8    1, 4
26      64    bytes     system identifier, generating software
90      4     u16, u16  day and year of creation: 0, the same points are the same bytes
94      2     u16       375
96      8     u32, u32  offset to the points, number of records (VLR)
104     3     u8, u16   point format (bit 7: compressed), bytes of a record
107     24    6 x u32   counts of old: 0
131     48    6 x f64   scale x, y, z, offset x, y, z
179     48    6 x f64   max x, min x, max y, min y, max z, min z
247     128   16 x u64  number of points, and by return
======  ====  ========  =======================================================
"""

from __future__ import annotations

import struct
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from volatool._version import __version__
from volatool.errors import OutputError
from volatool.model import I64
from volatool.points.header import COMPRESSED_BIT, WKT_BIT
from volatool.points.laz_encode import PointEncoder

_HEADER_BYTES = 375
_I32 = np.iinfo(np.int32)
_FIELDS = [
    ("x", "<i4"),
    ("y", "<i4"),
    ("z", "<i4"),
    ("intensity", "<u2"),
    ("returns", "u1"),
    ("flags", "u1"),
    ("classification", "u1"),
    ("user_data", "u1"),
    ("scan_angle", "<i2"),
    ("point_source_id", "<u2"),
    ("gps_time", "<f8"),
]
_COLOURS = [("red", "<u2"), ("green", "<u2"), ("blue", "<u2")]


class LasWriter:
    """
    A LAS or LAZ file that is written piece by piece.

    Parameters
    ----------
    out : binary file
        Empty, seekable.
    scale, offset : tuple of 3 float
        ``coordinate = stored * scale + offset``.
    has_colours : bool
        Point format 7 instead of 6.
    is_compressed : bool
        LAZ.
    wkt : str, optional
        CRS.
    """

    def __init__(
        self,
        out: BinaryIO,
        scale: tuple[float, float, float],
        offset: tuple[float, float, float],
        *,
        has_colours: bool,
        is_compressed: bool,
        wkt: str | None = None,
    ) -> None:
        self._out, self._scale, self._offset = out, scale, offset
        self._format = 7 if has_colours else 6
        self._dtype = np.dtype(_FIELDS + (_COLOURS if has_colours else []))
        self._has_wkt = wkt is not None
        self._counts: I64 = np.zeros(16, np.int64)  # by return number; 0 is none
        self._low = np.full(3, _I32.max, np.int64)
        self._high = np.full(3, _I32.min, np.int64)
        records = [_wkt_record(wkt)] if wkt is not None else []
        self._encoder: PointEncoder | None = None
        if is_compressed:
            self._encoder = PointEncoder(self._format, self._dtype.itemsize)
            records.append(self._encoder.vlr())
        self._n_records = len(records)
        self._points_at = _HEADER_BYTES + sum(map(len, records))
        out.write(bytes(_HEADER_BYTES) + b"".join(records))
        if self._encoder is not None:
            self._encoder.begin(out)

    def write(self, stored: NDArray[Any], **attributes: Any) -> None:
        """
        Append points.

        Parameters
        ----------
        stored : (n, 3) array of int
            x, y, z as they are stored.
        **attributes : (n,) arrays or scalars
            ``intensity``, ``classification``, ``red``, ``green``, ``blue``, and
            ``number_of_returns`` (1 to 15, 1 if not given); each is the first return.

        Raises
        ------
        OutputError
            A coordinate does not fit 32 bits.
        """
        if not len(stored):
            return
        low, high = stored.min(axis=0), stored.max(axis=0)
        if low.min() < _I32.min or high.max() > _I32.max:
            raise OutputError("coordinates don't fit the 32 bits of a LAS file at this scale")
        self._low, self._high = np.minimum(self._low, low), np.maximum(self._high, high)
        records = np.zeros(len(stored), self._dtype)
        for axis, name in enumerate("xyz"):
            records[name] = stored[:, axis]
        n_returns = np.asarray(attributes.pop("number_of_returns", 1), np.uint8)
        records["returns"] = n_returns << np.uint8(4) | np.uint8(1)
        for name, values in attributes.items():
            records[name] = values
        self._counts[0] += len(stored)
        self._counts[1] += len(stored)
        raw = records.view(np.uint8).reshape(len(records), -1)
        if self._encoder is not None:
            self._encoder.write(raw)
        else:
            self._out.write(raw.tobytes())

    def finish(self) -> None:
        """Write what waits, and the header."""
        if self._encoder is not None:
            self._encoder.end()
        self._out.seek(0)
        self._out.write(self._header())

    def _header(self) -> bytes:
        head = bytearray(_HEADER_BYTES)
        struct.pack_into("<4sHH", head, 0, b"LASF", 0, WKT_BIT if self._has_wkt else 0)
        software = f"volatool {__version__}".encode()
        struct.pack_into("<BB32s32s", head, 24, 1, 4, b"OTHER", software)
        struct.pack_into("<HII", head, 94, _HEADER_BYTES, self._points_at, self._n_records)
        kind = self._format | (COMPRESSED_BIT if self._encoder is not None else 0)
        struct.pack_into("<BH", head, 104, kind, self._dtype.itemsize)
        struct.pack_into("<6d", head, 131, *self._scale, *self._offset)
        if self._counts[0]:
            for axis in range(3):
                ends = [
                    int(stored[axis]) * self._scale[axis] + self._offset[axis]
                    for stored in (self._high, self._low)
                ]
                struct.pack_into("<2d", head, 179 + 16 * axis, *ends)
        struct.pack_into("<16Q", head, 247, *self._counts.tolist())
        return bytes(head)


def _wkt_record(wkt: str) -> bytes:
    data = wkt.encode("utf-8") + b"\0"
    if len(data) > 65535:
        raise OutputError("the CRS is too long for a record of a LAS file")
    return struct.pack("<H16sHH32s", 0, b"LASF_Projection", 2112, len(data), b"WKT") + data
