"""Open LAS, LAZ and COPC files and stream their points in bounded memory."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from dataclasses import astuple
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Self

import numpy as np
from numpy.typing import NDArray

from volatool.census import header_box
from volatool.cube import Cube
from volatool.errors import (
    CodedWarning,
    FormatError,
    InputError,
    InputNotFoundError,
    TruncatedError,
    VolatoolError,
)
from volatool.model import Bounds, CrsInfo, PointChunk
from volatool.points.copc import chunks_outside
from volatool.points.crs import CrsLike
from volatool.points.crs_file import crs_of
from volatool.points.header import LasHeader, read_header
from volatool.points.layout import take_apart
from volatool.points.laz import LazPoints
from volatool.points.laz_decode import EVERYTHING, backend_name, selection_of
from volatool.points.select import Selection
from volatool.remote.path import RemotePath, path_of

CHUNK_POINTS = 400_000
"""Points of a chunk unless asked otherwise; neither less nor more is faster."""

MAX_CHUNK_POINTS = 2_000_000
"""Larger chunks are cut to this."""

Rectangle = tuple[float, float, float, float]
"""Left, bottom, right, top."""

_NOT_DEFECTS = frozenset({"W_NO_CRS", "W_SALVAGED", "W_Z_UNIT"})


class PointSource:
    """
    The points of one file, as often as wanted, in file order.

    Use `open_points`; it is a context manager.

    Attributes
    ----------
    name : str
        File name without folders.
    path : str
        As given; the name of a file object.
    header : LasHeader
        What the header claims.
    crs : CrsInfo
        From the file or the override.
    warnings : list of CodedWarning
        Grows while reading.
    n_points : int
        Points that can be read, as far as it is known: the total for progress.
    is_partial : bool
        Points were lost (salvage only).
    n_unread : int
        Points of chunks that are left out, as they lie outside `near`.
    format, own_grid : None
        Of imported files only.
    """

    format: str | None = None
    own_grid: tuple[Cube, int] | None = None

    def __init__(
        self,
        source: str | os.PathLike[str] | BinaryIO,
        *,
        crs: CrsLike = None,
        crs_default: CrsLike = None,
        salvage: bool = False,
        strict: bool = False,
        near: Rectangle | None = None,
    ) -> None:
        self._stream, self.path = _open(source)
        self.name = Path(self.path).name
        self._salvage = salvage
        self.warnings: list[CodedWarning] = []
        self.is_partial = False
        try:
            size = self._stream.seek(0, os.SEEK_END)
            self.header: LasHeader = read_header(self._stream, size)
            self.warnings += self.header.warnings
            self._laz: LazPoints | None = None
            if self.header.is_compressed:
                self._laz = LazPoints(self._stream, self.header)
                self.warnings += self._laz.warnings
                self._check_end(self._laz.n_points if self._laz.is_cut else None)
                self.n_points = self._laz.n_points
            else:
                self.n_points = self._count_plain()
            self.crs: CrsInfo = crs_of(self.header, crs, crs_default, self.warnings)
            if strict:
                self._refuse_defects()
            self.n_unread = 0
            self._unwanted: frozenset[int] = frozenset()
            if near is not None:
                self._leave_out(near)
        except OSError as error:
            self._stream.close()
            if isinstance(error, VolatoolError):
                _retell(error, self.name)
                raise
            reason = error.strerror or "not a file that can be searched, such as a pipe"
            raise InputError(f"{self.name}: can't be read ({reason})") from error
        except BaseException as error:
            self._stream.close()
            _retell(error, self.name)
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def raw(self, start: int, n_bytes: int) -> bytes:
        """Return bytes of the file, fewer at its end."""
        try:
            self._stream.seek(start)
            return self._stream.read(n_bytes)
        except OSError as error:
            raise InputError(f"{self.name}: can't be read: {error}") from error

    def close(self) -> None:
        """Close the file; chunks can't be read any more."""
        self._stream.close()

    def chunks(
        self,
        attributes: Iterable[str] = (),
        chunk_points: int = CHUNK_POINTS,
        near: Rectangle | None = None,
    ) -> Iterator[PointChunk]:
        """
        Stream the points in file order.

        Parameters
        ----------
        attributes : iterable of str
            Names of `PointChunk.attributes` to decode; those that the format lacks are left out.
        chunk_points : int
            At most as many points a chunk (and never more than `MAX_CHUNK_POINTS`).
        near : tuple of 4 float, optional
            left, bottom, right, top: points outside may be left out, and of a COPC file most are;
            by default the rectangle that the file was opened with.

        Yields
        ------
        chunk : PointChunk
            Never empty.

        Raises
        ------
        TruncatedError, FormatError
            With the number of the first point that can't be read, unless salvaging.
        """
        if chunk_points < 1:
            raise ValueError(f"chunk_points must be at least 1, got {chunk_points}")
        chunk_points = min(chunk_points, MAX_CHUNK_POINTS)
        names = frozenset(attributes) & self.header.dimensions
        skipped = self._unwanted
        if near is not None:
            skipped = chunks_outside(self.header, self.raw, near)
        for start, raw in self._told(selection_of(names), chunk_points, skipped):
            records = raw.reshape(-1, self.header.record_bytes)
            yield from self._cut(start, records, names, chunk_points)

    def records(self, chunk_points: int = CHUNK_POINTS) -> Iterator[tuple[int, NDArray[np.uint8]]]:
        """
        Stream the whole records, decompressed, as bytes in file order.

        Parameters
        ----------
        chunk_points : int
            About as many points at a time.

        Yields
        ------
        start, records : int, (n, record_bytes) array of uint8
            Number of the first point; the records, which may be changed until the next are asked
            for.

        Raises
        ------
        TruncatedError, FormatError
            With the number of the first point that can't be read, unless salvaging.
        """
        for start, raw in self._told(EVERYTHING, min(chunk_points, MAX_CHUNK_POINTS)):
            yield start, raw.reshape(-1, self.header.record_bytes)

    def _told(
        self, selection: int, chunk_points: int, skipped: frozenset[int] = frozenset()
    ) -> Iterator[tuple[int, NDArray[np.uint8]]]:
        """Yield batches of records; errors get the file's name, losses a warning."""
        losses: list[tuple[int, int]] = []
        self._announce(skipped)
        try:
            yield from self._batches(selection, chunk_points, losses, skipped)
        except VolatoolError as error:
            _retell(error, self.name)
            raise
        except OSError as error:
            raise InputError(f"{self.name}: can't be read: {error}") from error
        if losses:
            self._note_loss(sum(n for _, n in losses), f"from point {losses[0][0]} on")

    def _batches(
        self,
        selection: int,
        chunk_points: int,
        losses: list[tuple[int, int]],
        skipped: frozenset[int],
    ) -> Iterator[tuple[int, NDArray[np.uint8]]]:
        if self._laz is not None:
            kept = losses if self._salvage else None
            yield from self._laz.batches(selection, chunk_points, kept, skipped)
            return
        record = self.header.record_bytes
        for start in range(0, self.n_points, chunk_points):
            n = min(chunk_points, self.n_points - start)
            self._stream.seek(self.header.offset_to_points + start * record)
            data = self._stream.read(n * record)
            if len(data) < n * record:  # the file shrank since it was opened
                at = start + len(data) // record
                raise TruncatedError(f"the file ends at point {at} of {self.n_points}")
            yield start, np.frombuffer(bytearray(data), np.uint8)  # writable, as decoded ones are

    def _announce(self, skipped: frozenset[int]) -> None:
        """Tell a remote file what will be read of it."""
        expect = getattr(self._stream, "expect", None)
        if expect is None:
            return
        if self._laz is None or self._laz.chunks is None:
            expect([(self.header.offset_to_points, self.header.points_end)])
        else:
            chunks = self._laz.chunks
            expect([(one.at, one.at + one.n_bytes) for one in chunks if one.at not in skipped])

    def _leave_out(self, near: Rectangle) -> None:
        """Find the chunks outside a rectangle, if the header's box can stand for their points."""
        header = self.header
        if self._laz is None or header_box(header.box, header.scale, header.offset) is None:
            return
        self._unwanted = chunks_outside(header, self.raw, near)
        chunks = self._laz.chunks or ()
        self.n_unread = sum(chunk.n_points for chunk in chunks if chunk.at in self._unwanted)
        self.n_points -= self.n_unread

    def read_all(self) -> None:
        """Leave nothing out from now on."""
        self.n_points += self.n_unread
        self.n_unread, self._unwanted = 0, frozenset()

    def _cut(
        self, start: int, records: NDArray[np.uint8], names: frozenset[str], chunk_points: int
    ) -> Iterator[PointChunk]:
        """Yield a batch of records as chunks."""
        x, y, z, taken = take_apart(records, sorted(names), self.header.point_format)
        for at in range(0, len(records), chunk_points):
            part = slice(at, at + chunk_points)
            yield PointChunk(
                start + at,
                x[part],
                y[part],
                z[part],
                self.header.scale,
                self.header.offset,
                {name: values[part] for name, values in taken.items()},
            )

    def _count_plain(self) -> int:
        """Return the records that an uncompressed file really holds."""
        header = self.header
        n_fit = (header.size_bytes - header.offset_to_points) // header.record_bytes
        if header.n_points > n_fit:
            self._check_end(n_fit)
            return n_fit
        room = header.points_end - header.offset_to_points
        n_real, rest = divmod(room, header.record_bytes)
        if n_real > header.n_points and not rest and self._is_point(n_real - 1):
            text = f"the header claims {header.n_points} points; the file holds {n_real}, all read"
            self.warnings.append(CodedWarning("W_HEADER_COUNT", text))
            return n_real
        return header.n_points

    def _is_point(self, number: int) -> bool:
        """Whether a record beyond the claimed ones can be one: not zeros, in the box."""
        header = self.header
        self._stream.seek(header.offset_to_points + number * header.record_bytes)
        record = self._stream.read(header.record_bytes)
        if not header.n_points:  # a writer that died: the box says nothing either
            return any(record)
        stored = np.frombuffer(record, "<i4", 3)
        low, high = np.array(header.box[:3]), np.array(header.box[3:])
        place = stored * np.array(header.scale) + np.array(header.offset)
        slack = np.array(header.scale)
        return bool(np.all((low - slack <= place) & (place <= high + slack)))

    def _check_end(self, n_readable: int | None) -> None:
        """Refuse a file that ends early, or note it when salvaging."""
        if n_readable is None:
            return
        claimed = self.header.n_points
        if not self._salvage:
            raise TruncatedError(
                f"the file ends at point {n_readable} of {claimed} "
                f"(byte {self.header.size_bytes}); --salvage keeps the readable points"
            )
        self._note_loss(claimed - n_readable, f"from point {n_readable} on")

    def _note_loss(self, n_lost: int, where: str) -> None:
        self.is_partial = True
        text = f"{n_lost} points could not be read ({where}); the others are used"
        warning = CodedWarning("W_SALVAGED", text, n_lost)
        if warning not in self.warnings:  # a second pass finds the same
            self.warnings.append(warning)

    def _refuse_defects(self) -> None:
        defects = [w for w in self.warnings if w.code not in _NOT_DEFECTS]
        if defects:
            told = "; ".join(f"{w.code}: {w.message}" for w in defects)
            raise FormatError(f"refused by --strict: {told}", "E_STRICT")


