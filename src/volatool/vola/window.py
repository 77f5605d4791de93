"""A box of a volume's cells as a dense array, for a neural network or an image filter."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from volatool.cube import Cube
from volatool.errors import OptionError, ResourceError
from volatool.model import I32, I64, Bool, Bounds
from volatool.units import format_size
from volatool.vola.frame import cells_meeting
from volatool.vola.regions import select
from volatool.vola.volume import Volume

WINDOW_LIMIT_BYTES = 1 << 30
"""Largest array that is made unless the caller says otherwise; a cell is a byte."""

_SLAB_BYTES = 16 << 20


@dataclass(frozen=True, slots=True)
class Window:
    """
    A box of cells at one level of a volume.

    Parameters
    ----------
    level : int
        Of the cells.
    first : tuple of 3 int
        Cell of the lower corner in the cube: x, y, z.
    shape : tuple of 3 int
        Cells along x, y, z.
    origin : tuple of 3 float
        Its lower corner, in units of the CRS (z in the vertical unit).
    cell : float
        Edge of a cell, horizontal unit.
    cells : (n, 3) array of int32
        Those that are set, from the window's corner, in VOLA order.
    """

    level: int
    first: tuple[int, int, int]
    shape: tuple[int, int, int]
    origin: tuple[float, float, float]
    cell: float
    cells: I32

    def __len__(self) -> int:
        return len(self.cells)

    @property
    def size_bytes(self) -> int:
        """Bytes of the dense array."""
        return math.prod(self.shape)

    def refuse_size(self, limit: int = WINDOW_LIMIT_BYTES, what_to_do: str = "") -> None:
        """
        Refuse a dense array that is too large.

        Raises
        ------
        ResourceError
            ``E_SIZE``.
        """
        if self.size_bytes > limit:
            x, y, z = self.shape
            advice = what_to_do or "give smaller bounds, z or a coarser level, or a larger limit"
            raise ResourceError(
                f"a dense window of {x} x {y} x {z} cells takes {format_size(self.size_bytes)}, "
                f"at most {format_size(limit)} are made; {advice}",
                "E_SIZE",
            )

    def to_numpy(self, *, limit: int = WINDOW_LIMIT_BYTES) -> Bool:
        """
        Return the dense array.

        Parameters
        ----------
        limit : int
            Largest array, bytes.

        Returns
        -------
        window : (nx, ny, nz) array of bool
            Axes x, y, z; the place of ``window[i, j, k]`` is
            ``origin + (i + 0.5, j + 0.5, k + 0.5) * cell`` (z in the horizontal unit).

        Raises
        ------
        ResourceError
            ``E_SIZE``.
        """
        self.refuse_size(limit)
        window = np.zeros(self.shape, np.bool_)
        window[tuple(self.cells.T)] = True
        return window

    def slabs(self) -> Iterator[Bool]:
        """
        Yield the dense array in pieces along x, without making all of it.

        Yields
        ------
        slab : (m, ny, nz) array of bool
        """
        order = np.argsort(self.cells[:, 0], kind="stable")
        cells = self.cells[order]
        step = max(_SLAB_BYTES // max(self.shape[1] * self.shape[2], 1), 1)
        for start in range(0, self.shape[0], step):
            stop = min(start + step, self.shape[0])
            low, high = np.searchsorted(cells[:, 0], [start, stop])
            slab = np.zeros((stop - start, *self.shape[1:]), np.bool_)
            x, y, z = cells[low:high].T
            slab[x - start, y, z] = True
            yield slab


def window_of(
    volume: Volume,
    bounds: Bounds | Sequence[float] | None = None,
    level: int | None = None,
    *,
    z: tuple[float, float] | None = None,
) -> Window:
    """
    Return a box of a volume.

    Parameters
    ----------
    volume : Volume
        The volume.
    bounds : Bounds or four float, optional
        Closed rectangle, in units of the CRS; the whole cube by default.
    level : int, optional
        1 to the depth; the deepest by default.
    z : tuple of 2 float, optional
        Lowest and highest, in the vertical unit.

    Returns
    -------
    window : Window
        All cells of the cube that meet the box, set or not (those that `vola.algebra.crop` looks
        at). Blocks outside are not visited.

    Raises
    ------
    OptionError
        The box lies outside the cube, or is none; or there is no such level.
    """
    level = volume.depth if level is None else level
    volume.n_cells(level)  # refuses one that is not there
    placed = half_open(volume)
    first, last = cells_meeting(placed, bounds, z)
    if (first > last).any():
        ratio, edge = float(volume.crs.z_ratio), volume.cube.side
        ends = (
            f"{name} {low / unit:.12g} to {(low + edge) / unit:.12g}"
            for name, low, unit in zip("xyz", volume.cube.origin, (1, 1, ratio), strict=True)
        )
        raise OptionError(f"the window lies outside the cube: it has {', '.join(ends)}")
    first, last = (cells >> 2 * (volume.depth - level) for cells in (first, last))
    x, y, z_first = map(int, first)
    nx, ny, nz = map(int, last - first + 1)
    *corner, side = placed.cube.exact
    origin = [corner[axis] + side * int(first[axis]) / 4**level for axis in range(3)]
    return Window(
        level,
        (x, y, z_first),
        (nx, ny, nz),
        (float(origin[0]), float(origin[1]), float(origin[2] / volume.crs.z_ratio)),
        placed.cube.cell(level),
        cells_inside(volume.truncated(level), first, last) - first.astype(np.int32),
    )


def cells_inside(volume: Volume, first: I64, last: I64) -> I32:
    """
    Return the cells set in a box of cells, visiting only blocks that meet it.

    Parameters
    ----------
    volume : Volume
        The volume.
    first, last : (3,) arrays of int64
        Lowest and highest x, y, z, both included.

    Returns
    -------
    cells : (n, 3) array of int32
        x, y, z from the cube's corner, in VOLA order.
    """
    from volatool.kernels.words import child_cells

    chosen = select(volume, first, last)
    cells: I32 = child_cells(chosen.words, chosen.blocks.astype(np.int32), chosen.n_voxels)
    return cells


def half_open(volume: Volume) -> Volume:
    """
    Return a volume of rounded points as one of half-open cells around them.

    Parameters
    ----------
    volume : Volume
        Of any quantizer.

    Returns
    -------
    volume : Volume
        The same words. The original toolkit rounds to S = 4**depth points a side, side / (S - 1)
        apart: the middles of the cells of a cube of S / (S - 1) times the side, half a step lower.
        Only such a cube can be divided more coarsely.
    """
    if volume.info.quantizer == "floor":
        return volume
    *origin, side = volume.cube.exact
    n_cells = 4**volume.depth
    step = side / (n_cells - 1)
    cube = Cube.from_exact([corner - step / 2 for corner in origin], step * n_cells)
    info = replace(volume.info, quantizer="floor")
    return Volume(volume.levels, volume.metadata_levels, cube, info)
