"""Lengths and sizes as people write them: ``1m``, ``0.5ft``, ``256M``."""

from __future__ import annotations

import re
from dataclasses import dataclass
from decimal import Decimal
from fractions import Fraction

from volatool.errors import OptionError

METRES_PER_UNIT: dict[str, Fraction] = {
    "mm": Fraction(1, 1000),
    "cm": Fraction(1, 100),
    "m": Fraction(1),
    "km": Fraction(1000),
    "ft": Fraction(3048, 10000),
    "ftUS": Fraction(1200, 3937),
    "in": Fraction(254, 10000),
}
"""Exact length of each unit that may follow a number; ``ft`` is the international foot."""

_LONGEST = Fraction(10) ** 15  # what is longer is a slip, and more than a float has digits for
_NUMBER = r"([0-9]+(?:\.[0-9]*)?(?:[eE][-+]?[0-9]+)?|\.[0-9]+)"
_LENGTH = re.compile(rf"{_NUMBER}\s*({'|'.join(METRES_PER_UNIT)})?")
_SIZE = re.compile(rf"{_NUMBER}\s*([kKMGT]?)(i?)B?")
_POWERS = {"": 0, "K": 1, "M": 2, "G": 3, "T": 4}


@dataclass(frozen=True, slots=True)
class Length:
    """
    A length with the unit it was given in.

    Parameters
    ----------
    value : Fraction
        The number.
    unit : str or None
        A key of `METRES_PER_UNIT`; None means the horizontal unit of the CRS.
    """

    value: Fraction
    unit: str | None = None

    @classmethod
    def parse(cls, text: str | float | Length, *, or_zero: bool = False) -> Length:
        """
        Return a length from text such as ``"1m"``, ``"0.5 ft"`` or ``"2.5"``.

        Parameters
        ----------
        text : str, float or Length
            With a unit or without.
        or_zero : bool
            0 is a length too.

        Raises
        ------
        OptionError
            If it is not a number greater than zero with a known unit or none.

        Examples
        --------
        >>> Length.parse("0.5ft")
        Length(value=Fraction(1, 2), unit='ft')
        """
        if isinstance(text, Length):
            return text
        text = str(text).strip()
        match = _LENGTH.fullmatch(text)
        if match is not None and or_zero and not Fraction(match[1]):
            return cls(Fraction(0), match[2])
        if match is None or not 0 < Fraction(match[1]) <= _LONGEST:
            raise OptionError(
                f"{text!r} is not a length: give a number greater than 0 and, if need be, "
                f"one of the units {', '.join(METRES_PER_UNIT)}"
            )
        return cls(Fraction(match[1]), match[2])

    def in_units(self, metres_per_unit: Fraction | None) -> Fraction:
        """
        Return the length in the unit of a CRS.

        Parameters
        ----------
        metres_per_unit : Fraction or None
            Length of the CRS unit; None when it is unknown.

        Raises
        ------
        OptionError
            If the length has a unit and the CRS has none.
        """
        if self.unit is None:
            return self.value
        if metres_per_unit is None:
            raise OptionError(
                f"{self}: the file has no CRS, so its unit is unknown; "
                "give a bare number in file units, or the CRS with --crs"
            )
        return self.value * METRES_PER_UNIT[self.unit] / metres_per_unit

    def __str__(self) -> str:
        number = Decimal(self.value.numerator) / Decimal(self.value.denominator)
        return f"{number:f}{self.unit or ''}"


def parse_size(text: str | int) -> int:
    """
    Return bytes from text such as ``"256M"`` (1024-based) or ``"500kB"``.

    Raises
    ------
    OptionError
        If it is not a size greater than zero.

    Examples
    --------
    >>> parse_size("256M"), parse_size("1.5KiB")
    (268435456, 1536)
    """
    match = _SIZE.fullmatch(str(text).strip())
    if match is None or not 0 < Fraction(match[1]) <= _LONGEST:
        raise OptionError(f"{text!r} is not a size: give bytes, or a number with K, M, G or T")
    return int(Fraction(match[1]) * 1024 ** _POWERS[match[2].upper()])


def format_quantity(value: float) -> str:
    """
    Return an area or volume for people: six digits, but no power of ten where it is large.

    Examples
    --------
    >>> format_quantity(80952.2094), format_quantity(1765396.4), format_quantity(4.5e-13)
    ('80,952.2', '1,765,396', '4.5e-13')
    """
    return f"{value:,.0f}" if abs(value) >= 1e5 else f"{value:,.6g}"


def format_size(n_bytes: int) -> str:
    """
    Return a size for people, 1024-based.

    Examples
    --------
    >>> format_size(268435456)
    '256.0 MiB'
    """
    value, unit = float(n_bytes), "B"
    for unit in ("B", "KiB", "MiB", "GiB", "TiB"):
        if value < 1024 or unit == "TiB":
            break
        value /= 1024
    return f"{value:.0f} {unit}" if unit == "B" else f"{value:.1f} {unit}"
