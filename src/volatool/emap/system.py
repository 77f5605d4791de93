"""The EMap equations: springs, the evidence of points, and their product with heights."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from volatool.errors import OptionError
from volatool.model import F64
from volatool.scratch import Scratch

if TYPE_CHECKING:
    from volatool.emap.cuts import Cuts
    from volatool.emap.lines import Lines

STRIP_CELLS = 1 << 17
"""Nodes that a loop handles between two chances for file-backed rows to leave RAM."""

RHO = 0.02
"""Bending stiffness of a single net: ``kb c^2 / w = RHO s^2``, s the mean spacing of the points."""

ELL = 3.0
"""Length beyond which tension rules over bending in a single net, in mean point spacings.

For what needs one system, and for the part of --k-surface and --ell that is not given. A DEM's
default is the sum of nets of `volatool.emap.tuning`, which has less error in gaps.
"""


MAX_RATIO = 1e9
"""Surface springs may be so many times stiffer, or softer, than those of the points."""


def strips(height: int, width: int, cells: int = STRIP_CELLS) -> Iterator[tuple[int, int]]:
    """
    Yield (first row, last row + 1) of the strips that cover a grid, from the top.

    Examples
    --------
    >>> list(strips(5, 10, cells=20))
    [(0, 2), (2, 4), (4, 5)]
    """
    rows = max(1, cells // max(1, width))
    for start in range(0, height, rows):
        yield start, min(height, start + rows)


def windows(
    scratch: Scratch, height: int, width: int, *arrays: NDArray[Any]
) -> list[tuple[int, int]]:
    """
    Return (first row, last row + 1) of the windows to pass points in any order for.

    Parameters
    ----------
    scratch : Scratch
        Where the arrays live.
    height, width : int
        Of the grid.
    arrays : arrays, by rows
        What is read or written at the points' places.

    Returns
    -------
    windows : list of tuple of 2 int
        One while all arrays are in RAM; else as large as what is left of the budget allows.
    """
    row_bytes = sum(array.nbytes for array in arrays if scratch.is_filed(array)) // height
    if not row_bytes:
        return [(0, height)]
    rows = max(scratch.left_bytes // 2 // row_bytes, 4 * STRIP_CELLS // width)
    return list(strips(height, width, rows * width))


@dataclass(frozen=True, slots=True)
class Springs:
    """
    Stiffness of the surface's springs, on a grid of a given cell, and how points attach.

    Parameters
    ----------
    kb : float
        Bending springs, acting on second differences of the nodes' heights.
    km : float
        Stretching springs, acting on first differences.
    weight : float
        Stiffness of a point's spring.
    is_nearest : bool
        Points pull on the nearest node instead of on the surface at their own place.
    """

    kb: float
    km: float
    weight: float = 1.0
    is_nearest: bool = False

    def __post_init__(self) -> None:
        values = (self.kb, self.km, self.weight)
        if not all(np.isfinite(values)) or min(values) < 0 or self.weight <= 0:
            raise OptionError(f"spring stiffness must be finite and not negative, got {self}")
        # softer, and cells without a point hang on nothing; stiffer, and the points are lost
        if not 1 / MAX_RATIO <= max(self.kb, self.km) / self.weight <= MAX_RATIO:
            raise OptionError(
                "--k-surface and --k-point are out of all proportion: the surface would be "
                f"{max(self.kb, self.km) / self.weight:.3g} times as stiff as the points' springs"
            )

    @classmethod
    def emap(
        cls,
        cell: float,
        spacing: float,
        *,
        k_surface: float | None = None,
        k_point: float | None = None,
        ell: float | None = None,
    ) -> Springs:
        """
        Return the springs of a single net: bending, a little tension, bilinear attachment.

        Parameters
        ----------
        cell : float
            Edge of a cell.
        spacing : float
            Mean spacing of the points, same unit.
        k_surface : float, optional
            Stiffness of the surface ``kb cell^2``, which does not depend on the cell; in the
            square of the unit; ``0.02 spacing^2 k_point`` by default.
        k_point : float, optional
            Stiffness of a point's spring; 1 by default.
        ell : float, optional
            ``km = k_surface / ell^2``; 3 spacings by default.
        """
        weight = 1.0 if k_point is None else k_point
        rho = RHO * spacing**2 * weight if k_surface is None else k_surface
        length = ELL * spacing if ell is None else ell
        if not length > 0 or not cell > 0:
            raise OptionError(f"cell and ell must be greater than zero, got {cell}, {length}")
        return cls(rho / cell**2, rho / length**2, weight)

    @classmethod
    def paper(cls, *, k_surface: float | None = None, k_point: float | None = None) -> Springs:
        """Return the paper's springs: stretching only, points pull on the nearest node."""
        weight = 1.0 if k_point is None else k_point
        return cls(0.0, weight / 10 if k_surface is None else k_surface, weight, is_nearest=True)


