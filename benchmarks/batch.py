"""What the batch engine costs beside the work: time and memory a tile, and of a resumed run.

    python benchmarks/batch.py                # 234,887 tiles: San Francisco in the VOLA paper
    python benchmarks/batch.py --tiles 50000 --jobs 4

The tiles are empty files and the work on them is a stub that names four outputs, so that what is
measured is the engine alone: planning, scheduling, pipes, manifest (one flush to the disk a tile)
and, in the second run, the proof from that manifest. CPU seconds are this process's own unless the
workers' are named.
"""

from __future__ import annotations

import argparse
import resource
import tempfile
import time
from pathlib import Path

from volatool.batch.executor import Executor, Serial
from volatool.batch.identity import identify
from volatool.batch.manifest import Manifest
from volatool.batch.pool import Pool
from volatool.batch.run import run_inputs
from volatool.batch.work import Output, Result, Unit
from volatool.model import Progress
from volatool.options import ConvertOptions
from volatool.report import Report
from volatool.resources import peak_rss_bytes, rss_bytes

SUFFIXES = (".vol.gz", ".dvol.gz", ".dem.tif", ".stats.json")


def stub(unit: Unit, progress: Progress) -> Result:
    """Return a result like that of a tile: four outputs, a report of 8 levels, two events."""
    progress(1, 2)
    progress(2, 2)
    assert unit.outdir is not None
    outputs = tuple(
        Output(unit.outdir / (unit.path.stem + suffix), 0, "0" * 64) for suffix in SUFFIXES
    )
    level = {f"number_{k}": k / 7 for k in range(15)} | {"occupancy_histogram": [9] * 65}
    report = Report(status="ok", input={"name": unit.path.name}, levels=[level] * 8)
    return Result(unit.index, report, identify(unit.path), outputs, 0.001)


def main() -> None:
    """Run the engine twice and print what it took."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--tiles", type=int, default=234_887)
    parser.add_argument("--jobs", type=int, default=2, help="1: no workers")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "out").mkdir()
        paths = [folder / f"tile_{k:06}.laz" for k in range(arguments.tiles)]
        for path in paths:
            path.touch()
        base = rss_bytes()
        pool = Pool(arguments.jobs, work=stub) if arguments.jobs > 1 else Serial(stub)
        print(f"{arguments.tiles:,} tiles, {arguments.jobs} worker(s)")
        report(run(paths, folder, pool, resume=False), "first run", arguments.tiles, base)
        for path in paths:
            for suffix in SUFFIXES:
                (folder / "out" / (path.stem + suffix)).touch()
        report(run(paths, folder, pool, resume=True), "resumed run", arguments.tiles, base)
        size = (folder / "run.jsonl").stat().st_size
        print(f"manifest: {size / 1e6:.0f} MB, {size / arguments.tiles:.0f} bytes a tile")


def run(
    paths: list[Path], folder: Path, executor: Executor, *, resume: bool
) -> tuple[float, float, float]:
    """Return wall seconds, CPU seconds of this process, and of its children."""
    begun, used, below = time.perf_counter(), time.process_time(), children_s()
    with Manifest(folder / "run.jsonl") as manifest:
        results = run_inputs(
            paths,
            ConvertOptions(),
            kind="convert",
            outdir=folder / "out",
            executor=executor,
            manifest=manifest,
            resume=resume,
        )
        done = sum(1 for _ in results)
    assert done == (0 if resume else len(paths))
    return time.perf_counter() - begun, time.process_time() - used, children_s() - below


def children_s() -> float:
    """Return the CPU seconds of the children that have ended."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def report(times: tuple[float, float, float], what: str, n_tiles: int, base: int) -> None:
    """Print a line."""
    wall, own, children = times
    peak = peak_rss_bytes()
    print(
        f"{what}: {wall:.1f} s wall, {own:.1f} s CPU here ({1e3 * own / n_tiles:.3f} ms a tile), "
        f"{children:.1f} s in workers; peak {peak / 1e6:.0f} MB here, "
        f"{(peak - base) / n_tiles:.0f} bytes a tile over {base / 1e6:.0f} MB"
    )


if __name__ == "__main__":
    from batch import main as run_main  # the stub's module has a name that workers can import

    run_main()
