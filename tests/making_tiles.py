"""LAS files made for a test, written by laspy: an independent writer."""

from __future__ import annotations

import laspy
import numpy as np


def write_las(
    path,
    xyz,
    *,
    point_format=6,
    version="1.4",
    scale=0.01,
    offset=(0.0, 0.0, 0.0),
    crs=None,
    **attributes,
):
    """Write points, (n, 3) int stored integers, and their attributes."""
    header = laspy.LasHeader(point_format=point_format, version=version)
    header.scales = np.broadcast_to(scale, 3).astype(float)
    header.offsets = np.asarray(offset, float)
    if crs is not None:
        import pyproj

        header.add_crs(pyproj.CRS(crs))
    las = laspy.LasData(header)
    xyz = np.asarray(xyz)
    las.X, las.Y, las.Z = (xyz[:, axis].astype(np.int32) for axis in range(3))
    for name, values in attributes.items():
        setattr(las, name, values)
    las.write(path)
    return path


def hills(n_points, seed=0, extent=5000):
    """Return stored integers of a rough slope, (n, 3) int64."""
    rng = np.random.default_rng(seed)
    x, y = rng.integers(0, extent, (2, n_points))
    z = 1000 + x // 10 + (200 * np.sin(y / 700)).astype(int) + rng.integers(0, 20, n_points)
    return np.column_stack([x, y, z])
