"""A* over the largest cells that are wholly passable, whatever their level.

Coordinates and lengths are in cells of the deepest level. The *core* of a cell is the box of the
centres of its deepest cells; a cell is passable when no occupied voxel comes nearer to its core
than the clearance, and the core is between the heights that are allowed. Any two places of a core
may be joined by a straight line that keeps both, and so may two places across a face: a distance
to a voxel's box changes monotonously along each axis between two neighbouring centres, so that it
is nowhere below that of one of the centres around.
"""

from __future__ import annotations

import math

import numpy as np

from volatool.kernels._jit import kernel
from volatool.kernels.nearest import keeps_clear
from volatool.kernels.openlist import FREE_SLOT, drop_first, lift, packed, slot_of, unpacked

FOUND, EXHAUSTED, OUT_OF_ROOM = 1, 0, 2
"""How a search ends."""


@kernel
def all_keep_clear(words, first, depth, points, square):
    """
    Tell which points no occupied voxel comes nearer to than a distance.

    Parameters
    ----------
    words, first, depth
        The nodes, as for `nearest.nearest`.
    points : (n, 3) array of float64
        Lattice coordinates.
    square : float
        The distance's square.

    Returns
    -------
    are_clear : (n,) array of bool
    """
    stack = np.empty((63 * depth + 1, 5), np.int64)
    box = np.empty(6)
    result = np.empty(points.shape[0], np.bool_)
    for i in range(points.shape[0]):
        box[:3] = points[i]
        box[3:] = points[i]
        result[i] = keeps_clear(words, first, depth, box, square, stack)
    return result


@kernel
def _is_passable(words, first, depth, rule, level, x, y, z, known, verdicts, counts, stack, box):
    """1 if a cell is passable, 0 if not; remembered. 0 too, and counts[1] set, without room."""
    key = packed(level, x, y, z)
    slot = slot_of(known, key)
    if known[slot] == key:
        return verdicts[slot]
    if counts[0] >= known.size // 2:
        counts[1] = 1
        return np.uint8(0)
    span = 1 << 2 * (depth - level)
    box[0], box[3] = x * span + 0.5, (x + 1) * span - 0.5
    box[1], box[4] = y * span + 0.5, (y + 1) * span - 0.5
    box[2], box[5] = z * span + 0.5, (z + 1) * span - 0.5
    verdict = np.uint8(
        box[2] >= rule[1]
        and box[5] <= rule[2]
        and keeps_clear(words, first, depth, box, rule[0], stack)
    )
    known[slot] = key
    verdicts[slot] = verdict
    counts[0] += 1
    return verdict


