"""The kernels' own cache: safe for processes that start together, done without if need be."""

from __future__ import annotations

import os
import subprocess
import sys

CODE = """
import numpy as np
from volatool.kernels import levels, quantize
keys = np.array([0, 0, 7, 63, 64], np.uint64)
print(quantize.key_cells(keys, 2).tolist(), levels.drop_repeats(keys))
"""
EXPECTED = "[[0, 0, 0], [0, 0, 0], [3, 1, 0], [3, 3, 3], [4, 0, 0]] 4"


def start(folder):
    return subprocess.Popen(
        [sys.executable, "-c", CODE],
        env={**os.environ, "VOLATOOL_CACHE_DIR": str(folder)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def ends_well(process):
    stdout, stderr = process.communicate(timeout=120)
    return (process.returncode, stdout.strip(), stderr) == (0, EXPECTED, "")


def test_processes_that_start_together_on_an_empty_cache_agree(tmp_path):
    assert all([ends_well(process) for process in [start(tmp_path) for _ in range(4)]])
    compiled = sorted(tmp_path.rglob("*.nbc"))
    assert compiled
    times = [path.stat().st_mtime_ns for path in compiled]
    assert ends_well(start(tmp_path))  # from the cache: nothing is compiled again
    assert [path.stat().st_mtime_ns for path in sorted(tmp_path.rglob("*.nbc"))] == times


def test_without_a_writable_folder_kernels_compile_in_memory(tmp_path):
    (tmp_path / "file").touch()
    assert ends_well(start(tmp_path / "file"))


def test_importing_the_kernels_compiles_nothing(tmp_path):
    code = "from volatool.kernels import levels, quantize, reduce, spring, multigrid, words"
    environment = {**os.environ, "VOLATOOL_CACHE_DIR": str(tmp_path)}
    subprocess.run([sys.executable, "-c", code], env=environment, check=True)
    assert not list(tmp_path.rglob("*.nbc"))
