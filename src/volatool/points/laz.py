"""The points of a LAZ file as batches of plain records, in file order, whole or salvaged."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from itertools import groupby
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from volatool.errors import FormatError, TruncatedError
from volatool.points.header import LasHeader
from volatool.points.laz_chunks import (
    ONE_CHUNK,
    POINTWISE,
    POINTWISE_CHUNKED,
    Chunk,
    ChunkFinder,
)
from volatool.points.laz_decode import DecodeError, Sequence, decode_chunks, read_table
from volatool.resources import n_threads

MAX_CHUNK_BYTES = 64 << 20
"""Chunks that unpack to more are decoded piece by piece, on one core."""

MAX_GROUP_BYTES = 16 << 20
"""Unpacked bytes to which small batches are widened, so that all cores have a chunk."""


class LazPoints:
    """
    The compressed points of a file.

    Parameters
    ----------
    stream : binary file
        The file; it is positioned before every read.
    header : LasHeader
        Of that file.

    Attributes
    ----------
    n_points : int
        Points that the chunks hold: the real number when it can be known, else the header's.
    is_cut : bool
        The file ends before the points that the header claims.
    chunks : list of Chunk or None
        None: one stream that can only be read from its start.
    warnings : list of CodedWarning
        What is wrong with the chunk table or the count.
    """

    def __init__(self, stream: BinaryIO, header: LasHeader) -> None:
        self._stream = stream
        self._header = header
        found = ChunkFinder(stream, header, read_table)
        self._laszip, self._at = found.laszip, found.start
        self.chunks, self.is_cut, self.warnings = found.chunks, found.is_cut, found.warnings
        if self.chunks is None:
            self.n_points = header.n_points
        else:
            self.n_points = sum(chunk.n_points for chunk in self.chunks)

    def batches(
        self,
        selection: int,
        batch_points: int,
        losses: list[tuple[int, int]] | None = None,
        skipped: frozenset[int] = frozenset(),
    ) -> Iterator[tuple[int, NDArray[np.uint8]]]:
        """
        Decode the points in file order.

        Parameters
        ----------
        selection : int
            Fields to decode, of `selection_of`; those left out are undefined.
        batch_points : int
            About as many points at a time.
        losses : list, optional
            Given: skip what can't be decoded and append (first point, points) of each loss here.
        skipped : frozenset of int
            Offsets of chunks that are not wanted.

        Yields
        ------
        start, records : int, (n, record_bytes) array of uint8
            Number of the first point; the records, in a buffer that the next batch overwrites.

        Raises
        ------
        FormatError, TruncatedError
            With the number of the first point that can't be decoded.
        """
        if self.chunks is None:
            whole = Chunk(0, self.n_points, self._at, self._header.size_bytes - self._at)
            size = self._laszip.chunk_size
            size = ONE_CHUNK if self._laszip.compressor == POINTWISE else size
            yield from self._pieces(whole, size, selection, batch_points, losses)
            return
        buffer = np.empty((0, self._header.record_bytes), np.uint8)
        for group in self._groups(batch_points, skipped):
            if len(group) == 1 and self._is_huge(group[0], batch_points):
                yield from self._pieces(group[0], ONE_CHUNK, selection, batch_points, losses)
                continue
            n_points = sum(chunk.n_points for chunk in group)
            if len(buffer) < n_points:  # fresh pages for every batch cost a tenth of the decoding
                buffer = np.empty((n_points, self._header.record_bytes), np.uint8)
            try:
                self._decode(group, selection, buffer[:n_points])
            except DecodeError:
                for chunk in group:
                    try:
                        self._decode([chunk], selection, buffer[: chunk.n_points])
                    except DecodeError as error:
                        if losses is None:
                            raise self._damage(chunk, selection) from error
                        losses.append((chunk.first, chunk.n_points))
                    else:
                        yield chunk.first, buffer[: chunk.n_points]
            else:
                yield group[0].first, buffer[:n_points]

    def _is_huge(self, chunk: Chunk, batch_points: int) -> bool:
        unpacked = chunk.n_points * self._header.record_bytes
        return unpacked > MAX_CHUNK_BYTES and chunk.n_points > batch_points

    def _groups(self, batch_points: int, skipped: frozenset[int]) -> Iterator[list[Chunk]]:
        """Yield runs of chunks to decode at once: full batches, all cores busy."""
        assert self.chunks is not None
        # points of a batch are numbered in a row, so that no run goes over a gap
        for is_wanted, run in groupby(self.chunks, lambda chunk: chunk.at not in skipped):
            if is_wanted:
                yield from self._parts(list(run), batch_points)

    def _parts(self, chunks: list[Chunk], batch_points: int) -> Iterator[list[Chunk]]:
        record, cores = self._header.record_bytes, n_threads()
        at = 0
        while at < len(chunks):
            end, points = at, 0
            while end < len(chunks):
                points += chunks[end].n_points
                is_wide = end - at >= cores or points * record > MAX_GROUP_BYTES
                if end > at and points > batch_points and is_wide:
                    break
                end += 1
            if end < len(chunks) and end - at > cores:
                end -= (end - at) % cores
            yield chunks[at:end]
            at = end

    def _decode(self, group: list[Chunk], selection: int, records: NDArray[np.uint8]) -> None:
        decode_chunks(self._stream, self._laszip, group, selection, records)

    def _sequence(self, chunk: Chunk, chunk_size: int, selection: int) -> Sequence:
        return Sequence(self._stream, self._laszip, chunk, chunk_size, selection)

    def _pieces(
        self,
        chunk: Chunk,
        chunk_size: int,
        selection: int,
        batch_points: int,
        losses: list[tuple[int, int]] | None,
    ) -> Iterator[tuple[int, NDArray[np.uint8]]]:
        """Decode a stretch of points one after another; keep those before a failure."""
        record = self._header.record_bytes
        done = 0
        try:
            decoder = self._sequence(chunk, chunk_size, selection)
            while done < chunk.n_points:
                records = np.zeros((min(batch_points, chunk.n_points - done), record), np.uint8)
                decoder.read_into(records)
                yield chunk.first + done, records
                done += len(records)
        except DecodeError as error:
            rest = self._readable(chunk, chunk_size, selection, done, batch_points)
            if losses is None:
                raise self._damage_at(chunk.first + done + len(rest)) from error
            if len(rest):
                yield chunk.first + done, rest
            lost = done + len(rest)
            losses.append((chunk.first + lost, chunk.n_points - lost))

    def _readable(
        self, chunk: Chunk, chunk_size: int, selection: int, done: int, batch_points: int
    ) -> NDArray[np.uint8]:
        """Return the points behind the first `done` of a stretch, up to the failure."""
        good = np.zeros((batch_points, self._header.record_bytes), np.uint8)
        n_good = 0
        with contextlib.suppress(DecodeError):
            decoder = self._sequence(chunk, chunk_size, selection)
            for at in range(0, done, batch_points):
                decoder.read_into(good[: min(batch_points, done - at)])
            while n_good < min(batch_points, chunk.n_points - done):
                decoder.read_into(good[n_good])
                n_good += 1
        return good[:n_good]

    def _damage(self, chunk: Chunk, selection: int) -> FormatError:
        """Return the error for a chunk that can't be decoded, with the first bad point."""
        n_good = 0
        if self._laszip.compressor == POINTWISE_CHUNKED:
            n_good = len(self._readable(chunk, ONE_CHUNK, selection, 0, chunk.n_points))
        return self._damage_at(chunk.first + min(n_good, chunk.n_points - 1))

    def _damage_at(self, point: int) -> FormatError:
        where = f"point {point} of {self.n_points}"
        hint = "--salvage keeps the readable points"
        if self.chunks is None:
            return TruncatedError(f"the compressed points end or break off at {where}; {hint}")
        return FormatError(f"the compressed points are damaged at {where}; {hint}")
