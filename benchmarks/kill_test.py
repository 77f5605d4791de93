"""Kill a batch at random moments, resume it, and hold the outputs against an undisturbed run's.

    python benchmarks/kill_test.py                          # 1,000 made-up tiles, ten kills
    python benchmarks/kill_test.py --tiles 60 --real DIR --kills 4

SIGKILL goes to the parent and to one of its workers in turn. After a killed parent the same command
is started again at once. At the end each tile must have exactly one record that says ok, the
folders must be the same to the byte, and nothing else may lie about.
"""

from __future__ import annotations

import argparse
import hashlib
import itertools
import os
import random
import re
import signal
import struct
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from volatool.batch.manifest import read_records

SAMPLES = Path(__file__).resolve().parents[1] / "data_samples"
OPTIONS = ("--no-resources", "-q")


@dataclass
class Story:
    """What happened to a batch."""

    kills: list[str] = field(default_factory=list)
    n_starts: int = 0
    peak_parent_bytes: int = 0
    n_records: int = 0
    faults: list[str] = field(default_factory=list)


def make_tiles(folder: Path, n_tiles: int, n_points: int = 20_000) -> list[Path]:
    """Write copies of two generated tiles, each moved to a place of its own."""
    sys.path.insert(0, str(SAMPLES))
    import generate

    folder.mkdir(parents=True, exist_ok=True)
    bases = []
    for kind in ("town", "forest"):
        path = folder / f"base-{kind}.laz"
        generate.generate(kind, path, n_points)
        bases.append(path.read_bytes())
        path.unlink()
    paths = []
    for k in range(n_tiles):
        path = folder / f"made_{k:04}.laz"
        path.write_bytes(moved(bases[k % 2], 1000.0 * k))
        paths.append(path)
    return paths


def moved(laz: bytes, dx: float) -> bytes:
    """Return a LAZ file with its points moved to the east: the offset, and the header's box."""
    data = bytearray(laz)
    for at in (155, 179, 187):  # x offset, largest and smallest x
        struct.pack_into("<d", data, at, struct.unpack_from("<d", data, at)[0] + dx)
    return bytes(data)