def open_points(
    path: str | os.PathLike[str] | BinaryIO,
    *,
    crs: CrsLike = None,
    crs_default: CrsLike = None,
    salvage: bool = False,
    strict: bool = False,
    near: Rectangle | None = None,
) -> PointSource:
    """
    Open a LAS, LAZ or COPC file for streaming.

    Parameters
    ----------
    path : path or binary file
        The file; a seekable binary file object is closed with the source.
    crs : str or CrsInfo, optional
        Used in place of what the file says.
    crs_default : str or CrsInfo, optional
        Used if the file says nothing usable.
    salvage : bool
        Read what can be read of a damaged file.
    strict : bool
        Refuse files with defects that could be read around (``E_STRICT``).
    near : tuple of 4 float, optional
        left, bottom, right, top: leave out the chunks of a COPC file that lie outside.

    Returns
    -------
    source : PointSource
        A context manager; header, CRS and sizes are checked already.

    Raises
    ------
    InputNotFoundError, FormatError, TruncatedError, CRSError
        With the file's name in the message.
    """
    return PointSource(
        path, crs=crs, crs_default=crs_default, salvage=salvage, strict=strict, near=near
    )


def stream(
    path: str | os.PathLike[str] | BinaryIO,
    *,
    classes: Iterable[int] | None = None,
    exclude_classes: Iterable[int] = (),
    returns: str = "all",
    keep_withheld: bool = False,
    keep_noise: bool = False,
    bounds: Bounds | tuple[float, float, float, float] | None = None,
    thin: int = 1,
    attributes: Iterable[str] | None = None,
    chunk_points: int = CHUNK_POINTS,
    salvage: bool = False,
) -> Iterator[PointChunk]:
    """
    Stream the selected points of a file: open, select, close.

    Parameters
    ----------
    path : path or binary file
        LAS, LAZ or COPC.
    classes, exclude_classes : iterable of int
        Only these classes; not these.
    returns : {"all", "first", "last"}
        Which returns.
    keep_withheld, keep_noise : bool
        Keep withheld points; classes 7 and 18. Both are dropped by default.
    bounds : Bounds or 4 floats, optional
        Left, bottom, right, top.
    thin : int
        Every how many-th point of the file.
    attributes : iterable of str, optional
        Attributes to deliver; by default all that the format has.
    chunk_points, salvage
        As in `open_points` and `PointSource.chunks`.

    Yields
    ------
    chunk : PointChunk
        Points that pass; chunks of which nothing is left are skipped.
    """
    selection = Selection(
        classes=None if classes is None else frozenset(classes),
        exclude_classes=frozenset(exclude_classes),
        returns=returns,
        keep_withheld=keep_withheld,
        keep_noise=keep_noise,
        bounds=bounds if bounds is None or isinstance(bounds, Bounds) else Bounds(*bounds),
        thin=thin,
    )
    dropped: dict[str, int] = {}
    with open_points(path, salvage=salvage) as source:
        wanted = source.header.dimensions if attributes is None else frozenset(attributes)
        needed = wanted | selection.attributes(source.header)
        near = None if selection.bounds is None else astuple(selection.bounds)
        for chunk in source.chunks(needed, chunk_points, near):
            mask = selection.mask(chunk, dropped)
            kept = chunk if mask is None else chunk.take(mask)
            if len(kept):
                yield kept


