"""From coordinates to places in units of a volume's cells, and back."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from volatool.errors import OptionError
from volatool.model import F64, I64, Bounds, as_fraction

if TYPE_CHECKING:
    from volatool.vola.volume import Volume

_ULPS = 4 * float(np.finfo(np.float64).eps)


@dataclass(frozen=True, slots=True)
class Frame:
    """
    Places in cells: cell k of an axis is [k, k + 1), the last one closed.

    Parameters
    ----------
    corner : (3,) array of float64
        Of the cube, in the horizontal unit.
    step : float
        Edge of a cell, in the horizontal unit; 0 for a cube of side 0, which is one place.
    shift : float
        Place of the corner: 0, or a half in volumes of the original toolkit, which rounds.
    size : int
        Cells an axis.
    z_ratio : float
        Horizontal units per vertical unit.
    """

    corner: F64
    step: float
    shift: float
    size: int
    z_ratio: float

    @classmethod
    def of(cls, volume: Volume) -> Frame:
        """Return the frame of a volume's deepest level."""
        size, side = 4**volume.depth, volume.cube.side
        is_rounded = volume.info.quantizer != "floor"
        return cls(
            corner=np.array(volume.cube.origin),
            step=side / (size - 1) if is_rounded else side / size,
            shift=0.5 if is_rounded else 0.0,
            size=size,
            z_ratio=float(volume.crs.z_ratio),
        )

    def places(self, xyz: ArrayLike, snap: float = 0.0) -> F64:
        """
        Return places.

        Parameters
        ----------
        xyz : (n, 3) array of float
            In units of the CRS, z in the vertical unit.
        snap : float
            What is within rounding error (4 units in the last place of the coordinate) of
            ``k + snap`` is on it: 0 for the faces of cells, a half for their middles.

        Returns
        -------
        places : (n, 3) array of float64
            In cells. Where the cube is one place: 0 there, else infinite.
        """
        points = np.array(xyz, np.float64).reshape(-1, 3)
        points[:, 2] *= self.z_ratio
        with np.errstate(all="ignore"):
            away = points - self.corner
            error = _ULPS * np.maximum(np.abs(points), np.abs(self.corner))
            if not self.step:
                return np.where(np.abs(away) <= error, 0.0, np.copysign(np.inf, away))
            places = away / self.step + self.shift
            near = np.rint(places - snap) + snap
            return np.where(np.abs(places - near) * self.step <= error, near, places)

    def directions(self, directions: ArrayLike) -> F64:
        """Return directions in cells: z counts in the horizontal unit, lengths don't matter."""
        scaled = np.array(directions, np.float64).reshape(-1, 3)
        scaled[:, 2] *= self.z_ratio
        return scaled

    def coordinates(self, places: ArrayLike) -> F64:
        """
        Return coordinates.

        Parameters
        ----------
        places : (n, 3) array of float
            In cells; ``k + 0.5`` is the middle of cell k.

        Returns
        -------
        xyz : (n, 3) array of float64
            In units of the CRS, z in the vertical unit.
        """
        away = (np.asarray(places, np.float64) - self.shift) * self.step
        xyz: F64 = away + self.corner
        xyz[..., 2] /= self.z_ratio
        return xyz

    def range_of(self, low: ArrayLike, high: ArrayLike, *, centres: bool) -> tuple[I64, I64]:
        """
        Return the cells of a box.

        Parameters
        ----------
        low, high : (3,) arrays of float
            Corners in units of the CRS, z in the vertical unit; infinity is no limit.
        centres : bool
            Cells whose centre lies in the half-open box; else those that a point of the closed
            box falls into.

        Returns
        -------
        first, last : (3,) arrays of int64
            Both inclusive, within the grid; ``first > last`` on an axis where there are none.
        """
        box = np.array([low, high], np.float64)
        low_place, high_place = self.places(box, snap=0.5 if centres else 0.0)
        if centres:
            first, last = np.ceil(low_place - 0.5), np.ceil(high_place - 0.5) - 1
        else:
            # the cube's far face belongs to the last cell
            first = np.where(low_place == self.size, self.size - 1, np.floor(low_place))
            last = np.floor(high_place)
        first, last = np.clip(first, 0, self.size), np.clip(last, -1, self.size - 1)
        return first.astype(np.int64), last.astype(np.int64)


