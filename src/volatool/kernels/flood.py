"""Connected components of set cells: a bit flood inside each block, union-find across blocks."""

from __future__ import annotations

import numpy as np

from volatool.kernels._jit import kernel
from volatool.kernels.contiguity import popcount

_ONE = np.uint64(1)
_LOW = np.uint64(0x1111111111111111), np.uint64(0x000F000F000F000F), np.uint64(0xFFFF)
_HIGH = (
    np.uint64(0x8888888888888888),
    np.uint64(0xF000F000F000F000),
    np.uint64(0xFFFF000000000000),
)
_X0, _Y0, _Z0 = _LOW
_X3, _Y3, _Z3 = _HIGH
_SLOTS = np.uint64(15)
_LOWEST = np.array([0, 0, 1, 0, 2, 0, 1, 0, 3, 0, 1, 0, 2, 0, 1, 0])
_HIGHEST = np.array([0, 0, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3, 3, 3, 3, 3])
_U1, _U2, _U4, _U8, _U16, _U32 = (np.uint64(1 << i) for i in range(6))


@kernel
def _along_x(word):
    return word | ((word & ~_X3) << _U1) | ((word & ~_X0) >> _U1)


@kernel
def _along_y(word):
    return word | ((word & ~_Y3) << _U4) | ((word & ~_Y0) >> _U4)


@kernel
def _along_z(word):
    return word | (word << _U16) | (word >> _U16)


@kernel
def grown(word, is_26):
    """
    Cells of a block that are set or next to one that is.

    Parameters
    ----------
    word : uint64
        Bit ``lx + 4 ly + 16 lz``.
    is_26 : bool
        Next to means sharing a corner; else a face.

    Returns
    -------
    grown : uint64
        Nothing leaves the block.
    """
    if is_26:
        return _along_z(_along_y(_along_x(word)))
    return _along_x(word) | _along_y(word) | _along_z(word)


