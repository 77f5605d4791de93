"""Write a LAS or LAZ file again as LAZ: other records, all else byte for byte as it was.

What changes in front of and behind the points:

======  ====================================================================
offset  what
======  ====================================================================
96      offset to the points, and 100 the number of records (VLR)
104     point format: marked as compressed
107     counts of points and returns, when they are not those of the points
227     place of internal waveforms
235     place and number of extended records (EVLR)
247     counts of points and returns (1.4), as at 107
======  ====================================================================

A former LASzip record is replaced; the records of a COPC index are left out, as the order of bytes
that they describe is gone.
"""

from __future__ import annotations

import struct
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from volatool.errors import FormatError, OutputError
from volatool.points.header import COMPRESSED_BIT, LasHeader, Vlr
from volatool.points.laz_encode import PointEncoder
from volatool.points.reader import PointSource

_BLOCK = 1 << 20


class Rewriter:
    """
    A LAZ file that is a copy of another file but for its points.

    Parameters
    ----------
    source : PointSource
        The file that is copied.
    out : binary file
        Empty, seekable.
    """

    def __init__(self, source: PointSource, out: BinaryIO) -> None:
        self._source, self._out = source, out
        self._header: LasHeader = source.header
        self._head = bytearray(source.raw(0, self._header.offset_to_points))
        self._encoder = PointEncoder(self._header.point_format, self._header.record_bytes)
        self._n_points = 0
        self._channel: int | None = None
        self._returns = np.zeros(16, np.int64)
        self._write_head()
        self._encoder.begin(out)

    def write(self, records: NDArray[np.uint8]) -> None:
        """
        Append points.

        Parameters
        ----------
        records : (n, record_bytes) array of uint8
            Whole records.
        """
        self._refuse_channels(records)
        mask = np.uint8(0x07 if self._header.point_format < 6 else 0x0F)
        self._returns += np.bincount(records[:, 14] & mask, minlength=16)
        self._n_points += len(records)
        self._encoder.write(np.ascontiguousarray(records))

    def _refuse_channels(self, records: NDArray[np.uint8]) -> None:
        """
        Refuse waveforms of several scanner channels.

        lazrs 0.8.2 loses their wave packets (test_rewrite.py shows it), in silence.
        """
        if self._header.point_format not in (9, 10) or not len(records):
            return
        channels = records[:, 15] >> np.uint8(4) & np.uint8(3)
        if self._channel is None:
            self._channel = int(channels[0])
        if np.any(channels != self._channel):
            raise OutputError(
                f"{self._source.name}: waveforms of several scanner channels can't be written "
                "as LAZ without loss"
            )

    def finish(self) -> None:
        """Write what stands behind the points, and the header."""
        self._encoder.end()
        self._out.seek(0, 2)
        moved = self._copy_behind()
        self._set_places(moved)
        self._set_counts()
        self._out.seek(0)
        self._out.write(self._head[: self._header.header_bytes])

    def _write_head(self) -> None:
        """Write header and records; keep the header to complete it in the end."""
        header, head = self._header, self._head
        at = header.header_bytes
        parts = [bytes(head[:at])]
        for vlr in header.vlrs:
            if vlr.is_extended:
                continue
            if not _is_dropped(vlr):
                parts.append(bytes(head[at : at + vlr.size_bytes]))
            at += vlr.size_bytes
        n_vlrs = len(parts)  # one more than are kept: the LASzip record
        rest = bytes(head[at:])  # user data, which may stand between records and points
        whole = b"".join([*parts, self._encoder.vlr(), rest])
        if len(whole) >= 2**32:
            raise FormatError("header and records are too large for a LASzip record more")
        struct.pack_into("<II", head, 96, len(whole), n_vlrs)
        head[104] = header.point_format | COMPRESSED_BIT
        self._out.write(whole)

    def _copy_behind(self) -> dict[int, int]:
        """Copy extended records and waveforms; return the new place of each by its old one."""
        header, moved = self._header, {}
        extended = [vlr for vlr in header.vlrs if vlr.is_extended]
        at = _first_evlr(header, self._head)
        for vlr in extended:
            if not _is_dropped(vlr):
                moved[at] = self._copy(at, vlr.size_bytes)
            at += vlr.size_bytes
        waveforms = _waveforms(header, self._head)
        if not extended and header.points_end <= waveforms < header.size_bytes:
            moved[waveforms] = self._copy(waveforms, header.size_bytes - waveforms)
        return moved

    def _copy(self, at: int, n_bytes: int) -> int:
        """Copy a stretch of the source to the end; return where it starts there."""
        start = self._out.tell()
        while n_bytes:
            block = self._source.raw(at, min(n_bytes, _BLOCK))
            if not block:
                raise FormatError(f"{self._source.name}: an extended record ends early")
            self._out.write(block)
            at, n_bytes = at + len(block), n_bytes - len(block)
        return start

    def _set_places(self, moved: dict[int, int]) -> None:
        header, head = self._header, self._head
        waveforms = _waveforms(header, head)
        if waveforms in moved:
            struct.pack_into("<Q", head, 227, moved[waveforms])
        if _has_64_bit_counts(header):
            n_kept = sum(vlr.is_extended and not _is_dropped(vlr) for vlr in header.vlrs)
            first = min(moved.values()) if n_kept else 0
            struct.pack_into("<QI", head, 235, first, n_kept)

    def _set_counts(self) -> None:
        """Correct the counts if they are not those of the points written."""
        head, n_points = self._head, self._n_points
        (legacy,) = struct.unpack_from("<I", head, 107)
        is_new = _has_64_bit_counts(self._header)
        claimed = struct.unpack_from("<Q", head, 247)[0] if is_new else legacy
        if claimed == n_points and legacy in (0, n_points):
            return
        fits = self._header.point_format < 6 and n_points < 2**32
        returns = self._returns[1:].tolist()
        struct.pack_into("<6I", head, 107, *([n_points, *returns[:5]] if fits else [0] * 6))
        if is_new:
            struct.pack_into("<16Q", head, 247, n_points, *returns)


def _is_dropped(vlr: Vlr) -> bool:
    return vlr.user_id == "copc" or (vlr.user_id, vlr.record_id) == ("laszip encoded", 22204)


def _has_64_bit_counts(header: LasHeader) -> bool:
    return header.version == "1.4" and header.header_bytes >= 375


def _first_evlr(header: LasHeader, head: bytearray) -> int:
    return int(struct.unpack_from("<Q", head, 235)[0]) if _has_64_bit_counts(header) else 0


def _waveforms(header: LasHeader, head: bytearray) -> int:
    has_place = header.version in ("1.3", "1.4") and header.header_bytes >= 235
    return int(struct.unpack_from("<Q", head, 227)[0]) if has_place else 0
