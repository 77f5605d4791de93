"""The kernels' own cache: safe for processes that start together, done without if need be."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

SAMPLES = Path(__file__).resolve().parents[2] / "data_samples"

CODE = """
import numpy as np
from volatool.kernels import levels, quantize
keys = np.array([0, 0, 7, 63, 64], np.uint64)
print(quantize.key_cells(keys, 2).tolist(), levels.drop_repeats(keys))
"""
EXPECTED = "[[0, 0, 0], [0, 0, 0], [3, 1, 0], [3, 3, 3], [4, 0, 0]] 4"

FAILING = """
import numpy as np, sys
from volatool.kernels import _jit
@_jit.kernel
def broken(a):
    return a.no_such_thing()
try:
    broken(np.zeros(1))
except Exception as error:
    print(type(error).__name__, _jit._turn._depth)
"""

CALLING = """
import sys
import numpy as np
from volatool.kernels import _jit
if "refused" in sys.argv:
    def refuse(cls, codegen, state):
        raise RuntimeError("another numba")
    _jit._Library._unserialize = classmethod(refuse)
@_jit.kernel
def square(a):
    return a * a
@_jit.kernel
def sum_of_squares(a):
    total = 0.0
    for i in range(a.size):
        total += square(a[i])
    return total
if "inner" in sys.argv:
    square(2.0)
print(sum_of_squares(np.arange(4.0)), square(3.0))
(found,) = sum_of_squares.overloads.values()
print(type(found.library).__name__)
"""


def start(folder, *command):
    return subprocess.Popen(
        [sys.executable, *(command or ("-c", CODE))],
        env={**os.environ, "VOLATOOL_CACHE_DIR": str(folder)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def ends_well(process):
    stdout, stderr = process.communicate(timeout=300)
    return (process.returncode, stdout.strip(), stderr) == (0, EXPECTED, "")


def compiled(folder):
    return {path: path.stat().st_mtime_ns for path in folder.rglob("*.nbc")}


def test_processes_that_start_together_on_an_empty_cache_agree(tmp_path):
    assert all([ends_well(process) for process in [start(tmp_path) for _ in range(10)]])
    before = compiled(tmp_path)
    # each kernel was compiled by one of them, and saved once
    assert len(before) == len(list(tmp_path.rglob("*.nbi")))
    assert ends_well(start(tmp_path))  # from the cache: nothing is compiled again
    assert compiled(tmp_path) == before


@pytest.mark.slow
def test_conversions_that_start_together_on_an_empty_cache_agree(tmp_path):
    tile, cache = SAMPLES / "forest.laz", tmp_path / "cache"
    options = ("--no-dem", "--meta", "none", "--no-resources", "-q", "--depth", "3")
    processes = []
    for number in range(10):
        command = ("-m", "volatool_cli", "convert", str(tile), "-o", str(tmp_path / str(number)))
        processes.append(start(cache, *command, *options))
    for process in processes:
        _, stderr = process.communicate(timeout=600)
        assert (process.returncode, stderr) == (0, "")
    sums = {
        tuple(hashlib.sha256(path.read_bytes()).digest() for path in sorted(folder.iterdir()))
        for folder in (tmp_path / str(number) for number in range(10))
    }
    assert len(sums) == 1
    assert len(compiled(cache)) == len(list(cache.rglob("*.nbi")))


@pytest.mark.skipif(os.name == "nt", reason="folders have no such permissions")
@pytest.mark.parametrize("kind", ["a file", "read-only", "cut"])
def test_a_cache_that_cannot_be_used_is_done_without(tmp_path, kind):
    folder = tmp_path / "cache"
    if kind == "a file":
        folder.touch()
    else:
        assert ends_well(start(folder))
    if kind == "read-only":  # root may write where permissions forbid it: the folder is a file
        kernels = next(folder.glob("kernels/*"))
        shutil.rmtree(kernels)
        kernels.touch()
    if kind == "cut":
        for path in folder.rglob("*.nbi"):
            path.write_bytes(path.read_bytes()[:40])
    assert ends_well(start(folder))


def test_importing_the_kernels_compiles_nothing(tmp_path):
    code = "from volatool.kernels import levels, quantize, reduce, spring, multigrid, words"
    environment = {**os.environ, "VOLATOOL_CACHE_DIR": str(tmp_path)}
    subprocess.run([sys.executable, "-c", code], env=environment, check=True)
    assert not list(tmp_path.rglob("*.nbc"))


def test_a_failed_compilation_lets_others_compile(tmp_path):
    script = tmp_path / "failing.py"  # a kernel needs a file to be cached
    script.write_text(FAILING)
    stdout, _ = start(tmp_path, str(script)).communicate(timeout=120)
    assert stdout.split() == ["TypingError", "0"]


def test_kernels_from_the_cache_can_be_run_and_compiled_into_others(tmp_path):
    script = tmp_path / "calling.py"
    script.write_text(CALLING)

    def result(*words):
        stdout, stderr = start(tmp_path, str(script), *words).communicate(timeout=120)
        return stdout.split() or stderr

    assert result() == ["14.0", "9.0", "JITCodeLibrary"]
    (outer,) = tmp_path.rglob("calling.sum_of_squares*.nbc")
    outer.unlink()
    inner = compiled(tmp_path)
    # the inner one comes from the cache, is run, and then made part of the outer one
    assert result("inner") == ["14.0", "9.0", "JITCodeLibrary"]
    assert {path: when for path, when in compiled(tmp_path).items() if path != outer} == inner
    assert result() == ["14.0", "9.0", "_Library"]
    before = compiled(tmp_path)
    # numba's own way does as well, from the same cache
    assert result("refused") == ["14.0", "9.0", "JITCodeLibrary"]
    assert compiled(tmp_path) == before
