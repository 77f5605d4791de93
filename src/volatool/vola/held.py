"""Points put by for later: in RAM while the budget has room, in a file beyond."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from volatool.model import PointChunk
from volatool.scratch import Scratch, drop


class HeldPoints:
    """
    Chunks of points, given back once, in the order in which they came.

    Parameters
    ----------
    scratch : Scratch
        Budget and temporary files.
    share : float
        Part of the whole budget that may be in use when points are kept in RAM.
    attributes : iterable of str
        Those that are kept beside the coordinates.
    """

    def __init__(self, scratch: Scratch, share: float, attributes: Iterable[str]) -> None:
        self._scratch = scratch
        self._share = share
        self._names = sorted(attributes)
        self._chunks: list[PointChunk | _Filed] = []
        self._file: BinaryIO | None = None
        self._counted_bytes = 0
        self._n_points = 0

    def __len__(self) -> int:
        return self._n_points

    def add(self, points: PointChunk) -> None:
        """Keep a copy of points."""
        attributes = {name: points.attributes[name] for name in self._names}
        columns = (points.x, points.y, points.z, *attributes.values())
        n_bytes = sum(column.nbytes for column in columns)
        self._n_points += len(points)
        if self._file is None and self._scratch.take(n_bytes, self._share):
            self._counted_bytes += n_bytes
            x, y, z, *values = (column.copy() for column in columns)
            held = dict(zip(attributes, values, strict=True))
            chunk = PointChunk(points.start, x, y, z, points.scale, points.offset, held)
            self._chunks.append(chunk)
            return
        self._chunks.append(self._written(points, columns))

    def _written(self, points: PointChunk, columns: tuple[NDArray[Any], ...]) -> _Filed:
        self._file = self._file or self._scratch.file()
        with self._scratch.writing(self._file):
            for column in columns:
                self._file.write(np.ascontiguousarray(column).view(np.uint8).data)
                self._scratch.spilled_bytes += column.nbytes
        kinds = [column.dtype for column in columns]
        return _Filed(points.start, len(points), points.scale, points.offset, kinds)

    def taken(self) -> Iterator[PointChunk]:
        """Yield the points; none is left."""
        chunks, self._chunks, self._n_points = self._chunks, [], 0
        chunks.reverse()
        if self._file is not None:
            with self._scratch.writing(self._file):
                self._file.seek(0)  # writes what is left
        while chunks:
            chunk = chunks.pop()
            if isinstance(chunk, _Filed):
                assert self._file is not None
                chunk = chunk.read(self._file, self._names)
            yield chunk
        self.close()

    def close(self) -> None:
        """Drop the points and give the memory back."""
        self._chunks, self._n_points = [], 0
        self._scratch.give(self._counted_bytes)
        self._counted_bytes = 0
        if self._file is not None:
            drop(self._file)
            self._file = None


@dataclass(frozen=True, slots=True)
class _Filed:
    """What is known of points in the file: all but their columns, which are there in order."""

    start: int
    n_points: int
    scale: tuple[float, float, float]
    offset: tuple[float, float, float]
    kinds: list[np.dtype[Any]]

    def read(self, file: BinaryIO, names: list[str]) -> PointChunk:
        columns = []
        for kind in self.kinds:
            column = np.empty(self.n_points, kind)
            file.readinto(column.view(np.uint8).data)  # type: ignore[attr-defined]
            columns.append(column)
        x, y, z, *attributes = columns
        held = dict(zip(names, attributes, strict=True))
        return PointChunk(self.start, x, y, z, self.scale, self.offset, held)
