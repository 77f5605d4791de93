"""The public header block and the variable length records of a LAS file, read by ourselves.

Everything is checked against the file's size here, before any decoder sees the file: decoders
allocate what a header claims.

======  ====  ========  =======================================================
offset  size  type      meaning
======  ====  ========  =======================================================
0       4     bytes     ``LASF``
6       2     u16       global encoding; bit 4: the CRS is WKT
24      2     u8, u8    version, major and minor
94      2     u16       size of this header: 227, 235 (1.3), 375 (1.4)
96      4     u32       offset to the first point
100     4     u32       number of variable length records (VLR, 54 bytes + data)
104     1     u8        point format; bit 7: compressed
105     2     u16       bytes of a point record
107     4     u32       number of points (legacy)
131     24    3 x f64   scale x, y, z
155     24    3 x f64   offset x, y, z
179     48    6 x f64   max x, min x, max y, min y, max z, min z
235     12    u64, u32  first extended record (EVLR, 60 bytes + data), their number (1.4)
247     8     u64       number of points (1.4)
======  ====  ========  =======================================================
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from typing import BinaryIO

from volatool.errors import CodedWarning, FormatError, TruncatedError
from volatool.points.layout import RECORD_BYTES, dimensions_of

HEADER_BYTES = 227
"""Least size of the header block."""

VLR_BYTES = 54
EVLR_BYTES = 60

MAX_RECORD_DATA = 1 << 20
"""Data of longer extended records is not kept: no CRS is that long."""

COMPRESSED_BIT, COMPRESSED_BITS = 0x80, 0xC0
WKT_BIT = 0x10

_SIGNATURES = (
    (b"\x1f\x8b", "gzip data; unpack it first"),
    (b"PK\x03\x04", "a ZIP archive; unpack it first"),
    (b"7z\xbc\xaf", "a 7-Zip archive; unpack it first"),
    (b"VOLA", "a VOLA volume, not points"),
    (b"ASTM-E57", "an E57 file; convert it to LAS first"),
    (b"ply", "a PLY file; `volatool import` reads it"),
    (b"# .PCD", "a PCD file; `volatool import` reads it"),
    (b"VERSION", "a PCD file; `volatool import` reads it"),
    (b"\x93NUMPY", "a NumPy array; `volatool import` reads it"),
    (b"#binvox", "a binvox grid; `volatool import` reads it"),
    (b"# Octomap", "an OctoMap; `volatool import` reads it"),
    (b"\x89HDF", "an HDF5 file"),
    (b"II*\x00", "a TIFF image"),
    (b"MM\x00*", "a TIFF image"),
    (b"%PDF", "a PDF document"),
    (b"\x89PNG", "a PNG image"),
    (b"version https://git-lfs", "a Git LFS pointer; fetch the real file (git lfs pull)"),
)


@dataclass(frozen=True, slots=True)
class Vlr:
    """
    One variable length record.

    Parameters
    ----------
    user_id : str
        Who defined it: ``"LASF_Projection"``, ``"copc"``, ...
    record_id : int
        Which of theirs.
    data : bytes
        Its content; empty for extended records longer than `MAX_RECORD_DATA`.
    size_bytes : int
        With its own header.
    is_extended : bool
        It stands behind the points.
    """

    user_id: str
    record_id: int
    data: bytes
    size_bytes: int
    is_extended: bool = False


@dataclass(frozen=True, slots=True)
class LasHeader:
    """
    What a LAS or LAZ file says of itself.

    Parameters
    ----------
    version : str
        ``"1.4"``.
    point_format : int
        0 to 10.
    is_compressed, is_copc : bool
        LAZ; LAZ in the order of a COPC octree.
    n_points : int
        As the header claims (of two counts that disagree the one that the file can hold).
    record_bytes : int
        Of one uncompressed point, extra bytes included.
    scale, offset : tuple of 3 float
        ``coordinate = stored * scale + offset``; no negative zeros.
    box : tuple of 6 float
        Minimum x, y, z, then maximum, as stored: often wrong, may be NaN.
    size_bytes : int
        Of the file.
    las_equivalent_bytes : int
        The file without compression: header, records (but LASzip's and COPC's own), points.
    dimensions : frozenset of str
        The attribute names of `PointChunk` that the point format has.
    offset_to_points, points_end, header_bytes : int
        Where the points start; where something else or the end of the file follows; size of the
        header block.
    has_wkt_flag : bool
        The header says that the CRS is WKT.
    vlrs : tuple of Vlr
        Records before and behind the points that lie inside the file.
    warnings : tuple of CodedWarning
        What is wrong with the header but can be read around.
    """

    version: str
    point_format: int
    is_compressed: bool
    is_copc: bool
    n_points: int
    record_bytes: int
    scale: tuple[float, float, float]
    offset: tuple[float, float, float]
    box: tuple[float, float, float, float, float, float]
    size_bytes: int
    las_equivalent_bytes: int
    dimensions: frozenset[str]
    offset_to_points: int
    points_end: int
    header_bytes: int
    has_wkt_flag: bool
    vlrs: tuple[Vlr, ...]
    warnings: tuple[CodedWarning, ...]

    def find(self, user_id: str, record_id: int) -> list[Vlr]:
        """Return the records of this name, those before the points first."""
        return [v for v in self.vlrs if (v.user_id, v.record_id) == (user_id, record_id)]


def read_header(stream: BinaryIO, size: int) -> LasHeader:
    """
    Read and check the header and the records of a LAS or LAZ file.

    Parameters
    ----------
    stream : binary file
        Seekable; its position is not kept.
    size : int
        Length of the file in bytes.

    Returns
    -------
    header : LasHeader
        Every offset and size in it lies inside the file, but for the points themselves.

    Raises
    ------
    FormatError
        ``E_NOT_LAS`` with what the first bytes look like; ``E_CORRUPT``; ``E_BAD_SCALE``.
    TruncatedError
        The file ends inside the header or before the first point.
    """
    stream.seek(0)
    head = stream.read(min(size, 375))
    if head[:4] != b"LASF":
        raise FormatError(f"not a LAS or LAZ file: {_looks_like(head)}", "E_NOT_LAS")
    if len(head) < HEADER_BYTES:
        raise TruncatedError(
            f"the file ends inside its header: byte {len(head)} of at least {HEADER_BYTES}"
        )
    warnings: list[CodedWarning] = []
    major, minor = head[24], head[25]
    header_bytes, offset_to_points, n_vlrs, format_byte, record_bytes, n_legacy = (
        struct.unpack_from("<HIIBHI", head, 94)
    )
    if major != 1:
        raise FormatError(f"LAS version {major}.{minor} is not one of 1.0 to 1.4")
    if minor > 4:
        text = f"LAS version 1.{minor} is read as 1.4"
        warnings.append(CodedWarning("W_LAS_VERSION", text))
    if not HEADER_BYTES <= header_bytes <= offset_to_points:
        raise FormatError(
            f"header of {header_bytes} bytes and points from byte {offset_to_points}: "
            f"expected {HEADER_BYTES} <= header <= points"
        )
    point_format, is_compressed = _point_format(format_byte, record_bytes)
    n_points = n_legacy
    evlrs = (0, 0)
    behind_points: list[int] = []
    if minor >= 3 and header_bytes >= 235 and len(head) >= 235:
        behind_points += struct.unpack_from("<Q", head, 227)  # waveforms
    if minor >= 4 and header_bytes >= 375 and len(head) >= 375:
        first_evlr, n_evlrs, n_points = struct.unpack_from("<QIQ", head, 235)
        evlrs = (first_evlr, n_evlrs)
        behind_points += [first_evlr] if n_evlrs else []
        if n_points != n_legacy and n_legacy and not (n_legacy == 2**32 - 1 < n_points):
            n_points = _pick_count(n_points, n_legacy, size - offset_to_points, record_bytes)
            text = f"the header's two point counts disagree (legacy {n_legacy}); {n_points} is used"
            warnings.append(CodedWarning("W_HEADER_COUNT", text))
    if offset_to_points > size:
        raise TruncatedError(
            f"the file ends at byte {size}, its points should start at byte {offset_to_points}: "
            f"point 0 of {n_points}"
        )
    scale, offset = _scale_and_offset(struct.unpack_from("<6d", head, 131))
    high_x, low_x, high_y, low_y, high_z, low_z = struct.unpack_from("<6d", head, 179)
    vlrs = _walk_vlrs(stream, header_bytes, offset_to_points, n_vlrs, warnings)
    vlrs += _walk_evlrs(stream, evlrs, size, offset_to_points, warnings)
    own = sum(v.size_bytes for v in vlrs if _is_codec_record(v))
    behind = sum(v.size_bytes for v in vlrs if v.is_extended)
    return LasHeader(
        version=f"{major}.{minor}",
        point_format=point_format,
        is_compressed=is_compressed,
        is_copc=any(v.user_id == "copc" and v.record_id == 1 for v in vlrs),
        n_points=n_points,
        record_bytes=record_bytes,
        scale=scale,
        offset=offset,
        box=(low_x, low_y, low_z, high_x, high_y, high_z),
        size_bytes=size,
        las_equivalent_bytes=offset_to_points + n_points * record_bytes + behind - own,
        dimensions=dimensions_of(point_format),
        offset_to_points=offset_to_points,
        points_end=min([size, *(at for at in behind_points if offset_to_points <= at < size)]),
        header_bytes=header_bytes,
        has_wkt_flag=bool(head[6] & WKT_BIT),
        vlrs=tuple(vlrs),
        warnings=tuple(warnings),
    )


def _looks_like(head: bytes) -> str:
    """Say what the first bytes of a file that isn't LAS look like."""
    if not head:
        return "the file is empty"
    for signature, what in _SIGNATURES:
        if head.startswith(signature):
            return f"it looks like {what}"
    start = head.lstrip(b"\xef\xbb\xbf \t\r\n")[:200].lower()
    if start.startswith((b"<!doctype html", b"<html")) or b"<html" in start:
        return "it looks like an HTML page (a failed download?)"
    if start.startswith(b"<"):
        return "it looks like XML (a failed download?)"
    if start.startswith((b"{", b"[")):
        return "it looks like JSON"
    if not any(head):
        return "it starts with zeros only (an unfinished download?)"
    shown = head[:60]
    if all(byte in b"\t\r\n" or 32 <= byte < 127 for byte in shown):
        line = shown.decode("ascii").splitlines()[0]
        return f"it looks like text, starting {line!r}"
    return f"it starts with bytes {head[:8].hex(' ')}, expected 'LASF'"


