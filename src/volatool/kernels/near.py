"""Bits of a volume that are far from all bits of another one, across block borders."""

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
    touching,
)
from volatool.kernels.contiguity import popcount

_ONE = np.uint64(1)


@kernel
def _spread_axis(word, axis, low, high):
    """All copies of a block moved by `low` to `high` cells along an axis; what leaves is cut."""
    low, high = max(low, -3), min(high, 3)
    result = np.uint64(0)
    for step in range(low, high + 1):
        moved = word
        size = np.uint64(abs(step))
        if axis == 0:
            if step > 0:
                moved = (word << size) & (
                    np.uint64(0x1111111111111111) * ((np.uint64(15) << size) & np.uint64(15))
                )
            elif step < 0:
                moved = (word >> size) & (np.uint64(0x1111111111111111) * (np.uint64(15) >> size))
        elif axis == 1:
            if step > 0:
                mask = (np.uint64(0xFFFF) << (np.uint64(4) * size)) & np.uint64(0xFFFF)
                moved = (word << (np.uint64(4) * size)) & (np.uint64(0x0001000100010001) * mask)
            elif step < 0:
                mask = np.uint64(0xFFFF) >> (np.uint64(4) * size)
                moved = (word >> (np.uint64(4) * size)) & (np.uint64(0x0001000100010001) * mask)
        elif step > 0:
            moved = word << (np.uint64(16) * size)
        elif step < 0:
            moved = word >> (np.uint64(16) * size)
        result |= moved
    return result


@kernel
def spread(word, x, y, z, reach):
    """
    Cells of a block that are near the cells of another one.

    Parameters
    ----------
    word : uint64
        Cells of the other block.
    x, y, z : int
        Where it is, in blocks: -1, 0 or 1 on each axis.
    reach : int
        Cells on each axis (Chebyshev), 0 to 4.

    Returns
    -------
    near : uint64
    """
    near = _spread_axis(word, 0, 4 * x - reach, 4 * x + reach)
    near = _spread_axis(near, 1, 4 * y - reach, 4 * y + reach)
    return _spread_axis(near, 2, 4 * z - reach, 4 * z + reach)


@kernel
def _child_of(neighbours, block, words, ranks, x, y, z):
    """Block of the next level at cell x, y, z (-1 to 4) of a block or its neighbours, or -1."""
    place = neighbours[block, (x >> 2) + 1 + 3 * ((y >> 2) + 1) + 9 * ((z >> 2) + 1)]
    if place < 0:
        return np.int64(-1)
    flag = _ONE << np.uint64((x & 3) + 4 * (y & 3) + 16 * (z & 3))
    word = words[place]
    if not word & flag:
        return np.int64(-1)
    return ranks[place] + popcount(word & (flag - _ONE))


@kernel
def neighbour_children(cells, neighbours, words, ranks, n_cells):
    """
    Find the 27 blocks of another volume around each cell, one level down.

    Parameters
    ----------
    cells : (n,) array of uint64
        For each block the cells that are asked for.
    neighbours : (n, 27) array of int32
        Blocks of the other volume around each block, x fastest, its own place in the middle; -1
        where there is none.
    words, ranks : (m,) arrays of uint64, int64
        The other volume's words of this level, and the set bits before each.
    n_cells : int
        Set bits of `cells`.

    Returns
    -------
    children : (n_cells, 27) array of int32
        The same for each set bit, in the next level of the other volume.
    """
    children = np.empty((n_cells, 27), np.int32)
    place = 0
    for i in range(cells.size):
        word = cells[i]
        while word:
            low = word & (~word + _ONE)
            bit = popcount(low - _ONE)
            x, y, z = bit & 3, (bit >> 2) & 3, bit >> 4
            for dz in range(-1, 2):
                for dy in range(-1, 2):
                    for dx in range(-1, 2):
                        children[place, 13 + dx + 3 * dy + 9 * dz] = _child_of(
                            neighbours, i, words, ranks, x + dx, y + dy, z + dz
                        )
            place += 1
            word ^= low
    return children


@kernel
def far_bits(bits, cells, neighbours, words, ranks, deepest, reach):
    """
    Keep the bits that have no bit of another volume near them.

    Parameters
    ----------
    bits : (k,) array of uint64
        For each set bit of `cells` the bits of its block one level down.
    cells, neighbours, words, ranks
        As in `neighbour_children`.
    deepest : (j,) array of uint64
        The other volume's words one level down.
    reach : int
        Cells on each axis, 0 to 4.

    Returns
    -------
    far : (k,) array of uint64
    """
    far = np.empty(bits.size, np.uint64)
    borders = np.empty(27, np.uint64)
    for k in range(27):
        borders[k] = spread(~np.uint64(0), k % 3 - 1, k // 3 % 3 - 1, k // 9 - 1, reach)
    directions = np.concatenate((FACES, NOT_FACES))  # the likelier first
    starts, nodes, ways = meetings(directions, True)
    sides = np.empty(27, np.uint64)
    start = 0
    for i in range(cells.size):
        word, node = cells[i], neighbours[i, 13]
        own, child = (words[node], ranks[node]) if node >= 0 else (np.uint64(0), np.int64(0))
        rest, place, n_left = word, start, 0
        while rest:
            low = rest & (~rest + _ONE)
            rest ^= low
            left = bits[place]
            if own & low:
                near = deepest[child + popcount(own & (low - _ONE))]
                left &= ~(grown(near, True) if reach == 1 else spread(near, 0, 0, 0, reach))
            far[place] = left
            place += 1
            n_left += left != 0
        # all pairs of blocks in one direction at once, of the children with a bit at the side that
        # way
        for at in range(directions.size if n_left else 0):
            if at in (0, FACES.size):
                at_sides(word, far, start, borders, sides)
            direction = directions[at]
            side = sides[direction]
            if not side:
                continue
            for k in range(starts[at], starts[at + 1]):
                node = neighbours[i, nodes[k]]
                if node < 0:
                    continue
                other, up, down = words[node], ways[k, UP], ways[k, DOWN]
                pairs = side & ways[k, CELLS] & moved(other, down, up)
                while pairs:
                    low = pairs & (~pairs + _ONE)
                    pairs ^= low
                    near = deepest[ranks[node] + popcount(other & (moved(low, up, down) - _ONE))]
                    if reach == 1:
                        near = touching(near, ways, k)
                    else:
                        x, y, z = direction % 3 - 1, direction // 3 % 3 - 1, direction // 9 - 1
                        near = spread(near, x, y, z, reach)
                    far[start + popcount(word & (low - _ONE))] &= ~near
        start = place
    return far
