"""Another library's point queries, one run for each line on stdin; run by ``query.py``.

Needs NumPy and the library alone, so that the library may live in an environment of its own::

    PYTHON query_rival.py octomap|open3d DATA.npz < lines

DATA has ``voxels`` (centres from the cube's corner), ``points`` (the same), ``cell`` and ``size``.
The first line out says what is called, then a line a run: CPU seconds, voxels found.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np


def octomap(data: Any) -> tuple[str, Callable[[], Any], Callable[[Any], int]]:
    """OctoMap by its fastest batch call of pyoctomap: one label a point, in C++."""
    from importlib.metadata import version

    import pyoctomap

    tree = pyoctomap.OcTree(float(data["cell"]))
    tree.updateNodes(np.ascontiguousarray(data["voxels"]), True)
    points = np.ascontiguousarray(data["points"])
    return (
        f"OctoMap (pyoctomap {version('pyoctomap')}, getLabels)",
        lambda: tree.getLabels(points),
        lambda labels: int((np.asarray(labels) == 1).sum()),
    )


def open3d(data: Any) -> tuple[str, Callable[[], Any], Callable[[Any], int]]:
    """Open3D's hash of voxels; the points are handed over outside the clock."""
    import open3d as o3d

    side = float(data["cell"]) * int(data["size"])
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(data["voxels"]))
    grid = o3d.geometry.VoxelGrid.create_from_point_cloud_within_bounds(
        cloud, float(data["cell"]), np.zeros(3), np.full(3, side)
    )
    points = o3d.utility.Vector3dVector(data["points"])
    return (
        f"Open3D {o3d.__version__} (VoxelGrid.check_if_included)",
        lambda: grid.check_if_included(points),
        lambda found: int(np.sum(found)),
    )


def main() -> None:
    name, run, n_found = {"octomap": octomap, "open3d": open3d}[sys.argv[1]](np.load(sys.argv[2]))
    run()  # memory and caches are warm
    print(name, flush=True)
    for _ in sys.stdin:
        start = time.process_time()
        found = run()
        print(time.process_time() - start, n_found(found), flush=True)


if __name__ == "__main__":
    main()
