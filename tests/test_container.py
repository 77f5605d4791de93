"""
The steps of the Containerfile, run as a script.

No container engine is needed, so these are left untried: the base images, the step that installs
a Debian package as root, ``COPY`` and ``USER`` as an engine does them, and the size of the image.
The packages that volatool needs are those of the tests, not installed anew.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

TOP = Path(__file__).resolve().parents[1]


def instructions():
    """Return the instructions of the file with their arguments, in order."""
    lines = (TOP / "Containerfile").read_text(encoding="utf-8").splitlines()
    return [tuple(line.split(" ", 1)) for line in lines if line and not line.startswith("#")]


def copied_files():
    """Return what ``COPY . .`` brings into the image, by .containerignore."""
    lines = (TOP / ".containerignore").read_text(encoding="utf-8").splitlines()
    assert "*" in lines
    return [line[1:] for line in lines if line.startswith("!")]


def test_the_file_has_the_parts_that_it_should():
    steps = instructions()
    names = [name for name, _ in steps]
    assert names.count("FROM") == 2
    last = dict(steps[len(names) - 1 - names[::-1].index("FROM") :])
    assert last["USER"].split(":")[0].isdigit()
    assert int(last["USER"].split(":")[0]) > 0
    assert json.loads(last["ENTRYPOINT"]) == ["volatool"]
    assert json.loads(last["CMD"]) == ["--help"]
    assert (TOP / ".dockerignore").read_text() == (TOP / ".containerignore").read_text()


@pytest.mark.slow
def test_its_steps_make_a_volatool_that_converts(tmp_path):
    source, root = tmp_path / "src", tmp_path / "root"
    for name in copied_files():
        target = source / name
        target.parent.mkdir(parents=True, exist_ok=True)
        if (TOP / name).is_dir():
            shutil.copytree(TOP / name, target, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(TOP / name, target)
    environment = {
        "PATH": f"{tmp_path / 'base'}:{os.environ['PATH']}",
        "HOME": str(tmp_path),
        "EXTRAS": "mesh",
        **{name: value for name, value in os.environ.items() if name.startswith(("PIP_", "UV_"))},
    }
    (tmp_path / "base").mkdir()
    (tmp_path / "base" / "python").symlink_to(sys._base_executable)

    left_out = []
    for name, argument in instructions():
        here = re.sub(r"/(opt|var/cache)/volatool", rf"{root}/\1/volatool", argument)
        if name == "ENV":
            for pair in shlex.split(here):
                key, value = pair.split("=", 1)
                environment[key] = value.replace("$PATH", environment["PATH"])
        elif name == "RUN" and "apt-get" in argument:
            left_out.append(argument)
        elif name == "RUN":
            done = subprocess.run(
                ["sh", "-ec", here], cwd=source, env=environment, capture_output=True, text=True
            )
            if "pip install" in here and done.returncode and "CI" not in os.environ:
                pytest.skip(f"no registry to build from: {done.stderr.splitlines()[-1]}")
            assert done.returncode == 0, f"{here}\n{done.stderr}"
            if "venv" in here:  # what it depends on is there already
                (packages,) = (root / "opt" / "volatool").glob("lib/python3*/site-packages")
                there = sysconfig.get_path("purelib")
                (packages / "tests.pth").write_text(f"{there}\n")
    assert len(left_out) == 1

    command = root / "opt" / "volatool" / "bin" / "volatool"
    assert (root / "opt" / "volatool" / "share" / "man" / "man1" / "volatool-stats.1").is_file()
    kernels = [path for path in (root / "var/cache/volatool").rglob("*.nbi")]
    before = {path: path.stat().st_mtime_ns for path in kernels}
    assert len(before) > 50
    assert all(path.stat().st_mode & 0o006 == 0o006 for path in kernels)

    out = tmp_path / "out"
    done = subprocess.run(
        [command, "convert", TOP / "data_samples" / "town.laz", "-o", out],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert len(done.stdout.splitlines()) == 4
    now = {path: path.stat().st_mtime_ns for path in (root / "var/cache/volatool").rglob("*.nbi")}
    assert now == before  # nothing was left to compile