class Evidence:
    """
    What points say about the nodes of a grid; it only ever grows by sums.

    The data springs of any number of scans or chunks are five stencil arrays and a right side, so
    that evidence added bit by bit equals evidence added at once.

    Parameters
    ----------
    height, width : int
        Nodes; at least 2 a side.
    scratch : Scratch, optional
        Where the arrays live; RAM by default.

    Attributes
    ----------
    data : (height, 5, width) array of float64
        Diagonal, and the couplings to the nodes east, south, south-east and south-west.
    right : (height, width) array of float64
        Weighted heights.
    """

    def __init__(self, height: int, width: int, scratch: Scratch | None = None) -> None:
        if min(height, width) < 2:
            raise OptionError(f"evidence needs at least 2 x 2 nodes, got {height} x {width}")
        self.scratch = Scratch() if scratch is None else scratch
        self.data: F64 = self.scratch.zeros((height, 5, width), np.float64)
        self.right: F64 = self.scratch.zeros((height, width), np.float64)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of nodes."""
        height, width = self.right.shape
        return height, width

    def windows(self) -> list[tuple[int, int]]:
        """Return the row windows to pass all points for: the whole grid when it is in RAM."""
        return windows(self.scratch, *self.shape, self.data, self.right)

    def add(
        self,
        col: F64,
        row: F64,
        heights: F64,
        springs: Springs,
        window: tuple[int, int] | None = None,
        weights: F64 | None = None,
        lines: Lines | None = None,
    ) -> None:
        """
        Add points, in order.

        Parameters
        ----------
        col, row : (n,) arrays of float64
            Places in cells from the grid's top left corner; points outside are ignored.
        heights : (n,) array of float64
            Best counted from near their mean: it keeps digits.
        springs : Springs
            Gives the weight and the attachment.
        window : tuple of 2 int, optional
            Only rows in it are touched.
        weights : (n,) array of float64, optional
            Factor of each point's own on the springs' weight.
        lines : Lines, optional
            Break lines (`Cuts.lines`): a point pulls only on nodes of its own side.
        """
        from volatool.kernels import spring
        from volatool.kernels.lines import cut_accumulate

        first, last = window or (0, self.shape[0])
        # one entry stands for all points
        stiffness = np.full(1, springs.weight) if weights is None else weights * springs.weight
        arrays = (self.data, self.right, col, row, heights, stiffness)
        if lines is None:
            spring.accumulate(*arrays, springs.is_nearest, first, last)
        else:
            cut_accumulate(*arrays, springs.is_nearest, first, last, *lines.tables)

    def tether(self, stiffness: float) -> None:
        """Add a spring at each node that pulls it to height 0."""
        for start, stop in strips(*self.shape):
            self.data[start:stop, 0] += stiffness
            self.scratch.relax(self.data, start, stop)

    def subtract(self, z: F64, tether: float = 0.0) -> None:
        """
        Take heights off those of the points: ``right -= data z``.

        Parameters
        ----------
        z : (h, w) array of float64
            Heights of the nodes, in the evidence's scratch.
        tether : float
            Of the springs that `tether` added: they don't say where points are.

        Notes
        -----
        The same as adding the points anew with their heights above this surface, without a look
        at the points.
        """
        from volatool.kernels import spring

        product: F64 = self.scratch.zeros(self.shape, np.float64)
        dots = np.empty(len(z))
        for start, stop in strips(*self.shape):
            spring.apply_rows(self.data, z, 0.0, 0.0, start, stop, product, dots, None)
            self.right[start:stop] -= product[start:stop] - tether * z[start:stop]
            for array in (self.data, z, product, self.right):
                self.scratch.relax(array, start, stop)
        self.scratch.free(product)

    def __iadd__(self, other: Evidence) -> Evidence:
        self.data += other.data
        self.right += other.right
        return self

    def relax(self, start: int = 0, stop: int | None = None) -> None:
        """Let file-backed rows leave RAM."""
        self.scratch.relax(self.data, start, stop)
        self.scratch.relax(self.right, start, stop)

    def free(self) -> None:
        """Give the memory back; the evidence must not be used any more."""
        self.scratch.free(self.data, self.right)
        del self.data, self.right


def apply(data: NDArray[Any], z: F64, springs: Springs, cuts: Cuts | None = None) -> F64:
    """
    Return ``H z``: the force of all springs at each node.

    Parameters
    ----------
    data : (h, 5, w) array of float64
        Data stencil of `Evidence`.
    z : (h, w) array of float64
        Heights.
    springs : Springs
        Stiffness of the surface.
    cuts : Cuts, optional
        Springs that are missing or weaker.

    Returns
    -------
    product : (h, w) array of float64
        Zero for the solution's ``H z - right``.
    """
    from volatool.kernels import spring

    out = np.empty(z.shape)
    dots = np.empty(len(z))
    edges = None if cuts is None else cuts.edges
    spring.apply_rows(data, z, springs.kb, springs.km, 0, len(z), out, dots, edges)
    return out
