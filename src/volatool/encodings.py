"""Sizes of a volume in each encoding, and writing the ones that are wanted."""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO

from volatool.beside import IsStopped, StoppedError
from volatool.formats import dense, gz, sparse
from volatool.formats.header import HEADER_BYTES
from volatool.outputs import write_error
from volatool.vola.volume import Volume

DENSE_LIMIT_BYTES = 64 << 20
"""Dense bodies up to here are written by ``--dense auto`` and measured for the report."""


class _Counter(io.RawIOBase):
    """A stream that keeps nothing but the number of bytes."""

    def __init__(self) -> None:
        self.size = 0

    def writable(self) -> bool:
        return True

    def write(self, data: Any) -> int:
        self.size += len(data)
        return len(data)


@dataclass(frozen=True, slots=True)
class Encoding:
    """
    One way to write a volume.

    Parameters
    ----------
    kind : str
        ``"sparse"`` or ``"dense"``.
    bits_per_voxel : int
        1, or 2 with metadata words.
    codec : str
        ``"none"`` or ``"gzip"``.
    """

    kind: str
    bits_per_voxel: int
    codec: str

    @property
    def suffix(self) -> str:
        """Suffix of such a file."""
        return (".vol" if self.kind == "sparse" else ".dvol") + (
            ".gz" if self.codec == "gzip" else ""
        )

    def payload_bytes(self, volume: Volume) -> int:
        """Return the exact size of the levels, without header and trailer."""
        with_metadata = self.bits_per_voxel == 2
        if self.kind == "dense":
            return dense.dense_bytes(volume.depth, with_metadata) - HEADER_BYTES
        blocks = [len(words) for words in volume.levels]
        return sparse.sparse_bytes(blocks, with_metadata) - HEADER_BYTES


def encodings_of(volume: Volume) -> Iterator[Encoding]:
    """Yield the encodings that the report lists; 2 bits only for a volume with metadata."""
    for kind in ("sparse", "dense"):
        for bits in (1, 2) if volume.has_metadata else (1,):
            for codec in ("none", "gzip"):
                yield Encoding(kind, bits, codec)


class _Stoppable(io.RawIOBase):
    """A stream into another that ends with `StoppedError` when it is no longer wanted."""

    def __init__(self, stream: BinaryIO, is_stopped: IsStopped) -> None:
        self._stream = stream
        self._is_stopped = is_stopped

    def writable(self) -> bool:
        return True

    def write(self, data: Any) -> int:
        if self._is_stopped():
            raise StoppedError
        return self._stream.write(data)


def write_volume(
    stream: BinaryIO,
    volume: Volume,
    encoding: Encoding,
    is_stopped: IsStopped | None = None,
) -> None:
    """
    Write a volume.

    Parameters
    ----------
    stream : binary file
        Where it goes.
    volume : Volume
        What is written.
    encoding : Encoding
        How; with 1 bit per voxel the metadata is left out.
    is_stopped : callable, optional
        Asked before each piece; `StoppedError` when it says so.
    """
    if is_stopped is not None:
        stream = _Stoppable(stream, is_stopped)  # type: ignore[assignment]
    if encoding.bits_per_voxel == 1 and volume.has_metadata:
        info = replace(volume.info, channels=())
        volume = Volume(volume.levels, None, volume.cube, info)
    write = sparse.write if encoding.kind == "sparse" else dense.write
    if encoding.codec == "gzip":
        is_sparse = encoding.kind == "sparse"
        level = gz.level_for(encoding.payload_bytes(volume)) if is_sparse else gz.LEVEL
        with gz.writer(stream, level) as packed:
            write(packed, volume)  # type: ignore[arg-type]
    else:
        write(stream, volume)


def written_bytes(volume: Volume, encoding: Encoding, is_stopped: IsStopped | None = None) -> int:
    """Return the size of the file that `write_volume` would write, by writing it to nowhere."""
    counter = _Counter()
    write_volume(counter, volume, encoding, is_stopped)  # type: ignore[arg-type]
    return counter.size


def encoding_row(
    volume: Volume,
    encoding: Encoding,
    path: Path | None,
    name: str | None,
    las_bytes: int | None,
    input_bytes: int | None,
    is_stopped: IsStopped | None = None,
) -> dict[str, Any]:
    """
    Return the report's object for one encoding.

    Parameters
    ----------
    volume : Volume
        The volume.
    encoding : Encoding
        One way to write it.
    path, name : pathlib.Path and str, or None
        The file if it was written, under its temporary name, and the name it will have.
    las_bytes, input_bytes : int or None
        Sizes to compare with.
    is_stopped : callable, optional
        As for `write_volume`.
    """
    payload = encoding.payload_bytes(volume)
    size: int | None = None
    if path is not None:
        size = path.stat().st_size
    elif payload <= DENSE_LIMIT_BYTES or encoding.kind == "sparse":
        size = written_bytes(volume, encoding, is_stopped)
    return {
        "kind": encoding.kind,
        "bits_per_voxel": encoding.bits_per_voxel,
        "codec": encoding.codec,
        "path": name,
        "header_bytes": HEADER_BYTES,
        "payload_bytes": payload,
        "file_bytes": size,
        "percent_of_las": _percent(size, las_bytes),
        "percent_of_input": _percent(size, input_bytes),
        "measured": size is not None,
    }


def added_rows(
    total: list[dict[str, Any]],
    rows: list[dict[str, Any]],
    las_bytes: int | None,
    input_bytes: int | None,
) -> list[dict[str, Any]]:
    """
    Add the rows of one more volume to those of others, encoding by encoding.

    Parameters
    ----------
    total, rows : list of dict
        As `encoding_row` returns them; `total` is empty at first.
    las_bytes, input_bytes : int or None
        Sizes that the sum is compared with.
    """
    if not total:
        return rows
    by_encoding = {_identity(row): row for row in rows}
    added = []
    for row in total:
        other = by_encoding.get(_identity(row))
        if other is None:
            continue
        measured = row["measured"] and other["measured"]
        size = row["file_bytes"] + other["file_bytes"] if measured else None
        added.append(
            {
                **row,
                "path": None,
                "header_bytes": row["header_bytes"] + other["header_bytes"],
                "payload_bytes": row["payload_bytes"] + other["payload_bytes"],
                "file_bytes": size,
                "percent_of_las": _percent(size, las_bytes),
                "percent_of_input": _percent(size, input_bytes),
                "measured": measured,
            }
        )
    return added


def resized(
    rows: Iterable[dict[str, Any]], las_bytes: int | None, input_bytes: int | None
) -> tuple[dict[str, Any], ...]:
    """Return rows with the sizes that they are compared with replaced."""
    return tuple(
        {
            **row,
            "percent_of_las": _percent(row["file_bytes"], las_bytes),
            "percent_of_input": _percent(row["file_bytes"], input_bytes),
        }
        for row in rows
    )


def _identity(row: dict[str, Any]) -> tuple[str, int, str]:
    return row["kind"], row["bits_per_voxel"], row["codec"]


def _percent(size: int | None, whole: int | None) -> float | None:
    return None if size is None or not whole else round(100 * size / whole, 6)


@contextmanager
def output_stream(path: Path) -> Iterator[BinaryIO]:
    """
    Open an output for writing; what goes wrong inside is an `OutputError` with its name.

    Parameters
    ----------
    path : pathlib.Path
        The (temporary) file.
    """
    try:
        with path.open("wb") as stream:
            yield stream
    except OSError as error:
        # a writer that wrapped the system's error took its number away
        cause = error.__cause__
        raise write_error(path, cause if isinstance(cause, OSError) else error) from error
