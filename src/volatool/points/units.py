"""Lengths of units, exact, and the names that PROJ gives them."""

from __future__ import annotations

from fractions import Fraction

from volatool.model import as_fraction

METRE = ("metre", Fraction(1))
FOOT = ("foot", Fraction(3048, 10000))
US_SURVEY_FOOT = ("US survey foot", Fraction(1200, 3937))

_KNOWN = (METRE, FOOT, US_SURVEY_FOOT)

BY_EPSG: dict[int, tuple[str, Fraction]] = {
    9001: METRE,
    9002: FOOT,
    9003: US_SURVEY_FOOT,
    9005: ("Clarke's foot", Fraction("0.3047972654")),
    9036: ("kilometre", Fraction(1000)),
    9095: ("British foot (1936)", Fraction("0.3048007491")),
}
"""Unit codes that GeoTIFF keys 3076 and 4099 use."""


def linear_unit(name: str, factor: float) -> tuple[str, Fraction]:
    """
    Return a unit's name and its exact length in metres.

    Files give feet by many names and with few digits; the length decides. International and US
    survey feet differ by two parts in a million, so the tolerance is a tenth of that.

    Parameters
    ----------
    name : str
        As the CRS has it.
    factor : float
        Metres per unit.

    Returns
    -------
    name : str
        As PROJ writes it, if known.
    metres : Fraction
        Exact for known units, else the decimal number that the factor prints as.

    Examples
    --------
    >>> linear_unit("Foot_US", 0.3048006096012192)
    ('US survey foot', Fraction(1200, 3937))
    """
    for known, metres in _KNOWN:
        if abs(factor - float(metres)) <= 2e-7 * float(metres):
            return known, metres
    return name, as_fraction(factor)
