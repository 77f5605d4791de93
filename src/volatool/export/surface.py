"""The outside of a volume's voxels as a mesh, in lattice steps from the cube's corner."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from volatool.export.colours import Colours, labels_of
from volatool.model import F64, I32, I64
from volatool.vola.faces import boundary, shared_corners
from volatool.vola.volume import Volume


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """
    Quads that cover each outer face of the voxels once.

    Parameters
    ----------
    points : (k, 3) array of int32
        Lattice points x, y, z, 0 to ``4**depth``; each once, or once for each colour.
    quads : (m, 4) array of int64
        Rows of `points`, anticlockwise as seen from outside.
    colours : (k, 3) array of uint8 or None
        Of the points: that of their quads.
    """

    points: I32
    quads: I64
    colours: Colours | None

    def triangles(self) -> I64:
        """Return two triangles for each quad, (2 m, 3)."""
        return self.quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)


def surface_of(volume: Volume, colours: Colours | None = None) -> Surface:
    """
    Return the outside of a volume's voxels.

    Parameters
    ----------
    volume : Volume
        Half-open cells.
    colours : (n, 3) array of uint8, optional
        Of the voxels; only faces of equal colour are joined.
    """
    labels = labels_of(colours)
    faces = boundary(volume.voxels(), labels)
    own: NDArray[np.int64] | None = None if labels is None else labels[faces.cells]
    points, quads, firsts = shared_corners(faces.corners, own)
    chosen = None if colours is None else colours[faces.cells[firsts]]
    return Surface(points, quads, chosen)


def placed(volume: Volume, points: I32, *, is_local: bool, is_world_z: bool = True) -> F64:
    """
    Return the coordinates of lattice points.

    Parameters
    ----------
    volume : Volume
        Half-open cells.
    points : (k, 3) array of int32
        Steps from the cube's corner.
    is_local : bool
        From the cube's corner, or in the CRS.
    is_world_z : bool
        z in the vertical unit, or in the horizontal one.

    Returns
    -------
    xyz : (k, 3) array of float64
        Equal steps give equal numbers, so edges along an axis stay exactly on it.
    """
    step = volume.cube.exact[3] / 4**volume.depth
    ratio = volume.crs.z_ratio if is_world_z else 1
    xyz = np.empty(points.shape)
    for axis in range(3):
        unit = ratio if axis == 2 else 1
        corner = 0.0 if is_local else float(volume.cube.exact[axis] / unit)
        xyz[:, axis] = points[:, axis] * float(step / unit) + corner
    return xyz
