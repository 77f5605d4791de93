"""Levels as read, and the trailer that may follow them, to a volume."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from volatool.errors import CodedWarning, FormatError
from volatool.formats import trailer
from volatool.formats.header import Header
from volatool.formats.stream import Source
from volatool.model import U64, CrsInfo
from volatool.vola.info import VolumeInfo
from volatool.vola.volume import Volume


def assemble(
    source: Source,
    header: Header,
    levels: Sequence[U64],
    metadata: Sequence[U64] | None,
    blocks: Sequence[int],
    warnings: Sequence[CodedWarning] = (),
) -> Volume:
    """
    Return the volume of levels that were read.

    Parameters
    ----------
    source : Source
        After the last level.
    header : Header
        The header.
    levels, metadata : sequence of (n,) arrays of uint64
        As `Volume` has them.
    blocks : sequence of int
        Words that the file stores for each level.
    warnings : sequence of CodedWarning
        For the volume's `info`.

    Raises
    ------
    TruncatedError, FormatError
        Something else than a trailer follows, or one that is damaged or contradicts the levels.
    """
    offset = source.position
    content = read_trailer(source)
    if content is None:
        cube, info = header.cube(), header_info(header)
    else:
        cube, info = trailer.interpret(content, header)
        if content.get("blocks") != list(blocks):
            told = trailer.short(content.get("blocks"))
            raise FormatError(
                f"the trailer's block counts {told} are not the file's {list(blocks)} "
                f"(offset {offset})"
            )
    if warnings:
        info = with_warnings(info, warnings)
    return Volume(tuple(levels), None if metadata is None else tuple(metadata), cube, info)


def read_trailer(source: Source) -> dict[str, object] | None:
    """
    Return the trailer's object, None at the end of the file.

    Parameters
    ----------
    source : Source
        After the last level; `Source.crc` is that of header and levels.

    Raises
    ------
    TruncatedError, FormatError
        Something else follows, or a trailer that is cut or damaged.
    """
    offset, body_crc = source.position, source.crc
    rest = source.read(trailer.MAX_TRAILER + 1)
    if not rest:
        return None
    if not (rest.startswith(trailer.MAGIC) or trailer.MAGIC.startswith(rest)):
        more = "at least " if len(rest) > trailer.MAX_TRAILER else ""
        raise FormatError(
            f"{more}{len(rest)} bytes that are no known trailer follow the last level "
            f"(offset {offset})"
        )
    return trailer.unframe(rest, body_crc, offset)


def header_info(header: Header) -> VolumeInfo:
    """Return what a header alone tells: a file of the original toolkit, or like it."""
    crs = CrsInfo()
    if header.epsg is not None:
        crs = CrsInfo(horizontal=f"EPSG:{header.epsg}", epsg=header.epsg, source="vola")
    return VolumeInfo(
        crs=crs,
        box=header.box,
        quantizer="unknown",
        lat=header.place[0],
        lon=header.place[1],
        epsg=header.epsg,
    )


def with_warnings(info: VolumeInfo, warnings: Sequence[CodedWarning]) -> VolumeInfo:
    """Return the same facts with more warnings."""
    return replace(info, warnings=(*info.warnings, *warnings))
