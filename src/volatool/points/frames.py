"""Scans as they come: files by name, or NumPy arrays one after another in a pipe."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from volatool.errors import FormatError, InputError, InputNotFoundError, TruncatedError
from volatool.model import F64
from volatool.points.pcd import MAX_POINTS, parse_pcd

FRAME_SUFFIXES = (".las", ".laz", ".pcd", ".npy")
"""What a folder of scans is searched for."""

MAX_FILE_BYTES = 1 << 32
"""PCD and NPY files are read whole; larger ones are refused."""

MAX_COLUMNS = 1 << 10


@dataclass(frozen=True, slots=True)
class Frame:
    """
    One scan that has not been read yet, or could not be.

    Parameters
    ----------
    name : str or None
        Of its file; None out of a pipe.
    read : callable
        Returns (n, 3) float64 x, y, z; rows may be NaN. Raises the errors of `read_frame`.
    """

    name: str | None
    read: Callable[[], F64]


def frames_of_files(paths: Iterable[Path]) -> Iterator[Frame]:
    """Yield the scans of files; a name is taken when it is asked for, no sooner."""
    for path in paths:
        yield Frame(str(path), lambda path=path: read_frame(path))  # type: ignore[misc]


def frames_of_npy(stream: BinaryIO, name: str = "stdin") -> Iterator[Frame]:
    """
    Yield the scans of NumPy arrays written one after another with ``numpy.save``.

    Parameters
    ----------
    stream : binary file
        Read as far as the next array, no further; need not be seekable.
    name : str
        For messages.

    Yields
    ------
    frame : Frame
        Its `read` raises when the array is no scan (shape, type); the next one can be read all
        the same.

    Raises
    ------
    FormatError, TruncatedError
        The bytes are no array, or end inside one: nothing after can be found.
    """
    at = 0
    while True:
        head = stream.read(1)
        if not head:
            return
        reader = Reader(stream, head, at, name)
        shape, is_fortran, dtype = npy_header(reader, f"{name}, byte {at}")
        count = int(np.prod(shape, dtype=object)) if shape else 1
        if dtype.hasobject or count * dtype.itemsize > MAX_POINTS * 8 * 3:
            raise FormatError(
                f"{name}, byte {at}: an array of {shape} {dtype} is no scan, and can't be skipped"
            )
        data = reader.exactly(count * dtype.itemsize)
        where = f"{name}, byte {at}"
        yield Frame(
            None,
            lambda data=data, shape=shape, is_fortran=is_fortran, dtype=dtype, where=where: (  # type: ignore[misc]
                _xyz(data, shape, is_fortran, dtype, where)
            ),
        )
        at = reader.at


def read_frame(path: Path) -> F64:
    """
    Read a scan.

    Parameters
    ----------
    path : pathlib.Path
        LAS, LAZ, COPC, PCD or NPY; told apart by the first bytes.

    Returns
    -------
    xyz : (n, 3) array of float64
        Rows may be NaN (PCD, NPY). Of LAS files withheld points and noise are left out.

    Raises
    ------
    InputNotFoundError, InputError, FormatError, TruncatedError, ResourceError
        With the file's name.
    """
    try:
        if not path.is_file():
            if path.exists():
                raise InputError(f"{path}: is not a file")
            raise InputNotFoundError(f"{path}: no such file")
        with path.open("rb") as file:
            magic = file.read(6)
            if magic == b"\x93NUMPY":
                return _npy_file(path)
            if magic[:4] != b"LASF" and (magic[:1] == b"#" or magic[:6] in (b"VERSIO", b"FIELDS")):
                return _pcd_file(path)
    except (OSError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: can't be read ({error})") from error
    return _las_file(path)


def _las_file(path: Path) -> F64:
    from volatool.points.reader import stream

    try:
        chunks = [chunk.xyz() for chunk in stream(path, attributes=())]
    except FormatError as error:
        if error.code != "E_NOT_LAS":
            raise
        raise FormatError(
            f"{path}: not a scan: neither LAS, LAZ, PCD nor NPY", "E_NOT_SCAN"
        ) from error
    return np.concatenate([np.empty((0, 3)), *chunks])


def _pcd_file(path: Path) -> F64:
    try:
        return parse_pcd(_whole(path))
    except (FormatError, TruncatedError) as error:
        raise type(error)(f"{path}: {error}", error.code) from error


def _npy_file(path: Path) -> F64:
    with path.open("rb") as file:
        frames = list(_first(frames_of_npy(file, str(path))))
    return frames[0].read()


def _first(frames: Iterator[Frame]) -> Iterator[Frame]:
    for frame in frames:
        yield frame
        return


def _whole(path: Path) -> bytes:
    size = path.stat().st_size
    if size > MAX_FILE_BYTES:
        raise FormatError(f"{size} bytes are more than a scan has", "E_SIZE")
    return path.read_bytes()


@dataclass(slots=True)
class Reader:
    """
    Exact reads from a pipe, with the offset for messages.

    Parameters
    ----------
    stream : binary file
        Need not be seekable.
    pushed : bytes
        Read already, to be given again.
    at : int
        Offset of the stream.
    name : str
        For messages.
    is_over : bool
        The end was met.
    """

    stream: BinaryIO
    pushed: bytes
    at: int
    name: str
    is_over: bool = False

    def read(self, size: int = -1) -> bytes:
        """Return what numpy's header reader asks for, or less at the end."""
        data, self.pushed = self.pushed[:size], self.pushed[size:]
        while len(data) < size:
            more = self.stream.read(size - len(data))
            if not more:
                self.is_over = True
                break
            data += more
        self.at += len(data)
        return data

    def exactly(self, size: int) -> bytes:
        """Return so many bytes."""
        start = self.at
        parts, missing = [], size
        while missing:  # in pieces: a header may claim what never comes
            part = self.read(min(missing, 1 << 20))
            if not part:
                raise TruncatedError(
                    f"{self.name}: ends at byte {self.at}, inside the array whose {size} bytes "
                    f"begin at {start}"
                )
            parts.append(part)
            missing -= len(part)
        return b"".join(parts)


