"""CPU time of the EMap solver by grid size, points already summed to springs.

    python benchmarks/solver.py
    python benchmarks/solver.py tile.laz --millions 0.25 1 4 16 --threads 1 2 --runs 5

The grid has cells of 1 m. Points are a tile's ground points, mirrored side by side, or hills with
0.15 points a cell and holes of 20 cells on 5 % of the area. "blend" is the default of a DEM, two
nets one after the other; "membrane" is the paper's net. Both stop at 1e-4 m. With one thread the
seconds are the CPU time of that thread, else that of the process; the wall time is beside it, and
means little on a busy machine. GMT's `surface` takes part where it is installed: its seconds are
those of the program, with reading and writing of a small file.
"""

from __future__ import annotations

import argparse
import math
import os
import shutil
import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from dem import by_gmt, ground, mirrored

DENSITY = 0.15
HOLE_CELLS = 20


def hills(n: int) -> np.ndarray:
    """Return (m, 3) points on n x n cells."""
    rng = np.random.default_rng(0)
    xy = rng.uniform(0, n, (int(n * n * DENSITY), 2))
    holes = rng.random((n // HOLE_CELLS + 1,) * 2) < 0.05
    xy = xy[~holes[tuple((xy // HOLE_CELLS).astype(int).T)]]
    x, y = xy.T
    z = 10 * np.sin(x / 23) * np.cos(y / 31) + 40 * np.sin(x / 407 + y / 301)
    return np.column_stack([x, y, z + rng.normal(0, 0.05, len(z))])


def solved(points: np.ndarray, n: int, preset: str, threads: int) -> dict[str, Any]:
    """Solve once; return CPU and wall seconds and the iterations of each net."""
    from volatool.dem.fit import solve_nets
    from volatool.emap.system import Evidence
    from volatool.emap.tuning import choose_springs

    spacing = math.sqrt(n * n / len(points))
    nets = choose_springs(1.0, spacing, preset=preset).nets
    evidence = Evidence(n, n)
    evidence.add(*np.ascontiguousarray(points.T), nets[0].springs)
    clock = time.thread_time if threads == 1 else time.process_time
    wall, cpu = time.perf_counter(), clock()
    _, infos = solve_nets(evidence, nets, 1e-4, threads=threads)
    return {
        "cpu_s": clock() - cpu,
        "wall_s": time.perf_counter() - wall,
        "iterations": [info.iterations for info in infos],
    }


def measure(points: np.ndarray, n: int, threads: list[int], runs: int) -> list[dict[str, Any]]:
    """Return a row for each solver on a grid of n x n cells; the runs of all alternate."""
    cases = [(name, k) for name in ("membrane", "blend") for k in threads]
    presets = {"membrane": "paper", "blend": "emap"}
    results: dict[tuple[str, int], list[dict[str, Any]]] = {case: [] for case in cases}
    if shutil.which("gmt"):
        results["surface -T0.35 (GMT)", 1] = []
    for _ in range(runs):
        for (name, k), found in results.items():
            if name in presets:
                found.append(solved(points, n, presets[name], k))
                continue
            with tempfile.TemporaryDirectory() as folder:
                began, wall = os.times(), time.perf_counter()
                by_gmt(points, n, Path(folder))
                cpu_s = sum(os.times()[2:4]) - sum(began[2:4])
                wall_s = time.perf_counter() - wall
                found.append({"cpu_s": cpu_s, "wall_s": wall_s, "iterations": []})
    return [
        {
            "cells": n * n,
            "solver": name,
            "threads": k,
            "cpu_us_per_cell": statistics.median(run["cpu_s"] for run in found) / (n * n) * 1e6,
            "wall_us_per_cell": statistics.median(run["wall_s"] for run in found) / (n * n) * 1e6,
            "iterations": found[0]["iterations"],
        }
        for (name, k), found in results.items()
    ]


def table(rows: list[dict[str, Any]]) -> str:
    """Return the rows as a Markdown table, with each solver's growth from its smallest grid."""
    lines = [
        "| M cells | solver | threads | CPU us / cell | growth | wall us / cell | iterations |",
        "|---:|---|---:|---:|---:|---:|---|",
    ]
    smallest: dict[tuple[str, int], float] = {}
    for row in rows:
        cost = row["cpu_us_per_cell"]
        first = smallest.setdefault((row["solver"], row["threads"]), cost)
        iterations = " + ".join(map(str, row["iterations"]))
        lines.append(
            f"| {row['cells'] / 1e6:.2f} | {row['solver']} | {row['threads']} | {cost:.2f} "
            f"| {cost / first:.2f} | {row['wall_us_per_cell']:.2f} | {iterations} |"
        )
    return "\n".join(lines)


def main() -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("tile", type=Path, nargs="?", help="LAS or LAZ with class 2")
    parser.add_argument("--millions", type=float, nargs="+", default=[0.25, 1, 4, 16])
    parser.add_argument("--threads", type=int, nargs="+", default=[1])
    parser.add_argument("--runs", type=int, default=3)
    options = parser.parse_args()
    xyz = None if options.tile is None else ground(options.tile)
    rows: list[dict[str, Any]] = []
    for preset in ("paper", "emap"):  # compiled kernels are loaded before the clock starts
        for k in options.threads:
            solved(hills(300), 300, preset, k)
    for millions in options.millions:
        n = round(math.sqrt(millions * 1e6))
        points = hills(n) if xyz is None else mirrored(xyz, float(n))
        rows += measure(points, n, options.threads, options.runs)
    print(f"{'hills' if xyz is None else options.tile.name}, median of {options.runs} runs\n")
    print(table(rows))


if __name__ == "__main__":
    main()
