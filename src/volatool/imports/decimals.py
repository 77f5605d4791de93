"""Integers for coordinates: the decimal scale and offset that keep them exact, or fine enough."""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from volatool.errors import FormatError
from volatool.model import F64, I32

MAX_DECIMALS = 15
"""Looked for in numbers."""

FINEST, COARSEST = 40, -9
"""Decimals of the scales that numbers without decimals get."""

_INT32 = 2**31 - 1
_EXACT = 2.0**52


@dataclass(frozen=True, slots=True)
class Axis:
    """
    How an axis is stored.

    Parameters
    ----------
    decimals : int
        The scale is ``10**-decimals``.
    offset : float
        A multiple of the scale.
    is_exact : bool
        Every coordinate is the decimal number that its stored integer stands for.
    """

    decimals: int
    offset: float
    is_exact: bool

    @property
    def scale(self) -> float:
        """``10**-decimals``, the float nearest to it."""
        return float(Fraction(10) ** -self.decimals)

    def stored(self, values: F64) -> I32:
        """Return the integers of coordinates."""
        moved = values - self.offset
        if self.decimals >= 0:
            moved *= 10.0**self.decimals
        else:
            moved /= 10.0**-self.decimals
        stored: I32 = np.rint(moved).astype(np.int32)
        return stored


class AxisSurvey:
    """Learns the range of an axis, and with how many decimals its values are written."""

    def __init__(self) -> None:
        self.low, self.high = math.inf, -math.inf
        self.decimals: int | None = 0

    def add(self, values: F64) -> None:
        """Take in finite values."""
        if not len(values):
            return
        self.low = min(self.low, float(values.min()))
        self.high = max(self.high, float(values.max()))
        open_values = values
        while self.decimals is not None:
            open_values = open_values[~_written_with(open_values, self.decimals)]
            if not len(open_values):
                return
            self.decimals = self.decimals + 1 if self.decimals < MAX_DECIMALS else None

    def axis(self, name: str) -> Axis:
        """
        Return the storage.

        Parameters
        ----------
        name : str
            Of the axis, for messages.

        Raises
        ------
        FormatError
            ``E_BAD_COORDINATE``: the values are too far apart for 32 bits.
        """
        if self.low > self.high:
            return Axis(3, 0.0, True)
        largest = max(abs(self.low), abs(self.high))
        # finer than the numbers themselves are, a box would not come back as it was stored
        finest = FINEST
        while finest > COARSEST and 10.0**-finest < 4 * float(np.spacing(largest)):
            finest -= 1
        if self.decimals is not None and self.decimals <= finest:
            offset = _offset(self.low, self.high, self.decimals)
            if offset is not None:
                return Axis(self.decimals, offset, True)
        for decimals in range(finest, COARSEST - 1, -1):
            offset = _offset(self.low, self.high, decimals)
            if offset is not None:
                return Axis(decimals, offset, False)
        raise FormatError(
            f"{name} goes from {self.low!r} to {self.high!r}, too far apart to be stored",
            "E_BAD_COORDINATE",
        )


def _written_with(values: F64, decimals: int) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Return which values are the floats nearest to a number with so many decimals."""
    power = 10.0**decimals
    with np.errstate(over="ignore"):
        whole = np.rint(values * power)
    # below 2**52 the division is of two exact floats and so rounds to the nearest one
    good: np.ndarray[tuple[int], np.dtype[np.bool_]] = (np.abs(whole) < _EXACT) & (
        whole / power == values
    )
    return good


def _offset(low: float, high: float, decimals: int) -> float | None:
    """Return an offset with which a range fits 32 bits: 0, or a multiple of a round step."""
    scale = Fraction(10) ** -decimals
    ends = Fraction(low), Fraction(high)
    if max(abs(end) for end in ends) / scale < _INT32:
        return 0.0
    middle = sum(ends) / 2
    for power in range(12, -decimals - 1, -1):
        step = Fraction(10) ** power
        offset = round(middle / step) * step
        if max(abs(end - offset) for end in ends) / scale < _INT32 - 1:
            return float(offset)
    return None