def run_with_kills(
    tiles: Sequence[Path],
    out: Path,
    *,
    n_kills: int,
    seed: int = 0,
    jobs: int = 2,
    options: Sequence[str] = OPTIONS,
) -> Story:
    """
    Convert tiles, killed now and then, until all are done.

    Parameters
    ----------
    tiles : sequence of pathlib.Path
        The inputs.
    out : pathlib.Path
        Folder of the outputs; the manifest and the list of inputs are beside it.
    n_kills : int
        Of the parent and of a worker in turn, spread over the run.
    seed : int
        Of the moments.
    jobs : int
        Workers.
    options : sequence of str
        More for the command.

    Raises
    ------
    RuntimeError
        The command ended with another status than 0.
    """
    chance, story = random.Random(seed), Story()
    names, manifest = out.with_suffix(".txt"), out.with_suffix(".jsonl")
    names.write_text("".join(f"{tile}\n" for tile in tiles))
    command = [sys.executable, "-m", "volatool_cli", "convert", f"@{names}", "-o", str(out)]
    command += ["-j", str(jobs), "--manifest", str(manifest), "--resume", *options]
    # none so late that the run is over before it comes
    last = len(tiles) - min(len(tiles) // 2, 20)
    longest_wait = min(1.0, len(tiles) / 200)
    moments = sorted(chance.randrange(last) for _ in range(n_kills))
    victims = itertools.cycle(("parent", "worker"))
    parent = _start(command, story)
    for moment in moments:
        _watch(parent, story, lambda n=moment: _n_records(manifest) >= n)
        delay = time.monotonic() + chance.uniform(0, longest_wait)
        _watch(parent, story, lambda end=delay: time.monotonic() >= end)
        victim = next(victims)
        if parent.poll() is None:
            pids = [parent.pid] if victim == "parent" else workers_of(parent.pid)
            if pids:
                os.kill(chance.choice(pids), signal.SIGKILL)
                story.kills.append(f"{victim} after {_n_records(manifest)} records")
        if victim == "parent" and parent.wait() == -signal.SIGKILL:
            parent = _start(command, story)
    _watch(parent, story, lambda: False)
    if parent.returncode:
        raise RuntimeError(f"the run ended with status {parent.returncode}")
    _judge(tiles, out, manifest, story)
    return story


def _start(command: list[str], story: Story) -> subprocess.Popen[bytes]:
    story.n_starts += 1
    return subprocess.Popen(command, stdout=subprocess.DEVNULL)


def _watch(parent: subprocess.Popen[bytes], story: Story, condition) -> None:
    """Wait for a condition or the end of the parent; keep its peak memory."""
    while parent.poll() is None and not condition():
        try:
            status = Path(f"/proc/{parent.pid}/status").read_text()
        except OSError:
            continue
        peak = re.search(r"VmHWM:\s+(\d+) kB", status)
        if peak:
            story.peak_parent_bytes = max(story.peak_parent_bytes, 1024 * int(peak[1]))
        time.sleep(0.02)


def workers_of(pid: int) -> list[int]:
    """Return the worker processes of a parent."""
    found = []
    for status in Path("/proc").glob("[0-9]*/stat"):
        try:
            ppid = int(status.read_text().rpartition(")")[2].split()[1])
            if ppid == pid and b"volatool.batch.worker" in (status.parent / "cmdline").read_bytes():
                found.append(int(status.parent.name))
        except OSError:
            continue
    return sorted(found)


def _n_records(manifest: Path) -> int:
    return manifest.read_bytes().count(b"\n") if manifest.exists() else 0


def _judge(tiles: Sequence[Path], out: Path, manifest: Path, story: Story) -> None:
    """Look for tiles that are not in the manifest exactly once, and for what lies about."""
    records = list(read_records(manifest))
    story.n_records = len(records)
    if len(records) != _n_records(manifest):
        story.faults.append("the manifest has damaged lines")
    counts = Counter(record["input"]["path"] for record in records if record["status"] == "ok")
    story.faults += [
        f"{tile}: {counts[str(tile)]} records" for tile in tiles if counts[str(tile)] != 1
    ]
    story.faults += [f"{path.name} lies about" for path in out.iterdir() if path.name[0] == "."]


def differences(one: Path, other: Path) -> list[str]:
    """Return the names of files that two folders don't both have with the same content."""
    contents = [
        {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in folder.iterdir()}
        for folder in (one, other)
    ]
    return sorted(
        name for name in contents[0] | contents[1] if contents[0].get(name) != contents[1].get(name)
    )


def main() -> int:
    """Run the big test; 1 if something is wrong."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--tiles", type=int, default=1000, help="made-up tiles")
    parser.add_argument("--points", type=int, default=20_000, help="in each of them")
    parser.add_argument("--real", type=Path, help="folder of real tiles to add")
    parser.add_argument("--kills", type=int, default=10)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--options", default="", help="more for convert")
    arguments = parser.parse_args()
    options = (*OPTIONS, *arguments.options.split())
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        tiles = make_tiles(folder / "tiles", arguments.tiles, arguments.points)
        if arguments.real:
            tiles += sorted(p for p in arguments.real.resolve().rglob("*.la[sz]"))
        stories = []
        for kind, n_kills in (("calm", 0), ("killed", arguments.kills)):
            begun = time.perf_counter()
            story = run_with_kills(
                tiles,
                folder / kind,
                n_kills=n_kills,
                seed=arguments.seed,
                jobs=arguments.jobs,
                options=options,
            )
            stories.append(story)
            print(
                f"{kind}: {len(tiles)} tiles, {story.n_starts} start(s), {story.n_records} records,"
                f" peak {story.peak_parent_bytes / 1e6:.0f} MB in the parent,"
                f" {time.perf_counter() - begun:.0f} s",
                flush=True,
            )
            for kill in story.kills:
                print(f"  killed: {kill}", flush=True)
        faults = [fault for story in stories for fault in story.faults]
        faults += [f"{name} differs" for name in differences(folder / "calm", folder / "killed")]
        print("\n".join(faults) or "the outputs are the same to the byte, each tile once")
        return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