def laz_backend_name() -> str:
    """Return what decodes LAZ, for `doctor`."""
    return backend_name()


def _open(source: str | os.PathLike[str] | BinaryIO) -> tuple[BinaryIO, str]:
    """Return a seekable binary stream and what to call it."""
    if not isinstance(source, str | os.PathLike):
        return source, str(getattr(source, "name", "<stream>"))
    path = path_of(source)
    if isinstance(path, RemotePath):
        from volatool.remote.ranges import open_url

        return open_url(path), str(path)
    try:
        if path.exists() and not (path.is_file() or path.is_dir()):
            raise InputError(f"{path}: is not a regular file; pipes and devices can't be read")
        return path.open("rb"), str(path)
    except FileNotFoundError as error:
        raise InputNotFoundError(f"{path}: no such file") from error
    except IsADirectoryError as error:
        raise InputError(f"{path}: is a folder, not a file") from error
    except OSError as error:
        raise InputError(f"{path}: can't be opened: {error.strerror or error}") from error
    except ValueError as error:  # a NUL in the name
        raise InputError(f"{path}: can't be opened: {error}") from error


def _retell(error: BaseException, name: str) -> None:
    """Put the file's name in front of the message of one of our errors."""
    if isinstance(error, VolatoolError) and not str(error).startswith(f"{name}: "):
        error.args = (f"{name}: {error}",)
