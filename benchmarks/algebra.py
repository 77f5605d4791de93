"""Time union, differences and `diff` of volumes beside numpy's set operations on path keys.

    python benchmarks/algebra.py tile.laz --depth 5
    python benchmarks/algebra.py --made 6

Two volumes of one grid: of a tile the points with even and with odd numbers, or two made surfaces
of 4**N x 4**N columns. A block is a stored word of either volume, at all levels; CPU time of one
process, best of the runs, kernels warm. `keys` sorts nothing: numpy gets the keys of the deepest
voxels, distinct and sorted, which an implementation without words would have to keep.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import volatool as vt
from volatool.cube import Cube
from volatool.vola import algebra
from volatool.vola.build import from_keys
from volatool.vola.diff import diff
from volatool.vola.volume import Volume, VolumeInfo


def of_tile(path: Path, depth: int) -> tuple[Volume, Volume]:
    """Return the volumes of every second point of a tile, from the first and from the second."""
    with tempfile.TemporaryDirectory() as folder:
        report = vt.convert(path, folder, depth=depth, dem=False, dense="never")
        whole = vt.open(report.paths[0])
    halves = []
    for first in (0, 1):
        builder = vt.VolaBuilder(
            whole.cube, depth, channels=("height",), z_ratio=whole.crs.z_ratio, crs=whole.crs
        )
        for chunk in vt.stream(path):
            builder.add(chunk.take(slice(first, None, 2)))
        halves.append(builder.finish(depth=depth))
    return halves[0], halves[1]


def made(depth: int) -> tuple[Volume, Volume]:
    """Return two rough surfaces that share about half of their voxels."""
    from volatool.kernels.quantize import cell_keys

    size = 4**depth
    x, y = np.meshgrid(np.arange(size), np.arange(size))
    volumes = []
    for seed in (1, 2):
        rough = np.random.default_rng(seed).integers(0, 2, x.shape)
        z = size / 4 + size / 20 * (np.sin(x / 300) + np.cos(y / 411)) + rough
        cells = np.column_stack([x.ravel(), y.ravel(), z.astype(np.int32).ravel()])
        keys = cell_keys(cells.astype(np.int32))
        volumes.append(from_keys(keys, depth, Cube((0.0, 0.0, 0.0), float(size)), VolumeInfo()))
    return volumes[0], volumes[1]


def best(job: Callable[[], Any], runs: int) -> float:
    """Return the least CPU seconds of some runs, after one that does not count."""
    job()
    seconds = []
    for _ in range(runs):
        start = time.process_time()
        job()
        seconds.append(time.process_time() - start)
    return min(seconds)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("tile", nargs="?", type=Path)
    parser.add_argument("--depth", type=int, default=5)
    parser.add_argument("--made", type=int, help="depth of made surfaces")
    parser.add_argument("--runs", type=int, default=5)
    options = parser.parse_args()
    if options.tile is None and options.made is None:
        parser.error("give a tile or --made N")
    a, b = made(options.made) if options.tile is None else of_tile(options.tile, options.depth)
    n_blocks = sum(len(words) for volume in (a, b) for words in volume.levels)
    plain = [Volume(volume.levels, None, volume.cube, volume.info) for volume in (a, b)]
    left, right = a.keys(), b.keys()
    print(f"a {a}\nb {b}\n{n_blocks:,} blocks, {len(a) + len(b):,} voxels\n")
    jobs: dict[str, Callable[[], Any]] = {
        f"a {sign} b": (lambda op=op: algebra.combine(*plain, op))
        for op, sign in (("or", "|"), ("and", "&"), ("xor", "^"), ("sub", "-"))
    }
    if a.has_metadata:
        jobs["a | b with metadata"] = lambda: a | b
    found = diff(*plain)
    jobs["diff, noise 0"] = lambda: diff(*plain, noise=0)
    jobs["diff, noise 1"] = lambda: diff(*plain)
    jobs["tops of columns compared"] = found.surface
    jobs["numpy union (concatenate, sort, unique)"] = lambda: _union(left, right)
    jobs["numpy intersect1d"] = lambda: np.intersect1d(left, right, assume_unique=True)
    jobs["numpy setdiff1d"] = lambda: np.setdiff1d(left, right, assume_unique=True)
    jobs["copy of all words (memory bandwidth)"] = lambda: [
        words.copy() for volume in plain for words in volume.levels
    ]
    print(f"{'':42}{'ms':>10}{'M blocks/s':>14}{'M voxels/s':>14}")
    for name, job in jobs.items():
        seconds = best(job, options.runs)
        rates = (count / seconds / 1e6 for count in (n_blocks, len(a) + len(b)))
        print(f"{name:42}{seconds * 1e3:>10.2f}" + "".join(f"{rate:>14.1f}" for rate in rates))


def _union(left: Any, right: Any) -> Any:
    both = np.concatenate([left, right])
    both.sort(kind="stable")
    return both[np.concatenate([[True], both[1:] != both[:-1]])]


if __name__ == "__main__":
    main()
