"""Distance from points to the nearest occupied voxel, exact, without a dense grid."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from volatool.errors import OptionError
from volatool.model import F64
from volatool.vola.rows import rows_of
from volatool.vola.tree import Tree, lattice_of, tree_of
from volatool.vola.volume import Volume

__all__ = ["TARGETS", "clearance", "segment_clearance"]

TARGETS = {"box": 0.0, "centre": 0.5}
"""What of a voxel the distance is to, and by how much of a cell it is smaller on each side."""


def clearance(volume: Volume, xyz: ArrayLike, level: int | None = None, *, to: str = "box") -> F64:
    """
    Return the distance from each point to the nearest occupied cell.

    Parameters
    ----------
    volume : Volume
        The volume.
    xyz : (n, 3) array of float
        In units of the CRS (z in the vertical unit), inside the cube or not.
    level : int, optional
        Level of the cells, 1 to the volume's depth; the deepest by default.
    to : {"box", "centre"}
        To the cell's box, 0 inside and on it; or to its middle.

    Returns
    -------
    distances : (n,) array of float64
        Euclidean, in the horizontal unit of the CRS: heights count ``z_ratio`` times. Infinity
        when the volume is empty, NaN for points that are not finite.

    Raises
    ------
    OptionError
        ``E_OPTION``: another `to`, a level that is not there, or points that are not (n, 3).

    Notes
    -----
    A cell's box is closed and a whole cell wide on all sides; that of a voxel of the original
    toolkit is centred on the place that its points were rounded to.
    """
    if to not in TARGETS:
        raise OptionError(f"a distance is to a voxel's box or centre, not {to!r}")
    from volatool.kernels import nearest

    level = volume.depth if level is None else level
    n_cells = volume.n_cells(level)
    lattice = lattice_of(volume, level)
    points = lattice.from_crs(rows_of(xyz))
    if not lattice.step:  # all cells are one place
        distances: F64 = np.sqrt((points**2).sum(axis=1))
        distances[np.isinf(distances)] = np.nan
        return distances if n_cells else np.where(np.isnan(distances), np.nan, np.inf)
    tree = tree_of(volume, level)
    squares = np.empty(len(points))
    nearest.nearest(tree.words, tree.first, tree.depth, points, TARGETS[to], squares)
    return np.sqrt(squares) * lattice.step


def segment_clearance(tree: Tree, starts: F64, ends: F64) -> F64:
    """
    Return the least distance of each segment from the occupied cells' boxes.

    Parameters
    ----------
    tree : Tree
        The volume's nodes.
    starts, ends : (n, 3) array of float64
        In lattice coordinates of its last level.

    Returns
    -------
    distances : (n,) array of float64
        In cells; infinity when the volume is empty.
    """
    from volatool.kernels import nearest

    squares = np.full(len(starts), np.inf)
    nearest.segment_clearances(tree.words, tree.first, tree.depth, starts, ends, squares)
    distances: F64 = np.sqrt(squares)
    return distances
