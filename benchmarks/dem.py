"""Time, memory and accuracy of surfaces through the same ground points, by grid size.

    python benchmarks/dem.py tile.laz
    python benchmarks/dem.py tile.laz --millions 0.25 1 4 16 --runs 3 --json dem.json

The tile's ground points are mirrored side by side until the grid has as many cells as wanted, so
that real terrain, real density and real holes grow without seams. One point in ten and square holes
of 10 m are held out; every method gets the others and is asked for the nodes of the same grid,
which is read bilinearly at the held-out points. Each method is a process of its own. The seconds
are CPU seconds from points in memory to the grid (programs: from a file they can read, and back);
the reading of the tile is not in them. startinpy, GMT's `surface` and GDAL's `gdal_grid` take part
where they are installed.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from costs import Cost, median, run

HERE = Path(__file__).resolve()
HOLE_M = 10.0
NEIGHBOURS = 12


def ground(tile: Path) -> np.ndarray:
    """Return (n, 3) metres of a tile's ground points, corner at 0, 0."""
    import laspy

    las = laspy.read(tile)
    kept = np.asarray(las.classification) == 2
    crs = las.header.parse_crs()
    unit = 1.0 if crs is None else crs.axis_info[0].unit_conversion_factor
    xyz = np.asarray(las.xyz)[kept] * unit
    if len(xyz) < 100:
        sys.exit(f"{tile}: {len(xyz)} ground points; give a tile with class 2")
    return np.asarray(xyz - [*xyz[:, :2].min(axis=0), xyz[:, 2].mean()])


def mirrored(xyz: np.ndarray, side: float) -> np.ndarray:
    """Return the points, mirrored side by side over a square of the given side."""
    width, height = xyz[:, :2].max(axis=0)
    parts = []
    for i in range(math.ceil(side / width)):
        for j in range(math.ceil(side / height)):
            part = xyz.copy()
            part[:, 0] = i * width + (width - xyz[:, 0] if i % 2 else xyz[:, 0])
            part[:, 1] = j * height + (height - xyz[:, 1] if j % 2 else xyz[:, 1])
            parts.append(part[(part[:, 0] < side) & (part[:, 1] < side)])
    return np.concatenate(parts)


def held_out(xyz: np.ndarray, seed: int = 10) -> tuple[np.ndarray, np.ndarray]:
    """Return the masks of the scattered points and of those in holes."""
    rng = np.random.default_rng(seed)
    scattered = rng.random(len(xyz)) < 0.1
    squares = np.floor(xyz[:, :2] / HOLE_M).astype(int)
    n = int(squares.max()) + 1
    holes = rng.random((n, n)) < 0.05
    in_hole = holes[squares[:, 0], squares[:, 1]]
    return scattered & ~in_hole, in_hole


# the methods: points and a number of 1 m nodes a side, to heights at the cells' centres (row = y)


