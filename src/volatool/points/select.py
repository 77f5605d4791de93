"""Which points of a chunk are used: pure masks, and a count of what was left out and why."""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from volatool.errors import OptionError
from volatool.model import I32, Bool, Bounds, PointChunk, as_fraction
from volatool.points.header import LasHeader

if TYPE_CHECKING:
    from volatool.options import ConvertOptions

NOISE_CLASSES = frozenset({7, 18})
"""Low and high noise (ASPRS)."""


@dataclass(frozen=True, slots=True)
class Selection:
    """
    Rules that a point must pass to be used.

    Parameters
    ----------
    classes : frozenset of int or None
        Only these classes. Naming a noise class keeps it.
    exclude_classes : frozenset of int
        Not these.
    returns : {"all", "first", "last"}
        First: return number 1. Last: return number equal to the number of returns. Points with
        neither number (0 of 0) pass both, they are the only return there is.
    keep_withheld : bool
        Keep points with the withheld flag.
    keep_noise : bool
        Keep classes 7 and 18.
    bounds : Bounds or None
        Closed rectangle, tested exactly (as decimal numbers, not in floating point).
    thin : int
        Keep the points of the file whose number is a multiple of it.
    """

    classes: frozenset[int] | None = None
    exclude_classes: frozenset[int] = frozenset()
    returns: str = "all"
    keep_withheld: bool = False
    keep_noise: bool = False
    bounds: Bounds | None = None
    thin: int = 1

    def __post_init__(self) -> None:
        if self.returns not in ("all", "first", "last"):
            raise OptionError(f"returns must be first, last or all, got {self.returns!r}")
        if self.thin < 1:
            raise OptionError(f"thin must be at least 1, got {self.thin}")
        for code in (*(self.classes or ()), *self.exclude_classes):
            if not 0 <= code <= 255:
                raise OptionError(f"a class is a number from 0 to 255, got {code}")
        if self.bounds is not None and not all(
            math.isfinite(edge)
            for edge in (self.bounds.left, self.bounds.bottom, self.bounds.right, self.bounds.top)
        ):
            raise OptionError(f"bounds must be finite, got {self.bounds}")

    def attributes(self, header: LasHeader) -> set[str]:
        """Return the attributes that `mask` looks at, of those that the format has."""
        needed = set() if self.keep_withheld else {"withheld"}
        if self._dropped_classes() or self.classes is not None:
            needed.add("classification")
        if self.returns != "all":
            needed |= {"return_number", "number_of_returns"}
        return needed & header.dimensions

    def mask(self, chunk: PointChunk, dropped: dict[str, int]) -> Bool | None:
        """
        Return which points pass.

        Parameters
        ----------
        chunk : PointChunk
            With the attributes that `attributes` names.
        dropped : dict of str to int
            Counts by reason are added here: ``"withheld"``, ``"noise"``, ``"class"``, ``"return"``,
            ``"bounds"``, ``"thin"``; a point counts for the first reason in this order.

        Returns
        -------
        mask : (n,) array of bool, or None
            None when all pass.
        """
        mask: Bool | None = None
        for reason, bad in self._tests(chunk):
            if bad is None:
                continue
            fresh = bad if mask is None else bad & mask
            n_bad = int(np.count_nonzero(fresh))
            if n_bad:
                dropped[reason] = dropped.get(reason, 0) + n_bad
                mask = ~bad if mask is None else mask & ~bad
        return mask

    def _dropped_classes(self) -> frozenset[int]:
        named = self.classes or frozenset()
        noise = frozenset() if self.keep_noise else NOISE_CLASSES - named
        return noise | self.exclude_classes

    def _tests(self, chunk: PointChunk) -> list[tuple[str, Bool | None]]:
        """Return (reason, points that fail) in the order of the reasons."""
        values = chunk.attributes
        withheld = None if self.keep_withheld else values.get("withheld")
        noise = wrong_class = wrong_return = None
        codes = values.get("classification")
        if codes is not None:
            table = np.zeros((2, 256), np.bool_)
            for code in self._dropped_classes():
                table[0 if code in NOISE_CLASSES - self.exclude_classes else 1, code] = True
            if self.classes is not None:
                unnamed = [code for code in range(256) if code not in self.classes]
                table[1, unnamed] = True
            noise, wrong_class = (row[codes] if row.any() else None for row in table)
        if self.returns != "all" and "return_number" in values:
            wrong_return = ~self._is_wanted_return(
                values["return_number"], values["number_of_returns"]
            )
        return [
            ("withheld", withheld),
            ("noise", noise),
            ("class", wrong_class),
            ("return", wrong_return),
            ("bounds", self._outside(chunk)),
            ("thin", self._thinned(chunk)),
        ]

    def _is_wanted_return(self, number: NDArray[Any], of: NDArray[Any]) -> Bool:
        if self.returns == "first":
            return number <= 1  # 0: not recorded
        wanted: Bool = (number == of) | (number == 0) | (of == 0)
        return wanted

    def _outside(self, chunk: PointChunk) -> Bool | None:
        if self.bounds is None:
            return None
        edges = self.bounds
        outside: Bool = np.zeros(len(chunk), np.bool_)
        for axis, stored, low, high in (
            (0, chunk.x, edges.left, edges.right),
            (1, chunk.y, edges.bottom, edges.top),
        ):
            first, last = stored_range(chunk.scale[axis], chunk.offset[axis], low, high)
            outside |= _not_between(stored, first, last)
        return outside

    def _thinned(self, chunk: PointChunk) -> Bool | None:
        if self.thin == 1:
            return None
        gone: Bool = np.ones(len(chunk), np.bool_)
        gone[-chunk.start % self.thin :: self.thin] = False
        return gone


def selection_for(options: ConvertOptions) -> Selection:
    """Return the rules that the options of a conversion ask for."""
    return Selection(
        classes=None if options.classes is None else frozenset(options.classes),
        exclude_classes=frozenset(options.exclude_classes or ()),
        returns=options.returns,
        keep_withheld=options.keep_withheld,
        keep_noise=options.keep_noise,
        bounds=options.bounds,
        thin=options.thin or 1,
    )


def stored_range(scale: float, offset: float, low: float, high: float) -> tuple[int, int]:
    """
    Return the stored integers whose coordinates lie in a closed interval, exactly.

    Parameters
    ----------
    scale, offset : float
        Of the axis; taken as the decimal numbers that they print as.
    low, high : float
        The interval, taken alike.

    Returns
    -------
    first, last : int
        Smallest and largest; first > last when there is none.

    Examples
    --------
    >>> stored_range(0.01, 0.0, 0.1, 0.3)  # 0.1 / 0.01 is no whole number in floating point
    (10, 30)
    """
    step: Fraction = as_fraction(scale)
    start: Fraction = as_fraction(offset)
    first = math.ceil((as_fraction(low) - start) / step)
    last = math.floor((as_fraction(high) - start) / step)
    return first, last


def _not_between(stored: I32, first: int, last: int) -> Bool:
    """Return which integers are outside [first, last], of which either may exceed 32 bits."""
    if first > last or first > 2**31 - 1 or last < -(2**31):
        return np.ones(len(stored), np.bool_)
    low, high = np.int32(max(first, -(2**31))), np.int32(min(last, 2**31 - 1))
    outside: Bool = (stored < low) | (stored > high)
    return outside
