"""Small frozen values that several layers share: bounds, point chunks, CRS, level counts."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Progress: TypeAlias = Callable[[int, int], None]
"""Called with (done, total) in a unit that the caller knows: points, cells, bytes."""

U64: TypeAlias = NDArray[np.uint64]
F64: TypeAlias = NDArray[np.float64]
I32: TypeAlias = NDArray[np.int32]
I64: TypeAlias = NDArray[np.int64]
Bool: TypeAlias = NDArray[np.bool_]


def no_progress(done: int, total: int) -> None:
    """Tell nobody."""


def as_fraction(value: float | Fraction | int) -> Fraction:
    """
    Return the rational that a float's shortest decimal form says: 0.01 is 1/100.

    Examples
    --------
    >>> as_fraction(0.01)
    Fraction(1, 100)
    """
    return value if isinstance(value, Fraction) else Fraction(repr(float(value)))


@dataclass(frozen=True, slots=True)
class Bounds:
    """
    Horizontal rectangle, (left, bottom, right, top), in units of the CRS.

    Parameters
    ----------
    left, bottom, right, top : float
        Closed on all sides.
    """

    left: float
    bottom: float
    right: float
    top: float

    def __post_init__(self) -> None:
        if not (self.left <= self.right and self.bottom <= self.top):  # also refuses NaN
            raise ValueError(f"bounds must be left <= right and bottom <= top, got {self}")


@dataclass(frozen=True, slots=True)
class CrsInfo:
    """
    What is known of a coordinate reference system and of the unit of each axis.

    Parameters
    ----------
    wkt2 : str or None
        WKT2:2019, compound when the vertical part is known; None without a CRS.
    horizontal, vertical : str or None
        ``"EPSG:2994"`` when an authority code is known, else the name, else None.
    epsg : int or None
        Horizontal EPSG code, for the VOLA header.
    unit_xy, unit_z : str or None
        Names as PROJ gives them: ``"metre"``, ``"foot"``, ``"US survey foot"``, ``"degree"``.
    metres_per_unit_xy, metres_per_unit_z : Fraction or None
        Exact length of the units; None if unknown (or an angle).
    is_geographic : bool
        Horizontal axes are angles.
    source : str
        ``"wkt"``, ``"geotiff"``, ``"override"``, ``"default"``, ``"to-crs"`` or ``"none"``.
    """

    wkt2: str | None = None
    horizontal: str | None = None
    vertical: str | None = None
    epsg: int | None = None
    unit_xy: str | None = None
    unit_z: str | None = None
    metres_per_unit_xy: Fraction | None = None
    metres_per_unit_z: Fraction | None = None
    is_geographic: bool = False
    source: str = "none"

    @property
    def z_ratio(self) -> Fraction:
        """Horizontal units per vertical unit; 1 when either is unknown."""
        if self.metres_per_unit_xy is None or self.metres_per_unit_z is None:
            return Fraction(1)
        return self.metres_per_unit_z / self.metres_per_unit_xy

    def to_dict(self) -> dict[str, Any]:
        """Return the ``crs`` object of the report."""
        return {
            "wkt2": self.wkt2,
            "horizontal": self.horizontal,
            "vertical": self.vertical,
            "unit_xy": self.unit_xy,
            "unit_z": self.unit_z,
            "source": self.source,
        }


@dataclass(frozen=True, slots=True)
class PointChunk:
    """
    Consecutive points of a file as they are stored.

    Parameters
    ----------
    start : int
        Number of the first point in the file, from 0.
    x, y, z : (n,) arrays of int32, C-contiguous
        Stored integers; a coordinate is ``stored * scale + offset``.
    scale, offset : tuple of 3 float
        Of x, y, z, as the header (or the reprojection) gives them.
    attributes : mapping of str to (n,) array
        Those that were asked for and exist, by these names: ``classification`` uint8 (the code
        alone), ``return_number``, ``number_of_returns`` uint8, ``intensity``, ``red``, ``green``,
        ``blue`` uint16, ``withheld``, ``synthetic``, ``key_point`` bool.
    """

    start: int
    x: I32
    y: I32
    z: I32
    scale: tuple[float, float, float]
    offset: tuple[float, float, float]
    attributes: Mapping[str, NDArray[Any]] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.x)

    def xyz(self) -> F64:
        """
        Return the coordinates.

        Returns
        -------
        xyz : (n, 3) array of float64
            In units of the CRS, axis by axis.
        """
        columns = zip((self.x, self.y, self.z), self.scale, self.offset, strict=True)
        return np.column_stack([stored * scale + offset for stored, scale, offset in columns])

    def take(self, chosen: Bool | I64 | slice) -> PointChunk:
        """Return the points that a mask, indices or a slice choose (``start`` is kept)."""
        return PointChunk(
            self.start,
            self.x[chosen],
            self.y[chosen],
            self.z[chosen],
            self.scale,
            self.offset,
            {name: values[chosen] for name, values in self.attributes.items()},
        )


@dataclass(frozen=True, slots=True)
class LevelCounts:
    """
    Exact counts of one level of a volume, or of the same level summed over volumes.

    Parameters
    ----------
    blocks : int
        Stored blocks (words) of the level.
    histogram : (65,) array of int64
        How many of them have 0, 1, ... 64 cells set.
    contiguous_pairs : int
        Face-sharing pairs of set cells inside blocks, summed over blocks (at most 144 each).
    """

    blocks: int
    histogram: I64
    contiguous_pairs: int

    @property
    def voxels(self) -> int:
        """Cells set: the blocks of the next level."""
        return int(np.dot(self.histogram, np.arange(65)))

    def __add__(self, other: LevelCounts) -> LevelCounts:
        return LevelCounts(
            self.blocks + other.blocks,
            self.histogram + other.histogram,
            self.contiguous_pairs + other.contiguous_pairs,
        )
