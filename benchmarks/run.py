"""The whole benchmark: stages, jobs, peers and growth in one table, as ratios to the decoder.

    python benchmarks/run.py --json results.json                # all of it
    python benchmarks/run.py --only occupancy convert-everything --runs 5
    python benchmarks/run.py --check                            # against benchmarks/baseline.json
    python benchmarks/run.py --check --from results.json        # the same without measuring
    python benchmarks/run.py --quick                            # does it run? small made-up tiles

Rows of a group take turns, so that a busy minute of the machine hits all of them; numbers are
medians of turns, ratios medians of the turns' ratios.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import hot_spots
import machine
import peers
import results
from costs import Cost, run
from results import Measured
from rows import ROWS, Row, chosen

HERE = Path(__file__).resolve().parent
BASELINE = HERE / "baseline.json"
GENERATOR = HERE.parent / "data_samples" / "generate.py"
SCHEMA = 1
QUICK_POINTS = 20_000
SPARSE = "autzen-2010-oregon-10.6M.laz"
DENSE = "ahn3_cropped_1.laz"


@dataclass(frozen=True, slots=True)
class Tile:
    """An input: where it is, its points, metres per unit."""

    path: Path
    points: int
    unit_m: float


class Suite:
    """
    Runs rows and gathers what they took.

    Parameters
    ----------
    options : argparse.Namespace
        The command line.
    folder : pathlib.Path
        For outputs.
    """

    def __init__(self, options: argparse.Namespace, folder: Path) -> None:
        self.options, self.folder = options, folder
        self.work: Path = options.work
        self.sparse, self.dense = self._sources()
        self.peers = {} if options.quick else peers.found(options.open3d)
        self.tiles: dict[str, Tile] = {}
        self.measured: dict[str, Measured] = {}
        self.surfaces: list[dict[str, Any]] = []

    def run(self, rows: tuple[Row, ...]) -> None:
        """Make the tiles and run the rows, group after group."""
        names = {row.input for row in rows if row.kind not in ("derived", "surfaces")}
        self._make_tiles(sorted(names | {"100k"}))
        for group in dict.fromkeys(row.group for row in rows):
            members = [row for row in rows if row.group == group]
            say(f"{group}: {', '.join(row.name for row in members)}")
            if group == "arrays":
                self._arrays(members)
            elif group == "surfaces":
                self._surfaces()
            elif members[0].kind == "stage":
                self._stages(members)
            else:
                self._processes(members)

    def profile(self, row: Row) -> str:
        """Return the functions that a job of ours spends its time in, as a Markdown table."""
        spy = shutil.which("py-spy") or shutil.which("py-spy", path=Path(sys.executable).parent)
        if spy is None:
            sys.exit("py-spy is not installed: pip install py-spy")
        self._make_tiles(sorted({row.input, "100k"}))
        self._warm([row])
        samples = self.folder / "samples.txt"
        command = [spy, "record", "--format", "raw", "--rate", "100"]
        run([*command, "-o", str(samples), "--", *(self._command(row) or [])])
        return hot_spots.table(samples.read_text().splitlines())

    # inputs

    def _sources(self) -> tuple[Path, Path]:
        """Return the tiles that the others are made from."""
        if self.options.quick:
            made = self.work / f"town-{QUICK_POINTS}.laz"
            return (self._town(made, QUICK_POINTS),) * 2
        shared = Path(os.environ.get("VOLATOOL_SHARED", "")) / "tiles"
        sparse = self.options.tile or shared / SPARSE
        if not sparse.exists():
            say(f"no {SPARSE} in VOLATOOL_SHARED: a made-up town of 10 M points instead")
            sparse = self._town(self.work / "town-10000000.laz", 10_000_000)
        dense = shared / DENSE
        return sparse, dense if dense.exists() else self._town(
            self.work / "town-640000.laz", 640_000
        )

    def _town(self, path: Path, n_points: int) -> Path:
        if not path.exists():
            path.parent.mkdir(parents=True, exist_ok=True)
            part = path.with_name(f".{os.getpid()}-{path.name}")
            command = [sys.executable, str(GENERATOR), "town", str(part)]
            command += ["--points", str(n_points)]
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
            part.replace(path)
        return path

    def _make_tiles(self, names: list[str]) -> None:
        """Have the tiles made, in a process that may use as much memory as it likes."""
        command = [sys.executable, str(HERE / "inputs.py"), str(self.work)]
        command += [str(self.sparse), str(self.dense), *names]
        command += ["--quick"] * self.options.quick
        for told in json_lines(command):
            self.tiles[told["name"]] = Tile(Path(told["path"]), told["points"], told["unit_m"])
            say(f"tile {told['name']}: {told['points']:,} points")

    # groups

    def _stages(self, rows: list[Row]) -> None:
        """Run a group of stages in one process."""
        stages = {row.arguments: row.name for row in rows if row.kind == "stage"}
        command = [sys.executable, str(HERE / "stages.py"), str(self.tiles[rows[0].input].path)]
        command += [*stages, "--runs", str(self.options.runs)]
        command += ["--warm", str(self.tiles["100k"].path)]
        if self.options.quick:
            command += ["--solve-share", "0.002"]
        for told in json_lines(command):
            row = self.measured.setdefault(stages[told["name"]], Measured())
            row.costs.append(Cost(told["wall_s"], told["cpu_s"], told["peak_mib"]))
            row.units = told["units"]

    def _processes(self, rows: list[Row]) -> None:
        """Run a group of whole processes, turn by turn."""
        commands = {}
        for row in rows:
            if row.kind == "derived":
                continue
            one = self.measured[row.name] = Measured(units=self.tiles[row.input].points)
            command = self._command(row)
            if command is None:
                one.skipped = f"{row.arguments.split()[0]} is absent"
            else:
                commands[row.name] = command
        self._warm(rows)
        n_turns = self.options.runs
        if rows[0].group == "growth":
            n_turns = (n_turns + 1) // 2  # they take minutes
        for _ in range(n_turns):
            for name, command in commands.items():
                cost = run(command)
                assert cost is not None
                self.measured[name].costs.append(cost)

    def _command(self, row: Row) -> list[str] | None:
        """Return the command of a row, None if its program is absent."""
        tile, out = self.tiles[row.input], self.folder / row.name
        if row.arguments == "decode":
            return [sys.executable, str(HERE / "stages.py"), "--decode", str(tile.path)]
        if row.kind == "command":
            words = [w.format(tile=tile.path, out=out) for w in row.arguments.split()]
            return [sys.executable, "-m", "volatool_cli", *words]
        program, _, job = row.arguments.partition(" ")
        where = self.peers.get(program)
        return (
            None if where is None else peers.pdal_command(where, job, tile.path, out, tile.unit_m)
        )

    def _warm(self, rows: list[Row]) -> None:
        """Run each job once on a small tile, and each decoder: kernels and files are cached."""
        small = self.tiles["100k"].path
        once = {
            (row.arguments, row.input if row.arguments == "decode" else ""): row for row in rows
        }
        for row in once.values():
            if row.arguments == "decode":
                run(self._command(row) or [])
            elif row.kind == "command":
                words = [
                    word.format(tile=small, out=self.folder / "warm")
                    for word in row.arguments.split()
                ]
                run([sys.executable, "-m", "volatool_cli", *words])

    def _arrays(self, rows: list[Row]) -> None:
        """Run the libraries that make voxels of arrays."""
        points = self.folder / "points.npy"
        for row in rows:
            name = row.arguments.split()[1]
            one = self.measured[row.name] = Measured()
            where = sys.executable if name == "volatool" else self.peers.get(name)
            if where is None:
                one.skipped = f"{name} is absent"
                continue
            if not points.exists():
                tile = self.tiles[row.input].path
                run([sys.executable, str(HERE / "inputs.py"), "--npy", str(tile), str(points)])
            script = [where, str(HERE / "array_voxels.py"), name, str(points)]
            for told in json_lines([*script, str(self.options.runs)]):
                one.costs.append(Cost(told["wall_s"], told["cpu_s"], told["peak_mib"]))
                one.units = told["units"]

    def _surfaces(self) -> None:
        """Run ``dem.py``, which has the other ways to a surface."""
        one = self.measured["surfaces"] = Measured()
        if self.options.quick:
            one.skipped = "not in a quick run"
            return
        out = self.folder / "surfaces.json"
        command = [sys.executable, str(HERE / "dem.py"), str(self.dense), "--millions", "1"]
        subprocess.run(
            [*command, "--runs", str((self.options.runs + 1) // 2), "--json", str(out)],
            check=True,
            stdout=subprocess.DEVNULL,
        )
        self.surfaces = json.loads(out.read_text())

    def surface_rows(self) -> list[dict[str, Any]]:
        """Return the rows of ``dem.py`` in the form of the others."""
        found = []
        for row in self.surfaces:
            cost = None
            if "seconds" in row:
                cost = {"wall_s": row["wall_s"], "cpu_s": row["seconds"]}
                cost["peak_mib"] = row["peak_mib"]
            ours = row["method"].startswith("EMap")
            found.append(
                {
                    **dict.fromkeys(("floor", "ratios", "target", "met", "prototype")),
                    "name": "surface-"
                    + re.sub(r"[^a-z0-9.]+", "-", row["method"].lower()).strip("-"),
                    "group": "surfaces",
                    "what": f"1 M cells of 1 m from {row['points'] / 1e6:.2f} M points: "
                    + row["method"],
                    "input": self.dense.name,
                    "units": row["cells"],
                    "runs": row.get("runs", 0),
                    "median": cost,
                    "measure": "us_per_unit",
                    "reached": row.get("us_per_cell"),
                    "at_least": False,
                    "peer": not ours,
                    "skipped": row.get("note"),
                }
            )
        return found


def json_lines(command: list[str]) -> list[dict[str, Any]]:
    """Run a command that prints a JSON object a line; end with its message if it fails."""
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"{' '.join(command)}\nexit code {done.returncode}\n{done.stderr}")
    return [json.loads(text) for text in done.stdout.splitlines()]


def say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Run the suite; return the document that ``--json`` writes."""
    rows = chosen(options.only)
    before = machine.describe()
    with tempfile.TemporaryDirectory(dir=options.out) as folder:
        suite = Suite(options, Path(folder))
        suite.run(rows)
    found = results.result_rows(rows, suite.measured)
    return {
        "schema": SCHEMA,
        "machine": {**before, "load_after": machine.load()},
        "settings": {"runs": options.runs, "quick": options.quick, "only": options.only},
        "tiles": {name: tile.points for name, tile in suite.tiles.items()},
        "peers": {name: where is not None for name, where in suite.peers.items()},
        "rows": found + suite.surface_rows(),
    }


