"""The header is checked against the file's size before anything else reads the file."""

from __future__ import annotations

import io
import struct

import pytest
from naive_points import RECORD, las_bytes, vlr

from volatool.errors import FormatError, TruncatedError, VolatoolError
from volatool.points.header import LasHeader, read_header


def read(data: bytes) -> LasHeader:
    return read_header(io.BytesIO(data), len(data))


def patched(data: bytes, at: int, layout: str, *values: float) -> bytes:
    changed = bytearray(data)
    struct.pack_into(layout, changed, at, *values)
    return bytes(changed)


@pytest.mark.parametrize("point_format", range(11))
def test_every_point_format_is_known(point_format: int) -> None:
    """Record size, names of attributes and sizes are right for formats 0 to 10."""
    header = read(las_bytes(point_format=point_format, minor=4))
    assert header.point_format == point_format
    assert header.record_bytes == RECORD[point_format]
    assert ("red" in header.dimensions) == (point_format in {2, 3, 5, 7, 8, 10})
    assert header.las_equivalent_bytes == header.size_bytes


@pytest.mark.parametrize("minor", range(5))
def test_every_version_is_read(minor: int) -> None:
    """LAS 1.0 to 1.4 give the same points."""
    header = read(las_bytes([(1, 2, 3)] * 7, minor=minor))
    assert (header.version, header.n_points) == (f"1.{minor}", 7)
    assert not header.warnings


@pytest.mark.parametrize(
    ("data", "told"),
    [
        (b"", "the file is empty"),
        (b"<!DOCTYPE html><html>", "an HTML page"),
        (b"\n <html>404", "an HTML page"),
        (b"<?xml version='1.0'?>", "XML"),
        (b'{"error": 404}', "JSON"),
        (b"\x1f\x8b\x08\x00", "gzip"),
        (b"PK\x03\x04aaaa", "ZIP"),
        (b"VOLA" + bytes(80), "a VOLA volume"),
        (b"version https://git-lfs.github.com/spec/v1\n", "Git LFS pointer"),
        (b"1.0 2.0 3.0\n", "text, starting '1.0 2.0 3.0'"),
        (bytes(400), "zeros only"),
        (b"\xde\xad\xbe\xef\x00\x01\x02\x03", "bytes de ad be ef 00 01 02 03"),
    ],
)
def test_what_is_not_las_is_named(data: bytes, told: str) -> None:
    """The error says what the first bytes look like."""
    with pytest.raises(FormatError, match=told) as caught:
        read(data)
    assert caught.value.code == "E_NOT_LAS"


@pytest.mark.parametrize(
    ("at", "layout", "values", "code"),
    [
        (24, "<B", (7,), "E_CORRUPT"),  # version 7
        (94, "<H", (100,), "E_CORRUPT"),  # header too short
        (94, "<H", (60000,), "E_CORRUPT"),  # header behind the points
        (96, "<I", (2**32 - 1,), "E_TRUNCATED"),  # points behind the file
        (104, "<B", (11,), "E_CORRUPT"),  # point format 11
        (105, "<H", (19,), "E_CORRUPT"),  # records too short
        (131, "<d", (0.0,), "E_BAD_SCALE"),
        (131, "<d", (float("nan"),), "E_BAD_SCALE"),
        (139, "<d", (float("inf"),), "E_BAD_SCALE"),
        (147, "<d", (-0.01,), "E_BAD_SCALE"),
        (131, "<d", (1e300,), "E_BAD_SCALE"),  # coordinates overflow
        (155, "<d", (float("nan"),), "E_BAD_SCALE"),
    ],
)
def test_senseless_headers_are_refused(
    at: int, layout: str, values: tuple[float, ...], code: str
) -> None:
    """Each with its stable code."""
    with pytest.raises(VolatoolError) as caught:
        read(patched(las_bytes(), at, layout, *values))
    assert caught.value.code == code


@pytest.mark.parametrize("size", [4, 100, 226])
def test_a_file_that_ends_in_its_header_is_truncated(size: int) -> None:
    """The error says at which byte."""
    with pytest.raises(TruncatedError, match=f"byte {size} of"):
        read(las_bytes()[:size])


def test_negative_zero_offsets_are_zero() -> None:
    """Real files have -0.0; its text form would differ."""
    header = read(las_bytes(offset=(-0.0, -0.0, -0.0)))
    assert str(header.offset) == "(0.0, 0.0, 0.0)"


def test_a_billion_claimed_records_are_not_walked() -> None:
    """odd/las_garbage_nVariableLength.las claims 1,069,128,089."""
    header = read(las_bytes(n_vlrs=1_069_128_089))
    assert [w.code for w in header.warnings] == ["W_VLR_COUNT"]


def test_a_record_longer_than_its_room_is_left_out() -> None:
    """The records before it are kept."""
    good, bad = vlr("a", 1, b"xyz"), bytearray(vlr("b", 2, b"123"))
    bad[20:22] = b"\xff\xff"
    header = read(las_bytes(vlrs=(good, bytes(bad))))
    assert [v.data for v in header.vlrs] == [b"xyz"]
    assert [w.code for w in header.warnings] == ["W_VLR_COUNT"]


@pytest.mark.parametrize(
    ("legacy", "wide", "used", "warned"),
    [(3, 3, 3, False), (0, 3, 3, False), (3, 0, 3, True), (2, 3, 3, True), (3, 999, 3, True)],
)
def test_two_counts_that_disagree(legacy: int, wide: int, used: int, warned: bool) -> None:
    """The 64-bit count holds unless only the legacy one fits the file."""
    header = read(las_bytes([(1, 2, 3)] * 3, minor=4, n_points=wide, n_legacy=legacy))
    assert header.n_points == used
    assert [w.code for w in header.warnings] == ["W_HEADER_COUNT"] * warned


def test_extended_records_are_read_and_bounded() -> None:
    """An extended record that claims terabytes is left out."""
    data = las_bytes([(1, 2, 3)], minor=4)
    good = struct.pack("<H16sHQ32s", 0, b"LASF_Projection", 2112, 5, b"") + b"hello"
    huge = struct.pack("<H16sHQ32s", 0, b"x", 1, 2**62, b"")
    whole = patched(data + good + huge, 235, "<QI", len(data), 2)
    header = read(whole)
    assert [v.data for v in header.find("LASF_Projection", 2112)] == [b"hello"]
    assert header.vlrs[0].is_extended
    assert header.points_end == len(data)
    assert [w.code for w in header.warnings] == ["W_VLR_COUNT"]