def _point_format(byte: int, record_bytes: int) -> tuple[int, bool]:
    """Return the point format and whether it is compressed."""
    point_format = byte & ~COMPRESSED_BITS
    if point_format not in RECORD_BYTES:
        raise FormatError(f"point format {point_format} is not one of 0 to 10")
    if record_bytes < RECORD_BYTES[point_format]:
        raise FormatError(
            f"point records of {record_bytes} bytes are too short for point format "
            f"{point_format}, which needs {RECORD_BYTES[point_format]}"
        )
    return point_format, byte & COMPRESSED_BITS == COMPRESSED_BIT


def _pick_count(n_points: int, n_legacy: int, room: int, record_bytes: int) -> int:
    """Return the one of two counts that fills the file, else the 64-bit one."""
    if not n_points or n_legacy * record_bytes <= room < n_points * record_bytes:
        return n_legacy
    return n_points


def _scale_and_offset(
    values: tuple[float, ...],
) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Return scale and offset, or refuse what can't give coordinates."""
    # adding 0.0 turns -0.0, which real files have, into 0.0: one text form, one hash
    x, y, z, x0, y0, z0 = (value + 0.0 for value in values)
    for axis, scale, offset in zip("xyz", (x, y, z), (x0, y0, z0), strict=True):
        if not (math.isfinite(scale) and scale > 0):
            raise FormatError(
                f"scale {scale!r} of {axis} is not a number above zero", "E_BAD_SCALE"
            )
        if not math.isfinite(offset):
            raise FormatError(f"offset {offset!r} of {axis} is not finite", "E_BAD_SCALE")
        if not math.isfinite(scale * 2.0**31 + abs(offset)):
            raise FormatError(
                f"scale {scale!r} and offset {offset!r} of {axis} give infinite coordinates",
                "E_BAD_SCALE",
            )
    return (x, y, z), (x0, y0, z0)


