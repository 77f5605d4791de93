"""What holds for every command: help, statuses, streams."""

from __future__ import annotations

import shlex
import shutil
import signal
import subprocess
import sys
import time
from itertools import product
from pathlib import Path

import click
import pytest
from making_scans import npy_bytes, pcd_bytes, scan

from volatool_cli.main import cli

ROOT = Path(__file__).resolve().parents[2]
CHECKPOINTS = ROOT / "data_samples" / "town-checkpoints.csv"
VECTORS = ROOT / "docs" / "vectors"

COMMANDS = [
    "convert", "stats", "info", "dem", "check", "classify", "validate", "emap", "reproduce",
    "doctor", "export", "import", "index", "diff", "merge", "query",
    "recommend", "retile",
]  # fmt: skip


def help_of(name):
    command = cli.commands[name]
    return command.get_help(click.Context(command, info_name=name))


def test_every_command_is_there_and_both_help_flags_work(volatool):
    assert sorted(cli.commands) == sorted(COMMANDS)
    for flag in ("-h", "--help"):
        done = volatool("convert", flag)
        assert (done.returncode, done.stderr) == (0, "")
        assert "Examples:" in done.stdout


def test_help_loads_neither_numpy_nor_numba_nor_rasterio():
    code = (
        "import sys\nfrom volatool_cli.main import cli\n"
        "try: cli(['convert', '--help'])\nexcept SystemExit: pass\n"
        "heavy = {'numpy', 'numba', 'rasterio', 'laspy', 'pyproj'} & set(sys.modules)\n"
        "sys.exit(f'loaded {heavy}' if heavy else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_without_a_command_the_help_goes_to_stderr_with_status_2(volatool):
    done = volatool()
    assert (done.returncode, done.stdout) == (2, "")
    assert "Usage: volatool" in done.stderr


def test_the_version_is_told(volatool):
    from volatool import __version__

    assert volatool("--version").stdout.strip() == f"volatool, version {__version__}"


@pytest.mark.parametrize("name", COMMANDS)
def test_every_option_says_what_it_does(name):
    for parameter in cli.commands[name].params:
        if isinstance(parameter, click.Option):
            assert parameter.help, parameter.name


@pytest.mark.parametrize("name", COMMANDS)
def test_the_examples_of_the_help_run(name, volatool):
    """Each example, with the names of the sample tiles in place of its own."""
    folder = volatool.folder
    (folder / "tile.laz").symlink_to(folder / "forest.laz")
    (folder / "tiles").mkdir()
    (folder / "tiles" / "one.laz").symlink_to(folder / "forest.laz")
    if name == "check":
        assert volatool("dem", "town.laz", "-q", "--layers", "flag").returncode == 0
        for suffix in (".dem.tif", ".dem.flag.tif"):
            (folder / f"town{suffix}").rename(folder / f"tile{suffix}")
        (folder / "checkpoints.csv").symlink_to(CHECKPOINTS)
    if name in ("info", "validate", "stats", "dem", "export", "query"):
        assert volatool("convert", "tile.laz", "-q").returncode == 0
        for made in folder.glob("tile.dem*") if name == "dem" else ():
            made.unlink()
    if name == "import":
        for suffix, separator in ((".xyz", " "), (".csv", ",")):
            rows = (separator.join(map(str, (k, k % 7, k % 3, 9, 5))) for k in range(40))
            (folder / f"cloud{suffix}").write_text("\n".join(rows))
        (folder / "scan.npy").write_bytes(npy_bytes(scan()))
    if name in ("recommend", "retile"):
        done = volatool("stats", "tile.laz", "--summary", "--format", "json")
        (folder / "dataset.json").write_text(done.stdout)
    if name == "index":
        done = volatool("convert", "tile.laz", "-q", "-o", "out", "--cell", "2m")
        assert done.returncode == 0, done.stderr
    if name in ("diff", "merge"):
        assert volatool("convert", "tile.laz", "-q", "--no-dem").returncode == 0
        (folder / "cubes").mkdir()
        for made in ("may", "june", "other", "cubes/a"):
            shutil.copy(folder / "tile.vol.gz", folder / f"{made}.vol.gz")
    if name == "emap":
        (folder / "scans").mkdir()
        (folder / "scans" / "0.pcd").write_bytes(pcd_bytes(scan()))
        (folder / "poses.csv").write_text("0 0 2\n")
        (folder / "names.txt").write_text("scans/0.pcd\n")
        (folder / "drive.npy").write_bytes(npy_bytes(scan()))
    block = help_of(name).split("Examples:")[1].split("Options:")[0]
    examples = [line.strip() for line in block.splitlines() if line.strip()]
    assert examples
    for number, example in enumerate(examples):
        words = shlex.split(example)
        if "-o" in words:
            place = words.index("-o") + 1
            words[place] = f"out{number}" + "".join(Path(words[place]).suffixes)
        if name == "index":
            words.append("--overwrite")
        line = " ".join(word if word in "|" else shlex.quote(word) for word in words)
        line = line.replace("volatool ", f"{shlex.quote(sys.executable)} -m volatool_cli ")
        done = subprocess.run(
            ["bash", "-c", line], cwd=folder, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, f"{example}\n{done.stderr}"
        assert done.stdout, example
        if name == "dem":
            for made in folder.glob("tile.dem*"):
                made.unlink()


def test_an_unknown_option_is_status_2_and_one_coded_line(volatool):
    done = volatool("convert", "town.laz", "--frobnicate")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("E_OPTION: ")
    assert len(done.stderr.splitlines()) == 1


def test_a_closed_stdout_is_status_141_without_a_traceback(volatool):
    command = [sys.executable, "-m", "volatool_cli", "stats", "town.laz", "--format", "json"]
    with subprocess.Popen(
        command, cwd=volatool.folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        process.stdout.close()
        stderr = process.stderr.read()
        assert process.wait(60) == 141
    assert "Traceback" not in stderr


def test_a_full_or_missing_stdout_is_told_in_one_line(volatool):
    corners = shlex.quote(str(VECTORS / "sparse3-corners.vol"))
    commands = ("stats forest.laz", f"query {corners} components")  # prints by click, and by itself
    for command, (redirect, status) in product(commands, ((">/dev/full", 5), (">&-", 0))):
        line = f"{shlex.quote(sys.executable)} -m volatool_cli {command} {redirect}"
        done = subprocess.run(
            ["bash", "-c", line], cwd=volatool.folder, capture_output=True, text=True, check=False
        )
        assert done.returncode == status, done.stderr
        assert "Traceback" not in done.stderr


def test_an_interrupt_is_status_130_and_leaves_nothing(volatool):
    command = [sys.executable, "-m", "volatool_cli", "convert", "town.laz", "-o", "out"]
    command += ["--chunk-points", "200", "--progress", "json"]
    with subprocess.Popen(
        command, cwd=volatool.folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        process.stderr.readline()  # it is reading points
        time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        _, stderr = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "Traceback" not in stderr
    out = volatool.folder / "out"
    assert not out.exists() or not list(out.iterdir())


def test_a_killed_run_leaves_no_result_and_the_next_run_cleans_up(volatool):
    out = volatool.folder / "out"
    command = [sys.executable, "-m", "volatool_cli", "convert", "town.laz", "-o", "out"]
    with subprocess.Popen(
        command, cwd=volatool.folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    ) as process:
        deadline = time.monotonic() + 60
        while not (out.exists() and any(out.iterdir())):
            assert time.monotonic() < deadline
            time.sleep(0.002)
        process.kill()
    left = [path.name for path in out.iterdir()]
    assert all(name.startswith(".") for name in left) or len(left) == 4  # none or all
    done = volatool("convert", "town.laz", "-o", "out", "--overwrite")
    assert done.returncode == 0, done.stderr
    assert not [path.name for path in out.iterdir() if path.name.startswith(".")]
