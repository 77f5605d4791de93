"""Bytes in and out of VOLA files: bounded reads with offsets in errors, checksummed writes."""

from __future__ import annotations

import io
import os
import zlib
from typing import BinaryIO

import numpy as np

from volatool.errors import (
    FormatError,
    InputError,
    OptionError,
    OutputError,
    ResourceError,
    TruncatedError,
)
from volatool.formats import gz
from volatool.model import U64

SIZE_LIMIT = 1 << 30
"""How much of a file is unpacked or kept in memory unless the caller says otherwise, bytes."""

_PIECE_WORDS = 1 << 18


class Source:
    """
    A VOLA file being read front to back, unwrapped if it is gzip.

    Parameters
    ----------
    stream : binary file
        From its present position on. Must be seekable.
    limit : int
        Bytes that may be unpacked or kept.

    Attributes
    ----------
    position : int
        Offset in the unpacked file.
    crc : int
        CRC-32 of everything read so far.
    """

    def __init__(self, stream: BinaryIO, limit: int = SIZE_LIMIT) -> None:
        self.limit = limit
        self.position = 0
        self.crc = 0
        self._raw = stream
        try:
            self._start = stream.tell()
            magic = stream.read(2)
            self.size_stored = stream.seek(0, os.SEEK_END) - self._start
        except (OSError, ValueError) as error:  # ValueError: it is closed
            raise InputError(f"can't be read: {error}") from error
        if not isinstance(magic, bytes):
            raise OptionError("a VOLA file must be opened in binary mode")
        self.is_gzip = magic == gz.MAGIC
        self.rewind()

    def rewind(self) -> None:
        """Go back to the first byte."""
        self._raw.seek(self._start)
        self._stream: BinaryIO = gz.reader(self._raw) if self.is_gzip else self._raw  # type: ignore[assignment]
        self.position = 0
        self.crc = 0

    @property
    def remaining(self) -> int | None:
        """Bytes left, None while a gzip's length is unknown."""
        return None if self.is_gzip else self.size_stored - self.position

    def read(self, n_bytes: int) -> bytes:
        """
        Return the next bytes, fewer only at the end of the file.

        Raises
        ------
        TruncatedError, FormatError
            The gzip data is cut or damaged.
        """
        pieces = bytearray()
        while len(pieces) < n_bytes:
            piece = self._some(n_bytes - len(pieces))
            if not piece:
                break
            pieces += piece
        return bytes(pieces)

    def _some(self, n_bytes: int) -> bytes:
        where = f"at byte {self.position} of the unpacked file"
        try:
            piece = self._stream.read(min(n_bytes, 8 * _PIECE_WORDS))
        except EOFError as error:
            raise TruncatedError(f"the gzip data ends early, {where}") from error
        except zlib.error as error:
            raise FormatError(f"the gzip data is damaged, {where}: {error}") from error
        except OSError as error:  # gzip.BadGzipFile is one
            if self.is_gzip and error.errno is None:
                raise FormatError(f"the gzip data is damaged, {where}: {error}") from error
            raise InputError(f"can't be read, {where}: {error.strerror or error}") from error
        self.position += len(piece)
        self.crc = zlib.crc32(piece, self.crc)
        if self.is_gzip and self.position > self.limit + (1 << 21):
            raise _too_large(self.position, self.limit)
        return piece

    def expect(self, n_bytes: int, what: str, kept: bool = True) -> None:
        """
        Refuse a claim that the file, or the limit, has no room for, before memory is taken.

        Parameters
        ----------
        n_bytes : int
            Bytes that must follow.
        what : str
            What they are, for the message.
        kept : bool
            They are going to be held in memory.

        Raises
        ------
        TruncatedError
            There are not as many.
        ResourceError
            ``E_SIZE``: more than the limit.
        """
        remaining = self.remaining
        if remaining is not None and n_bytes > remaining:
            raise TruncatedError(
                f"{what} should take {n_bytes} bytes from offset {self.position}, the file ends "
                f"after {remaining} of them (offset {self.size_stored})"
            )
        if (kept or self.is_gzip) and self.position + n_bytes > self.limit:
            raise _too_large(self.position + n_bytes, self.limit)

    def tail(self, n_bytes: int) -> tuple[bytes, int]:
        """
        Return the last bytes of the file, at most so many, and the offset of the first of them.

        A gzip file is unpacked to its end for them.
        """
        if not self.is_gzip:
            start = max(self.position, self.size_stored - n_bytes)
            self._raw.seek(self._start + start)
            self.position = start
            return self.read(n_bytes), start
        end = b""
        while piece := self.read(max(n_bytes, 1 << 16)):
            end = (end + piece)[-n_bytes:]
        return end, self.position - len(end)

    def words(self, n_words: int, what: str, kept: bool = True) -> U64:
        """
        Return the next words.

        Parameters
        ----------
        n_words : int
            How many.
        what : str
            What they are, for the message.
        kept : bool
            They are going to be held in memory.

        Returns
        -------
        words : (n_words,) array of uint64
        """
        self.expect(8 * n_words, what, kept)
        try:
            words = np.empty(n_words, "<u8")  # pages are taken only as they are filled
        except MemoryError as error:
            raise ResourceError(f"no memory for {8 * n_words} bytes of {what}") from error
        for start in range(0, n_words, _PIECE_WORDS):
            stop = min(start + _PIECE_WORDS, n_words)
            piece = self.read(8 * (stop - start))
            if len(piece) < 8 * (stop - start):
                raise TruncatedError(
                    f"{what} should have {n_words} words, the file ends after "
                    f"{start + len(piece) // 8} of them (offset {self.position})"
                )
            words[start:stop] = np.frombuffer(piece, "<u8")
        return words.astype(np.uint64, copy=False)


def _too_large(n_bytes: int, limit: int) -> ResourceError:
    return ResourceError(
        f"the volume takes at least {n_bytes} bytes unpacked, the limit is {limit}; "
        "give a higher size limit if this file is to be trusted",
        "E_SIZE",
    )


def buffered(stream: BinaryIO, limit: int) -> BinaryIO:
    """Return the stream, or its content in memory if it can't seek."""
    try:
        if stream.seekable():
            return stream
        data = stream.read(limit + 1)
    except (OSError, ValueError) as error:  # ValueError: it is closed
        raise InputError(f"can't be read: {error}") from error
    if len(data) > limit:
        raise _too_large(len(data), limit)
    return io.BytesIO(data)


class Body:
    """
    Header and levels being written, with their size and CRC-32.

    Parameters
    ----------
    stream : binary file
        Where the bytes go.
    """

    def __init__(self, stream: BinaryIO) -> None:
        self.size = 0
        self.crc = 0
        self._stream = stream

    def write(self, data: bytes) -> None:
        """Write bytes."""
        try:
            self._stream.write(data)
        except OSError as error:
            raise OutputError(f"can't be written: {error.strerror or error}") from error
        self.size += len(data)
        self.crc = zlib.crc32(data, self.crc)

    def words(self, words: U64) -> None:
        """Write words, little-endian."""
        for start in range(0, len(words), _PIECE_WORDS):
            self.write(words[start : start + _PIECE_WORDS].astype("<u8", copy=False).tobytes())