def profile(options: argparse.Namespace) -> int:
    """Print where the time of one job goes."""
    row = next((row for row in ROWS if row.name == options.profile), None)
    if row is None or row.kind != "command":
        jobs = ", ".join(row.name for row in ROWS if row.kind == "command")
        say(f"--profile takes one of {jobs}")
        return 2
    with tempfile.TemporaryDirectory(dir=options.out) as folder:
        found = Suite(options, Path(folder)).profile(row)
    print(f"{row.what} on {row.input}; {machine.line(machine.describe())}\n\n{found}")
    return 0


def check(document: dict[str, Any], path: Path, measures: list[str]) -> int:
    """Compare with the baseline; return the exit status."""
    if not path.exists():
        say(f"{path} is not there: --save-baseline writes it")
        return 2
    baseline = json.loads(path.read_text())
    if not machine.is_same(document["machine"], baseline["machine"]):
        say(f"the baseline is of another machine: {machine.line(baseline['machine'])}")
    faults = results.worse(results.baseline_of(document), baseline, measures)
    for fault in faults:
        say(f"worse: {fault}")
    say(f"{len(faults)} ratios are worse than the baseline by more than {results.TOLERANCE:.0%}")
    return 1 if faults else 0


def main() -> int:
    """Run from the command line."""
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    add = parser.add_argument
    add("--only", nargs="+", default=[], metavar="NAME", help="rows or groups, with * and ?")
    add("--runs", type=int, default=3, help="turns [3]; half of them where a row takes minutes")
    add("--tile", type=Path, help="of some 10 M points, the Autzen tile of VOLATOOL_SHARED else")
    add("--work", type=Path, default=cache / "volatool-benchmarks", help="keeps the tiles made")
    add("--out", type=Path, help="for outputs, a temporary folder by default")
    add("--open3d", metavar="PYTHON", help="an interpreter that has Open3D")
    add("--json", type=Path, metavar="FILE", help="write the numbers too")
    add("--quick", action="store_true", help="small made-up tiles, one turn, no peers")
    add("--profile", metavar="JOB", help="where a job's time goes, by py-spy, instead of the table")
    add("--check", action="store_true", help="exit 1 when a ratio is worse than the baseline")
    add(
        "--by",
        nargs="+",
        choices=results.MEASURES,
        default=list(results.MEASURES),
        help="what --check compares [all]; cpu and peak on a busy machine",
    )
    add("--from", dest="result", type=Path, metavar="FILE", help="numbers measured before")
    add("--baseline", type=Path, default=BASELINE)
    add("--save-baseline", action="store_true", help="keep the ratios as the new baseline")
    options = parser.parse_args()
    if options.quick:
        options.runs = 1
    try:
        chosen(options.only)
    except ValueError as error:
        parser.error(str(error))
    if options.profile is not None:
        return profile(options)
    if options.result is not None:
        document = json.loads(options.result.read_text())
    else:
        document = measure(options)
    print(f"{machine.line(document['machine'])}; {document['settings']['runs']} runs\n")
    print(results.table(document["rows"]))
    if options.json is not None:
        options.json.write_text(json.dumps(document, indent=2) + "\n")
    if options.save_baseline:
        text = json.dumps(results.baseline_of(document), indent=2, sort_keys=True)
        options.baseline.write_text(text + "\n")
    return check(document, options.baseline, options.by) if options.check else 0


if __name__ == "__main__":
    sys.exit(main())
