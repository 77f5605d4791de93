"""Kernels compiled ahead of time are those that real work needs."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from volatool.warming import PARTS

SAMPLES = Path(__file__).resolve().parents[1] / "data_samples"
CODE = "import sys; from volatool.warming import warm_kernels; print(warm_kernels(sys.argv[1:]))"
RUNS = {
    "convert": [
        ("convert", "--layers", "count,flag,distance", "--preview"),
        ("convert", "--surface", "dtm", "--split", "50m", "--no-gzip"),
        ("stats", "--meta", "none"),
        ("dem", "--cell", "2m"),
    ],
    "surfaces": [("convert", "--cell", "2m", "--layers", "sigma", "--holdout", "10", "--robust")],
}


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    """A cache filled by warming up alone: what other tests compiled is not in it."""
    folder = tmp_path_factory.mktemp("cache")
    run([sys.executable, "-c", CODE, *RUNS], folder)
    return folder


def run(command, cache, cwd=None):
    done = subprocess.run(
        command,
        cwd=cwd,
        env={**os.environ, "VOLATOOL_CACHE_DIR": str(cache)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done


def test_every_part_has_a_name_that_doctor_warms():
    assert set(RUNS) < set(PARTS)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["forest.laz", "town.laz"])
@pytest.mark.parametrize("arguments", [one for part in RUNS.values() for one in part])
def test_after_warming_up_real_tiles_compile_nothing(cache, tmp_path, name, arguments):
    shutil.copy(SAMPLES / name, tmp_path)
    before = {path: path.stat().st_mtime_ns for path in cache.rglob("*.nbc")}
    assert before
    command, *options = arguments
    more = ["--no-resources"] if command == "stats" else ["-o", "out"]
    run(
        [sys.executable, "-m", "volatool_cli", command, name, "-q", *options, *more],
        cache,
        tmp_path,
    )
    after = {path: path.stat().st_mtime_ns for path in cache.rglob("*.nbc")}
    compiled = sorted(path.name for path in after if after[path] != before.get(path))
    assert compiled == []
