"""Connected components of set cells: a bit flood inside each block, union-find across blocks."""

from __future__ import annotations

import numpy as np

from volatool.kernels._jit import kernel
from volatool.kernels.adjacent import (
    CELLS,
    DOWN,
    FACES,
    NOT_FACES,
    UP,
    at_sides,
    grown,
    meetings,
    moved,
    touched,
    touching,
)
from volatool.kernels.contiguity import popcount
from volatool.kernels.near import spread

_ONE = np.uint64(1)
_SLOTS = np.uint64(15)
_U1, _U2, _U4, _U8, _U16, _U32 = (np.uint64(1 << i) for i in range(6))

_BATCH = 512  # words that are flooded together
_STEPS = 4  # so often they grow before each is looked at
_NODES = 256  # whose blocks are joined together
_MOST_PAIRS = 13 * 64  # of the blocks of a node with blocks that come later

SMALL = 1024
"""Components of fewer cells are put in order by counting."""


@kernel
def _flood_first(words, is_26, parts):
    """Flood from the lowest bit of each word, some steps: straight code, many words at once."""
    if is_26:
        for i in range(words.size):
            part = words[i] & (~words[i] + _ONE)
            for _ in range(_STEPS):
                part = grown(part, True) & words[i]
            parts[i] = part
    else:
        for i in range(words.size):
            part = words[i] & (~words[i] + _ONE)
            for _ in range(_STEPS):
                part = grown(part, False) & words[i]
            parts[i] = part


@kernel
def split(words, is_26, most):
    """
    Parts of each block that hang together inside it.

    The part of the lowest bit is flooded without a branch, for many blocks at once; it is mostly
    all there is. Only what is left is looked at block by block.

    Parameters
    ----------
    words : (n,) array of uint64
        Occupancy words.
    is_26 : bool
        Cells hang together over corners; else over faces only.
    most : int
        At least as many as there are parts: their cells will do.

    Returns
    -------
    starts : (n + 1,) array of int32
        Where the parts of each block begin; useless when there are 2**31 parts or more.
    masks : (m + 2,) array of uint64
        Cells of each of m parts, block after block, ordered by the lowest bit; two empty ones
        at the end, for `_part_of` to read.
    """
    starts = np.empty(words.size + 1, np.int32)
    masks = np.empty(most + 2, np.uint64)  # a page that is never written takes no memory
    parts = np.empty(_BATCH, np.uint64)
    n = 0
    for base in range(0, words.size, _BATCH):
        batch = words[base : base + _BATCH]
        _flood_first(batch, is_26, parts)
        for i in range(batch.size):
            starts[base + i] = n
            rest, part = batch[i], parts[i]
            while rest:
                before = np.uint64(0)
                while part != before and part != rest:
                    before = part
                    part = grown(part, is_26) & rest
                masks[n] = part
                n += 1
                rest ^= part
                part = rest & (~rest + _ONE)
    starts[words.size] = n
    masks[n : n + 2] = 0
    return starts, masks[: n + 2]


@kernel
def _unite(parents, i, j):
    """
    Join two trees under the smaller root: the component's first part in VOLA order.

    Rem's algorithm: both ways up are walked in turn, the one that is higher up in number hung
    lower on the way, until they meet.
    """
    a, b = parents[i], parents[j]
    while a != b:
        if a < b:
            i, j, a, b = j, i, b, a
        parents[i] = b
        if i == a:
            return
        i, a = a, parents[a]


@kernel
def _child(words, first, around, bit, dx, dy, dz):
    """Place of the neighbour of child `bit` of the middle node in a direction, -1 without."""
    x, y, z = (bit & 3) + dx, ((bit >> 2) & 3) + dy, (bit >> 4) + dz
    # arithmetic shifts: -1 below the node, 0 in it, 1 above
    node = around[(x >> 2) + 1 + 3 * ((y >> 2) + 1) + 9 * ((z >> 2) + 1)]
    if node < 0:
        return np.int64(-1)
    word = words[node]
    flag = _ONE << np.uint64((x & 3) | ((y & 3) << 2) | ((z & 3) << 4))
    if not word & flag:
        return np.int64(-1)
    return first[node] + popcount(word & (flag - _ONE))


