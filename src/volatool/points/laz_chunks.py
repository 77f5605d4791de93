"""Where the compressed chunks of a LAZ file stand, checked before a decoder sees them.

A damaged file must not reach the decoder unchecked: lazrs allocates what chunk tables and layer
sizes claim (an allocation that fails ends the process), divides by a chunk size of zero and panics
on some streams. So the chunks are located and measured here first, by their table or, where the
table is lost and the format allows, by walking from chunk to chunk.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import BinaryIO

from volatool.errors import CodedWarning, FormatError
from volatool.points.header import LasHeader

VARIABLE_CHUNKS = 2**32 - 1
ONE_CHUNK = 2**32 - 2
"""Chunk size given to the decoder when it sees a single chunk."""

MAX_POINTS_PER_BYTE = 10_000
"""More points a byte than any real file has (equal points take about 0.01 bit each)."""

POINTWISE, POINTWISE_CHUNKED, LAYERED = 1, 2, 3

# LASzip item types (laszip.hpp) after the point itself: what each point format must have
_ITEMS = {
    0: (6,),
    1: (6, 7),
    2: (6, 8),
    3: (6, 7, 8),
    4: (6, 7, 9),
    5: (6, 7, 8, 9),
    6: (10,),
    7: (10, 11),
    8: (10, 12),
    9: (10, 13),
    10: (10, 12, 13),
}
_EXTRA_ITEMS = (0, 14)
_LAYERS = {10: 9, 11: 1, 12: 2, 13: 1}
"""Layers of an item in a layered chunk; extra bytes (14) have one each."""


@dataclass(frozen=True, slots=True)
class Laszip:
    """
    The LASzip record of a file.

    Parameters
    ----------
    data : bytes
        The record as stored, but for a chunk size that was repaired.
    compressor : int
        1 one stream of points, 2 chunks of points, 3 chunks of layers.
    chunk_size : int
        Points of a chunk; 2**32 - 1 when they vary.
    n_layers : int
        Layers of a chunk (compressor 3).
    """

    data: bytes
    compressor: int
    chunk_size: int
    n_layers: int

    def patched(self, compressor: int, chunk_size: int) -> Laszip:
        """Return the record with another compressor and chunk size."""
        data = (
            struct.pack("<H", compressor)
            + self.data[2:12]
            + struct.pack("<I", chunk_size)
            + self.data[16:]
        )
        return Laszip(data, compressor, chunk_size, self.n_layers)


@dataclass(frozen=True, slots=True)
class Chunk:
    """
    Where a chunk stands.

    Parameters
    ----------
    first, n_points : int
        Number of its first point in the file; its points.
    at, n_bytes : int
        Its bytes in the file.
    """

    first: int
    n_points: int
    at: int
    n_bytes: int


def read_laszip(header: LasHeader) -> Laszip:
    """
    Return the checked LASzip record of a compressed file.

    Raises
    ------
    FormatError
        It is missing, inconsistent with the header, or of an unknown kind.
    """
    found = header.find("laszip encoded", 22204)
    if not found or len(found[0].data) < 34:
        raise FormatError("the points are compressed but there is no LASzip record")
    data = found[0].data
    compressor, coder = struct.unpack_from("<HH", data)
    (chunk_size,) = struct.unpack_from("<I", data, 12)
    (n_items,) = struct.unpack_from("<H", data, 32)
    if compressor not in (POINTWISE, POINTWISE_CHUNKED, LAYERED) or coder != 0:
        raise FormatError(f"LASzip compressor {compressor} with coder {coder} is not known")
    if len(data) < 34 + 6 * n_items:
        raise FormatError(f"the LASzip record is too short for its {n_items} items")
    items = [struct.unpack_from("<HHH", data, 34 + 6 * i) for i in range(n_items)]
    kinds = tuple(kind for kind, _, _ in items if kind not in _EXTRA_ITEMS)
    size = sum(size for _, size, _ in items)
    if kinds != _ITEMS[header.point_format] or size != header.record_bytes:
        raise FormatError(
            f"the LASzip record describes points of {size} bytes with items {kinds}, the header "
            f"point format {header.point_format} with {header.record_bytes} bytes"
        )
    is_layered = header.point_format >= 6
    if is_layered != (compressor == LAYERED):
        raise FormatError(
            f"LASzip compressor {compressor} does not go with point format {header.point_format}"
        )
    n_layers = sum(_LAYERS.get(kind, size) for kind, size, _ in items)
    return Laszip(data[: 34 + 6 * n_items], compressor, chunk_size, n_layers)


class ChunkFinder:
    """
    Finds the chunks of a LAZ file.

    Parameters
    ----------
    stream : binary file
        The file.
    header : LasHeader
        Of that file.
    read_table : callable
        (stream, LASzip record) to the (points, bytes) of each chunk, with the stream at the first
        point; None if the table can't be decoded.

    Attributes
    ----------
    laszip : Laszip
        The record, its chunk size repaired.
    chunks : list of Chunk or None
        None: one stream that can only be read from its start.
    is_cut : bool
        The file ends before the points that the header claims.
    start : int
        Byte at which the compressed points start.
    warnings : list of CodedWarning
        What is wrong with the chunk table or the count.
    """

    def __init__(
        self,
        stream: BinaryIO,
        header: LasHeader,
        read_table: Callable[[BinaryIO, bytes], list[tuple[int, int]] | None],
    ) -> None:
        self._stream, self._header, self._decode_table = stream, header, read_table
        self.laszip = read_laszip(header)
        self.warnings: list[CodedWarning] = []
        self.is_cut = False
        self.start = header.offset_to_points + (8 if self.laszip.compressor != POINTWISE else 0)
        if header.n_points > MAX_POINTS_PER_BYTE * header.size_bytes:
            raise FormatError(
                f"the header claims {header.n_points} points in a file of {header.size_bytes} bytes"
            )
        has_points = header.n_points or header.size_bytes > self.start
        self.chunks = self._locate() if has_points else []

    def _locate(self) -> list[Chunk] | None:
        """Return the chunks by their table, or by walking, or None."""
        laszip, size = self.laszip, self._header.size_bytes
        if laszip.compressor == POINTWISE:
            return None
        entries = self._read_table()
        if entries is not None:
            return self._chunks_of(entries)
        if laszip.compressor == LAYERED:
            chunks = self._walk()
        elif laszip.chunk_size in (0, VARIABLE_CHUNKS):
            raise FormatError("the chunk table is lost and the chunks are of varying size")
        else:
            chunks = None
        text = f"the LAZ chunk table is missing or broken (file of {size} bytes)"
        self.warnings.append(CodedWarning("W_CHUNK_TABLE", text))
        return chunks

    def _read_table(self) -> list[tuple[int, int]] | None:
        """Return (points, bytes) of each chunk as the table says, None if it can't be right."""
        header, size = self._header, self._header.size_bytes
        if size < self.start:
            return None
        offset = _i64(self._stream, header.offset_to_points)
        if offset <= header.offset_to_points:  # the writer could not go back: offset at the end
            offset = _i64(self._stream, size - 8)
        if not self.start <= offset <= size - 8:
            return None
        self._stream.seek(offset)
        _, n_chunks = struct.unpack("<II", self._stream.read(8))
        room = offset - self.start
        if n_chunks * header.record_bytes > room:
            return None
        if n_chunks == 0:
            return [] if room == 0 else None
        for chunk_size in self._plausible_chunk_sizes():
            laszip = self.laszip.patched(self.laszip.compressor, chunk_size)
            self._stream.seek(header.offset_to_points)
            table = self._decode_table(self._stream, laszip.data)
            if table is None or len(table) != n_chunks:
                continue
            if min(size for _, size in table) > 0 and sum(size for _, size in table) == room:
                self.laszip = laszip
                return table
        return None

    def _plausible_chunk_sizes(self) -> tuple[int, ...]:
        """Return the chunk size of the record; for a senseless 0 what writers mean by it."""
        if self.laszip.chunk_size:
            return (self.laszip.chunk_size,)
        # odd/example.copc.laz: 0, with a table of fixed chunks
        return (VARIABLE_CHUNKS, min(max(self._header.n_points, 1), ONE_CHUNK))

    def _chunks_of(self, entries: list[tuple[int, int]]) -> list[Chunk]:
        """Return the chunks of a table, with the header's count compared and corrected."""
        header, laszip = self._header, self.laszip
        counts = [count for count, _ in entries]
        claimed = header.n_points
        if entries and laszip.chunk_size != VARIABLE_CHUNKS:
            last_at = self.start + sum(n_bytes for _, n_bytes in entries[:-1])
            before = (len(entries) - 1) * laszip.chunk_size
            if laszip.compressor == LAYERED:
                counts[-1] = layered_count(self._stream, last_at, header.record_bytes)
            elif claimed <= before:
                self._warn_count(f"the chunks hold more than {before}; {claimed} are read")
                kept = -(-claimed // laszip.chunk_size)
                counts = counts[:kept]
                if counts:
                    counts[-1] = claimed - (kept - 1) * laszip.chunk_size
                return _chunks(counts, entries, self.start)
            else:
                counts[-1] = min(claimed - before, laszip.chunk_size)
        total = sum(counts)
        if total > MAX_POINTS_PER_BYTE * header.size_bytes:
            raise FormatError(
                f"the chunks claim {total} points in a file of {header.size_bytes} bytes"
            )
        if total != claimed:
            self._warn_count(f"the chunks hold {total}, which are read")
        return _chunks(counts, entries, self.start)

    def _warn_count(self, what: str) -> None:
        text = f"the header claims {self._header.n_points} points; {what}"
        self.warnings.append(CodedWarning("W_HEADER_COUNT", text))

    def _walk(self) -> list[Chunk]:
        """Return the layered chunks that are complete, from the first one on."""
        header, at, first = self._header, self.start, 0
        head_bytes = header.record_bytes + 4 + 4 * self.laszip.n_layers
        chunks: list[Chunk] = []
        while first < header.n_points and at + head_bytes <= header.size_bytes:
            self._stream.seek(at)
            head = self._stream.read(head_bytes)
            count, n_bytes = layered_size(head, header.record_bytes, self.laszip.n_layers)
            if not count or at + n_bytes > header.size_bytes or count > header.n_points - first:
                break
            chunks.append(Chunk(first, count, at, n_bytes))
            at, first = at + n_bytes, first + count
        self.is_cut = first < header.n_points
        return chunks


def _chunks(counts: list[int], entries: list[tuple[int, int]], at: int) -> list[Chunk]:
    """Return chunks from their counts and sizes in a row."""
    chunks, first = [], 0
    for count, (_, n_bytes) in zip(counts, entries, strict=False):
        chunks.append(Chunk(first, count, at, n_bytes))
        first, at = first + count, at + n_bytes
    return chunks


def _i64(stream: BinaryIO, at: int) -> int:
    stream.seek(at)
    return int.from_bytes(stream.read(8), "little", signed=True)


def layered_count(stream: BinaryIO, at: int, record_bytes: int) -> int:
    """Return the points of a layered chunk: the number behind its first record."""
    stream.seek(at + record_bytes)
    return int.from_bytes(stream.read(4), "little")


def layered_size(head: bytes, record_bytes: int, n_layers: int) -> tuple[int, int]:
    """Return points and bytes of a layered chunk from its first record, count and layer sizes."""
    if len(head) < record_bytes + 4 + 4 * n_layers:
        return 0, 0
    count, *sizes = struct.unpack_from(f"<{1 + n_layers}I", head, record_bytes)
    return count, record_bytes + 4 + 4 * n_layers + sum(sizes)
