"""The 80 bytes."""

from __future__ import annotations

import contextlib
import struct

import making_volumes as making
import naive_formats as naive
import pytest
from hypothesis import given
from hypothesis import strategies as st

from volatool.errors import FormatError, OptionError, ResourceError, TruncatedError, VolatoolError
from volatool.formats.header import Header

BOX = (1.0, 2.0, 3.0, 4.5, 5.0, 6.0)
GOOD = naive.header(0, 3, 1, BOX, 2994)


def patched(offset: int, layout: str, *values: float) -> bytes:
    data = bytearray(GOOD)
    struct.pack_into(layout, data, offset, *values)
    return bytes(data)


def test_bytes_and_back() -> None:
    """What is read is what is written."""
    header = Header.from_bytes(GOOD)
    assert (header.mode, header.depth, header.nbits, header.crs, header.box) == (0, 3, 1, 2994, BOX)
    assert header.to_bytes() == GOOD
    assert header.side == 3.5
    assert header.cube().origin == BOX[:3]


@pytest.mark.parametrize(
    ("data", "error", "code", "match"),
    [
        (b"", FormatError, "E_NOT_VOLA", "it is empty"),
        (b"LASF\1\2", FormatError, "E_NOT_VOLA", "LAS or LAZ file: convert it first"),
        (b"<!DOCTYPE html>", FormatError, "E_NOT_VOLA", "HTML"),
        (b"\x1f\x8b\x08", FormatError, "E_NOT_VOLA", "gzip inside gzip"),
        (b"\0" * 80, FormatError, "E_NOT_VOLA", "expected a header size of 80"),
        (patched(0, "<I", 96), FormatError, "E_NOT_VOLA", "expected a header size of 80"),
        (patched(4, "<H", 77), FormatError, "E_NOT_VOLA", "version is 77, expected 1"),
        (patched(0, ">I", 80), FormatError, "E_NOT_VOLA", "big-endian"),
        (patched(6, "<B", 9), FormatError, "E_CORRUPT", r"mode is 9.*offset 6"),
        (patched(7, "<B", 0), FormatError, "E_CORRUPT", r"depth is 0.*offset 7"),
        (patched(7, "<B", 16), ResourceError, "E_SIZE", r"depth is 16.*offset 7"),
        (patched(8, "<I", 2), FormatError, "E_CORRUPT", r"nbits is 2.*offset 8"),
        (patched(32, "<d", float("nan")), FormatError, "E_CORRUPT", r"not finite.*offset 32"),
        (patched(56, "<d", float("inf")), FormatError, "E_CORRUPT", "not finite"),
        (patched(64, "<d", 1.0), FormatError, "E_CORRUPT", "maximum below its minimum"),
        (
            patched(32, "<6d", -1.7e308, 0, 0, 1.7e308, 1, 1),
            FormatError,
            "E_CORRUPT",
            "too large for a float64",
        ),
        (GOOD[:79], TruncatedError, "E_TRUNCATED", r"ends inside the header.*offset 79"),
        (GOOD[:3], TruncatedError, "E_TRUNCATED", "offset 3"),
    ],
)
def test_bad_headers_are_refused(data, error, code, match) -> None:
    """Each with its code and offset."""
    with pytest.raises(error, match=match) as caught:
        Header.from_bytes(data)
    assert caught.value.code == code


@given(st.binary(max_size=100), st.booleans())
def test_any_bytes_are_a_header_or_one_error(data: bytes, starts_well: bool) -> None:
    """Nothing but a VolatoolError comes out."""
    with contextlib.suppress(VolatoolError):
        Header.from_bytes(GOOD[:6] + data if starts_well else data)


def test_lat_and_lon_are_only_information() -> None:
    """NaN and infinity are read, unknown places are None, and none is written but finite ones."""
    header = Header.from_bytes(patched(16, "<2d", float("nan"), float("inf")))
    assert header.place == (None, None)
    assert Header.from_bytes(patched(16, "<2d", 44.0, -123.0)).place == (44.0, -123.0)
    assert Header.from_bytes(patched(12, "<I2d", 2000, 44.0, -123.0)).place == (None, None)
    assert Header.of(making.random_volume(2, 9), 0).lat == 44.0


def test_the_box_written_is_the_cube() -> None:
    """So that the original toolkit places the cells right (its own writer stores the tight box)."""
    header = Header.of(making.random_volume(2, 9), 1)
    x, y, z = making.CUBE.origin
    assert header.box == (x, y, z, x + 10.01, y + 10.01, z + 10.01)
    assert header.mode == 1


def test_an_epsg_code_that_does_not_fit_is_refused() -> None:
    """The header has 32 bits for it."""
    header = Header(0, 1, 0, 2**32, 0.0, 0.0, BOX)
    with pytest.raises(OptionError, match="can't hold EPSG code") as caught:
        header.to_bytes()
    assert caught.value.code == "E_CRS"
