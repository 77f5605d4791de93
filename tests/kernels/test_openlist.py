"""The hash table and the heap of path searches."""

from __future__ import annotations

import heapq
import itertools

import numpy as np

from volatool.kernels import openlist


def test_cells_are_packed_and_unpacked():
    """The largest indices of the deepest level too; no cell is the free slot."""
    cells = [(0, 0, 0, 0), (10, 2**20 - 1, 2**20 - 1, 2**20 - 1), (3, 1, 2, 3), (5, 1023, 0, 7)]
    keys = [openlist.packed(*cell) for cell in cells]
    assert [tuple(map(int, openlist.unpacked(np.uint64(key)))) for key in keys] == cells
    assert openlist.FREE_SLOT not in keys


def test_keys_are_found_again_in_a_full_table():
    """Half full with neighbours, whose keys differ in few bits: each in a slot of its own."""
    slots = np.full(1024, openlist.FREE_SLOT, np.uint64)
    cells = itertools.product([4, 5], range(16), range(4), range(4))
    keys = [np.uint64(openlist.packed(*cell)) for cell in cells]
    assert len(set(keys)) == 512
    for key in keys:
        slot = openlist.slot_of(slots, key)
        assert slots[slot] == openlist.FREE_SLOT
        slots[slot] = key
    found = [openlist.slot_of(slots, key) for key in keys]
    assert len(set(found)) == 512
    assert slots[found].tolist() == [int(key) for key in keys]


def test_the_heap_gives_the_nodes_of_heapq():
    """Costs that go down on the way, ties by length and then by age."""
    rng = np.random.default_rng(7)
    costs = rng.integers(0, 20, 200).astype(float)
    lengths = rng.integers(0, 3, 200).astype(float)
    heap, places = np.empty(200, np.int64), np.full(200, -1, np.int64)
    n = 0
    for node in range(200):
        n = openlist.lift(heap, places, costs, lengths, node, n)
    for node in rng.choice(200, 60, replace=False):
        costs[node] -= rng.integers(1, 9)
        n = openlist.lift(heap, places, costs, lengths, node, n)
    assert n == 200
    expected = list(zip(costs.tolist(), (-lengths).tolist(), range(200), strict=True))
    heapq.heapify(expected)
    while expected:
        assert heap[0] == heapq.heappop(expected)[2]
        n = openlist.drop_first(heap, places, costs, lengths, n)
        assert sorted(heap[:n].tolist()) == sorted(row[2] for row in expected)
        assert all(places[heap[k]] == k for k in range(n))
