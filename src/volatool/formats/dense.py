"""
Dense VOLA files (``.dvol``): every cell of every level as one bit, empty or not.

Each level is one bit array over its whole grid of side ``s = 4**level``, cut into words:
``linear = x + y*s + z*s*s``, word ``linear // 64``, bit ``linear % 64``. A word is therefore a
strip of cells along x (of 4 x 4 x 4 cells only at level 1). Metadata words belong to the strips.
"""

from __future__ import annotations

from dataclasses import replace
from typing import BinaryIO

import numpy as np

from volatool.errors import FormatError, ResourceError
from volatool.formats import trailer
from volatool.formats.assemble import assemble
from volatool.formats.header import DENSE, HEADER_BYTES, Header
from volatool.formats.sparse import nonzero
from volatool.formats.stream import Body, Source
from volatool.model import U64
from volatool.occupancy.levels import dense_bytes as level_bytes
from volatool.vola.strips import Strips, bit_of, group_starts, level_strips, vola_order
from volatool.vola.volume import Volume

MAX_BYTES = 32 << 30
"""Largest dense file that is written: depth 6."""

_PIECE = 1 << 18


def dense_bytes(depth: int, metadata: bool) -> int:
    """
    Return the exact size of header and levels.

    Parameters
    ----------
    depth : int
        Number of levels.
    metadata : bool
        With metadata words.
    """
    return HEADER_BYTES + (1 + metadata) * level_bytes(depth)


def write(
    stream: BinaryIO,
    volume: Volume,
    *,
    with_trailer: bool = True,
    header: Header | None = None,
) -> int:
    """
    Write a volume; memory is proportional to its voxels, not to the file.

    Parameters
    ----------
    stream : binary file
        Where it goes.
    volume : Volume
        What is written. The metadata word of a strip is the mean of the block words of its voxels
        (class: the most frequent, ties to the lowest code).
    with_trailer : bool
        Append the trailer.
    header : Header, optional
        Another header than the volume's own.

    Returns
    -------
    n_bytes : int
        Size of what was written, before any compression.

    Raises
    ------
    ResourceError
        ``E_SIZE``: the file would be larger than `MAX_BYTES`.
    """
    refuse_size(volume.depth, volume.has_metadata)
    body = Body(stream)
    body.write((header or Header.of(volume, DENSE)).to_bytes())
    for level in range(1, volume.depth + 1):
        strips = level_strips(volume, level)
        if strips.metadata is not None:
            strips = replace(strips, metadata=nonzero(strips.metadata))
        write_strips(body, strips, level)
    if with_trailer:
        text = trailer.describe(volume, [64**level for level in range(volume.depth)])
        body.write(trailer.frame(text, body.crc))
    return body.size


def refuse_size(depth: int, metadata: bool) -> None:
    """Refuse a depth whose dense file nobody can want."""
    size = dense_bytes(depth, metadata)
    if size > MAX_BYTES:
        raise ResourceError(
            f"a dense file of depth {depth} takes {size} bytes, at most {MAX_BYTES} are written; "
            "write it sparse or less deep",
            "E_SIZE",
        )


def write_strips(body: Body, strips: Strips, level: int) -> None:
    """Write one level: all its words, then all its metadata words."""
    for values in (strips.words, strips.metadata):
        if values is None:
            continue
        for start in range(0, 64 ** (level - 1), _PIECE):
            stop = min(start + _PIECE, 64 ** (level - 1))
            low, high = np.searchsorted(strips.numbers, np.array([start, stop], np.uint64))
            piece = np.zeros(stop - start, np.uint64)
            piece[strips.numbers[low:high] - np.uint64(start)] = values[low:high]
            body.words(piece)


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
        In VOLA order. The metadata word of a block is the mean of the words of the strips that its
        cells lie in (class: the most frequent).

    Raises
    ------
    TruncatedError, FormatError
        The file ends early or goes on after its end, or its levels contradict each other.
    ResourceError
        ``E_SIZE``: larger than the source's limit.
    """
    from volatool.kernels.words import mean_words

    levels: list[U64] = []
    metadata: list[U64] = []
    above = np.zeros(1, np.uint64)
    for level, strips in enumerate(read_strips(source, header), 1):
        keys, words = vola_order(strips, level)
        blocks = keys >> np.uint64(6)
        starts = group_starts(blocks)
        if level > 1 and not np.array_equal(blocks[starts], above):
            raise FormatError(f"level {level} has voxels where level {level - 1} has not, or none")
        if level == 1:
            levels.append(np.bitwise_or.reduce(bit_of(keys), keepdims=True, dtype=np.uint64))
        else:
            levels.append(np.bitwise_or.reduceat(bit_of(keys), starts) if len(keys) else keys)
        if words is not None:
            means = mean_words(words, starts)
            metadata.append(means if len(levels[-1]) == len(means) else np.zeros(1, np.uint64))
        above = keys
    stored = [64**level for level in range(header.depth)]
    return assemble(source, header, levels, metadata if header.nbits else None, stored)


def read_strips(source: Source, header: Header) -> list[Strips]:
    """
    Read the levels as they are stored.

    Parameters
    ----------
    source : Source
        After the header.
    header : Header
        The header.

    Returns
    -------
    levels : list of Strips
        The root first. Only words that are not empty are held.
    """
    what = f"the levels of a dense file of depth {header.depth}"
    source.expect(dense_bytes(header.depth, bool(header.nbits)) - HEADER_BYTES, what, kept=False)
    levels = []
    kept = 0
    for level in range(1, header.depth + 1):
        numbers, words = _not_empty(source, level)
        kept += 24 * len(numbers)
        if kept > source.limit:
            raise ResourceError(
                f"the volume takes more than the limit of {source.limit} bytes", "E_SIZE"
            )
        metadata = _words_at(source, level, numbers) if header.nbits else None
        levels.append(Strips(numbers, words, metadata))
    return levels


def _not_empty(source: Source, level: int) -> tuple[U64, U64]:
    n_words = 64 ** (level - 1)
    numbers, words = [], []
    for start in range(0, n_words, _PIECE):
        piece = source.words(min(_PIECE, n_words - start), f"level {level}", kept=False)
        places = np.flatnonzero(piece)
        numbers.append(places.astype(np.uint64) + np.uint64(start))
        words.append(piece[places])
    return np.concatenate(numbers), np.concatenate(words)


def _words_at(source: Source, level: int, numbers: U64) -> U64:
    n_words = 64 ** (level - 1)
    words = []
    for start in range(0, n_words, _PIECE):
        n_piece = min(_PIECE, n_words - start)
        piece = source.words(n_piece, f"the metadata of level {level}", kept=False)
        low, high = np.searchsorted(numbers, np.array([start, start + n_piece], np.uint64))
        words.append(piece[numbers[low:high] - np.uint64(start)])
    return np.concatenate(words)
