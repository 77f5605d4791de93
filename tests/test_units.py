"""Lengths and sizes as people write them."""

from fractions import Fraction

import pytest

from volatool.errors import OptionError
from volatool.units import Length, format_size, parse_size


@pytest.mark.parametrize(
    ("text", "unit_m", "expected"),
    [
        ("1m", Fraction(1), Fraction(1)),
        ("1m", Fraction(3048, 10000), Fraction(10000, 3048)),
        ("2 ftUS", Fraction(1200, 3937), Fraction(2)),
        ("0.5ft", Fraction(1), Fraction(1524, 10000)),
        (".5", None, Fraction(1, 2)),
        ("1e2cm", Fraction(1), Fraction(1)),
    ],
)
def test_a_length_is_exact_in_the_unit_of_the_crs(text, unit_m, expected):
    assert Length.parse(text).in_units(unit_m) == expected


@pytest.mark.parametrize(
    "text", ["", "0", "0m", "-1m", "1 mile", "m", "nan", "inf", "1m2", "1e400"]
)
def test_what_is_no_length_is_refused(text):
    with pytest.raises(OptionError, match="not a length"):
        Length.parse(text)


def test_a_length_with_a_unit_needs_a_crs_with_one():
    with pytest.raises(OptionError, match="no CRS"):
        Length.parse("1m").in_units(None)


@pytest.mark.parametrize(
    ("text", "expected"),
    [("1", 1), ("256M", 256 << 20), ("1GiB", 1 << 30), ("500kB", 500 << 10), ("1.5K", 1536)],
)
def test_sizes_count_by_1024(text, expected):
    assert parse_size(text) == expected


@pytest.mark.parametrize("text", ["", "M", "0", "-5M", "12 parsecs", "1e400"])
def test_what_is_no_size_is_refused(text):
    with pytest.raises(OptionError, match="not a size"):
        parse_size(text)


def test_sizes_for_people():
    assert [format_size(n) for n in (0, 1023, 1536, 5 << 40)] == [
        "0 B",
        "1023 B",
        "1.5 KiB",
        "5.0 TiB",
    ]
