"""Runs give back one sorted stream whatever was spilled, merged or made coarser."""

from __future__ import annotations

import numpy as np
import pytest

from volatool.kernels import reduce
from volatool.scratch import Scratch
from volatool.vola.runs import KeyRuns, SumRuns


def sorted_runs(seed, n_runs, n=3000, limit=10**6):
    rng = np.random.default_rng(seed)
    for _ in range(n_runs):
        yield np.array(sorted(set(rng.integers(0, limit, n).tolist())), np.uint64)


@pytest.mark.parametrize("budget", [None, 0, 50_000, 200_000])
def test_keys_come_out_sorted_and_once(budget):
    """In RAM, in files, in files of files, and mixed."""
    scratch = Scratch(budget)
    runs = KeyRuns(scratch)
    expected = set()
    rng = np.random.default_rng(1)
    for _ in range(40):  # in any order, and repeated
        keys = rng.integers(0, 10**6, 3000).astype(np.uint64)
        expected.update(keys.tolist())
        runs.push(keys)
        runs.push(keys[:0])
    for _ in range(2):  # a stream can be had again
        found = np.concatenate(list(runs.stream()))
        assert found.tolist() == sorted(expected)
    runs.close()
    assert scratch.used_bytes == 0


def test_memory_in_use_stays_under_the_share():
    """The budget counts what is really held, merges included."""
    scratch = Scratch(1_000_000)
    runs = KeyRuns(scratch, share=0.5)
    for run in sorted_runs(2, 60):
        runs.push(run)
        assert scratch.used_bytes <= 500_000
    runs.close()


@pytest.mark.parametrize("kind", ["distinct", "repeated"])
def test_the_buffer_is_sorted_when_it_is_full(kind, monkeypatch):
    """Whether most keys are new, when the buffer becomes the run, or few are."""
    monkeypatch.setattr("volatool.vola.runs._MOST_LOOSE", 5000)
    scratch = Scratch()
    runs = KeyRuns(scratch)
    limit = 10**15 if kind == "distinct" else 50
    keys = np.random.default_rng(3).integers(0, limit, (70, 999)).astype(np.uint64)
    for row in keys:
        room = runs.room(999)
        assert len(room) >= 999
        room[:999] = row
        runs.filled(999)
        assert scratch.used_bytes >= 8 * len(room)
    found = np.concatenate(list(runs.stream()))
    assert found.tolist() == sorted(set(keys.ravel().tolist()))
    runs.close()
    assert scratch.used_bytes == 0


@pytest.mark.parametrize("coarsen_after", [0, 7, 19])
def test_sums_survive_spilling_and_coarsening(coarsen_after):
    """Blocks made coarser half way: the sums of files and of a run in RAM are exact."""
    rng = np.random.default_rng(4)
    runs = SumRuns(Scratch())
    kept = None
    total: dict[int, np.ndarray] = {}
    for i in range(20):
        rows = rng.integers(0, 99, (1000, 8))
        rows[:, 1] += 1
        block = np.sort(rng.integers(0, 200_000, 1000))
        if i > coarsen_after:
            block >>= 6
        rows[:, 0] = (block << 8) | rng.integers(0, 3, 1000)
        rows = reduce.fold_rows(rows, 0)
        if i == 19 and coarsen_after < 19:
            kept = rows
        else:
            runs.spill(rows)
        for row in rows:
            key = int(row[0]) if i > coarsen_after else (int(row[0]) >> 14 << 8) | int(row[0]) & 255
            total[key] = total.get(key, 0) + row[1:]
        if i == coarsen_after:
            runs.coarsen(1)
    found = np.concatenate(list(runs.stream(*([] if kept is None else [kept]))))
    assert found[:, 0].tolist() == sorted(total)
    assert all(np.array_equal(row[1:], total[int(row[0])]) for row in found)
    runs.close()
