"""The byte fields of a metadata word, what they are made from and how they are reduced.

====  =========  =================================================  =========
byte  name       value = byte x scale + offset                      reduction
====  =========  =================================================  =========
0     red        scale 256, or 1 when no colour reaches 256         mean
1     green      the same                                           mean
2     blue       the same                                           mean
3     height     0 at the lowest point used, 255 at the highest     mean
4     returns    number of returns of the pulse: 0 is 1, 255 is 7   mean
5     intensity  255 at the largest intensity                       mean
6     class      the class code                                     mode
7     present    always 1, so that no word is zero                  constant
====  =========  =================================================  =========

Means are over the points of the block, from exact integer sums, rounded half up and limited to
0 .. 255; the class is the most frequent one, the lowest code among equals. A channel that the file
lacks or that was not asked for is 0.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from volatool.channels import CHANNELS
from volatool.errors import OptionError
from volatool.model import I32, I64

ATTRIBUTES: Mapping[str, tuple[str, ...]] = {
    "rgb": ("red", "green", "blue"),
    "height": (),
    "returns": ("number_of_returns",),
    "intensity": ("intensity",),
    "class": ("classification",),
}
"""Attributes of a `PointChunk` that each channel is made from."""

_CONSTANT = {
    "byte": 7,
    "name": "present",
    "scale": 1.0,
    "offset": 0.0,
    "unit": "",
    "reduction": "constant",
}


def check_channels(channels: Iterable[str]) -> tuple[str, ...]:
    """
    Return channel names in their order in the word.

    Raises
    ------
    OptionError
        A name is not one of `CHANNELS`.
    """
    asked = list(channels)
    for name in asked:
        if name not in CHANNELS:
            raise OptionError(
                f"no metadata channel is called {name!r}; there are {', '.join(CHANNELS)}"
            )
    return tuple(name for name in CHANNELS if name in asked)


def channels_of(dimensions: Iterable[str]) -> tuple[str, ...]:
    """
    Return the channels that a file with these attributes can fill.

    Examples
    --------
    >>> channels_of({"intensity", "classification"})
    ('height', 'intensity', 'class')
    """
    have = set(dimensions)
    return tuple(name for name in CHANNELS if have.issuperset(ATTRIBUTES[name]))


def attributes_for(channels: Iterable[str]) -> frozenset[str]:
    """Return the attributes that the channels are made from."""
    return frozenset(name for channel in channels for name in ATTRIBUTES[channel])


@dataclass(slots=True)
class Ranges:
    """
    Extremes of the attributes of the points used; they fix the scaling of the bytes.

    Parameters
    ----------
    z_min, z_max : int or None
        Stored heights; None before the first point.
    colour_max, intensity_max : int
        Largest values.
    """

    z_min: int | None = None
    z_max: int | None = None
    colour_max: int = 0
    intensity_max: int = 0

    def add(self, z: I32, attributes: Mapping[str, NDArray[Any]]) -> None:
        """Take in points."""
        if not len(z):
            return
        low, high = int(z.min()), int(z.max())
        self.z_min = low if self.z_min is None else min(self.z_min, low)
        self.z_max = high if self.z_max is None else max(self.z_max, high)
        for name in ATTRIBUTES["rgb"]:
            if name in attributes:
                self.colour_max = max(self.colour_max, int(attributes[name].max()))
        if "intensity" in attributes:
            self.intensity_max = max(self.intensity_max, int(attributes["intensity"].max()))


@dataclass(frozen=True, slots=True)
class Scaling:
    """
    How sums become bytes.

    Parameters
    ----------
    table : (6, 3) array of int64
        Offset, numerator and denominator for bytes 0 to 5; numerator 0 where absent.
    has_class : bool
        Byte 6 is used.
    channels : tuple of dict
        The trailer's description of the bytes in use.
    """

    table: I64
    has_class: bool
    channels: tuple[dict[str, Any], ...]

    @classmethod
    def of(
        cls,
        channels: Iterable[str],
        ranges: Ranges,
        z_scale: float,
        z_offset: float,
        z_unit: str | None = None,
    ) -> Scaling:
        """
        Return the scaling for the points' extremes.

        Parameters
        ----------
        channels : iterable of str
            Those in use.
        ranges : Ranges
            Extremes.
        z_scale, z_offset : float
            From stored heights to the vertical unit.
        z_unit : str, optional
            Name of the vertical unit.
        """
        z_min, z_max = ranges.z_min or 0, ranges.z_max or 0
        colour = 256 if ranges.colour_max > 255 else 1
        rows: dict[str, tuple[int, int, int, float, float, str]] = {
            # byte = (mean - offset) num / den, and back: value = byte * scale + offset
            "rgb": (0, 1, colour, float(colour), 0.0, ""),
            "height": (
                z_min,
                255 if z_max > z_min else 0,
                max(z_max - z_min, 1),
                (z_max - z_min) * z_scale / 255,
                z_min * z_scale + z_offset,
                z_unit or "",
            ),
            "returns": (1, 255, 6, 6 / 255, 1.0, ""),
            "intensity": (
                0,
                255 if ranges.intensity_max else 0,
                max(ranges.intensity_max, 1),
                ranges.intensity_max / 255,
                0.0,
                "",
            ),
        }
        table = np.zeros((6, 3), np.int64)
        table[:, 2] = 1
        described: list[dict[str, Any]] = []

        def describe(byte: int, name: str, scale: float, offset: float, unit: str) -> None:
            reduction = "mode" if name == "class" else "mean"
            described.append(
                {
                    "byte": byte,
                    "name": name,
                    "scale": scale,
                    "offset": offset,
                    "unit": unit,
                    "reduction": reduction,
                }
            )

        places = {"rgb": (0, 1, 2), "height": (3,), "returns": (4,), "intensity": (5,)}
        names = ("red", "green", "blue", "height", "returns", "intensity")
        for channel in check_channels(channels):
            if channel == "class":
                describe(6, "class", 1.0, 0.0, "")
                continue
            offset, num, den, scale, zero, unit = rows[channel]
            for byte in places[channel]:
                table[byte] = (offset, num, den)
                describe(byte, names[byte], scale, zero, unit)
        if described:
            described.append(dict(_CONSTANT))
        return cls(table, "class" in channels, tuple(described))
