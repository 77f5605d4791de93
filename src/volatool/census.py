"""What passes by in one read of a tile: counts, boxes, heights, covered area."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from volatool.model import Bool, PointChunk, as_fraction

StoredBox = tuple[int, int, int, int, int, int]
"""Smallest x, y, z, then largest, as stored integers."""

_STORED = np.iinfo(np.int32)
_HEIGHT_BINS = 4096
_AREA_CELLS = 1 << 24


@dataclass(frozen=True, slots=True)
class HeightLimits:
    """
    Stored heights beyond which points stand alone.

    Parameters
    ----------
    low, high : int
        First and last height of the body of the tile (bins of the histogram, not points).
    n_points : int
        How many points lie outside.
    """

    low: int
    high: int
    n_points: int


class Census:
    """
    Counts over chunks, in any order.

    Parameters
    ----------
    box : tuple of 6 int
        Stored integers that the points are expected in; points outside are counted all the same,
        but fall into the outermost bins of heights and area.
    area_cell : tuple of 2 int
        Edges of the cells of covered area, in stored units of x and y; see `area_cell_for`.
    n_unread : int
        Points of the tile that are left out unread; they are taken to fill `box`.
    """

    def __init__(self, box: StoredBox, area_cell: tuple[int, int], n_unread: int = 0) -> None:
        self.n_read = 0
        self.n_unread = n_unread
        self.dropped: dict[str, int] = {"unread": n_unread}
        self._classes = np.zeros(256, np.int64)
        self._returns = np.zeros(256, np.int64)
        self._expected = box
        self._low = np.array(box[:3], np.int64)
        self._shift = max(0, int(box[5] - box[2]).bit_length() - 12)
        self._heights = np.zeros((2, _HEIGHT_BINS), np.int64)
        self._area_cell = area_cell
        columns = (box[3] - box[0]) // area_cell[0] + 1
        rows = (box[4] - box[1]) // area_cell[1] + 1
        self._covered = np.zeros((rows, columns), np.bool_)
        self._totals = np.zeros(2, np.int64)
        far = np.iinfo(np.int64)
        self._extremes = np.repeat([[far.max, far.min]] * 2, 3, axis=1)

    def add(self, chunk: PointChunk, mask: Bool | None) -> None:
        """
        Count a chunk.

        Parameters
        ----------
        chunk : PointChunk
            All points that were read.
        mask : (n,) array of bool or None
            Those that are used; None for all.
        """
        from volatool.kernels.census import count_points

        self.n_read += len(chunk)
        stored = (np.ascontiguousarray(axis, np.int32) for axis in (chunk.x, chunk.y, chunk.z))
        names = ("classification", "return_number")
        codes, numbers = (
            np.ascontiguousarray(chunk.attributes.get(name, ()), np.uint8) for name in names
        )
        count_points(
            *stored,
            np.ascontiguousarray(() if mask is None else mask, np.bool_),
            codes,
            numbers,
            self._low,
            np.array(self._area_cell, np.int64),
            self._shift,
            self._extremes,
            self._classes,
            self._returns,
            self._heights,
            self._covered,
            self._totals,
        )

    @property
    def n_used(self) -> int:
        """Points that are used."""
        return int(self._totals[0])

    @property
    def n_first(self) -> int:
        """First returns among the points used, and those that don't tell."""
        return int(self._totals[1])

    @property
    def box(self) -> StoredBox | None:
        """Box of all points read; of those unread it is the expected one."""
        if self.n_unread:
            low, high = np.reshape(self._expected, (2, 3))
            found = self._extremes[0].reshape(2, 3)
            return _box(np.concatenate([np.minimum(low, found[0]), np.maximum(high, found[1])]))
        return _box(self._extremes[0]) if self.n_read else None

    @property
    def box_used(self) -> StoredBox | None:
        """Box of the points used."""
        return _box(self._extremes[1]) if self.n_used else None

    @property
    def classes(self) -> dict[str, int]:
        """Points read per class code."""
        return {str(code): int(self._classes[code]) for code in np.flatnonzero(self._classes)}

    @property
    def returns(self) -> dict[str, int]:
        """Points read per return number."""
        return {str(code): int(self._returns[code]) for code in np.flatnonzero(self._returns)}

    def covered_area(self, scale: tuple[float, float, float]) -> float:
        """Return the area of the cells that hold a used point, in square units of the CRS."""
        width, height = (self._area_cell[axis] * scale[axis] for axis in (0, 1))
        return float(np.count_nonzero(self._covered) * width * height)

    def isolated(self, of_used: bool = False) -> HeightLimits | None:
        """
        Find points that stand alone far above or below the rest.

        Parameters
        ----------
        of_used : bool
            Look at the points used only, not at all points read.

        Returns
        -------
        limits : HeightLimits or None
            None when there are no such points.

        Notes
        -----
        A tail is isolated when at most 0.1 % of the points (one point, if fewer than 1,000 of at
        least 50) lie in it and an empty gap parts it
        from the rest that is at least as high as the middle 99 % of the points and 16 bins.
        Heights are counted in up to 4096 bins over the expected box.
        """
        counts = self._heights[int(of_used)]
        total = int(counts.sum())
        filled = np.flatnonzero(counts)
        if len(filled) < 2:
            return None
        few = max(1.0, total * 0.001) if total >= 50 else 0.0
        below = np.cumsum(counts)
        body = [int(np.searchsorted(below, total * share)) for share in (0.005, 0.995)]
        gap = max(16, body[1] - body[0])
        first, last = int(filled[0]), int(filled[-1])
        for left, right in itertools.pairwise(filled):
            if right - left > gap:
                if below[left] <= few:
                    first = int(right)
                elif total - below[left] <= few:
                    last = int(left)
                    break
        outside = total - int(counts[first : last + 1].sum())
        if not outside:
            return None
        low = self._expected[2] + (first << self._shift)
        high = self._expected[2] + ((last + 1) << self._shift) - 1
        # the outermost bins also hold what lies beyond the expected box
        low = _STORED.min if first == filled[0] else low
        high = _STORED.max if last == filled[-1] else high
        return HeightLimits(low, high, outside)

    def to_dict(self, scale: tuple[float, float, float]) -> dict[str, Any]:
        """Return the counts of the report's ``input`` object."""
        box = self.box
        area = 0.0 if box is None else (box[3] - box[0]) * scale[0] * (box[4] - box[1]) * scale[1]
        covered = self.covered_area(scale)
        return {
            "points_read": self.n_read,
            "points_used": self.n_used,
            "dropped": {reason: n for reason, n in self.dropped.items() if n},
            "classes": self.classes,
            "returns": self.returns,
            "density": {
                "all_per_area_bbox": (self.n_read + self.n_unread) / area if area else None,
                "all_per_area_occupied": self.n_used / covered if covered else None,
                "first_per_area_occupied": self.n_first / covered if covered else None,
                "occupied_cell": self._area_cell[0] * scale[0],
            },
        }


