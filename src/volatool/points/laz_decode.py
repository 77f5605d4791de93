"""Decoding by lazrs. Its errors and panics become `DecodeError`. `laz_encode` encodes."""

from __future__ import annotations

import contextlib
import io
import os
import struct
import threading
from collections.abc import Iterator
from importlib import metadata
from typing import Any, BinaryIO

import lazrs
import numpy as np
from numpy.typing import NDArray

from volatool.points.laz_chunks import (
    LAYERED,
    POINTWISE_CHUNKED,
    Chunk,
    Laszip,
    layered_size,
)

_FIELD_OF = {
    "classification": lazrs.SELECTIVE_DECOMPRESS_CLASSIFICATION,
    "intensity": lazrs.SELECTIVE_DECOMPRESS_INTENSITY,
    "withheld": lazrs.SELECTIVE_DECOMPRESS_FLAGS,
    "synthetic": lazrs.SELECTIVE_DECOMPRESS_FLAGS,
    "key_point": lazrs.SELECTIVE_DECOMPRESS_FLAGS,
    "red": lazrs.SELECTIVE_DECOMPRESS_RGB,
    "green": lazrs.SELECTIVE_DECOMPRESS_RGB,
    "blue": lazrs.SELECTIVE_DECOMPRESS_RGB,
}


EVERYTHING = int(lazrs.SELECTIVE_DECOMPRESS_ALL)
"""Selection of whole records."""


class DecodeError(Exception):
    """The decoder failed on bytes that were located and measured correctly."""


def selection_of(names: frozenset[str]) -> int:
    """Return the decoder's bit mask for x, y, z and these attributes."""
    mask = lazrs.SELECTIVE_DECOMPRESS_XY_RETURNS_CHANNEL | lazrs.SELECTIVE_DECOMPRESS_Z
    for name in names:
        mask |= _FIELD_OF.get(name, 0)
    return int(mask)


def backend_name() -> str:
    """Return the decoder's name and version."""
    return f"lazrs {metadata.version('lazrs')}, parallel"


def read_table(stream: BinaryIO, record: bytes) -> list[tuple[int, int]] | None:
    """Return the (points, bytes) of each chunk; None if the table can't be decoded."""
    try:
        with _decoding():
            table = lazrs.read_chunk_table(stream, lazrs.LazVlr(record))
    except DecodeError:
        return None
    return [(int(n_points), int(n_bytes)) for n_points, n_bytes in table]


def decode_chunks(
    stream: BinaryIO,
    laszip: Laszip,
    group: list[Chunk],
    selection: int,
    records: NDArray[np.uint8],
) -> None:
    """
    Decode chunks that stand one behind the other, on all cores.

    Parameters
    ----------
    stream : binary file
        The file.
    laszip : Laszip
        Its LASzip record.
    group : list of Chunk
        What to decode.
    selection : int
        Of `selection_of`.
    records : (n, record_bytes) array of uint8, C-contiguous
        Filled with the points of the group; fields that are not selected are undefined.

    Raises
    ------
    DecodeError
        Some chunk of the group can't be decoded.
    """
    start, n_bytes = group[0].at, sum(chunk.n_bytes for chunk in group)
    stream.seek(start)
    data = stream.read(n_bytes)
    if len(data) < n_bytes:
        raise DecodeError("the file ends inside a chunk")
    if laszip.compressor == LAYERED:
        record_bytes = records.shape[1]
        head_bytes = record_bytes + 4 + 4 * laszip.n_layers
        for chunk in group:
            head = data[chunk.at - start : chunk.at - start + head_bytes]
            count, needed = layered_size(head, record_bytes, laszip.n_layers)
            if count != chunk.n_points or needed > chunk.n_bytes:
                raise DecodeError("the layers of a chunk don't fit it")
    table = [(chunk.n_points, chunk.n_bytes) for chunk in group]
    with _decoding():
        lazrs.decompress_points_with_chunk_table(
            data, laszip.data, records.reshape(-1), table, lazrs.DecompressionSelection(selection)
        )


