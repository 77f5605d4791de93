"""One large file on many cores: its chunks shared out to processes, against one process.

    python benchmarks/cores.py tile.laz --runs 3

Two designs make the sorted cells of an occupancy volume of one LAZ file:

- ``threads``: what volatool does. One process; the decoder has a thread a core, points are split,
  counted and given to the builder by one thread each.
- ``processes``: a process a core, each with a range of the chunk table, one decoder thread and a
  builder of its own; their sorted cells go through files to the parent, which merges them.

Both run here with the cores at hand. Their parts are timed in CPU seconds, the merges for each
number of processes on the real cells, and from these the wall time on more cores is worked out.
Neither memory bandwidth nor the disk is part of that: it is the best that a design can do.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

RANGES = 32
"""Parts that the chunk table is cut into; numbers of processes divide it."""

CORES = (1, 2, 4, 8, 16, 32)
DEPTH = 8

Keys = NDArray[np.uint64]


@dataclass(slots=True)
class Parts:
    """CPU seconds of the parts of reading a range; `serial` is what follows each batch decoded."""

    decode: float = 0.0
    serial: float = 0.0
    build: float = 0.0
    sort: float = 0.0


def read_range(path: Path, start: int, stop: int, out: Path) -> Parts:
    """Read parts `start` to `stop` of the chunk table and save the sorted cells of each."""
    from volatool.census import Census, area_cell_for, box_corners, header_box
    from volatool.cube import Cube
    from volatool.points.reader import open_points
    from volatool.vola.builder import VolaBuilder

    parts = Parts()
    with open_points(path) as source:
        box = header_box(source.header.box, source.header.scale, source.header.offset)
        if source._laz is None or not source._laz.chunks or box is None:
            raise SystemExit(f"{path}: not a LAZ file with a chunk table and a box")
        header, crs = source.header, source.crs
        cube = Cube.around(box_corners(box, header.scale, header.offset, crs.z_ratio))
        chunks = source._laz.chunks
        edges = np.linspace(0, len(chunks), RANGES + 1).astype(int)
        area = area_cell_for(box, header.scale, crs.metres_per_unit_xy)
        for part in range(start, stop):
            wanted = {chunk.at for chunk in chunks[edges[part] : edges[part + 1]]}
            source._unwanted = frozenset(chunk.at for chunk in chunks) - wanted
            builder = VolaBuilder(cube, DEPTH, z_ratio=crs.z_ratio)
            census = Census(box, area)
            points = source.chunks(("classification", "return_number"))
            mark = time.process_time()
            decoding = _Decoding()
            with decoding:
                for chunk in points:
                    census.add(chunk, None)
                    parts.serial += time.process_time() - mark
                    mark = time.process_time()
                    builder.add(chunk)
                    parts.build += time.process_time() - mark
                    mark = time.process_time()
            parts.serial -= decoding.seconds
            parts.decode += decoding.seconds
            mark = time.process_time()
            np.save(out / f"{part}.npy", _joined(builder._drained_keys()))
            parts.sort += time.process_time() - mark
            builder.close()
    return parts


class _Decoding:
    """Counts the CPU time that the decoder takes of that of the reader."""

    def __enter__(self) -> None:
        from volatool.points import laz

        self.seconds = 0.0
        self._plain = plain = laz.decode_chunks

        def timed(*arguments: object) -> None:
            mark = time.process_time()
            plain(*arguments)  # type: ignore[arg-type]
            self.seconds += time.process_time() - mark

        laz.decode_chunks = timed  # type: ignore[assignment]

    def __exit__(self, *_: object) -> None:
        from volatool.points import laz

        laz.decode_chunks = self._plain


def _joined(pieces: Iterator[Keys]) -> Keys:
    found = [piece.copy() for piece in pieces]
    return np.concatenate(found) if found else np.empty(0, np.uint64)


def merge(runs: list[Keys]) -> Keys:
    """Return the sorted cells of sorted runs, merged as a tree."""
    from volatool.kernels import levels

    while len(runs) > 1:
        runs = [
            levels.merge_keys(*runs[k : k + 2]) if k + 1 < len(runs) else runs[k]
            for k in range(0, len(runs), 2)
        ]
    return runs[0]


def in_processes(
    path: Path, n: int, out: Path, threads: int = 1
) -> tuple[float, list[Parts], float]:
    """Read the file with `n` processes; return wall seconds, their parts, and start-up seconds."""
    width = RANGES // n
    command = [sys.executable, __file__, str(path)]
    environment = {**os.environ, "RAYON_NUM_THREADS": str(threads)}
    started = time.perf_counter()
    workers = [
        subprocess.Popen(
            [*command, "--part", str(k * width), str((k + 1) * width), "--out", str(out)],
            stdout=subprocess.PIPE,
            env=environment,
            text=True,
        )
        for k in range(n)
    ]
    told = [worker.communicate()[0] for worker in workers]
    wall = time.perf_counter() - started
    if any(worker.returncode for worker in workers):
        raise SystemExit("a worker failed")
    numbers = [[float(word) for word in text.split()] for text in told]
    starts = [row[4] - sum(row[:4]) for row in numbers]
    return wall, [Parts(*row[:4]) for row in numbers], max(starts)


def predict(parts: Parts, start: float, merges: dict[int, float], fold: float) -> list[str]:
    """Return the table's rows: wall seconds of both designs by number of cores."""
    rows = ["cores  threads  processes  processes, started  of which merge"]
    for cores in CORES:
        reader = parts.decode / cores + parts.serial
        threads = max(reader, parts.build) + parts.sort + fold
        each = (parts.decode + parts.serial + parts.build + parts.sort) / cores
        processes = each + merges[cores] + fold
        rows.append(
            f"{cores:5d} {threads:8.2f} {processes:10.2f} {processes + start:19.2f} "
            f"{merges[cores]:15.2f}"
        )
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("tile", type=Path)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--part", type=int, nargs=2, help=argparse.SUPPRESS)
    parser.add_argument("--out", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.part:
        parts = read_range(given.tile, *given.part, given.out)
        print(parts.decode, parts.serial, parts.build, parts.sort, time.process_time())
        return
    found: list[Parts] = []
    starts: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        in_processes(given.tile, 1, out)  # compiles what is not in the cache
        for _ in range(given.runs):
            for n, threads in ((1, 1), (2, 1), (1, 2)):
                wall, each, start = in_processes(given.tile, n, out, threads)
                print(
                    f"{n} process(es), {threads} decoder thread(s): wall {wall:.2f} s, "
                    f"start-up {start:.2f} CPU s"
                )
                for parts in each:
                    print(
                        f"    decode {parts.decode:.2f}, split and count {parts.serial:.2f}, "
                        f"build {parts.build:.2f}, sort and save {parts.sort:.2f} CPU s"
                    )
                starts.append(start)
                if n == threads == 1:
                    found += each
        runs = [np.load(out / f"{part}.npy") for part in range(RANGES)]
        merges, fold = _merging(runs, out)
    names = ("decode", "serial", "build", "sort")
    middle = Parts(*(statistics.median(getattr(one, name) for one in found) for name in names))
    print(f"cells: {len(merge(runs))}; medians in CPU s: {middle}, levels {fold:.2f}")
    print("\n".join(predict(middle, statistics.median(starts), merges, fold)))


def _merging(runs: list[Keys], out: Path) -> tuple[dict[int, float], float]:
    """Return the CPU time of loading and merging by number of processes, and of the levels."""
    from volatool.cube import Cube
    from volatool.vola.builder import VolaBuilder

    merge(runs)
    took = {}
    for cores in CORES:
        width = RANGES // cores
        for k in range(cores):
            np.save(out / f"joined-{k}.npy", merge(runs[k * width : (k + 1) * width]))
        mark = time.process_time()
        joined = merge([np.load(out / f"joined-{k}.npy") for k in range(cores)])
        took[cores] = time.process_time() - mark
    cube = Cube.around([Fraction(0)] * 3 + [Fraction(1)] * 3)
    for _ in range(2):  # the first loads the kernels
        with VolaBuilder(cube, DEPTH) as builder:
            builder._keys.push(joined.copy())
            mark = time.process_time()
            builder.build()
            fold = time.process_time() - mark
    return took, fold


if __name__ == "__main__":
    main()