def _box(extremes: NDArray[np.int64]) -> StoredBox:
    x0, y0, z0, x1, y1, z1 = (int(value) for value in extremes)
    return (x0, y0, z0, x1, y1, z1)


def area_cell_for(
    box: StoredBox, scale: tuple[float, float, float], metres_per_unit: Fraction | None
) -> tuple[int, int]:
    """
    Return the edges of the cells that covered area is counted in.

    Parameters
    ----------
    box : tuple of 6 int
        Stored integers that the points are expected in.
    scale : tuple of 3 float
        Of the stored integers.
    metres_per_unit : Fraction or None
        Length of the CRS unit; None counts as 1 m.

    Returns
    -------
    edges : tuple of 2 int
        In stored units of x and y: 10 m, or a hundredth of the box where that is shorter, longer
        where there would be more than 16 million cells.
    """
    edge = Fraction(10) / (metres_per_unit or 1)
    extents = [(box[3 + axis] - box[axis]) * as_fraction(scale[axis]) for axis in (0, 1)]
    longest = max(extents)
    if longest:
        edge = min(edge, longest / 100)
    while (extents[0] / edge + 1) * (extents[1] / edge + 1) > _AREA_CELLS:
        edge *= 2
    x, y = (max(1, round(edge / as_fraction(scale[axis]))) for axis in (0, 1))
    return x, y


def header_box(
    box: tuple[float, ...],
    scale: tuple[float, float, float],
    offset: tuple[float, float, float],
) -> StoredBox | None:
    """
    Return a header's box as stored integers, or None if it can't be one.

    Parameters
    ----------
    box : tuple of 6 float
        Smallest x, y, z, then largest.
    scale, offset : tuple of 3 float
        Of the stored integers.
    """
    if not all(np.isfinite(box)):
        return None
    stored = [
        round((as_fraction(value) - as_fraction(offset[i % 3])) / as_fraction(scale[i % 3]))
        for i, value in enumerate(box)
    ]
    fits = all(-(2**31) <= value < 2**31 for value in stored)
    if not fits or any(stored[axis] > stored[3 + axis] for axis in range(3)):
        return None
    return (stored[0], stored[1], stored[2], stored[3], stored[4], stored[5])


def box_corners(
    box: StoredBox,
    scale: tuple[float, float, float],
    offset: tuple[float, float, float],
    z_ratio: Fraction = Fraction(1),
) -> list[Fraction]:
    """
    Return the exact coordinates of a stored box.

    Parameters
    ----------
    box : tuple of 6 int
        Stored integers.
    scale, offset : tuple of 3 float
        Of the stored integers.
    z_ratio : Fraction
        Horizontal units per vertical unit, to have z in the horizontal unit.

    Returns
    -------
    corners : list of 6 Fraction
        Smallest x, y, z, then largest.
    """
    ratios = (Fraction(1), Fraction(1), z_ratio)
    return [
        (value * as_fraction(scale[i % 3]) + as_fraction(offset[i % 3])) * ratios[i % 3]
        for i, value in enumerate(box)
    ]