@kernel
def unite_blocks(upper, first, height, leaves, starts, masks, is_26, parents):
    """
    Join the parts of neighbouring blocks that touch.

    One walk over the tree in VOLA order keeps the nodes about the current one of each level,
    without search and without a table of neighbours. For nodes whose children are blocks, all
    pairs of blocks that may touch in a direction come from the words of two nodes, one moved
    (`adjacent.meetings`), so that a neighbour costs one rank.

    Parameters
    ----------
    upper : (u,) array of uint64
        Words of the levels above the leaves, root first.
    first : (u,) array of int64
        Place of each node's first child, counted over all levels.
    height : int
        Number of these levels, at least 1.
    leaves : (n,) array of uint64
        Words of the level whose cells are joined.
    starts, masks : arrays
        From `split`.
    is_26 : bool
        Over corners; else over faces.
    parents : (m,) array of int32
        In: each part its own number. Out: a forest, roots are the smallest of their trees.
    """
    around = np.full((height, 27), -1, np.int64)
    rest = np.zeros(height, np.uint64)
    around[0, 13] = 0
    rest[0] = upper[0]
    later = FACES[3:]
    if is_26:
        later = np.concatenate((later, NOT_FACES[10:]))
    meeting = later, meetings(later, is_26)
    borders = np.empty(27, np.uint64)
    for k in range(27):
        borders[k] = spread(~np.uint64(0), k % 3 - 1, k // 3 % 3 - 1, k // 9 - 1, 1)
    room = borders, np.empty(27, np.uint64), np.empty((_MOST_PAIRS + 1, 3), np.int64)
    found, n = np.empty((_NODES, 27), np.int64), 0
    if height == 1:
        rest[0] = 0
        found[0] = around[0]
        n = 1
    level = 0
    while level >= 0:
        word = rest[level]
        if not word:
            level -= 1
            continue
        low = word & (~word + _ONE)
        rest[level] = word ^ low
        bit = popcount(low - _ONE)
        below = around[level + 1]
        for z in range(2):  # no direction goes down
            for y in range(-1, 2):
                for x in range(-1, 2):
                    below[(x + 1) + 3 * (y + 1) + 9 * (z + 1)] = _child(
                        upper, first, around[level], bit, x, y, z
                    )
        if level == height - 2:
            found[n] = below
            n += 1
            if n == _NODES:
                _unite_children(upper, first, found, leaves, starts, masks, meeting, room, parents)
                n = 0
            continue
        level += 1
        rest[level] = upper[below[13]]
    _unite_children(upper, first, found[:n], leaves, starts, masks, meeting, room, parents)


@kernel
def _unite_children(upper, first, arounds, leaves, starts, masks, meeting, room, parents):
    """Join the blocks of nodes with each other and with those of the nodes around them."""
    directions, (starts_of, nodes, ways) = meeting
    borders, sides, hits = room
    for i in range(arounds.shape[0]):
        word, base = upper[arounds[i, 13]], first[arounds[i, 13]] - upper.size
        at_sides(word, leaves, base, borders, sides)
        n = 0
        for at in range(directions.size):
            side, facing = sides[directions[at]], sides[26 - directions[at]]
            if not side:
                continue
            for k in range(starts_of[at], starts_of[at + 1]):
                node = arounds[i, nodes[k]]
                if node < 0:
                    continue
                other, up, down = upper[node], ways[k, UP], ways[k, DOWN]
                wanted = facing if nodes[k] == 13 else other
                pairs = side & ways[k, CELLS] & moved(wanted, down, up)
                other_base = first[node] - upper.size
                while pairs:
                    low = pairs & (~pairs + _ONE)
                    pairs ^= low
                    here = base + popcount(word & (low - _ONE))
                    there = other_base + popcount(other & (moved(low, up, down) - _ONE))
                    hits[n, 0], hits[n, 1], hits[n, 2] = here, there, k
                    n += (touched(leaves[here], ways, k) & leaves[there]) != 0
        for hit in range(n):
            here, there, k = hits[hit, 0], hits[hit, 1], hits[hit, 2]
            reached = touched(leaves[here], ways, k) & leaves[there]
            reaching = touching(reached, ways, k) & leaves[here]
            one = _part_of(masks, starts[here], reaching & (~reaching + _ONE))
            other_one = _part_of(masks, starts[there], reached & (~reached + _ONE))
            if not (reaching & ~masks[one] or reached & ~masks[other_one]):
                _unite(parents, one, other_one)
            else:
                _unite_parts(here, there, starts, masks, ways, k, parents)


@kernel
def _part_of(masks, start, cell):
    """First part from `start` on that has a cell; three are looked at without a branch."""
    a = np.int64((masks[start] & cell) == 0)
    b = np.int64((masks[start + 1] & cell) == 0)
    c = np.int64((masks[start + 2] & cell) == 0)
    start += a * (1 + b * (1 + c))
    while not masks[start] & cell:
        start += 1
    return start


@kernel
def _unite_parts(here, there, starts, masks, ways, k, parents):
    """Join the parts of two blocks that touch each other."""
    for i in range(starts[here], starts[here + 1]):
        reached = touched(masks[i], ways, k)
        for j in range(starts[there], starts[there + 1]):
            if reached & masks[j]:
                _unite(parents, i, j)


@kernel
def number(parents, masks):
    """
    Replace each part's parent by its tree's number, and count the trees' cells.

    Parameters
    ----------
    parents : (m,) array of int32
        No root is above a member of its tree. Out: the tree's number, from 0.
    masks : array of uint64
        From `split`.

    Returns
    -------
    sizes : (n,) array of int64
        Cells of each tree.
    """
    sizes = np.zeros(parents.size, np.int64)
    n = 0
    for i in range(parents.size):
        parent = parents[i]
        if parent == i:
            tree = n
            n += 1
        else:
            tree = parents[parent]
        parents[i] = tree
        sizes[tree] += popcount(masks[i])
    return sizes[:n]


@kernel
def rank(sizes, large):
    """
    Order components by size, the largest first, equal ones as they come.

    Parameters
    ----------
    sizes : (n,) array of int64
        At least 1.
    large : (l,) array of int64
        Those of `SMALL` cells and more, in order; the others are ordered by counting.

    Returns
    -------
    ranks : (n,) array of int32
        Where each component goes.
    ordered : (n,) array of int64
        The sizes in order.
    """
    places = np.zeros(SMALL, np.int64)
    for i in range(sizes.size):
        if sizes[i] < SMALL:
            places[sizes[i]] += 1
    place = large.size
    for size in range(SMALL - 1, 0, -1):
        n_equal = places[size]
        places[size] = place
        place += n_equal
    ranks, ordered = np.empty(sizes.size, np.int32), np.empty(sizes.size, np.int64)
    for i in range(large.size):
        ranks[large[i]] = i
        ordered[i] = sizes[large[i]]
    for i in range(sizes.size):
        size = sizes[i]
        if size < SMALL:
            place = places[size]
            places[size] = place + 1
            ranks[i] = place
            ordered[place] = size
    return ranks, ordered


@kernel
def measure(starts, masks, numbers, ranks, blocks, boxes):
    """
    Find the boxes of the components, and give each part its component's rank.

    Parameters
    ----------
    starts, masks : arrays
        From `split`.
    numbers : (m,) array of int32
        Component of each part. Out: its rank.
    ranks : (k,) array of int32
        From `rank`.
    blocks : (n, 3) array of int32
        x, y, z of the blocks.
    boxes : (k, 6) array of int32
        Out: lowest x, y, z and highest x, y, z of the cells, by rank.
    """
    boxes[:, :3] = np.int32(2**31 - 1)
    boxes[:, 3:] = np.int32(-1)
    for block in range(blocks.shape[0]):
        x, y, z = 4 * blocks[block, 0], 4 * blocks[block, 1], 4 * blocks[block, 2]
        for part in range(starts[block], starts[block + 1]):
            mask = masks[part]
            k = ranks[numbers[part]]
            numbers[part] = k
            plane = mask | (mask >> _U32)
            plane = (plane | (plane >> _U16)) & np.uint64(0xFFFF)
            line = plane | (plane >> _U8)
            line = (line | (line >> _U4)) & _SLOTS
            boxes[k, 0] = min(boxes[k, 0], x + _lowest(line))
            boxes[k, 1] = min(boxes[k, 1], y + (_lowest(plane) >> 2))
            boxes[k, 2] = min(boxes[k, 2], z + (_lowest(mask) >> 4))
            boxes[k, 3] = max(boxes[k, 3], x + _quarter(line, _U1))
            boxes[k, 4] = max(boxes[k, 4], y + _quarter(plane, _U4))
            boxes[k, 5] = max(boxes[k, 5], z + _quarter(mask, _U16))


@kernel
def _lowest(word):
    """Return the number of the lowest bit."""
    return popcount((word & (~word + _ONE)) - _ONE)


@kernel
def _quarter(word, width):
    """Return which group of so many bits, of four, has the highest bit."""
    return (
        np.int64(word >> width != 0)
        + np.int64(word >> (_U2 * width) != 0)
        + np.int64(word >> (np.uint64(3) * width) != 0)
    )


@kernel
def label(words, starts, masks, numbers, labels):
    """
    Give each set cell the component of its part.

    Parameters
    ----------
    words : (n,) array of uint64
        Occupancy words.
    starts, masks : arrays
        From `split`.
    numbers : (m,) array of int32
        Component of each part.
    labels : (v,) array of int32
        Out: in VOLA order of the cells.
    """
    place = 0
    for block in range(words.size):
        start, stop = starts[block], starts[block + 1]
        word = words[block]
        if stop == start + 1:
            for _ in range(popcount(word)):
                labels[place] = numbers[start]
                place += 1
            continue
        for part in range(start, stop):
            mask = masks[part]
            while mask:
                low = mask & (~mask + _ONE)
                labels[place + popcount(word & (low - _ONE))] = numbers[part]
                mask ^= low
        place += popcount(word)
