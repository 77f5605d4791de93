"""The space that a path may run through: what of it keeps a distance, and where paths may end."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from volatool.errors import OptionError
from volatool.model import F64, I64
from volatool.vola.clearance import segment_clearance
from volatool.vola.tree import Lattice, Tree
from volatool.vola.volume import Volume

ROUNDING = 1e-9
"""A distance counts as kept when it is short by no more than this part of it."""

_AROUND = np.array([d for d in itertools.product((-1, 0, 1), repeat=3) if any(d)], np.int64)


class PathEndError(OptionError):
    """A path can't begin or end there: outside the cube, in a voxel, or too near to one."""

    code = "E_PATH_END"


@dataclass(frozen=True, slots=True)
class Place:
    """An end in lattice coordinates, and the (1, 3) indices of its cell."""

    place: F64
    cell: I64


@dataclass(frozen=True, slots=True)
class End:
    """An end, the passable cells to whose centres a line from it may go, and how long it is."""

    place: F64
    cells: I64
    lengths: F64

    def __len__(self) -> int:
        return len(self.cells)


@dataclass(frozen=True, slots=True)
class Space:
    """A level of a volume, and the distance to be kept in it, in cells."""

    volume: Volume
    level: int
    lattice: Lattice
    tree: Tree
    clearance: float
    heights: tuple[float, float]

    @property
    def least(self) -> float:
        """Distance that the whole line keeps."""
        if not self.lattice.step:
            return 0.0
        return self.clearance / self.lattice.step * (1 - ROUNDING)

    @property
    def usual(self) -> float:
        """Distance that a passable cell's centre keeps: every free cell's has half a cell."""
        return max(self.least, 0.5)

    @property
    def rule(self) -> F64:
        """What passable cells keep: square of the distance, lowest and highest centre."""
        low, high = self.lattice.from_crs([(0.0, 0.0, height) for height in self.heights])[:, 2]
        return np.array([self.usual**2, low, high])

    def end(self, point: ArrayLike, name: str) -> Place:
        """Return an end in lattice coordinates and its cell, if a path may have it."""
        xyz = np.asarray(point, np.float64)
        if xyz.shape != (3,):
            raise OptionError(f"the {name} is three numbers, not of shape {xyz.shape}")
        cell = self.volume.cell_indices(xyz, self.level)
        if cell[0, 0] < 0 or not self.lattice.step:
            raise PathEndError(f"{name} outside: not in the volume's cube")
        if not self.heights[0] <= xyz[2] <= self.heights[1]:
            raise PathEndError(f"{name} outside: not between the heights")
        if self.volume.contains_cells(cell, self.level)[0]:
            raise PathEndError(f"{name} occupied: in a voxel")
        # a point that rounding errs for belongs to the cell's side of the face
        place: F64 = self.lattice.from_crs(xyz)
        np.clip(place, cell, cell + 1, out=place)
        distance = segment_clearance(self.tree, place, place)[0]
        if distance < self.least:
            raise PathEndError(
                f"{name} too near: a voxel is {distance * self.lattice.step:g} away, less than "
                f"{self.clearance:g}"
            )
        return Place(place[0], cell)

    def linked(self, end: Place) -> End:
        """Return an end with the cells that it is linked to: its own if possible, else others."""
        # not the cell of the coordinates: a place on a face has two
        place, own = end.place, end.cell
        linked = self._clear_links(place, own, 0.0)
        if len(linked):
            return linked
        around = own + _AROUND
        inside = ((around >= 0) & (around < self.lattice.size)).all(axis=1)
        return self._clear_links(place, around[inside], ROUNDING)

    def _clear_links(self, place: F64, cells: I64, more_than: float) -> End:
        from volatool.kernels.roam import all_keep_clear

        tree = self.tree
        centres: F64 = cells.astype(np.float64) + 0.5
        square, low, high = self.rule
        good = all_keep_clear(tree.words, tree.first, tree.depth, centres, square)
        good &= (centres[:, 2] >= low) & (centres[:, 2] <= high)
        centres = np.ascontiguousarray(centres[good])
        from_here = np.broadcast_to(place, centres.shape).copy()
        line_clear = segment_clearance(tree, from_here, centres) >= max(self.least, more_than)
        lengths: F64 = np.sqrt(((centres - place) ** 2).sum(axis=1))
        return End(place, cells[good][line_clear], lengths[line_clear])
