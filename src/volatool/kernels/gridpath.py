"""A* over the cells of the deepest level, 26 steps that cut no corner.

Coordinates and lengths are in cells. What is passable is worked out block by block when the search
comes there, one 64-bit word each: no grid is ever made.
"""

from __future__ import annotations

import math

import numpy as np

from volatool.kernels._jit import kernel
from volatool.kernels.contiguity import popcount
from volatool.kernels.nearest import keeps_clear
from volatool.kernels.openlist import FREE_SLOT, drop_first, lift, packed, slot_of, unpacked
from volatool.kernels.roam import EXHAUSTED, FOUND, OUT_OF_ROOM

_ONE = np.uint64(1)
_SQRT2, _SQRT3 = math.sqrt(2.0), math.sqrt(3.0)


@kernel
def octile(dx, dy, dz):
    """Return the length of the shortest way over so many cells when nothing is in the way."""
    dx, dy, dz = abs(dx), abs(dy), abs(dz)
    most = max(dx, dy, dz)
    least = min(dx, dy, dz)
    middle = dx + dy + dz - most - least
    return _SQRT3 * least + _SQRT2 * (middle - least) + (most - middle)


@kernel
def passable_word(words, first, depth, rule, x, y, z, stack, box):
    """
    Tell which cells of a block of the deepest level are passable.

    Parameters
    ----------
    words, first, depth
        The nodes, as for `nearest.nearest`.
    rule : (3,) array of float64
        Square of the clearance that a cell's centre must keep, at 0.25 all free cells do; lowest
        and highest z of the centre.
    x, y, z : int
        The block.
    stack, box
        To work in, as for `nearest.keeps_clear`.

    Returns
    -------
    word : uint64
        Bit ``lx + 4 ly + 16 lz``.
    """
    box[0], box[3] = 4 * x + 0.5, 4 * x + 3.5
    box[1], box[4] = 4 * y + 0.5, 4 * y + 3.5
    box[2], box[5] = 4 * z + 0.5, 4 * z + 3.5
    word = np.uint64(0)
    for slot in range(4):
        if rule[1] <= 4 * z + slot + 0.5 <= rule[2]:
            word |= np.uint64(0xFFFF) << np.uint64(16 * slot)
    if word == 0 or keeps_clear(words, first, depth, box, rule[0], stack):
        return word
    if rule[0] <= 0.25:
        node = np.int64(0)
        for level in range(depth - 1):
            shift = 2 * (depth - 2 - level)
            bit = ((x >> shift) & 3) | (((y >> shift) & 3) << 2) | (((z >> shift) & 3) << 4)
            below = (_ONE << np.uint64(bit)) - _ONE
            node = first[node] + popcount(words[node] & below)
        return word & ~words[node]
    for bit in range(64):
        flag = _ONE << np.uint64(bit)
        if not word & flag:
            continue
        box[0] = 4 * x + (bit & 3) + 0.5
        box[1] = 4 * y + ((bit >> 2) & 3) + 0.5
        box[2] = 4 * z + (bit >> 4) + 0.5
        box[3:] = box[:3]
        if not keeps_clear(words, first, depth, box, rule[0], stack):
            word ^= flag
    return word


