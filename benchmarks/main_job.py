"""Time ``volatool convert`` beside plain decoding of the same file: wall, CPU and peak memory.

    python benchmarks/main_job.py tile.laz --runs 5
    python benchmarks/main_job.py --points 10000000

Each run is a process of its own; the jobs take turns, so that a busy minute of the machine hits all
of them; the table has medians. Nothing else should run meanwhile: the load is printed too.
"""

from __future__ import annotations

import argparse
import os
import platform
import shlex
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

HERE = Path(__file__).resolve()
GENERATOR = HERE.parents[1] / "data_samples" / "generate.py"
OCCUPANCY_ONLY = "--no-dem --meta none --dense never --no-gzip"
FLOOR = "decode only (lazrs, parallel, xyz)"


@dataclass(frozen=True)
class Cost:
    """What one process took."""

    wall_s: float
    cpu_s: float
    peak_mib: float


def run(command: list[str], allowed: tuple[int, ...] = ()) -> Cost | None:
    """
    Run a command and measure it.

    Parameters
    ----------
    command : list of str
        Program and arguments.
    allowed : tuple of int
        Exit codes, besides 0, that don't end the benchmark.

    Returns
    -------
    cost : Cost
        Wall time from start to end, user and system time, and peak resident memory of the process
        itself and of those it has waited for. None after one of the allowed codes.
    """
    start = time.perf_counter()
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) as child:
        assert child.stderr is not None
        message = child.stderr.read()
        _, status, usage = os.wait4(child.pid, 0)
        wall = time.perf_counter() - start
        child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode in allowed:
        return None
    if child.returncode:
        sys.exit(f"{shlex.join(command)}\nexit code {child.returncode}\n{message.decode()}")
    unit = 2**20 if sys.platform == "darwin" else 2**10
    return Cost(wall, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / unit)


def decode(path: Path) -> int:
    """Decode the coordinates of a file and nothing else; the floor of all that reads it."""
    import laspy

    selection = laspy.DecompressionSelection.XY_RETURNS_CHANNEL | laspy.DecompressionSelection.Z
    total = 0
    with laspy.open(
        path, laz_backend=laspy.LazBackend.LazrsParallel, decompression_selection=selection
    ) as reader:
        for points in reader.chunk_iterator(500_000):
            total += len(points.X) + 0 * int(points.Y[0]) * int(points.Z[0])
    return total


def median(costs: list[Cost]) -> Cost:
    """Return the median of each number."""
    return Cost(
        *(statistics.median(getattr(c, name) for c in costs) for name in Cost.__dataclass_fields__)
    )


def table(results: dict[str, list[Cost]], n_points: int) -> str:
    """Return the medians as a Markdown table, with ratios to the decode-only process."""
    lines = [
        "| job | wall s (min to max) | wall / decode | CPU s | CPU / decode "
        "| peak MiB | M points/s |",
        "|---|---|---:|---:|---:|---:|---:|",
    ]
    floor = median(results[FLOOR])
    for job, costs in results.items():
        cost, walls = median(costs), [c.wall_s for c in costs]
        lines.append(
            f"| {job} | {cost.wall_s:.2f} ({min(walls):.2f} to {max(walls):.2f}) "
            f"| {cost.wall_s / floor.wall_s:.2f} | {cost.cpu_s:.2f} "
            f"| {cost.cpu_s / floor.cpu_s:.2f} | {cost.peak_mib:.0f} "
            f"| {n_points / cost.wall_s / 1e6:.2f} |"
        )
    return "\n".join(lines)


def main() -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("tile", nargs="?", type=Path)
    parser.add_argument("--points", type=int, default=2_000_000, help="size of a made-up town")
    parser.add_argument("--runs", type=int, default=3, help="of each job")
    parser.add_argument(
        "--job",
        action="append",
        metavar="OPTIONS",
        help="options of `volatool convert` to time; may be repeated "
        f"[default: '' and '{OCCUPANCY_ONLY}']",
    )
    parser.add_argument("--decode-one", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.decode_one is not None:
        decode(options.decode_one)
        return

    import laspy

    with tempfile.TemporaryDirectory() as folder:
        tile = options.tile
        if tile is None:
            tile = Path(folder) / "town.laz"
            make = [sys.executable, str(GENERATOR), "town", str(tile)]
            subprocess.run([*make, "--points", str(options.points)], check=True)
        with laspy.open(tile) as reader:
            n_points = reader.header.point_count
        jobs = {FLOOR: [sys.executable, str(HERE), "--decode-one", str(tile)]}
        convert = [sys.executable, "-m", "volatool_cli", "convert", str(tile), "--overwrite", "-q"]
        for extra in options.job or ["", OCCUPANCY_ONLY]:
            out = str(Path(folder) / f"out{len(jobs)}")
            jobs[f"`convert {extra}`".replace(" `", "`")] = [
                *convert,
                "-o",
                out,
                *shlex.split(extra),
            ]
        for command in jobs.values():  # file cache and kernel cache are warm afterwards
            run(command)
        results: dict[str, list[Cost]] = {job: [] for job in jobs}
        for _ in range(options.runs):
            for job, command in jobs.items():
                results[job].append(run(command))
    load = ", ".join(f"{value:.1f}" for value in os.getloadavg())
    size = f"{n_points:,} points"
    print(f"{tile.name}, {size}, {options.runs} runs, {os.cpu_count()} cores, load {load},")
    print(f"Python {platform.python_version()}, {platform.system()} {platform.machine()}\n")
    print(table(results, n_points))


if __name__ == "__main__":
    main()