@kernel
def split(words, is_26):
    """
    Parts of each block that hang together inside it.

    Parameters
    ----------
    words : (n,) array of uint64
        Occupancy words.
    is_26 : bool
        Cells hang together over corners; else over faces only.

    Returns
    -------
    starts : (n + 1,) array of int64
        Where the parts of each block begin.
    masks : (m,) array of uint64
        Cells of each part, block after block, ordered by the lowest bit.
    """
    starts = np.empty(words.size + 1, np.int64)
    masks = np.empty(words.size + words.size // 4 + 64, np.uint64)
    n = 0
    for i in range(words.size):
        starts[i] = n
        if n + 64 > masks.size:
            larger = np.empty(2 * masks.size + 64, np.uint64)
            larger[:n] = masks[:n]
            masks = larger
        rest = words[i]
        while rest:
            part = rest & (~rest + _ONE)
            before = np.uint64(0)
            while part != before:
                before = part
                part = grown(part, is_26) & rest
            masks[n] = part
            n += 1
            rest ^= part
    starts[words.size] = n
    return starts, masks[:n].copy()


@kernel
def _root(parents, i):
    while parents[i] != i:
        parents[i] = parents[parents[i]]
        i = parents[i]
    return i


@kernel
def _unite(parents, i, j):
    """Join two trees under the smaller root: the component's first part in VOLA order."""
    i = _root(parents, i)
    j = _root(parents, j)
    if i < j:
        parents[j] = i
    elif j < i:
        parents[i] = j


@kernel
def _handed_over(word, mask, shift, ways, is_26):
    """Cells of a neighbouring block that touch a set cell of this one."""
    word &= mask
    word = word << np.uint64(shift) if shift >= 0 else word >> np.uint64(-shift)
    if is_26 and word:
        if ways & 1:
            word = _along_x(word)
        if ways & 2:
            word = _along_y(word)
        if ways & 4:
            word = _along_z(word)
    return word


@kernel
def _directions(is_26):
    """
    Return the upper half of the directions to neighbouring blocks.

    A row each: dx, dy, dz, by how much bits shift, and the axes along which cells spread (x 1,
    y 2, z 4); and which cells are at that side.
    """
    rows, sides = np.empty((13, 5), np.int64), np.empty(13, np.uint64)
    n = 0
    for direction in range(14, 27):
        dx, dy, dz = direction % 3 - 1, (direction // 3) % 3 - 1, direction // 9 - 1
        if not is_26 and abs(dx) + abs(dy) + abs(dz) > 1:
            continue
        side = ~np.uint64(0)
        if dx:
            side &= _X3 if dx > 0 else _X0
        if dy:
            side &= _Y3 if dy > 0 else _Y0
        if dz:
            side &= _Z3
        ways = (dx == 0) + 2 * (dy == 0) + 4 * (dz == 0)
        rows[n, 0], rows[n, 1], rows[n, 2], rows[n, 3] = dx, dy, dz, -(3 * dx + 12 * dy + 48 * dz)
        rows[n, 4] = ways
        sides[n] = side
        n += 1
    return rows[:n], sides[:n]


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

    One walk over the tree in VOLA order, which keeps the 27 nodes about the current one of each
    level: a neighbour is found by one rank, without search and without a table of neighbours.

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
    directions, sides = _directions(is_26)
    level = 0
    while level >= 0:
        word = rest[level]
        if not word:
            level -= 1
            continue
        low = word & (~word + _ONE)
        rest[level] = word ^ low
        bit = popcount(low - _ONE)
        if level < height - 1:
            for z in range(-1, 2):
                for y in range(-1, 2):
                    for x in range(-1, 2):
                        around[level + 1, (x + 1) + 3 * (y + 1) + 9 * (z + 1)] = _child(
                            upper, first, around[level], bit, x, y, z
                        )
            level += 1
            rest[level] = upper[around[level, 13]]
            continue
        here = _child(upper, first, around[level], bit, 0, 0, 0) - upper.size
        _unite_with_next(
            upper, first, around[level], bit, here, leaves, starts, masks, is_26, directions, sides,
            parents,
        )  # fmt: skip


@kernel
def _unite_with_next(
    upper, first, around, bit, here, leaves, starts, masks, is_26, directions, sides, parents
):
    """Join one block with its neighbours in the upper half of all directions."""
    own = leaves[here]
    for k in range(sides.size):
        if not own & sides[k]:
            continue
        there = _child(
            upper, first, around, bit, directions[k, 0], directions[k, 1], directions[k, 2]
        )
        if there < 0:
            continue
        there -= upper.size
        side, shift, ways = sides[k], directions[k, 3], directions[k, 4]
        if not _handed_over(own, side, shift, ways, is_26) & leaves[there]:
            continue
        for i in range(starts[here], starts[here + 1]):
            reached = _handed_over(masks[i], side, shift, ways, is_26)
            if reached:
                for j in range(starts[there], starts[there + 1]):
                    if reached & masks[j]:
                        _unite(parents, i, j)


@kernel
def number(parents):
    """
    Replace each part's parent by its tree's number.

    Parameters
    ----------
    parents : (m,) array of int32
        No root is above a member of its tree. Out: the tree's number, from 0.

    Returns
    -------
    n : int
        Trees.
    """
    n = 0
    for i in range(parents.size):
        if parents[i] == i:
            parents[i] = n
            n += 1
        else:
            parents[i] = parents[parents[i]]
    return n


@kernel
def measure(starts, masks, numbers, blocks, sizes, boxes):
    """
    Add up cells and boxes of the components.

    Parameters
    ----------
    starts, masks : arrays
        From `split`.
    numbers : (m,) array of int32
        Component of each part.
    blocks : (n, 3) array of int32
        x, y, z of the blocks.
    sizes : (k,) array of int64
        Zeros; out: cells of each component.
    boxes : (k, 6) array of int32
        Out: lowest x, y, z and highest x, y, z of its cells.
    """
    boxes[:, :3] = np.int32(2**31 - 1)
    boxes[:, 3:] = np.int32(-1)
    for block in range(blocks.shape[0]):
        for part in range(starts[block], starts[block + 1]):
            mask = masks[part]
            k = numbers[part]
            sizes[k] += popcount(mask)
            # which of the four slots of each axis are in use, as four bits
            plane = mask | (mask >> _U32)
            plane |= plane >> _U16
            x = plane | (plane >> _U8)
            x = (x | (x >> _U4)) & _SLOTS
            y = plane | (plane >> _U1)
            y = (y | (y >> _U2)) & np.uint64(0x1111)
            y = (y | (y >> np.uint64(3)) | (y >> np.uint64(6)) | (y >> np.uint64(9))) & _SLOTS
            z = np.uint64(0)
            for slot in range(4):
                if (mask >> np.uint64(16 * slot)) & _Z0:
                    z |= _ONE << np.uint64(slot)
            for axis, slots in enumerate((x, y, z)):
                corner = 4 * blocks[block, axis]
                low, high = corner + _LOWEST[slots], corner + _HIGHEST[slots]
                boxes[k, axis] = min(boxes[k, axis], low)
                boxes[k, 3 + axis] = max(boxes[k, 3 + axis], high)


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