@kernel
def _needed():
    """For each step dx + 3 dy + 9 dz + 13 the cells about that it passes between, as bits."""
    needed = np.zeros(27, np.int64)
    for step in range(27):
        dx, dy, dz = step % 3 - 1, (step // 3) % 3 - 1, step // 9 - 1
        for corner in range(8):
            kx, ky, kz = dx * (corner & 1), dy * ((corner >> 1) & 1), dz * (corner >> 2)
            needed[step] |= 1 << (kx + 1 + 3 * (ky + 1) + 9 * (kz + 1))
    return needed


@kernel
def walk(
    words, first, depth, rule, starts, start_lengths, goals, goal_lengths, weight, bound, room
):
    """
    Look for a short way from some cells to others.

    Parameters
    ----------
    words, first, depth, rule
        As for `passable_word`.
    starts, goals : (n, 3) arrays of int64
        Passable cells.
    start_lengths, goal_lengths : (n,) arrays of float64
        What the ways to each start and from each goal cost.
    weight : float
        1 for the shortest way; else it is at most that many times as long.
    bound : float
        Ways of this length or more are not looked for.
    room : int
        Cells that may be taken in, a power of two.

    Returns
    -------
    status : int
        `FOUND`, `EXHAUSTED` (no way is shorter than the bound) or `OUT_OF_ROOM`.
    cells : (m, 3) array of int64
        The way.
    looked_at : int
        Cells that were taken in.
    least : float
        No way is shorter than this.

    Notes
    -----
    A* [Hart1968]_; with a weight [Pohl1970]_ cells are reopened when a shorter way to them is
    found, so that the way is at most `weight` times as long as the shortest.
    """
    slots = np.full(2 * room, FREE_SLOT, np.uint64)
    slot_nodes = np.empty(2 * room, np.int64)
    blocks = np.full(2 * room, FREE_SLOT, np.uint64)
    block_words = np.empty(2 * room, np.uint64)
    keys = np.empty(room, np.uint64)
    lengths, costs = np.empty(room), np.empty(room)
    parents = np.empty(room, np.int64)
    heap, places = np.empty(room, np.int64), np.empty(room, np.int64)
    stack = np.empty((63 * depth + 1, 5), np.int64)
    box = np.empty(6)
    needed = _needed()
    size = 1 << 2 * depth
    n_nodes = n_open = n_blocks = 0
    nothing = np.empty((0, 3), np.int64)

    for i in range(starts.shape[0]):
        n_nodes, n_open = _take(
            starts[i, 0], starts[i, 1], starts[i, 2], start_lengths[i], -1, depth, goals,
            goal_lengths, weight, bound, slots, slot_nodes, keys, lengths, costs, parents, heap,
            places, n_nodes, n_open,
        )  # fmt: skip
    # a way's end, with what follows the goal: open until nothing can be shorter
    end, end_length = np.int64(-1), np.inf
    while n_open:
        node = heap[0]
        if end_length <= costs[node]:
            break
        if n_nodes + 26 >= room or n_blocks + 8 >= room:
            least = min(costs[node] / weight, bound)
            return OUT_OF_ROOM, nothing, n_nodes, least
        n_open = drop_first(heap, places, costs, lengths, n_open)
        _, x, y, z = unpacked(keys[node])
        for i in range(goals.shape[0]):
            if x == goals[i, 0] and y == goals[i, 1] and z == goals[i, 2]:
                length = lengths[node] + goal_lengths[i]
                if length < end_length and length < bound:
                    end, end_length = node, length
        about = np.int64(0)
        last = FREE_SLOT
        word = np.uint64(0)
        for k in range(27):
            cx, cy, cz = x + k % 3 - 1, y + (k // 3) % 3 - 1, z + k // 9 - 1
            if min(cx, cy, cz) < 0 or max(cx, cy, cz) >= size:
                continue
            key = packed(depth, cx >> 2, cy >> 2, cz >> 2)
            if key != last:
                slot = slot_of(blocks, key)
                if blocks[slot] != key:
                    blocks[slot] = key
                    block_words[slot] = passable_word(
                        words, first, depth, rule, cx >> 2, cy >> 2, cz >> 2, stack, box
                    )
                    n_blocks += 1
                last = key
                word = block_words[slot]
            bit = (cx & 3) | ((cy & 3) << 2) | ((cz & 3) << 4)
            about |= np.int64((word >> np.uint64(bit)) & _ONE) << k
        for k in range(27):
            if k == 13 or about & needed[k] != needed[k]:
                continue
            dx, dy, dz = k % 3 - 1, (k // 3) % 3 - 1, k // 9 - 1
            length = lengths[node] + octile(dx, dy, dz)
            n_nodes, n_open = _take(
                x + dx, y + dy, z + dz, length, node, depth, goals, goal_lengths, weight, bound,
                slots, slot_nodes, keys, lengths, costs, parents, heap, places, n_nodes, n_open,
            )  # fmt: skip
    if end < 0:
        return EXHAUSTED, nothing, n_nodes, bound
    least = min(end_length / weight, bound)
    m = 0
    at = end
    while at >= 0:
        m += 1
        at = parents[at]
    cells = np.empty((m, 3), np.int64)
    at = end
    for k in range(m - 1, -1, -1):
        _, x, y, z = unpacked(keys[at])
        cells[k, 0], cells[k, 1], cells[k, 2] = x, y, z
        at = parents[at]
    return FOUND, cells, n_nodes, least


@kernel
def _take(
    x, y, z, length, parent, depth, goals, goal_lengths, weight, bound, slots, slot_nodes, keys,
    lengths, costs, parents, heap, places, n_nodes, n_open,
):  # fmt: skip
    """Take a cell in, or the shorter way to it; reopened if need be (weights above 1)."""
    key = packed(depth, x, y, z)
    slot = slot_of(slots, key)
    is_known = slots[slot] == key
    if is_known and length >= lengths[slot_nodes[slot]]:
        return n_nodes, n_open
    left = np.inf
    for i in range(goals.shape[0]):
        left = min(
            left, goal_lengths[i] + octile(x - goals[i, 0], y - goals[i, 1], z - goals[i, 2])
        )
    if length + left >= bound:
        return n_nodes, n_open
    if is_known:
        node = slot_nodes[slot]
    else:
        node = n_nodes
        n_nodes += 1
        slots[slot] = key
        slot_nodes[slot] = node
        keys[node] = key
        places[node] = -1
    lengths[node], costs[node], parents[node] = length, length + weight * left, parent
    return n_nodes, lift(heap, places, costs, lengths, node, n_open)
