"""Which points fall into a voxel."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from volatool.model import Bool
from volatool.vola.rows import rows_of

if TYPE_CHECKING:
    from volatool.vola.volume import Volume


def contains(volume: Volume, xyz: ArrayLike) -> Bool:
    """
    Tell which points fall into a voxel, in one pass over the points.

    Parameters
    ----------
    volume : Volume
        With half-open cells, in a cube that is not a single place.
    xyz : (n, 3) array of float
        In units of the CRS (z in the vertical unit).

    Returns
    -------
    contained : (n,) array of bool
        As ``volume.contains_cells(volume.cell_indices(xyz))``.
    """
    from volatool.kernels import locate

    points = np.ascontiguousarray(rows_of(xyz))
    contained = np.empty(len(points), np.bool_)
    directory = volume.directory
    locate.contains(
        directory.rows,
        directory.last,
        directory.jump,
        directory.jump_level,
        points,
        np.array(volume.cube.origin),
        volume.cube.side,
        float(volume.crs.z_ratio),
        volume.depth,
        contained,
    )
    return contained