def npy_header(reader: Reader, where: str) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """
    Return shape, order (True: Fortran) and type of the array that begins at a reader's place.

    Parameters
    ----------
    reader : Reader
        Read up to the first value.
    where : str
        For messages.

    Raises
    ------
    FormatError, TruncatedError
        No array begins there, or the file ends in its header.
    """
    start = reader.at
    try:
        version = np.lib.format.read_magic(reader)
        if version == (1, 0):
            return np.lib.format.read_array_header_1_0(reader)
        if version == (2, 0):
            return np.lib.format.read_array_header_2_0(reader)
        raise ValueError(f"version {version} is not known")
    except Exception as error:  # numpy parses it as Python: syntax and token errors too
        if reader.is_over:
            raise TruncatedError(
                f"{reader.name}: ends at byte {reader.at}, inside the header of the array that "
                f"begins at {start}"
            ) from error
        raise FormatError(f"{where}: no NumPy array begins there ({error})") from error


def _xyz(
    data: bytes, shape: tuple[int, ...], is_fortran: bool, dtype: np.dtype[Any], where: str
) -> F64:
    if len(shape) != 2 or not 3 <= shape[1] <= MAX_COLUMNS or dtype.kind not in "fiu":
        raise FormatError(
            f"{where}: a scan is an array of numbers with rows of x, y, z, not {shape} {dtype}",
            "E_NOT_SCAN",
        )
    array = np.frombuffer(data, dtype).reshape(shape, order="F" if is_fortran else "C")
    with np.errstate(invalid="ignore"):  # signalling NaNs
        return array[:, :3].astype(np.float64, order="C")