def _walk_vlrs(
    stream: BinaryIO, start: int, end: int, n_claimed: int, warnings: list[CodedWarning]
) -> list[Vlr]:
    """Return the records between the header and the points, as many as really fit."""
    vlrs: list[Vlr] = []
    at = start
    while len(vlrs) < n_claimed and at + VLR_BYTES <= end:
        stream.seek(at)
        _, user_id, record_id, length = struct.unpack_from("<H16sHH", stream.read(VLR_BYTES))
        if at + VLR_BYTES + length > end:
            break
        vlrs.append(Vlr(_text(user_id), record_id, stream.read(length), VLR_BYTES + length))
        at += VLR_BYTES + length
    if len(vlrs) < n_claimed:
        text = f"the header claims {n_claimed} records (VLR), {len(vlrs)} fit before the points"
        warnings.append(CodedWarning("W_VLR_COUNT", text, n_claimed - len(vlrs)))
    return vlrs


def _walk_evlrs(
    stream: BinaryIO,
    claimed: tuple[int, int],
    size: int,
    offset_to_points: int,
    warnings: list[CodedWarning],
) -> list[Vlr]:
    """Return the extended records that lie inside the file."""
    at, n_claimed = claimed
    vlrs: list[Vlr] = []
    while at >= offset_to_points and len(vlrs) < n_claimed and at + EVLR_BYTES <= size:
        stream.seek(at)
        _, user_id, record_id, length = struct.unpack_from("<H16sHQ", stream.read(EVLR_BYTES))
        if at + EVLR_BYTES + length > size:
            break
        data = stream.read(length) if length <= MAX_RECORD_DATA else b""
        vlrs.append(Vlr(_text(user_id), record_id, data, EVLR_BYTES + length, True))
        at += EVLR_BYTES + length
    if len(vlrs) < n_claimed:
        text = f"the header claims {n_claimed} extended records, {len(vlrs)} fit in the file"
        warnings.append(CodedWarning("W_VLR_COUNT", text, n_claimed - len(vlrs)))
    return vlrs


def _text(raw: bytes) -> str:
    """Return a fixed-size text field up to its first zero."""
    return raw.split(b"\0")[0].decode("ascii", "replace").strip()


def _is_codec_record(vlr: Vlr) -> bool:
    """Whether a record serves the compression only and would not be in a LAS file."""
    return (vlr.user_id, vlr.record_id) == ("laszip encoded", 22204) or vlr.user_id == "copc"
