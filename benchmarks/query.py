"""How fast volumes answer: points per second beside OctoMap and Open3D, and other rates.

One table, as Markdown. Rows are in `RATES`: add yours there.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib.util
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

import volatool as vt

RIVAL = Path(__file__).with_name("query_rival.py")
Job = tuple[Callable[[], Any], float]
"""What to run, and how many of its unit are done."""


def tile_parser(text: str | None) -> argparse.ArgumentParser:
    """Return a parser of a tile and how it is to be made a volume."""
    shared = os.environ.get("VOLATOOL_SHARED")
    parser = argparse.ArgumentParser(description=text)
    parser.add_argument(
        "tile",
        nargs="?",
        type=Path,
        default=shared and Path(shared) / "tiles" / "ahn3_cropped_1.laz",
        help="LAS, LAZ or VOLA; by default the Delft tile in VOLATOOL_SHARED",
    )
    parser.add_argument("--depth", type=int, default=5)
    parser.add_argument("--crs", help="of a tile that has none")
    return parser


def parsed(parser: argparse.ArgumentParser) -> argparse.Namespace:
    """Return the arguments, which must name a tile."""
    arguments = parser.parse_args()
    if not arguments.tile:
        parser.error("give a tile, or set VOLATOOL_SHARED")
    return arguments


def made_volume(tile: Path, depth: int, crs: str | None, folder: Path) -> vt.Volume:
    """Return the volume of a tile; a VOLA file as it is."""
    if ".vol" in tile.name or ".dvol" in tile.name:
        return vt.open(tile)
    options = {} if crs is None else {"crs": crs}
    report = vt.convert(tile, folder, depth=depth, dem=False, dense="never", **options)
    return vt.open(next(path for path in report.paths if ".vol" in Path(path).name))


def chosen_points(volume: vt.Volume, n: int, rng: np.random.Generator) -> np.ndarray:
    """Half somewhere in voxels, half anywhere in their box, in random order."""
    centers = volume.centers()
    size = volume.cell() * np.array([1, 1, 1 / float(volume.crs.z_ratio)])
    inside = centers[rng.integers(0, len(centers), n // 2)]
    inside += (rng.random(inside.shape) - 0.5) * 0.98 * size
    box = np.stack([centers.min(0), centers.max(0)])
    anywhere = box[0] + rng.random((n - n // 2, 3)) * (box[1] - box[0])
    return np.ascontiguousarray(rng.permutation(np.vstack([inside, anywhere])))


def points_per_second(volume: vt.Volume, rng: np.random.Generator, n: int) -> Job:
    points = chosen_points(volume, n, rng)
    return lambda: volume.contains(points), n


def rays(volume: vt.Volume, rng: np.random.Generator, n: int) -> Job:
    """From a place above the middle, in all directions downwards."""
    n //= 5
    centers = volume.centers()
    origin = centers.mean(0)
    origin[2] = centers[:, 2].max()
    directions = rng.normal(size=(n, 3))
    directions[:, 2] = -np.abs(directions[:, 2]) * 0.5
    return lambda: volume.ray(origin, directions), n


def sights(volume: vt.Volume, rng: np.random.Generator, n: int) -> Job:
    """Between voxels, at random."""
    n //= 5
    centers = volume.centers()
    a, b = centers[rng.integers(0, len(centers), (2, n))]
    return lambda: volume.sight(a, b, ignore_ends=True), n


def columns(volume: vt.Volume, rng: np.random.Generator, n: int) -> Job:
    n //= 5
    centers = volume.centers()[:, :2]
    xy = centers.min(0) + rng.random((n, 2)) * np.ptp(centers, axis=0)
    return lambda: volume.columns(xy), n


def neighbours(exact: bool) -> Callable[[vt.Volume, np.random.Generator, int], Job]:
    def job(volume: vt.Volume, rng: np.random.Generator, n: int) -> Job:
        from volatool.vola.neighbours import count_cells

        cells = volume.voxels().astype(np.int64)
        return lambda: count_cells(volume, cells, exact=exact), len(cells)

    return job


def census(volume: vt.Volume, rng: np.random.Generator, n: int) -> Job:
    return lambda: volume.census(bands=[-np.inf, 0.0, np.inf]), volume.n_blocks()


def components(connectivity: int) -> Callable[[vt.Volume, np.random.Generator, int], Job]:
    return lambda volume, rng, n: (lambda: volume.components(connectivity), volume.n_blocks())


def clearances(volume: vt.Volume, rng: np.random.Generator, n: int) -> Job:
    n //= 5
    points = chosen_points(volume, n, rng)
    return lambda: volume.clearance(points), n


RATES: list[tuple[str, str, Callable[[vt.Volume, np.random.Generator, int], Job]]] = [
    ("point", "points", points_per_second),
    ("ray, first voxel", "rays", rays),
    ("line of sight", "pairs", sights),
    ("column", "columns", columns),
    ("26 neighbours, exact", "voxels", neighbours(exact=True)),
    ("26 neighbours, by block", "voxels", neighbours(exact=False)),
    ("census of all", "blocks", census),
    ("components, 6-connected", "blocks", components(6)),
    ("components, 26-connected", "blocks", components(26)),
    ("clearance", "points", clearances),
]
"""Name, unit, and what makes the job from volume, generator and number of points."""


def cpu_seconds(run: Callable[[], Any]) -> float:
    start = time.process_time()
    run()
    return time.process_time() - start


@contextlib.contextmanager
def rival(name: str, interpreter: str, data: Path) -> Iterator[subprocess.Popen[str] | None]:
    """Another library in a process of its own, waiting for lines."""
    process = subprocess.Popen(
        [interpreter, str(RIVAL), name, str(data)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    try:
        yield process
    finally:
        with contextlib.suppress(BrokenPipeError):
            process.communicate()


def against_rivals(
    volume: vt.Volume, n: int, runs: int, interpreters: dict[str, str | None], folder: Path
) -> dict[str, Any]:
    """Take turns with the other libraries over the same voxels and points."""
    points = chosen_points(volume, n, np.random.default_rng(1))
    unit = np.array([1, 1, float(volume.crs.z_ratio)])
    corner = np.array(volume.cube.origin)
    data = folder / "query.npz"
    np.savez(
        data,
        voxels=volume.centers() * unit - corner,
        points=points * unit - corner,
        cell=volume.cell(),
        size=4**volume.depth,
    )
    n_found = int(volume.contains(points).sum())
    own: list[float] = []
    result: dict[str, Any] = {"points": n, "found": n_found, "rivals": []}
    with contextlib.ExitStack() as stack:
        others = []
        for name, interpreter in interpreters.items():
            if interpreter is None:
                print(f"{name} is not installed: skipped", file=sys.stderr)
                continue
            process = stack.enter_context(rival(name, interpreter, data))
            title = process.stdout.readline().strip()
            if not title:
                print(f"{name} does not run in {interpreter}: skipped", file=sys.stderr)
                continue
            record: dict[str, Any] = {"name": title, "seconds": [], "differ": 0}
            others.append((process, record))
            result["rivals"].append(record)
        for _ in range(runs):
            own.append(cpu_seconds(lambda: volume.contains(points)))
            for process, record in others:
                process.stdin.write("go\n")
                process.stdin.flush()
                seconds, found = process.stdout.readline().split()
                record["seconds"].append(float(seconds))
                record["differ"] = max(record["differ"], abs(int(found) - n_found))
    result["seconds"] = statistics.median(own)
    for record in result["rivals"]:
        record["seconds"] = statistics.median(record["seconds"])
        record["ratio"] = record["seconds"] / result["seconds"]
    return result


def rates(volume: vt.Volume, n: int, runs: int) -> list[dict[str, Any]]:
    """Time every row of `RATES`."""
    rows = []
    for name, unit, make in RATES:
        run, amount = make(volume, np.random.default_rng(2), n)
        run()
        seconds = statistics.median(cpu_seconds(run) for _ in range(runs))
        rows.append({"name": name, "unit": unit, "amount": amount, "seconds": seconds})
    return rows


def show(result: dict[str, Any]) -> None:
    points = result["point"]
    print(f"{result['volume']}\n")
    print("| what | million a second | ns each | volatool is faster by |")
    print("|---|---:|---:|---:|")
    for record in points["rivals"]:
        ns = 1e9 * record["seconds"] / points["points"]
        note = f", {record['differ']} answers differ" if record["differ"] else ""
        print(
            f"| point: {record['name']}{note} | {1e3 / ns:.2f} | {ns:.1f} | {record['ratio']:.1f} |"
        )
    for row in result["rates"]:
        seconds = points["seconds"] if row["name"] == "point" else row["seconds"]
        ns = 1e9 * seconds / row["amount"]
        print(f"| {row['name']} ({row['unit']}) | {1e3 / ns:.2f} | {ns:.1f} | |")


def main() -> None:
    parser = tile_parser(__doc__)
    parser.add_argument("--points", type=int, default=1_000_000)
    parser.add_argument("--runs", type=int, default=9)
    parser.add_argument("--open3d", metavar="PYTHON", help="an interpreter that has open3d")
    parser.add_argument("--json", action="store_true")
    arguments = parsed(parser)

    def here(package: str) -> str | None:
        return sys.executable if importlib.util.find_spec(package) else None

    interpreters = {"octomap": here("pyoctomap"), "open3d": arguments.open3d or here("open3d")}
    with tempfile.TemporaryDirectory() as name:
        volume = made_volume(arguments.tile, arguments.depth, arguments.crs, Path(name))
        result = {
            "volume": f"{arguments.tile.name}: {volume!r}",
            "point": against_rivals(
                volume, arguments.points, arguments.runs, interpreters, Path(name)
            ),
            "rates": rates(volume, arguments.points, arguments.runs),
        }
    if arguments.json:
        print(json.dumps(result, indent=2))
    else:
        show(result)


if __name__ == "__main__":
    main()
