"""Encoding by lazrs: the LASzip record and the stream of compressed points."""

from __future__ import annotations

import struct
from typing import Any, BinaryIO

import lazrs
import numpy as np
from numpy.typing import NDArray

from volatool.points.layout import RECORD_BYTES
from volatool.points.relay import Relay, uninterrupted


class PointEncoder:
    """
    Compresses records onto a file.

    Parameters
    ----------
    point_format : int
        0 to 10.
    record_bytes : int
        Of a record, extra bytes included.
    """

    def __init__(self, point_format: int, record_bytes: int) -> None:
        n_extra = record_bytes - RECORD_BYTES[point_format]
        self._vlr: Any = lazrs.LazVlr.new_for_compression(point_format, n_extra)
        self._compressor: Any = None

    def vlr(self) -> bytes:
        """Return the LASzip record, its header included."""
        data = bytes(self._vlr.record_data())
        head = struct.pack("<H16sHH32s", 0, b"laszip encoded", 22204, len(data), b"by volatool")
        return head + data

    def begin(self, out: BinaryIO) -> None:
        """Start the points at the file's position; it must seek."""
        self._out = Relay(out)
        self._compressor = lazrs.ParLasZipCompressor(self._out, self._vlr)
        self._compressor.reserve_offset_to_chunk_table()

    def write(self, records: NDArray[np.uint8]) -> None:
        """
        Compress records.

        Parameters
        ----------
        records : (n, record_bytes) array of uint8, C-contiguous
            How they are cut into calls does not change the file.
        """
        try:
            with uninterrupted():
                self._compressor.compress_many(records.reshape(-1))
        except lazrs.LazrsError as error:
            raise self._out.cause(error, "the points can't be compressed") from error

    def end(self) -> None:
        """Write what waits, and the chunk table."""
        try:
            with uninterrupted():
                self._compressor.done()
        except lazrs.LazrsError as error:
            raise self._out.cause(error, "the points can't be compressed") from error
