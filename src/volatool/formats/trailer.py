"""
The trailer after the last level: what the header has no room for.

========== ======== ====================================================================
offset     type     meaning
========== ======== ====================================================================
0          8 bytes  ``VOLATRL1``
8          u32      n, length of the JSON
12         n bytes  JSON, UTF-8, one object
12 + n     u32      CRC-32 of header and levels
16 + n     u32      CRC-32 of the JSON
20 + n     u32      n again
24 + n     8 bytes  ``1LRTALOV``, the end of the file
========== ======== ====================================================================

The original toolkit does not read past the last level. The second length and magic let the
trailer be found from the end.
"""

from __future__ import annotations

import json
import math
import re
import struct
import zlib
from collections.abc import Sequence
from fractions import Fraction
from typing import Any

from volatool._version import __version__
from volatool.cube import Cube
from volatool.errors import FormatError, TruncatedError
from volatool.formats.header import NO_CRS, Header
from volatool.model import CrsInfo
from volatool.vola.info import VolumeInfo
from volatool.vola.volume import Volume

MAGIC = b"VOLATRL1"
END = MAGIC[::-1]
FRAME_BYTES = 32
MAX_TRAILER = 1 << 20
"""Longest trailer that is read; ours are a few kilobytes."""

_SCHEMA = "volatool.trailer/1"
_RATIO = re.compile(r"-?[0-9]{1,400}/[0-9]{1,400}")
_CRS_TEXT = ("wkt2", "horizontal", "vertical", "unit_xy", "unit_z")


def frame(text: bytes, body_crc: int) -> bytes:
    """
    Return the trailer.

    Parameters
    ----------
    text : bytes
        The JSON.
    body_crc : int
        CRC-32 of header and levels.
    """
    length = struct.pack("<I", len(text))
    checks = struct.pack("<II", body_crc, zlib.crc32(text))
    return MAGIC + length + text + checks + length + END


def unframe(data: bytes, body_crc: int | None, offset: int) -> dict[str, Any]:
    """
    Check a trailer and return its JSON object.

    Parameters
    ----------
    data : bytes
        Everything after the last level; begins with the magic, or with as much of it as there is.
    body_crc : int or None
        CRC-32 of header and levels as read; None to leave that check out.
    offset : int
        Where `data` begins in the file.

    Raises
    ------
    TruncatedError, FormatError
        The trailer is cut, or damaged, or the levels are.
    """
    if len(data) < 12:
        raise TruncatedError(f"the file ends inside its trailer (offset {offset + len(data)})")
    (length,) = struct.unpack_from("<I", data, 8)
    if length + FRAME_BYTES > MAX_TRAILER:
        raise FormatError(
            f"the trailer claims {length} bytes, at most {MAX_TRAILER - FRAME_BYTES} are read "
            f"(offset {offset + 8})"
        )
    if len(data) < length + FRAME_BYTES:
        raise TruncatedError(
            f"the trailer should have {length + FRAME_BYTES} bytes, the file ends after "
            f"{len(data)} of them (offset {offset + len(data)})"
        )
    if len(data) > length + FRAME_BYTES:
        raise FormatError(f"bytes follow the trailer (offset {offset + length + FRAME_BYTES})")
    text = data[12 : 12 + length]
    body, own, again = struct.unpack_from("<III", data, 12 + length)
    if again != length or data[-8:] != END:
        raise FormatError(f"the trailer has no proper end (offset {offset + 20 + length})")
    if own != zlib.crc32(text):
        raise FormatError(f"the trailer's checksum does not match (offset {offset + 16 + length})")
    if body_crc is not None and body != body_crc:
        raise FormatError(
            f"the checksum of header and levels does not match: the file was damaged "
            f"(bytes 0 to {offset})"
        )
    try:
        content = _printable(json.loads(text, parse_constant=_refuse_constant))
    except (ValueError, RecursionError) as error:
        raise FormatError(f"the trailer is not JSON: {error} (offset {offset + 12})") from error
    if not isinstance(content, dict):
        raise FormatError(f"the trailer is not a JSON object (offset {offset + 12})")
    return content


