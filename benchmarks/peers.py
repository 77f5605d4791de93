"""Other tools found on the machine, and how they do what we do."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

PEERS = ("pdal", "open3d", "pyoctomap", "gmt", "gdal_grid", "startinpy")
PROGRAMS = ("pdal", "gmt", "gdal_grid")


def found(open3d: str | None = None) -> dict[str, str | None]:
    """
    Return the program or the interpreter of each peer, None for those that are absent.

    Parameters
    ----------
    open3d : str, optional
        An interpreter that has Open3D; this one is asked by default.
    """
    where: dict[str, str | None] = {name: shutil.which(name) for name in PROGRAMS}
    for name in ("pyoctomap", "startinpy", "open3d"):
        where[name] = sys.executable if find_spec(name) is not None else None
    if open3d is not None:
        asked = subprocess.run([open3d, "-c", "import open3d"], capture_output=True, check=False)
        where["open3d"] = open3d if asked.returncode == 0 else None
    return where


def pdal_pipeline(job: str, tile: Path, out: Path, unit_m: float) -> list[dict[str, Any]]:
    """
    Return the pipeline of a PDAL job.

    Parameters
    ----------
    job : str
        ``"voxels"``, ``"idw 1m"``, ``"faceraster 0.5m"``, ...
    tile, out : pathlib.Path
        Input; output without suffix.
    unit_m : float
        Metres per horizontal unit of the tile.
    """
    read = {"type": "readers.las", "filename": str(tile)}
    what, _, cell = job.partition(" ")
    if what == "voxels":
        edge = {"type": "filters.voxeldownsize", "cell": 0.5 / unit_m, "mode": "center"}
        return [read, edge, {"type": "writers.las", "filename": f"{out}.laz"}]
    resolution = float(cell.removesuffix("m")) / unit_m
    raster = f"{out}.tif"
    if what == "idw":
        write = {"type": "writers.gdal", "output_type": "idw", "resolution": resolution}
        return [read, {**write, "filename": raster}]
    faces = {"type": "filters.faceraster", "resolution": resolution}
    return [
        read,
        {"type": "filters.delaunay"},
        faces,
        {"type": "writers.raster", "filename": raster},
    ]


def pdal_command(pdal: str, job: str, tile: Path, out: Path, unit_m: float) -> list[str]:
    """Write the pipeline of a job beside its output; return the command that runs it."""
    pipeline = out.with_suffix(".json")
    pipeline.write_text(json.dumps(pdal_pipeline(job, tile, out, unit_m)))
    return [pdal, "pipeline", str(pipeline)]
