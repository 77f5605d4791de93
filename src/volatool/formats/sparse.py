"""
Sparse VOLA files (``.vol``): the stored blocks of each level, in VOLA order.

After the header, for each level from the root: its occupancy words, then its metadata words if the
file has any. The bits set in one level number the words of the next; nothing else tells a length.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import BinaryIO

import numpy as np

from volatool.errors import CodedWarning, FormatError
from volatool.formats import trailer
from volatool.formats.assemble import assemble, with_warnings
from volatool.formats.header import HEADER_BYTES, SPARSE, Header
from volatool.formats.stream import Body, Source
from volatool.model import U64
from volatool.vola.volume import Volume

SAFE_WORD = np.uint64(0x010101)
"""Stands for a metadata word of zero, which tools of the original's family would drop."""


def sparse_bytes(blocks: Sequence[int], metadata: bool) -> int:
    """
    Return the exact size of header and levels.

    Parameters
    ----------
    blocks : sequence of int
        Stored blocks of each level.
    metadata : bool
        With metadata words.
    """
    return HEADER_BYTES + 8 * (1 + metadata) * sum(blocks)


def write(stream: BinaryIO, volume: Volume, *, with_trailer: bool = True) -> int:
    """
    Write a volume.

    Parameters
    ----------
    stream : binary file
        Where it goes.
    volume : Volume
        What is written.
    with_trailer : bool
        Append the trailer.

    Returns
    -------
    n_bytes : int
        Size of what was written, before any compression.
    """
    body = Body(stream)
    body.write(Header.of(volume, SPARSE).to_bytes())
    write_levels(body, volume)
    if with_trailer:
        text = trailer.describe(volume, [len(words) for words in volume.levels])
        body.write(trailer.frame(text, body.crc))
    return body.size


def write_levels(body: Body, volume: Volume) -> None:
    """Write the levels."""
    for level, words in enumerate(volume.levels, 1):
        body.words(words)
        if volume.has_metadata:
            body.words(nonzero(volume.metadata_words(level)))


def nonzero(metadata: U64) -> U64:
    """Return metadata words with zeros replaced by `SAFE_WORD`."""
    if metadata.all():
        return metadata
    return np.where(metadata == 0, SAFE_WORD, metadata)


def read(source: Source, header: Header) -> Volume:
    """
    Read a volume.

    Parameters
    ----------
    source : Source
        After the header.
    header : Header
        The header.

    Returns
    -------
    volume : Volume
        With warnings in its `info` where something was put right.

    Raises
    ------
    TruncatedError, FormatError
        The file ends early, goes on after its end, or has lost metadata words.
    ResourceError
        ``E_SIZE``: larger than the source's limit.
    """
    try:
        return _read(source, header, header.nbits)
    except FormatError as error:
        if not header.nbits:
            raise
        # the original's writer drops metadata words of zero. Only if it dropped all of them is
        # there one reading: the file without metadata, to its last byte (golden zero_all)
        repaired = _read_without_metadata(source, header)
        if repaired is not None:
            return repaired
        message = (
            f"{error}; the file is cut or damaged, or its writer left out metadata words of zero"
        )
        raise type(error)(message, error.code) from error


def _read(source: Source, header: Header, n_metadata: int) -> Volume:
    levels: list[U64] = []
    metadata: list[U64] = []
    warnings: list[CodedWarning] = []
    n_words = 1
    for level in range(1, header.depth + 1):
        offset = source.position
        words = source.words(n_words, f"level {level}")
        if n_metadata:
            metadata.append(source.words(n_words, f"the metadata of level {level}"))
        levels.append(words)
        empty = 0 if level == 1 else n_words - int(np.count_nonzero(words))
        if empty and n_metadata:
            place = offset + 8 * int(np.flatnonzero(words == 0)[0])
            raise FormatError(f"a stored block of level {level} is empty (offset {place})")
        if empty:
            warnings.append(
                CodedWarning("W_EMPTY_BLOCKS", f"level {level} stores empty blocks", empty)
            )
        n_words = int(np.bitwise_count(words).sum(dtype=np.int64))
    return assemble(
        source,
        header,
        levels,
        metadata if n_metadata else None,
        [len(words) for words in levels],
        warnings,
    )


def _read_without_metadata(source: Source, header: Header) -> Volume | None:
    source.rewind()
    source.read(HEADER_BYTES)
    try:
        volume = _read(source, header, 0)
    except FormatError:
        return None
    n_words = sum(len(words) for words in volume.levels)
    if volume.info.warnings or source.position != HEADER_BYTES + 8 * n_words:
        return None  # empty blocks, or a trailer: not the original's file
    # every file with metadata can be cut where the words left add up as one without; in our own
    # ones the root's metadata word gives it away, its byte 7 is 1
    if volume.depth > 1 and len(volume) and int(volume.levels[1][0]) >> 56 == 1:
        return None
    warning = CodedWarning(
        "W_ZERO_METADATA",
        "the writer left out all metadata words, which were zero; they are zero again",
        n_words,
    )
    zeros = tuple(np.zeros(len(words), np.uint64) for words in volume.levels)
    return Volume(volume.levels, zeros, volume.cube, with_warnings(volume.info, [warning]))