def unframe_end(data: bytes, offset: int) -> dict[str, Any] | None:
    """
    Find a trailer at the end of a file, without the levels.

    Parameters
    ----------
    data : bytes
        The last bytes of the file.
    offset : int
        Where they begin in it.

    Returns
    -------
    content : dict or None
        None if the file does not end with a trailer.
    """
    if data[-8:] != END or len(data) < FRAME_BYTES:
        return None
    (length,) = struct.unpack_from("<I", data, len(data) - 12)
    start = len(data) - length - FRAME_BYTES
    if start < 0 or data[start : start + 8] != MAGIC:
        raise FormatError(f"the trailer has no proper start (offset {offset + max(start, 0)})")
    return unframe(data[start:], None, offset + start)


def _printable(value: Any) -> Any:
    """Return a JSON value whose texts can be printed anywhere: no escapes, no lone surrogates."""
    if isinstance(value, str):
        return "".join(c if c.isprintable() or c in "\n\t" else "\ufffd" for c in value)
    if isinstance(value, list):
        return [_printable(item) for item in value]
    if isinstance(value, dict):
        return {_printable(key): _printable(item) for key, item in value.items()}
    return value


def short(value: object) -> str:
    """Return a value for a message: a crafted trailer must not make it a megabyte."""
    text = str(value)
    return text if len(text) <= 200 else f"{text[:200]}..."


def _refuse_constant(name: str) -> None:
    raise ValueError(f"{name} is not JSON")


def describe(volume: Volume, blocks: Sequence[int]) -> bytes:
    """
    Return the trailer's JSON of a volume.

    Parameters
    ----------
    volume : Volume
        What is described.
    blocks : sequence of int
        Stored words of each level, as the file has them.

    Returns
    -------
    text : bytes
        Sorted keys, no blanks.
    """
    info, crs, cube = volume.info, volume.crs, volume.cube
    content: dict[str, Any] = {
        "schema": _SCHEMA,
        "generator": f"volatool {__version__}",
        "quantizer": info.quantizer,
        "cube": {
            "origin": [_ratio(value) for value in cube.exact[:3]],
            "side": _ratio(cube.exact[3]),
            "snapped": cube.is_snapped,
        },
        "box": None if info.box is None else list(info.box),
        "crs": {
            **{name: getattr(crs, name) for name in _CRS_TEXT},
            "epsg": crs.epsg,
            "metres_per_unit_xy": _ratio(crs.metres_per_unit_xy),
            "metres_per_unit_z": _ratio(crs.metres_per_unit_z),
            "is_geographic": crs.is_geographic,
            "source": crs.source,
        },
        "channels": [dict(channel) for channel in info.channels],
        "points": info.n_points,
        "source": {"name": info.source_name, "bytes": info.source_bytes},
        "blocks": list(blocks),
        "voxels": volume.n_voxels,
    }
    return json.dumps(
        content, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False
    ).encode("utf-8", "backslashreplace")  # a file name may hold surrogates


def _ratio(value: Fraction | None) -> str | None:
    return None if value is None else f"{value.numerator}/{value.denominator}"


def interpret(content: dict[str, Any], header: Header) -> tuple[Cube, VolumeInfo]:
    """
    Return the cube and the facts that a trailer's JSON tells.

    Parameters
    ----------
    content : dict
        As `unframe` returned it.
    header : Header
        Of the same file.

    Raises
    ------
    FormatError
        A later schema, a value of the wrong type, or one that contradicts the header.
    """
    schema = content.get("schema")
    if schema != _SCHEMA:
        raise FormatError(
            f"the trailer's schema is {short(repr(schema))}, this version reads {_SCHEMA!r}: the "
            "file is of another version of volatool"
        )
    try:
        return _cube(content["cube"], header), _info(content, header)
    except (KeyError, TypeError, ValueError, ZeroDivisionError, OverflowError) as error:
        if isinstance(error, FormatError):
            raise
        raise FormatError(
            f"the trailer makes no sense: {type(error).__name__} {short(error)}"
        ) from error


