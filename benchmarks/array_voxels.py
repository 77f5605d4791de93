"""Voxels of 0.5 m from points in memory, by one library; run by ``run.py``.

    PYTHON array_voxels.py volatool|open3d|pyoctomap POINTS.npy RUNS

POINTS has (n, 3) float64 metres. Needs NumPy and the library alone, so that a library may live in
an environment of its own. Prints a line of JSON a run, the first, warm-up run left out; what turns
the array into the library's own kind of points is outside the clock.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

CELL = 0.5


def volatool(points: Any) -> Callable[[], int]:
    from fractions import Fraction

    from volatool import VolaBuilder
    from volatool.cube import Cube
    from volatool.model import PointChunk

    stored = np.round((points - points.min(axis=0)) * 1000).astype(np.int32)
    depth = 1
    while CELL * 4**depth < float(np.ptp(points, axis=0).max()):
        depth += 1
    cube = Cube.around([Fraction(0)] * 6, Fraction(CELL) * 4**depth)
    columns = [np.ascontiguousarray(stored[:, axis]) for axis in range(3)]
    chunk = PointChunk(0, *columns, (0.001,) * 3, (0.0,) * 3, {})

    def run() -> int:
        with VolaBuilder(cube, depth, keep_depth=depth) as builder:
            builder.add(chunk)
            return builder.build().counts[-1].voxels

    return run


def open3d(points: Any) -> Callable[[], int]:
    import open3d as o3d

    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    return lambda: len(cloud.voxel_down_sample(CELL).points)


def pyoctomap(points: Any) -> Callable[[], int]:
    import pyoctomap

    def run() -> int:
        tree = pyoctomap.OcTree(CELL)
        tree.updateNodes(points, True)
        return int(tree.getNumLeafNodes())

    return run


def main() -> None:
    points = np.ascontiguousarray(np.load(sys.argv[2]))
    run = {"volatool": volatool, "open3d": open3d, "pyoctomap": pyoctomap}[sys.argv[1]](points)
    for turn in range(int(sys.argv[3]) + 1):
        cpu, wall = time.process_time(), time.perf_counter()
        voxels = run()
        told = {"wall_s": time.perf_counter() - wall, "cpu_s": time.process_time() - cpu}
        told |= {"peak_mib": peak_mib(), "units": len(points), "voxels": voxels}
        if turn:
            print(json.dumps(told), flush=True)


def peak_mib() -> float:
    """Return this process's peak memory; 0 where the system doesn't tell."""
    status = Path("/proc/self/status")
    lines = status.read_text().splitlines() if status.exists() else []
    return sum(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) / 1024


if __name__ == "__main__":
    main()
