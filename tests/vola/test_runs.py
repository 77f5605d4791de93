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
    runs = KeyRuns(scratch, 4)
    expected = set()
    for run in sorted_runs(1, 40):
        expected.update(run.tolist())
        runs.push(run)
    for _ in range(2):  # a stream can be had again
        found = np.concatenate(list(runs.stream()))
        assert found.tolist() == sorted(expected)
    runs.close()
    assert scratch.used_bytes == 0


def test_memory_in_use_stays_under_the_share():
    """The budget counts what is really held, merges included."""
    scratch = Scratch(1_000_000)
    runs = KeyRuns(scratch, 4, share=0.5)
    for run in sorted_runs(2, 60):
        runs.push(run)
        assert scratch.used_bytes <= 500_000
    runs.close()


def test_growth_is_never_overstated():
    """What is ruled out by it must be ruled out for certain."""
    for budget in (None, 0):
        seen = []
        runs = KeyRuns(Scratch(budget), 4, on_growth=lambda counts, seen=seen: seen.append(counts))
        everything = np.zeros(0, np.uint64)
        for run in sorted_runs(3, 20):
            runs.push(run)
            everything = np.union1d(everything, run)
            actual = [len(np.unique(everything >> np.uint64(6 * (4 - i)))) for i in range(5)]
            assert (seen[-1] <= actual).all()
        runs.close()
        assert max(counts[4] for counts in seen) > 10_000


@pytest.mark.parametrize("budget", [None, 0, 400_000])
@pytest.mark.parametrize("coarsen_after", [0, 7, 19])
def test_sums_survive_spilling_and_coarsening(budget, coarsen_after):
    """Blocks made coarser half way, in RAM and in files: the sums are exact."""
    rng = np.random.default_rng(4)
    runs = SumRuns(Scratch(budget))
    total: dict[int, np.ndarray] = {}
    for i in range(20):
        rows = rng.integers(0, 99, (1000, 8))
        rows[:, 1] += 1
        block = np.sort(rng.integers(0, 200_000, 1000))
        if i > coarsen_after:
            block >>= 6
        rows[:, 0] = (block << 8) | rng.integers(0, 3, 1000)
        rows = reduce.fold_rows(rows, 0)
        runs.push(rows.copy())
        for row in rows:
            key = int(row[0]) if i > coarsen_after else (int(row[0]) >> 14 << 8) | int(row[0]) & 255
            total[key] = total.get(key, 0) + row[1:]
        if i == coarsen_after:
            runs.coarsen(1)
    found = np.concatenate(list(runs.stream()))
    assert found[:, 0].tolist() == sorted(total)
    assert all(np.array_equal(row[1:], total[int(row[0])]) for row in found)
    runs.close()
