"""The boundary of a set of cells as few rectangles, each face covered once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from volatool.errors import ResourceError
from volatool.model import I32, I64

MAX_SIDE = 1 << 20
"""Cells along an axis."""

_AXES = ((0, 1, 2), (1, 2, 0), (2, 0, 1))
"""Normal, then the two axes of the face; right-handed."""


@dataclass(frozen=True, slots=True, eq=False)
class Faces:
    """
    Rectangles on the lattice of the cells' corners.

    Parameters
    ----------
    corners : (m, 4, 3) array of int32
        Lattice points x, y, z, anticlockwise as seen from outside.
    cells : (m,) array of int64
        Row of a cell behind each.
    """

    corners: I32
    cells: I64

    def __len__(self) -> int:
        return len(self.cells)


def boundary(cells: I32, labels: NDArray[np.integer] | None = None) -> Faces:
    """
    Return the outside of a set of cells.

    Parameters
    ----------
    cells : (n, 3) array of int32
        x, y, z, 0 to ``2**20 - 1``; none twice.
    labels : (n,) array of int, optional
        Colours: faces are joined only if their cells' labels are equal. By default all are.

    Returns
    -------
    faces : Faces
        By axis, lower sides first, then layer, row and column. Each face between a cell and a
        place that has none is in exactly one rectangle. Rectangles meet at T-junctions: a long
        edge can have several short ones on its other side.

    Raises
    ------
    ResourceError
        ``E_SIZE``: a cell outside.

    Notes
    -----
    Rectangles grow along the row as far as they can, then row by row: not the fewest possible,
    but near it, and always the same.
    """
    from volatool.kernels import faces as kernels

    if len(cells) and (cells.min() < 0 or cells.max() >= MAX_SIDE):
        raise ResourceError(
            f"surfaces are made of at most {MAX_SIDE} cells a side; give a coarser level", "E_SIZE"
        )
    if labels is None:
        labels = np.zeros(len(cells), np.int64)
    labels = labels.astype(np.int64)
    corners, owners = [], []
    for normal, across, up in _AXES:
        keys = kernels.pack(cells, up, across, normal)
        order = np.argsort(keys)
        for is_upper, rows in enumerate(kernels.exposed(keys[order], order)):
            layers = kernels.pack(cells[rows], normal, up, across)
            by_layer = np.argsort(layers)
            rows = rows[by_layer]
            firsts, sizes = kernels.rectangles(layers[by_layer], labels[rows])
            owner = rows[firsts]
            corners.append(_corners(cells[owner], sizes, (normal, across, up), bool(is_upper)))
            owners.append(owner)
    return Faces(np.concatenate(corners), np.concatenate(owners))


def _corners(low: I32, sizes: I32, axes: tuple[int, int, int], is_upper: bool) -> I32:
    """Return the corners of rectangles from their lowest cells, rows and columns."""
    normal, across, up = axes
    corners = np.repeat(low[:, None, :], 4, axis=1)
    corners[:, :, normal] += int(is_upper)
    corners[:, 1:3, across] += sizes[:, 1, None]
    corners[:, 2:4, up] += sizes[:, 0, None]
    if not is_upper:  # seen from below the other way round
        corners = corners[:, ::-1]
    return np.ascontiguousarray(corners)


def shared_corners(corners: I32, labels: NDArray[np.integer] | None = None) -> tuple[I32, I64, I64]:
    """
    Return each lattice point once.

    Parameters
    ----------
    corners : (m, 4, 3) array of int32
        Of `Faces`, 0 to ``2**20``.
    labels : (m,) array of int, optional
        0 or more: corners of rectangles of different labels stay apart.

    Returns
    -------
    points : (k, 3) array of int32
        Ascending x, then y, then z.
    indices : (m, 4) array of int64
        Rows of `points`.
    firsts : (k,) array of int64
        A rectangle that each point belongs to, for its colour.
    """
    flat = corners.reshape(-1, 3).astype(np.int64)
    keys = (flat[:, 0] << 42) | (flat[:, 1] << 21) | flat[:, 2]
    if labels is not None:
        values, ranks = np.unique(labels, return_inverse=True)
        keys = np.unique(keys, return_inverse=True)[1] * len(values) + np.repeat(ranks, 4)
    _, firsts, inverse = np.unique(keys, return_index=True, return_inverse=True)
    points = corners.reshape(-1, 3)[firsts]
    return points, inverse.reshape(-1, 4), firsts // 4
