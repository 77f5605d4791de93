"""Voxel counts by plain numpy and laspy, sharing nothing with volatool."""

from __future__ import annotations

import laspy
import numpy as np


def stored_xyz(path):
    """Return all stored integers of a file, (n, 3) int64, and the mask of points that are used."""
    las = laspy.read(path)
    xyz = np.column_stack([las.X, las.Y, las.Z]).astype(np.int64)
    codes = np.asarray(las.classification)
    withheld = np.asarray(las.withheld).astype(bool)
    return xyz, ~(withheld | (codes == 7) | (codes == 18))


def count_levels(xyz, used, n_levels):
    """Return (blocks, voxels) of each level by the floor rule on equal scales."""
    low = xyz.min(axis=0)
    side = int((xyz.max(axis=0) - low).max())
    xyz = xyz[used] - low
    counts, blocks = [], 1
    for level in range(1, n_levels + 1):
        size = 4**level
        cells = np.minimum(size - 1, xyz * size // max(side, 1))
        linear = np.sort(cells[:, 0] + size * (cells[:, 1] + size * cells[:, 2]))
        voxels = int(np.count_nonzero(np.diff(linear, prepend=-1)))
        counts.append((blocks, voxels))
        blocks = voxels
    return counts
