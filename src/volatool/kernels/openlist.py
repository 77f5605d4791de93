"""What path searches keep their nodes in: a hash table of cells and a heap of open nodes."""

from __future__ import annotations

import numpy as np

from volatool.kernels._jit import kernel

FREE_SLOT = np.uint64(2**64 - 1)
"""Key of an unused slot; no cell packs to it."""

_MIX = np.uint64(0x9E3779B97F4A7C15)
_20 = np.uint64(20)
_MASK = np.uint64((1 << 20) - 1)


@kernel
def packed(level, x, y, z):
    """Return the key of a cell: 4 bits for the level, 20 for each index."""
    return (
        (np.uint64(level) << np.uint64(60))
        | (np.uint64(z) << np.uint64(40))
        | (np.uint64(y) << _20)
        | np.uint64(x)
    )


@kernel
def unpacked(key):
    """Return level, x, y, z of a key."""
    return (
        np.int64(key >> np.uint64(60)),
        np.int64(key & _MASK),
        np.int64((key >> _20) & _MASK),
        np.int64((key >> np.uint64(40)) & _MASK),
    )


@kernel
def slot_of(slots, key):
    """
    Return where a key is in a table, or the free slot where it belongs.

    Parameters
    ----------
    slots : (n,) array of uint64
        n is a power of two, larger than the number of keys.
    key : uint64
        From `packed`.

    Returns
    -------
    slot : int
    """
    mask = np.uint64(slots.size - 1)
    mixed = (key ^ (key >> np.uint64(31))) * _MIX
    slot = (mixed ^ (mixed >> np.uint64(29))) & mask
    while slots[slot] != key and slots[slot] != FREE_SLOT:
        slot = (slot + np.uint64(1)) & mask
    return np.int64(slot)


@kernel
def _is_before(costs, lengths, i, j):
    """Least cost first; then the one that has come farther; then the older one."""
    if costs[i] != costs[j]:
        return costs[i] < costs[j]
    if lengths[i] != lengths[j]:
        return lengths[i] > lengths[j]
    return i < j


@kernel
def lift(heap, places, costs, lengths, node, n):
    """
    Put a node into the heap, or move it up after its cost went down.

    Parameters
    ----------
    heap : (m,) array of int64
        Nodes; the first n are in the heap.
    places : (m,) array of int64
        Place of each node in the heap, below 0 when it is not there.
    costs, lengths : (m,) arrays of float64
        Of each node.
    node : int
        The node.
    n : int
        Nodes in the heap.

    Returns
    -------
    n : int
        Nodes in the heap afterwards.
    """
    at = places[node]
    if at < 0:
        at = n
        n += 1
    while at > 0:
        above = (at - 1) >> 1
        if not _is_before(costs, lengths, node, heap[above]):
            break
        heap[at] = heap[above]
        places[heap[at]] = at
        at = above
    heap[at] = node
    places[node] = at
    return n


@kernel
def drop_first(heap, places, costs, lengths, n):
    """Take the first node out of a heap of n; `heap[0]` was it. Return n - 1."""
    places[heap[0]] = -1
    n -= 1
    if n == 0:
        return n
    node = heap[n]
    at = 0
    while True:
        below = 2 * at + 1
        if below >= n:
            break
        if below + 1 < n and _is_before(costs, lengths, heap[below + 1], heap[below]):
            below += 1
        if not _is_before(costs, lengths, heap[below], node):
            break
        heap[at] = heap[below]
        places[heap[at]] = at
        at = below
    heap[at] = node
    places[node] = at
    return n
