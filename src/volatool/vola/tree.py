"""A volume as one array of nodes, and the lattice of its cells: what searches descend through."""

from __future__ import annotations

from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike

from volatool.model import F64, I64, U64
from volatool.vola.volume import Volume
from volatool.vola.words import ranks_of

__all__ = ["Lattice", "Tree", "lattice_of", "tree_of"]


@dataclass(frozen=True, slots=True)
class Lattice:
    """
    Where the cells of a level are: cell k of an axis is ``[k, k + 1]`` in lattice coordinates.

    Parameters
    ----------
    base : tuple of 3 float
        Place of the lattice's 0 on each axis, in the horizontal unit of the CRS.
    step : float
        Edge of a cell, same unit. Zero for a cube of side zero.
    size : int
        Cells on an axis.
    z_ratio : float
        Horizontal units per vertical unit.

    Notes
    -----
    The original toolkit rounded points to ``4**depth`` places: there a cell reaches half a step to
    both sides of its place, so that the outermost ones stick out of the cube.
    """

    base: tuple[float, float, float]
    step: float
    size: int
    z_ratio: float

    def from_crs(self, xyz: ArrayLike) -> F64:
        """Return (n, 3) lattice coordinates of points in units of the CRS."""
        points = np.array(xyz, np.float64).reshape(-1, 3)
        points[:, 2] *= self.z_ratio
        points -= self.base
        if self.step:
            points /= self.step
        return points

    def to_crs(self, points: ArrayLike) -> F64:
        """Return (n, 3) points in units of the CRS (z in the vertical unit)."""
        xyz: F64 = np.asarray(points, np.float64).reshape(-1, 3) * self.step + self.base
        xyz[:, 2] /= self.z_ratio
        return xyz


@dataclass(frozen=True, slots=True)
class Tree:
    """
    The words of levels 1 to `depth` in one array.

    Parameters
    ----------
    words : (n,) array of uint64
        Level after level, the root first.
    first : (n,) array of int64
        Place in `words` of each node's first child; means nothing for the last level.
    depth : int
        Number of levels.
    """

    words: U64
    first: I64
    depth: int


_TREES: WeakKeyDictionary[Volume, dict[int, Tree]] = WeakKeyDictionary()


def first_children(words: U64) -> I64:
    """Return the place of each node's first child: one after the bits set before it."""
    first = ranks_of(words)
    first += 1
    return first


def tree_of(volume: Volume, level: int) -> Tree:
    """Return the nodes of a volume down to a level, kept as long as the volume is."""
    trees = _TREES.setdefault(volume, {})
    if level not in trees:
        words = np.concatenate(volume.levels[:level])
        trees[level] = Tree(words, first_children(words), level)
    return trees[level]


def lattice_of(volume: Volume, level: int) -> Lattice:
    """Return where the cells of a level are."""
    origin, side = volume.cube.origin, volume.cube.side
    span = 4 ** (volume.depth - level)
    if volume.info.quantizer == "floor":
        step = volume.cube.cell(level)
        base = origin
    else:
        place = side / (4**volume.depth - 1)
        step = place * span
        x, y, z = (corner - place / 2 for corner in origin)
        base = (x, y, z)
    return Lattice(base, step, 4**level, float(volume.crs.z_ratio))