def centres(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Return x and y of the nodes."""
    return tuple(np.meshgrid(np.arange(n) + 0.5, np.arange(n) + 0.5))  # type: ignore[return-value]


def by_emap(xyz: np.ndarray, n: int, budget: int | None = None) -> np.ndarray:
    """Run what ``volatool dem --cell 1m`` runs on the points of a file."""
    from volatool.dem.gather import SurfaceGatherer
    from volatool.dem.surfaces import make_dem
    from volatool.model import CrsInfo, PointChunk
    from volatool.scratch import Scratch

    stored = np.round(xyz * 1000).astype(np.int32)
    scale, offset = (0.001,) * 3, (0.0,) * 3
    ground_class = {"classification": np.full(len(xyz), 2, np.uint8)}
    with Scratch(budget) as scratch:
        gatherer = SurfaceGatherer("dtm", scratch, ground_class)
        gatherer.add(PointChunk(0, *np.ascontiguousarray(stored.T), scale, offset, ground_class))
        points = gatherer.result()
        dem = make_dem(points, CrsInfo(), 1.0, max_gap=1000.0, scratch=scratch)
        out = np.full((n, n), np.nan, np.float32)
        rows, cols = min(n, dem.z.shape[0]), min(n, dem.z.shape[1])
        out[:rows, :cols] = dem.z[::-1][:rows, :cols]
    return out


def by_tin(xyz: np.ndarray, n: int) -> np.ndarray:
    """Interpolate linearly on Delaunay's triangles; the nearest point outside the hull."""
    from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator

    x, y = centres(n)
    z = LinearNDInterpolator(xyz[:, :2], xyz[:, 2])(x, y)
    outside = np.isnan(z)
    nearest = NearestNDInterpolator(xyz[:, :2], xyz[:, 2])
    z[outside] = nearest(x[outside], y[outside])
    return np.asarray(z)


def by_idw(xyz: np.ndarray, n: int) -> np.ndarray:
    """Weigh the 12 nearest points by the inverse square of their distance."""
    from scipy.spatial import KDTree

    tree = KDTree(xyz[:, :2])
    out = np.empty((n, n))
    for row in range(n):
        at = np.column_stack([np.arange(n) + 0.5, np.full(n, row + 0.5)])
        distance, index = tree.query(at, NEIGHBOURS)
        weight = 1 / np.maximum(distance, 1e-6) ** 2
        out[row] = (weight * xyz[index, 2]).sum(axis=1) / weight.sum(axis=1)
    return out


def by_startinpy(xyz: np.ndarray, n: int) -> np.ndarray:
    """Interpolate linearly on startinpy's triangulation; void outside the hull."""
    import startinpy

    triangles = startinpy.DT()
    triangles.insert(xyz)
    x, y = centres(n)
    places = np.column_stack([x.ravel(), y.ravel()])
    return np.asarray(triangles.interpolate({"method": "TIN"}, places)).reshape(n, n)


def by_gmt(xyz: np.ndarray, n: int, folder: Path) -> np.ndarray:
    """Run GMT's blockmean and surface, tension 0.35 as its manual advises for steep terrain."""
    region = ["-R" + "/".join(["0", str(n)] * 2), "-I1", "-r"]

    def gmt(*words: str, given: bytes | None = None) -> bytes:
        command = ["gmt", *words]
        return subprocess.run(
            command, input=given, capture_output=True, check=True, cwd=folder
        ).stdout

    xyz.tofile(folder / "points.bin")
    means = gmt("blockmean", "points.bin", *region, "-bi3d", "-bo3d")
    gmt("surface", *region, "-bi3d", "-T0.35", "-Ggrid.nc", given=means)
    # a GeoTIFF written by GMT 6.4 itself lies a row off
    return np.frombuffer(gmt("grd2xyz", "grid.nc", "-ZBLf"), np.float32).reshape(n, n)


def by_gdal(xyz: np.ndarray, n: int, folder: Path) -> np.ndarray:
    """Run gdal_grid's linear (Delaunay) algorithm."""
    import rasterio

    vrt, out = folder / "points.vrt", folder / "gdal.tif"
    np.savetxt(folder / "points.csv", xyz, "%.3f", ",", header="x,y,z", comments="")
    vrt.write_text(
        "<OGRVRTDataSource><OGRVRTLayer name='points'><SrcDataSource>points.csv</SrcDataSource>"
        "<GeometryType>wkbPoint25D</GeometryType>"
        "<GeometryField encoding='PointFromColumns' x='x' y='y' z='z'/>"
        "</OGRVRTLayer></OGRVRTDataSource>"
    )
    size = [str(n), str(n)]
    edges = ["0", str(n)]
    subprocess.run(
        [
            *["gdal_grid", "-q", "-a", "linear:radius=-1", "-ot", "Float32", "-outsize", *size],
            *["-txe", *edges, "-tye", *edges, "-l", "points", str(vrt), str(out)],
        ],
        check=True,
        cwd=folder,
    )
    with rasterio.open(out) as file:
        heights = file.read(1)
        return np.asarray(heights if file.transform.e > 0 else heights[::-1])


PROGRAMS = ("gmt", "gdal_grid")
METHODS: dict[str, tuple[str, Callable[..., np.ndarray]]] = {
    "EMap (volatool)": ("", by_emap),
    "EMap, 1 GiB ceiling": ("", by_emap),
    "TIN (scipy)": ("", by_tin),
    "IDW (scipy, 12 nearest)": ("", by_idw),
    "TIN (startinpy)": ("startinpy", by_startinpy),
    "surface -T0.35 (GMT)": ("gmt", by_gmt),
    "gdal_grid linear (GDAL)": ("gdal_grid", by_gdal),
}
"""What a method needs, a program or a package, and its function."""


def is_here(needs: str) -> bool:
    """Tell whether a program or a package is installed."""
    return not needs or bool(shutil.which(needs) if needs in PROGRAMS else find_spec(needs))


def work(method: str, folder: Path, n: int) -> None:
    """Run one method in this process; write the grid and its seconds."""
    points = np.load(folder / "train.npy")
    small = points[:2000]  # imports and cached kernels are not part of the method
    needs, function = METHODS[method]
    is_program = needs in PROGRAMS
    extra: dict[str, Any] = {"folder": folder} if is_program else {}
    if "ceiling" in method:
        from volatool.resources import working_budget

        extra["budget"] = working_budget(1 << 30)
    if not is_program:
        function(small, int(small[:, :2].max()) + 2, **extra)
    began = os.times()
    grid = function(points, n, **extra)
    seconds = sum(os.times()[:4]) - sum(began[:4])
    np.save(folder / "grid.npy", grid.astype(np.float32))
    (folder / "seconds").write_text(str(seconds))


def bilinear(grid: np.ndarray, xy: np.ndarray) -> np.ndarray:
    """Read a grid of cell centres at places; the margin of half a cell is held constant."""
    at = np.clip(xy - 0.5, 0, np.array(grid.shape[::-1]) - 1.001)
    col, row = np.floor(at).astype(int).T
    u, v = (at - np.floor(at)).T
    top = grid[row, col] * (1 - u) + grid[row, col + 1] * u
    low = grid[row + 1, col] * (1 - u) + grid[row + 1, col + 1] * u
    return np.asarray(top * (1 - v) + low * v)


def rmse(grid: np.ndarray, xyz: np.ndarray) -> tuple[float, int]:
    """Return the root mean square error in metres and how many points are on a void."""
    error = bilinear(grid, xyz[:, :2]) - xyz[:, 2]
    known = np.isfinite(error)
    return float(np.sqrt(np.mean(error[known] ** 2))), int(len(error) - known.sum())


def measure(xyz: np.ndarray, n: int, runs: int, limit_s: float) -> list[dict[str, Any]]:
    """Return a row for each method on a grid of n x n cells."""
    points = mirrored(xyz, float(n))
    scattered, in_hole = held_out(points)
    methods = [name for name, (needs, _) in METHODS.items() if is_here(needs)]
    costs: dict[str, list[tuple[float, Cost]]] = {name: [] for name in methods}
    rows = {name: {"method": name, "cells": n * n, "points": len(points)} for name in methods}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        np.save(folder / "train.npy", points[~scattered & ~in_hole])
        for _ in range(runs):
            for method in list(methods):
                command = [sys.executable, str(HERE), "--work", method, name, str(n)]
                cost = run(["timeout", str(limit_s), *command], allowed=(124, 137))
                if cost is None:
                    methods.remove(method)
                    rows[method]["note"] = f"not done in {limit_s:g} s"
                    continue
                costs[method].append((float((folder / "seconds").read_text()), cost))
                if len(costs[method]) == 1:
                    grid = np.load(folder / "grid.npy")
                    rows[method]["rmse_scattered_m"], void = rmse(grid, points[scattered])
                    rows[method]["rmse_holes_m"], more = rmse(grid, points[in_hole])
                    rows[method]["void"] = void + more
    for method in methods:
        rows[method]["seconds"] = statistics.median(second for second, _ in costs[method])
        whole = median([cost for _, cost in costs[method]])
        rows[method]["runs"] = len(costs[method])
        rows[method]["wall_s"], rows[method]["peak_mib"] = whole.wall_s, whole.peak_mib
        rows[method]["us_per_cell"] = rows[method]["seconds"] / (n * n) * 1e6
    return list(rows.values())


def table(rows: list[dict[str, Any]]) -> str:
    """Return the rows as a Markdown table."""
    lines = [
        "| M cells | M points | method | CPU s | us / cell | peak MiB | RMSE scattered m "
        "| RMSE in 10 m holes | held out on voids |",
        "|---:|---:|---|---:|---:|---:|---:|---:|---:|",
    ]
    for row in rows:
        head = f"| {row['cells'] / 1e6:.2f} | {row['points'] / 1e6:.2f} | {row['method']} "
        if "note" in row:
            lines.append(head + f"| {row['note']} | | | | | |")
            continue
        lines.append(
            head + f"| {row['seconds']:.2f} | {row['us_per_cell']:.2f} | {row['peak_mib']:.0f} "
            f"| {row['rmse_scattered_m']:.3f} | {row['rmse_holes_m']:.3f} | {row['void']} |"
        )
    return "\n".join(lines)


def main() -> None:
    """Run from the command line."""
    if sys.argv[1:2] == ["--work"]:
        work(sys.argv[2], Path(sys.argv[3]), int(sys.argv[4]))
        return
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("tile", type=Path, help="LAS or LAZ with class 2")
    parser.add_argument("--millions", type=float, nargs="+", default=[0.25, 1, 4], help="of cells")
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--limit-s", type=float, default=600, help="for one run of a method")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the numbers too")
    options = parser.parse_args()
    xyz = ground(options.tile)
    rows: list[dict[str, Any]] = []
    for millions in options.millions:
        rows += measure(xyz, round(math.sqrt(millions * 1e6)), options.runs, options.limit_s)
    print(f"{options.tile.name}, mirrored, 1 m cells, median of {options.runs} runs\n")
    print(table(rows))
    if options.json is not None:
        options.json.write_text(json.dumps(rows, indent=2) + "\n")


if __name__ == "__main__":
    main()
