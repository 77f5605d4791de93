"""Open a VOLA file whatever it is in: path, bytes or stream; gzip and mode by content."""

from __future__ import annotations

import io
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, TypeAlias

from volatool.cube import Cube
from volatool.errors import (
    InputError,
    InputNotFoundError,
    OptionError,
    ResourceError,
)
from volatool.formats import dense, sparse, trailer
from volatool.formats.assemble import header_info
from volatool.formats.header import DENSE, HEADER_BYTES, Header
from volatool.formats.stream import SIZE_LIMIT, Source, buffered
from volatool.remote.path import RemotePath, path_of
from volatool.vola.info import VolumeInfo
from volatool.vola.volume import Volume

Openable: TypeAlias = "str | os.PathLike[str] | bytes | bytearray | memoryview | BinaryIO"


@dataclass(frozen=True, slots=True)
class FileInfo:
    """
    What header and trailer of a VOLA file say, its levels unread.

    Parameters
    ----------
    name : str
        Of the file.
    is_gzip : bool
        The file is gzip.
    size_stored : int
        Bytes of the file as it is.
    header : Header
        The 80 bytes.
    trailer : dict or None
        The trailer's JSON object.
    cube : Cube
        The extent.
    info : VolumeInfo
        The rest.
    """

    name: str
    is_gzip: bool
    size_stored: int
    header: Header
    trailer: dict[str, Any] | None
    cube: Cube
    info: VolumeInfo


@contextmanager
def opened(source: Openable, size_limit: int = SIZE_LIMIT) -> Iterator[tuple[str, Source]]:
    """
    Open a file for reading; what goes wrong inside the block is told with the file's name.

    Parameters
    ----------
    source : path, bytes or binary file
        A file given as such is read from its present position and stays open.
    size_limit : int
        Bytes that may be unpacked or kept.

    Yields
    ------
    name, source : str, Source
    """
    name = "<bytes>"
    try:
        if isinstance(source, bytes | bytearray | memoryview):
            yield name, Source(io.BytesIO(source), size_limit)
        elif isinstance(source, str | os.PathLike):
            path = path_of(source)
            name = str(path)
            with _file(path) as file:
                yield name, Source(buffered(file, size_limit), size_limit)
        elif hasattr(source, "read"):
            name = str(getattr(source, "name", "<stream>"))
            yield name, Source(buffered(source, size_limit), size_limit)
        else:
            raise OptionError(f"expected a path, bytes or a binary file, got {type(source)}")
    except (InputError, ResourceError) as error:
        text = str(error).removeprefix(f"{name}: ")
        raise type(error)(f"{name}: {text}", error.code) from error
    except MemoryError as error:
        raise ResourceError(f"{name}: there is not enough memory to read it") from error


def _file(path: Path) -> BinaryIO:
    if isinstance(path, RemotePath):
        from volatool.remote.ranges import open_url

        return open_url(path)
    try:
        if path.is_dir():
            raise InputError("is a folder, not a VOLA file")
        if path.exists() and not path.is_file():
            raise InputError("is not a regular file; pipes and devices can't be read")
        return path.open("rb")
    except FileNotFoundError as error:
        raise InputNotFoundError("no such file") from error
    except (OSError, ValueError) as error:  # ValueError: NUL in the name
        raise InputError(f"can't be opened: {error}") from error


def open_volume(source: Openable, *, size_limit: int = SIZE_LIMIT) -> Volume:
    """
    Read a VOLA file.

    Parameters
    ----------
    source : path, bytes or binary file
        Sparse or dense, gzip or not: told by the content, never by the name.
    size_limit : int
        Bytes that may be unpacked or kept in memory; what claims more is refused.

    Returns
    -------
    volume : Volume
        ``volume.info.warnings`` says what was put right.

    Raises
    ------
    InputNotFoundError
        ``E_NOT_FOUND``.
    FormatError, TruncatedError
        ``E_NOT_VOLA``, ``E_CORRUPT``, ``E_TRUNCATED``, with the offset.
    ResourceError
        ``E_SIZE``.
    """
    with opened(source, size_limit) as (_, stream):
        header = Header.from_bytes(stream.read(HEADER_BYTES))
        if header.mode == DENSE:
            return dense.read(stream, header)
        return sparse.read(stream, header)


def read_info(source: Openable, *, size_limit: int = SIZE_LIMIT) -> FileInfo:
    """
    Read header and trailer only.

    Parameters
    ----------
    source : path, bytes or binary file
        A VOLA file.
    size_limit : int
        Bytes of a gzip file that may be unpacked in search of its end.

    Returns
    -------
    info : FileInfo
        Checksums of the levels are not checked.
    """
    with opened(source, size_limit) as (name, stream):
        header = Header.from_bytes(stream.read(HEADER_BYTES))
        content = trailer.unframe_end(*stream.tail(trailer.MAX_TRAILER))
        if content is None:
            cube, info = header.cube(), header_info(header)
        else:
            cube, info = trailer.interpret(content, header)
        return FileInfo(name, stream.is_gzip, stream.size_stored, header, content, cube, info)