def recall(content: dict[str, Any]) -> tuple[Cube, VolumeInfo]:
    """
    Return the cube and the facts that `describe` wrote, where there is no header.

    Parameters
    ----------
    content : dict
        The JSON object, from a comment in a file of another format.

    Raises
    ------
    FormatError
        A value of the wrong type, or one that makes no sense.
    """
    try:
        cube, epsg = _own_cube(content["cube"]), _whole(content["crs"]["epsg"])
        if cube.side < 0:  # 0: all points are in one place
            raise ValueError(f"side {cube.side}")
        x, y, z = cube.origin
        box = (x, y, z, x + cube.side, y + cube.side, z + cube.side)
        header = Header(0, 1, 0, NO_CRS if epsg is None else epsg, 0.0, 0.0, box)
        return cube, _info(content, header)
    except (KeyError, TypeError, ValueError, ZeroDivisionError, OverflowError) as error:
        raise FormatError(
            f"the line of volatool makes no sense: {type(error).__name__} {short(error)}"
        ) from error


def _own_cube(content: dict[str, Any]) -> Cube:
    origin = [_fraction(value) for value in content["origin"]]
    return Cube.from_exact(origin, _fraction(content["side"]), bool(content["snapped"]))


def _cube(content: dict[str, Any], header: Header) -> Cube:
    cube = _own_cube(content)
    # the header's side went through a subtraction of large coordinates
    slack = 8 * max(math.ulp(abs(value)) for value in header.box)
    if cube.origin != header.box[:3] or abs(cube.side - header.side) > slack:
        raise FormatError(f"the trailer's cube {cube} is not the header's box {header.box}")
    return cube


def _info(content: dict[str, Any], header: Header) -> VolumeInfo:
    crs = content["crs"]
    units = [crs["metres_per_unit_xy"], crs["metres_per_unit_z"]]
    metres = [None if value is None else _positive(_fraction(value)) for value in units]
    box = content["box"]
    if box is not None and (len(box) != 6 or not all(map(math.isfinite, box))):
        raise ValueError(f"box {box}")
    quantizer = content["quantizer"]
    if quantizer not in ("floor", "toolkit", "unknown"):
        raise ValueError(f"quantizer {quantizer!r}")
    source = content["source"]
    return VolumeInfo(
        crs=CrsInfo(
            wkt2=_text(crs["wkt2"]),
            horizontal=_text(crs["horizontal"]),
            vertical=_text(crs["vertical"]),
            epsg=_whole(crs["epsg"]),
            unit_xy=_text(crs["unit_xy"]),
            unit_z=_text(crs["unit_z"]),
            metres_per_unit_xy=metres[0],
            metres_per_unit_z=metres[1],
            is_geographic=bool(crs["is_geographic"]),
            source=str(crs["source"]),
        ),
        box=None if box is None else tuple(map(float, box)),  # type: ignore[arg-type]
        n_points=_whole(content["points"]),
        channels=tuple(_channel(channel) for channel in content["channels"]),
        quantizer=quantizer,
        source_name=_text(source["name"]),
        source_bytes=_whole(source["bytes"]),
        lat=header.place[0],
        lon=header.place[1],
        epsg=header.epsg,
        generator=_text(content["generator"]),
    )


def _channel(content: dict[str, Any]) -> dict[str, Any]:
    byte = _whole(content["byte"])
    numbers = [float(content["scale"]), float(content["offset"])]
    if byte is None or byte > 7 or not all(map(math.isfinite, numbers)):
        raise ValueError(f"channel {content}")
    return {**content, "byte": byte, "name": str(content["name"])}


def _fraction(text: str) -> Fraction:
    # digits only: Fraction("1e999999999") would never return
    if not _RATIO.fullmatch(text):
        raise ValueError(f"{text!r} is not a ratio")
    numerator, denominator = text.split("/")
    return Fraction(int(numerator), int(denominator))


def _positive(value: Fraction) -> Fraction:
    if value <= 0:
        raise ValueError(f"unit of length {value}")
    return value


def _text(value: Any) -> str | None:
    if value is not None and not isinstance(value, str):
        raise TypeError(f"{value!r} is not text")
    return value


def _whole(value: Any) -> int | None:
    if value is not None and (not isinstance(value, int) or isinstance(value, bool) or value < 0):
        raise TypeError(f"{value!r} is not a count")
    return value