def cells_meeting(
    volume: Volume,
    bounds: Bounds | Sequence[float] | None = None,
    z: tuple[float, float] | None = None,
) -> tuple[I64, I64]:
    """
    Return the cells that meet a closed box, worked out on exact rationals.

    Parameters
    ----------
    volume : Volume
        Whose deepest level is meant.
    bounds : Bounds or four float, optional
        Rectangle, in units of the CRS; may be infinite.
    z : tuple of 2 float, optional
        Lowest and highest, in the vertical unit; may be infinite.

    Returns
    -------
    first, last : (3,) arrays of int64
        Both inclusive, within the grid; ``first > last`` on an axis where there are none. Cells as
        `volatool.vola.algebra.crop` has them. `Frame.range_of` differs at the faces of cells: it
        forgives the rounding errors of coordinates, as look-ups of points do.

    Raises
    ------
    OptionError
        The bounds are no rectangle; the lowest z is above the highest, or one is not a number.
    """
    sides = sides_of(bounds, z)
    ranges = [_exact_range(volume, axis, *ends) for axis, ends in enumerate(sides)]
    first, last = np.array(ranges, np.int64).T.copy()
    return first, last


def sides_of(
    bounds: Bounds | Sequence[float] | None, z: tuple[float, float] | None
) -> tuple[tuple[float, float], tuple[float, float], tuple[float, float]]:
    """
    Return lowest and highest x, y and z of a box; infinite where nothing is given.

    Parameters
    ----------
    bounds : Bounds or four float, optional
        Rectangle.
    z : tuple of 2 float, optional
        Lowest and highest.

    Raises
    ------
    OptionError
        They are no such numbers, or the lowest is above the highest.
    """
    try:
        box = Bounds(-math.inf, -math.inf, math.inf, math.inf) if bounds is None else bounds
        if not isinstance(box, Bounds):
            box = Bounds(*map(float, box))
    except (TypeError, ValueError) as error:
        raise OptionError(f"bounds must be left, bottom, right, top; got {bounds!r}") from error
    try:
        low, high = (-math.inf, math.inf) if z is None else map(float, z)
    except (TypeError, ValueError) as error:
        raise OptionError(f"z must be lowest, highest; got {z!r}") from error
    if not low <= high:
        raise OptionError(f"z must be lowest, highest; got {low:g}, {high:g}")
    return (box.left, box.right), (box.bottom, box.top), (low, high)


def _exact_range(volume: Volume, axis: int, low: float, high: float) -> tuple[int, int]:
    """First and last cell of an axis that meet a closed interval; first > last if none does."""
    size = 4**volume.depth
    side = volume.cube.exact[3]
    ratio = volume.crs.z_ratio if axis == 2 else Fraction(1)

    def place(value: float) -> Fraction | None:
        """Place in the cube from 0 to 1; None if infinite."""
        if math.isinf(value):
            return None
        away = as_fraction(value) * ratio - volume.cube.exact[axis]
        return away / side if side else away

    start, stop = place(low), place(high)
    if (start is not None and start > (1 if side else 0)) or (stop is not None and stop < 0):
        return 0, -1
    if low == math.inf or high == -math.inf:
        return 0, -1
    if volume.info.quantizer == "floor":
        first = 0 if start is None else math.floor(start * size)
        last = size - 1 if stop is None else math.floor(stop * size)
    else:
        steps, half = size - 1, Fraction(1, 2)
        first = 0 if start is None else math.ceil(start * steps - half)
        last = size - 1 if stop is None else math.floor(stop * steps + half)
    if not side:  # one place, cell 0
        return 0, 0
    return max(min(first, size - 1), 0), min(last, size - 1)