@kernel
def roam(
    words, first, depth, rule, starts, start_lengths, goals, origin, target, weight, finest,
    near, room,
):  # fmt: skip
    """
    Look for a way from some cells to others.

    Parameters
    ----------
    words, first, depth
        The nodes, as for `nearest.nearest`.
    rule : (3,) array of float64
        Square of the clearance, at least 0.25; lowest and highest z of a passable cell's centre.
    starts, goals : (n, 3) arrays of int64
        Passable cells of the deepest level.
    start_lengths : (n,) array of float64
        What the way to each start costs.
    origin, target : (3,) arrays of float64
        Where the search comes from and heads for.
    weight : float
        How much more the distance to the target counts than the way behind.
    finest : int
        Deepest level of cells to go through, but for those near both ends.
    near : float
        How near that is.
    room : int
        Cells that may be looked at, a power of two.

    Returns
    -------
    status : int
        `FOUND`, `EXHAUSTED` (there is no way, over such cells) or `OUT_OF_ROOM`.
    cells : (m,) array of uint64
        Keys of the cells on the way (`openlist.packed`).
    entries : (m, 3) array of float64
        Where each of them is entered, in its core; the first is the centre of a start.
    looked_at : int
        Cells that were looked at.

    Notes
    -----
    A* [Hart1968]_ with a weight [Pohl1970]_. The open list holds offers: a cell behind a face of
    one that was reached. An offer that is not passable as a whole makes way for its 16 children at
    that face when its turn comes, so that only the faces near the way are ever looked at closely.
    """
    known = np.full(2 * room, FREE_SLOT, np.uint64)
    verdicts = np.zeros(2 * room, np.uint8)
    counts = np.zeros(2, np.int64)
    reached = np.full(2 * room, FREE_SLOT, np.uint64)
    keys = np.empty(room, np.uint64)
    lengths, costs = np.empty(room), np.empty(room)
    entries = np.empty((room, 3))
    parents = np.empty(room, np.int64)
    faces = np.empty(room, np.int8)
    heap, places = np.empty(room, np.int64), np.full(room, -1, np.int64)
    stack = np.empty((63 * depth + 1, 5), np.int64)
    box = np.empty(6)
    n = n_open = 0
    no_keys, no_entries = np.empty(0, np.uint64), np.empty((0, 3))

    for i in range(starts.shape[0]):
        level = 0
        while level < depth and not _is_passable(
            words, first, depth, rule, level, starts[i, 0] >> 2 * (depth - level),
            starts[i, 1] >> 2 * (depth - level), starts[i, 2] >> 2 * (depth - level),
            known, verdicts, counts, stack, box,
        ):  # fmt: skip
            level += 1
        shift = 2 * (depth - level)
        keys[n] = packed(level, starts[i, 0] >> shift, starts[i, 1] >> shift, starts[i, 2] >> shift)
        for axis in range(3):
            entries[n, axis] = starts[i, axis] + 0.5
        parents[n], faces[n] = -1, -1
        lengths[n] = start_lengths[i]
        costs[n] = lengths[n] + weight * _distance(entries[n], target)
        n_open = lift(heap, places, costs, lengths, n, n_open)
        n += 1

    while n_open:
        if counts[1] or n + 16 > room:
            return OUT_OF_ROOM, no_keys, no_entries, counts[0]
        offer = heap[0]
        n_open = drop_first(heap, places, costs, lengths, n_open)
        level, x, y, z = unpacked(keys[offer])
        deepest = finest
        if finest < depth and (
            _distance(entries[offer], origin) < near or _distance(entries[offer], target) < near
        ):
            deepest = depth
        if level > deepest:
            continue
        if not _is_passable(
            words, first, depth, rule, level, x, y, z, known, verdicts, counts, stack, box
        ):
            if level < deepest:
                axis, sign = faces[offer] % 3, 1 - 2 * (faces[offer] // 3)
                side = 0 if sign > 0 else 3
                for child in range(16):
                    low, high = child & 3, child >> 2
                    bx = side if axis == 0 else low
                    by = side if axis == 1 else (low if axis == 0 else high)
                    bz = side if axis == 2 else high
                    n_open = _offer(
                        level + 1, 4 * x + bx, 4 * y + by, 4 * z + bz, parents[offer],
                        faces[offer], depth, target, weight, keys, lengths, costs, entries,
                        parents, faces, heap, places, n, n_open,
                    )  # fmt: skip
                    n += 1
            continue
        slot = slot_of(reached, keys[offer])
        if reached[slot] == keys[offer]:
            continue
        reached[slot] = keys[offer]
        shift = 2 * (depth - level)
        for i in range(goals.shape[0]):
            gx, gy, gz = goals[i, 0] >> shift, goals[i, 1] >> shift, goals[i, 2] >> shift
            if gx == x and gy == y and gz == z:
                cells, points = _traced(offer, keys, entries, parents)
                return FOUND, cells, points, counts[0]
        for face in range(6 if level else 0):
            axis, sign = face % 3, 1 - 2 * (face // 3)
            nx = x + sign if axis == 0 else x
            ny = y + sign if axis == 1 else y
            nz = z + sign if axis == 2 else z
            if min(nx, ny, nz) < 0 or max(nx, ny, nz) >= 1 << 2 * level:
                continue
            # the largest passable cell there; if there is none, the neighbour for its children
            there = 1
            while there <= level and not _is_passable(
                words, first, depth, rule, there, nx >> 2 * (level - there),
                ny >> 2 * (level - there), nz >> 2 * (level - there),
                known, verdicts, counts, stack, box,
            ):  # fmt: skip
                there += 1
            if there > level:
                if level == depth:
                    continue
                there = level
            up = 2 * (level - there)
            key = packed(there, nx >> up, ny >> up, nz >> up)
            if reached[slot_of(reached, key)] == key:
                continue
            n_open = _offer(
                there, nx >> up, ny >> up, nz >> up, offer, face, depth, target, weight, keys,
                lengths, costs, entries, parents, faces, heap, places, n, n_open,
            )  # fmt: skip
            n += 1
    return EXHAUSTED, no_keys, no_entries, counts[0]


@kernel
def _distance(a, b):
    return math.sqrt((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2)


@kernel
def _traced(last, keys, entries, parents):
    """Cells and entries of the way to one, the first first."""
    n = 0
    at = last
    while at >= 0:
        n += 1
        at = parents[at]
    cells, points = np.empty(n, np.uint64), np.empty((n, 3))
    at = last
    for k in range(n - 1, -1, -1):
        cells[k] = keys[at]
        points[k] = entries[at]
        at = parents[at]
    return cells, points


@kernel
def _offer(
    level, x, y, z, parent, face, depth, target, weight, keys, lengths, costs, entries, parents,
    faces, heap, places, offer, n_open,
):  # fmt: skip
    """Put a cell behind a face of a reached one into the open list."""
    axis, sign = face % 3, 1 - 2 * (face // 3)
    parent_level, px, py, pz = unpacked(keys[parent])
    entry = entries[parent]
    here, there = (px, py, pz), (x, y, z)
    here_span, there_span = 1 << 2 * (depth - parent_level), 1 << 2 * (depth - level)
    corner = here[axis] * here_span
    plane = corner + here_span - 0.5 if sign > 0 else corner + 0.5
    # through the face as near to the straight line to the target as it can
    ahead = (target[axis] - entry[axis]) * sign
    t = 0.0
    if ahead > 0.0:
        t = min(max((plane - entry[axis]) * sign / ahead, 0.0), 1.0)
    for k in range(3):
        aim = entry[k] + t * (target[k] - entry[k])
        low = max(here[k] * here_span, there[k] * there_span) + 0.5
        high = min((here[k] + 1) * here_span, (there[k] + 1) * there_span) - 0.5
        entries[offer, k] = plane if k == axis else min(max(aim, low), high)
    keys[offer] = packed(level, x, y, z)
    lengths[offer] = lengths[parent] + _distance(entries[offer], entry) + 1.0
    entries[offer, axis] += sign
    costs[offer] = lengths[offer] + weight * _distance(entries[offer], target)
    parents[offer], faces[offer] = parent, face
    return lift(heap, places, costs, lengths, offer, n_open)