class Sequence:
    """
    Decodes a stretch of points one after another.

    Parameters
    ----------
    stream : binary file
        The file.
    laszip : Laszip
        Its LASzip record.
    chunk : Chunk
        The stretch.
    chunk_size : int
        Points after which the coder starts anew inside the stretch.
    selection : int
        Of `selection_of`.
    """

    def __init__(
        self, stream: BinaryIO, laszip: Laszip, chunk: Chunk, chunk_size: int, selection: int
    ) -> None:
        compressor = LAYERED if laszip.compressor == LAYERED else POINTWISE_CHUNKED
        framed = _Framed(stream, chunk.at, chunk.n_bytes)
        record = laszip.patched(compressor, chunk_size).data
        with _decoding():
            self._decoder: Any = lazrs.LasZipDecompressor(
                framed, record, lazrs.DecompressionSelection(selection)
            )
        framed.hide_table()

    def read_into(self, records: NDArray[np.uint8]) -> None:
        """
        Decode the next points.

        Parameters
        ----------
        records : C-contiguous array of uint8
            One or many whole records, filled.

        Raises
        ------
        DecodeError
            Not all could be decoded.
        """
        with _decoding():
            self._decoder.decompress_many(records.reshape(-1))


class _Framed:
    """A stretch of a file as the decoder wants it: table offset, points, an empty table."""

    def __init__(self, stream: BinaryIO, at: int, n_bytes: int) -> None:
        self._stream, self._at, self._n_bytes = stream, at, n_bytes
        self._head = struct.pack("<q", 8 + n_bytes)
        self._tail = bytes(8)
        self._position = 0

    def hide_table(self) -> None:
        """End with the points, so that the table can't be taken for points."""
        self._tail = b""

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        """Move; all three ways."""
        end = 8 + self._n_bytes + len(self._tail)
        base = {io.SEEK_SET: 0, io.SEEK_CUR: self._position, io.SEEK_END: end}[whence]
        self._position = max(0, base + offset)
        return self._position

    def tell(self) -> int:
        """Return the position."""
        return self._position

    def read(self, size: int = -1) -> bytes:
        """Return up to `size` bytes of the part that the position is in."""
        here, end = self._position, 8 + self._n_bytes
        if here < 8:
            data = self._head[here:]
        elif here < end:
            self._stream.seek(self._at + here - 8)
            data = self._stream.read(end - here if size < 0 else min(size, end - here))
        else:
            data = self._tail[here - end :]
        data = data if size < 0 else data[:size]
        self._position += len(data)
        return data


_quiet_lock = threading.Lock()
_quiet: dict[str, int] = {"depth": 0, "stderr": -1}


@contextlib.contextmanager
def _decoding() -> Iterator[None]:
    """Turn the decoder's errors, Rust panics included, into `DecodeError`, silently."""
    _hush()
    try:
        yield
    except lazrs.LazrsError as error:
        raise DecodeError(str(error)) from error
    except BaseException as error:
        # a panic derives from BaseException and its class can't be imported
        if type(error).__name__ != "PanicException":
            raise
        raise DecodeError(f"panic: {error}") from error
    finally:
        _unhush()


def _hush() -> None:
    """Point file descriptor 2 at nothing: a Rust panic writes there before Python hears of it."""
    with _quiet_lock:
        _quiet["depth"] += 1
        if _quiet["depth"] == 1:
            with contextlib.suppress(OSError):  # no stderr, nothing to hush
                _quiet["stderr"] = os.dup(2)
                null = os.open(os.devnull, os.O_WRONLY)
                os.dup2(null, 2)
                os.close(null)


def _unhush() -> None:
    with _quiet_lock:
        _quiet["depth"] -= 1
        if _quiet["depth"] == 0 and _quiet["stderr"] >= 0:
            os.dup2(_quiet["stderr"], 2)
            os.close(_quiet["stderr"])
            _quiet["stderr"] = -1
