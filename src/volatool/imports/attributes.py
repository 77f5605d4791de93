"""Numbers of other formats to attributes of a `PointChunk`: ranges checked, fractions scaled."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from volatool.errors import CodedWarning, FormatError
from volatool.imports.model import ATTRIBUTES, Batch

UNIT_SCALE = {"red": 255, "green": 255, "blue": 255, "intensity": 65535}
"""What 1 becomes where all values lie in 0 .. 1 and some are no whole numbers."""

_COLOURS = ("red", "green", "blue")


@dataclass(slots=True)
class AttributeSurvey:
    """
    What a first read tells of an attribute.

    Parameters
    ----------
    name : str
        Of `ATTRIBUTES`.
    high : float
        Largest value.
    has_fractions : bool
        Some values are no whole numbers.
    """

    name: str
    high: float = 0.0
    has_fractions: bool = False

    def add(self, values: NDArray[Any]) -> None:
        """Take in values."""
        if not len(values):
            return
        self.high = max(self.high, float(values.max()))
        if values.dtype.kind == "f" and not self.has_fractions:
            with np.errstate(invalid="ignore"):  # signalling NaNs
                self.has_fractions = bool(np.any(values != np.rint(values)))


def factors(surveys: dict[str, AttributeSurvey]) -> dict[str, int]:
    """
    Return what values are multiplied by, 1 for most.

    Parameters
    ----------
    surveys : dict of str to AttributeSurvey
        Of all attributes; the three colours share a factor.
    """
    found = {}
    for name in surveys:
        family = [surveys[n] for n in (_COLOURS if name in _COLOURS else (name,)) if n in surveys]
        is_unit = max(s.high for s in family) <= 1 and any(s.has_fractions for s in family)
        found[name] = UNIT_SCALE.get(name, 1) if is_unit else 1
    return found


def scaling_warnings(
    factor: dict[str, int], surveys: dict[str, AttributeSurvey]
) -> list[CodedWarning]:
    """Say which attributes are not taken as they are."""
    warnings = []
    scaled = [f"{name} x {value}" for name, value in factor.items() if value != 1]
    if scaled:
        text = f"fractions of 1 were scaled and rounded: {', '.join(scaled)}"
        warnings.append(CodedWarning("W_SCALED", text))
    rounded = [n for n in surveys if surveys[n].has_fractions and factor[n] == 1]
    if rounded:
        text = f"values that are no whole numbers were rounded: {', '.join(rounded)}"
        warnings.append(CodedWarning("W_SCALED", text))
    return warnings


def checked(batch: Batch, name: str, factor: int) -> NDArray[Any]:
    """
    Return an attribute of a batch in its own type.

    Parameters
    ----------
    batch : Batch
        Of points that are used.
    name : str
        Of `ATTRIBUTES`.
    factor : int
        Of `factors`.

    Raises
    ------
    FormatError
        ``E_RANGE``, with the line or point: a value below 0, too large, or NaN.
    """
    largest, dtype = ATTRIBUTES[name]
    raw = batch.attributes[name]
    if raw.dtype.kind in "ub" and np.iinfo(dtype).max == largest and raw.dtype.itemsize == 1:
        return raw.astype(dtype)
    values = raw
    if factor != 1 or raw.dtype.kind == "f":  # float32 can't tell the half steps
        with np.errstate(invalid="ignore", over="ignore"):
            values = np.floor(raw.astype(np.float64) * factor + 0.5)
    good = (values >= 0) & (values <= largest)
    if not good.all():
        row = int(np.flatnonzero(~good)[0])
        raise FormatError(
            f"{batch.where(batch.start + row)}: {name} is {raw[row]:g}, not in 0 to {largest}; "
            "--meta or, for text, --columns leaves it out",
            "E_RANGE",
        )
    return values.astype(dtype)
