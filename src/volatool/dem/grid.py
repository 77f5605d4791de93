"""Where a raster cell is: grids snapped to multiples of the cell, so that neighbours mesh."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from volatool.errors import OptionError, ResourceError
from volatool.model import F64, Bounds, as_fraction

MAX_CELLS = 1 << 28
"""More cells than this are refused before anything is allocated."""


@dataclass(frozen=True, slots=True)
class Grid:
    """
    A raster of square cells; row 0 is the top (north).

    A cell holds its left and top edge, a point on a shared edge belongs to the cell right of or
    below it; points on the grid's own right and bottom edge belong to the last column and row.

    Parameters
    ----------
    left, top : float
        Corner, in units of the CRS.
    cell : float
        Edge of a cell.
    width, height : int
        Columns and rows.
    exact : tuple of 3 Fraction, optional
        left, top and cell as exact rationals; by default the decimals the floats print as.
    """

    left: float
    top: float
    cell: float
    width: int
    height: int
    exact: tuple[Fraction, Fraction, Fraction] = field(default=(), repr=False)  # type: ignore[assignment]

    def __post_init__(self) -> None:
        if not (math.isfinite(self.left) and math.isfinite(self.top)):
            raise OptionError(f"a grid needs a finite corner, got {self.left}, {self.top}")
        if not (math.isfinite(self.cell) and self.cell > 0):
            raise OptionError(f"a cell must be greater than zero, got {self.cell}")
        if self.width < 1 or self.height < 1:
            raise OptionError(f"a grid needs cells, got {self.width} x {self.height}")
        if not self.exact:
            exact = tuple(as_fraction(value) for value in (self.left, self.top, self.cell))
            object.__setattr__(self, "exact", exact)

    @property
    def bounds(self) -> Bounds:
        """Outer edges."""
        left, top, cell = self.exact
        right, bottom = left + cell * self.width, top - cell * self.height
        return Bounds(self.left, float(bottom), float(right), self.top)

    @property
    def transform(self) -> tuple[float, float, float, float, float, float]:
        """Affine coefficients a, b, c, d, e, f of (col, row) to (x, y)."""
        return (self.cell, 0.0, self.left, 0.0, -self.cell, self.top)

    def padded(self, cells: int) -> Grid:
        """Return the grid with so many more cells on every side."""
        left, top, cell = self.exact
        return _exact_grid(
            left - cells * cell,
            top + cells * cell,
            cell,
            self.width + 2 * cells,
            self.height + 2 * cells,
        )

    def places(
        self,
        rows: NDArray[np.int32],
        scale: tuple[float, float, float],
        offset: tuple[float, float, float],
    ) -> tuple[F64, F64]:
        """
        Return where points are, in cells from the top left corner.

        Parameters
        ----------
        rows : (n, 3) array of int32
            Stored x, y, z.
        scale, offset : tuple of 3 float
            Of the stored integers.

        Returns
        -------
        col, row : (n,) arrays of float64
            Their floor is the point's cell, exactly: worked out on integers, so that neighbours
            with other offsets agree.
        """
        from volatool.kernels import binning

        col, row = np.empty(len(rows)), np.empty(len(rows))
        binning.places(rows, self.lattice(scale, offset), col, row)
        return col, row

    def lattice(
        self, scale: tuple[float, float, float], offset: tuple[float, float, float]
    ) -> NDArray[np.int64]:
        """
        Return the integers that `volatool.kernels.binning.places` places stored points by.

        Parameters
        ----------
        scale, offset : tuple of 3 float
            Of the stored integers.

        Returns
        -------
        lattice : (2, 4) array of int64
            zero, factor, shift, length of the columns and the rows.
        """
        return _lattice(self.exact, self.width, self.height, tuple(scale[:2]), tuple(offset[:2]))


@functools.lru_cache(maxsize=16)
def _lattice(
    exact: tuple[Fraction, Fraction, Fraction],
    width: int,
    height: int,
    scale: tuple[float, ...],
    offset: tuple[float, ...],
) -> NDArray[np.int64]:
    left, top, cell = exact
    axes = []
    for axis, (origin, sign, n) in enumerate(((left, 1, width), (top, -1, height))):
        slope = sign * as_fraction(scale[axis]) / cell
        intercept = sign * (as_fraction(offset[axis]) - origin) / cell
        axes.append(_integers(slope, intercept, n))
    return np.array(axes, np.int64)


def _integers(slope: Fraction, intercept: Fraction, n: int) -> tuple[int, int, int, int]:
    """
    Return (zero, factor, shift, length) for `binning.places`.

    Counted from the stored integer nearest to the grid's edge, numbers stay small: within the
    grid and as far again on both sides all is exact if the common denominator allows, else
    rounded to a fixed point of at least 2**-24 cell over 2**31 stored steps.
    """
    zero = int(np.clip(round(-intercept / slope), -(2**31), 2**31 - 1))
    intercept += zero * slope
    length = math.lcm(slope.denominator, intercept.denominator)
    reach = abs(slope) * 2**33 + abs(intercept) + 2 * n
    if length * reach >= 2**62:
        length = max(1, 2 ** (61 - max(1, math.ceil(reach)).bit_length()))
    return zero, round(slope * length), round(intercept * length), length


def _exact_grid(left: Fraction, top: Fraction, cell: Fraction, width: int, height: int) -> Grid:
    return Grid(float(left), float(top), float(cell), width, height, (left, top, cell))


def grid_for(
    bounds: Bounds | tuple[Fraction, Fraction, Fraction, Fraction],
    cell: float | Fraction,
    max_cells: int = MAX_CELLS,
) -> Grid:
    """
    Return the smallest grid on multiples of the cell that holds a rectangle.

    Parameters
    ----------
    bounds : Bounds, or tuple of 4 Fraction
        left, bottom, right, top.
    cell : float or Fraction
        Edge of a cell, in the same unit; floats count as the decimals they print as.
    max_cells : int
        More are refused.

    Returns
    -------
    grid : Grid
        At least one cell; grids of the same cell share their edges wherever they meet.

    Raises
    ------
    ResourceError
        ``E_SIZE``: too many cells.

    Examples
    --------
    >>> grid_for(Bounds(0.3, 10.0, 2.0, 11.2), 0.5)
    Grid(left=0.0, top=11.5, cell=0.5, width=4, height=3)
    """
    edge = as_fraction(cell)
    if edge <= 0:
        raise OptionError(f"a cell must be greater than zero, got {cell}")
    if isinstance(bounds, Bounds):
        sides: tuple[Any, ...] = (bounds.left, bounds.bottom, bounds.right, bounds.top)
        bounds = tuple(as_fraction(side) for side in sides)  # type: ignore[assignment]
    left, bottom, right, top = bounds  # type: ignore[misc]
    first, last = math.floor(left / edge), math.ceil(right / edge)
    low, high = math.floor(bottom / edge), math.ceil(top / edge)
    width, height = max(1, last - first), max(1, high - low)
    if width * height > max_cells:
        raise ResourceError(
            f"the points spread over {width} x {height} cells of {float(edge):g}; "
            "give a larger --cell, or --bounds if a few points lie far off",
            "E_SIZE",
        )
    return _exact_grid(first * edge, (low + height) * edge, edge, width, height)


def extended(
    grid: Grid, box: tuple[Fraction, Fraction, Fraction, Fraction], max_cells: int = MAX_CELLS
) -> Grid:
    """
    Return the smallest grid on the same lines that holds a grid and a rectangle.

    Parameters
    ----------
    grid : Grid
        Need not lie on multiples of its cell.
    box : tuple of 4 Fraction
        left, bottom, right, top.
    max_cells : int
        More are refused.

    Raises
    ------
    ResourceError
        ``E_SIZE``: too many cells.

    Examples
    --------
    >>> extended(Grid(0.5, 3.5, 1.0, 2, 3), (Fraction(1), Fraction(-1), Fraction(5), Fraction(2)))
    Grid(left=0.5, top=3.5, cell=1.0, width=5, height=5)
    """
    left, top, cell = grid.exact
    first = min(0, math.floor((box[0] - left) / cell))
    last = max(grid.width, math.ceil((box[2] - left) / cell))
    high = min(0, math.floor((top - box[3]) / cell))
    low = max(grid.height, math.ceil((top - box[1]) / cell))
    width, height = last - first, low - high
    if width * height > max_cells:
        raise ResourceError(
            f"{width} x {height} cells of {float(cell):g} are too many; give a larger --cell or a "
            "shorter --buffer",
            "E_SIZE",
        )
    return _exact_grid(left + first * cell, top - high * cell, cell, width, height)
