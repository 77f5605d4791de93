"""Where a voxel is: the cubic extent of a volume and the exact way from points to cells."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from fractions import Fraction

import numpy as np

from volatool.errors import OptionError, ResourceError
from volatool.model import F64, I32, I64, U64, as_fraction

MAX_DEPTH = 10
"""Deepest level: 6 bits a level of a 64-bit path key, 4**10 cells a side."""

OUTSIDE = np.uint64(2**64 - 1)
"""Path key of a point outside the cube; no cell has it."""


@dataclass(frozen=True, slots=True)
class Cube:
    """
    The cubic extent that a volume divides 4 x 4 x 4, level after level.

    Parameters
    ----------
    origin : tuple of 3 float
        Minimum corner, in the horizontal unit of the CRS on all three axes.
    side : float
        Edge, same unit. Zero for a single place.
    is_snapped : bool
        The corner is a multiple of the side on every axis, so that neighbours mesh.
    exact : tuple of 4 Fraction, optional
        Corner and side as exact rationals; by default the decimal numbers that the floats print as.
    """

    origin: tuple[float, float, float]
    side: float
    is_snapped: bool = False
    exact: tuple[Fraction, Fraction, Fraction, Fraction] = field(default=(), repr=False)  # type: ignore[assignment]

    def __post_init__(self) -> None:
        if not all(map(math.isfinite, (*self.origin, self.side))) or self.side < 0:
            raise OptionError(f"a cube needs a finite corner and a side >= 0, got {self}")
        if not self.exact:
            exact = tuple(as_fraction(value) for value in (*self.origin, self.side))
            object.__setattr__(self, "exact", exact)

    @classmethod
    def from_exact(
        cls, origin: Sequence[Fraction], side: Fraction, is_snapped: bool = False
    ) -> Cube:
        """Return the cube with this exact corner and side."""
        x, y, z = origin
        return cls((float(x), float(y), float(z)), float(side), is_snapped, (x, y, z, side))

    @classmethod
    def around(cls, box: Sequence[Fraction], side: Fraction | None = None) -> Cube:
        """
        Return the cube anchored at a box's minimum.

        Parameters
        ----------
        box : sequence of 6 Fraction
            Minimum x, y, z, then maximum, z in the horizontal unit.
        side : Fraction, optional
            Edge; the box's longest extent by default.

        Raises
        ------
        OptionError
            ``E_CUBE``: the side is shorter than the box.
        """
        extent = max(box[3 + axis] - box[axis] for axis in range(3))
        if side is not None and side < extent:
            raise OptionError(
                f"--cube {float(side):g} is shorter than the points' longest extent "
                f"{float(extent):g}; give a longer side, or --split to cut the tile into cubes",
                "E_CUBE",
            )
        return cls.from_exact(box[:3], extent if side is None else side)

    @classmethod
    def snapped(cls, box: Sequence[Fraction], side: Fraction | None = None) -> Cube:
        """
        Return the cube with its corner on multiples of its side that holds a box.

        Parameters
        ----------
        box : sequence of 6 Fraction
            Minimum x, y, z, then maximum, z in the horizontal unit.
        side : Fraction, optional
            Edge; by default the shortest of ... 1, 2, 5, 10, 20, 50 ... that holds the box.

        Raises
        ------
        OptionError
            ``E_CUBE``: no such cube holds the box (it crosses a multiple of every side).
        """
        extent = max(box[3 + axis] - box[axis] for axis in range(3))
        if side is None:
            exponent = math.floor(math.log10(extent)) if extent else 0
            candidates = [
                Fraction(10) ** power * digit
                for power in range(exponent, exponent + 9)
                for digit in (1, 2, 5)
            ]
        else:
            candidates = [side]
        for edge in candidates:
            if edge < extent:
                continue
            corner = [math.floor(box[axis] / edge) * edge for axis in range(3)]
            if all(box[3 + axis] <= corner[axis] + edge for axis in range(3)):
                return cls.from_exact(corner, edge, is_snapped=True)
        raise OptionError(
            "the points cross a border between snapped cubes"
            + (f" of side {float(side):g}" if side is not None else " of every side")
            + "; use --split LENGTH to write one volume per snapped cube, or leave out --snap",
            "E_CUBE",
        )

    def cell(self, depth: int) -> float:
        """Return the edge of a cell at level `depth` (1 is the coarsest)."""
        return float(self.exact[3] / 4**depth)

    def corners(self, voxels: I32, depth: int) -> F64:
        """
        Return the minimum corner of cells.

        Parameters
        ----------
        voxels : (n, 3) array of int32
            Cell indices x, y, z at level `depth`.
        depth : int
            The level.

        Returns
        -------
        corners : (n, 3) array of float64
            In the horizontal unit of the CRS, z too.
        """
        return np.asarray(self.origin) + np.asarray(voxels, np.float64) * self.cell(depth)


@dataclass(frozen=True, slots=True)
class Quantizer:
    """
    Exact map from stored integers to path keys of a cube's cells.

    The cell of a point on one axis is ``min(S - 1, floor(S (p - origin) / side))``, S = 4**depth,
    worked out on rationals: scale and offset count as the decimal numbers that they print as.

    Parameters
    ----------
    cube : Cube
        The extent.
    scale, offset : tuple of 3 float
        Of the stored integers.
    depth : int
        Level of the cells, 1 to 10.
    z_ratio : Fraction
        Horizontal units per vertical unit.

    Notes
    -----
    With ``num = stored * factor + shift`` and ``0 <= num <= length`` the cell is
    ``num * S // length``. Where these integers don't fit 64 bits (odd scales, feet against
    metres), the first stored integer of each cell is tabulated exactly instead, once.
    A cube of side 0 holds the points that are exactly at its corner and no others.
    `plan` is what the kernels take of it: see `volatool.kernels.quantize.path_keys`.
    """

    cube: Cube
    scale: tuple[float, float, float]
    offset: tuple[float, float, float]
    depth: int
    z_ratio: Fraction = Fraction(1)
    plan: tuple[bool, I64, F64] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if not 1 <= self.depth <= MAX_DEPTH:
            raise ResourceError(f"depth must be 1 to {MAX_DEPTH}, got {self.depth}", "E_SIZE")
        if not all(map(math.isfinite, (*self.scale, *self.offset))) or 0 in self.scale:
            raise OptionError(
                f"scale and offset must be finite, the scale not 0; got {self.scale}, {self.offset}"
            )
        axes = [self._affine(axis) for axis in range(3)]
        cells = 4**self.depth
        limit = 2**62 // cells
        is_affine = self.cube.exact[3] > 0 and all(
            length <= limit and abs(factor) <= 2**30 and abs(shift) <= limit
            for factor, shift, length in axes
        )
        if is_affine:
            table, lines = np.array(axes, np.int64), np.zeros((3, 2))
        else:
            table = np.stack([_first_stored(*axis, cells) for axis in axes])
            lines = np.array([_line(*axis, cells) for axis in axes])
        object.__setattr__(self, "plan", (is_affine, table, lines))

    def _affine(self, axis: int) -> tuple[int, int, int]:
        """Return (factor, shift, length) of an axis: num / length is the place in the cube."""
        ratio = self.z_ratio if axis == 2 else Fraction(1)
        side = self.cube.exact[3]
        slope = as_fraction(self.scale[axis]) * ratio
        intercept = as_fraction(self.offset[axis]) * ratio - self.cube.exact[axis]
        if side:
            slope, intercept = slope / side, intercept / side
        length = math.lcm(slope.denominator, intercept.denominator)
        return int(slope * length), int(intercept * length), length if side else 0

    def keys(self, x: I32, y: I32, z: I32) -> U64:
        """
        Return the path key of each point's cell.

        Parameters
        ----------
        x, y, z : (n,) arrays of int32
            Stored integers.

        Returns
        -------
        keys : (n,) array of uint64
            Six bits a level, root first, ``lx + 4 ly + 16 lz``; `OUTSIDE` for points not in the
            closed cube.
        """
        from volatool.kernels import quantize

        keys = np.empty(len(x), np.uint64)
        quantize.path_keys(x, y, z, *self.plan, self.depth, keys)
        return keys


def _line(factor: int, shift: int, length: int, cells: int) -> tuple[float, float]:
    """Return about how many cells a step is and the place of 0; only the speed hangs on it."""
    if length == 0:
        return math.copysign(1e-9, factor), 0.0
    bound = Fraction(10) ** 9
    slope = min(max(Fraction(factor * cells, length), -bound), bound)
    base = min(max(Fraction(shift * cells, length), -(bound**2)), bound**2)
    return float(slope) or math.copysign(1e-300, factor), float(base)


def _first_stored(factor: int, shift: int, length: int, cells: int) -> I64:
    """
    Return the smallest stored integer of each cell of an axis, then the first one beyond.

    For a negative `factor` the stored integers count with their sign changed.
    """
    factor = abs(factor)
    bound = 2**40  # far beyond int32 either way
    if length == 0:  # a single place: cell 0 or nothing
        first = [-(shift // factor)] + [-shift // factor + 1] * cells
    else:
        # stored * factor + shift >= k * length / cells, hence the ceiling of
        # (k length - shift cells) / (factor cells)
        step = factor * cells
        start = shift * cells
        first = [-((start - k * length) // step) for k in range(cells)]
        first.append((length - shift) // factor + 1)  # the last cell is closed
    return np.array([min(max(value, -bound), bound) for value in first], np.int64)
