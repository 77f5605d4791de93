"""Cells and blocks that are next to each other: inside a block, and across nodes of the tree."""

from __future__ import annotations

import numpy as np

from volatool.kernels._jit import kernel

_ONE = np.uint64(1)
_X0, _X3 = np.uint64(0x1111111111111111), np.uint64(0x8888888888888888)
_Y0, _Y3 = np.uint64(0x000F000F000F000F), np.uint64(0xF000F000F000F000)
_U1, _U4, _U16 = np.uint64(1), np.uint64(4), np.uint64(16)

# columns of `meetings`
CELLS, UP, DOWN, SIDE, OVER_UP, OVER_DOWN = range(6)
_X_UP, _X_DOWN, _Y_UP, _Y_DOWN, _ALONG_Z = range(6, 11)

FACES = np.array([4, 10, 12, 14, 16, 22])
"""Directions over a face, as ``x + 3 y + 9 z``, each -1, 0 or 1 and one more: 13 is none."""
NOT_FACES = np.array([k for k in range(27) if k != 13 and k not in (4, 10, 12, 14, 16, 22)])
"""Directions over an edge or a corner."""


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
def moved(word, up, down):
    """Shift a word up or down, the other is zero: no branch."""
    return (word << up) >> down


@kernel
def _along(word, ways, k):
    """Let cells at a side of a block spread along it."""
    word |= ((word & ways[k, _X_UP]) << _U1) | ((word & ways[k, _X_DOWN]) >> _U1)
    word |= ((word & ways[k, _Y_UP]) << _U4) | ((word & ways[k, _Y_DOWN]) >> _U4)
    return word | ((word & ways[k, _ALONG_Z]) << _U16) | ((word & ways[k, _ALONG_Z]) >> _U16)


@kernel
def touched(word, ways, k):
    """Return the cells of the neighbouring block that touch a set cell of a block."""
    return _along(moved(word & ways[k, SIDE], ways[k, OVER_UP], ways[k, OVER_DOWN]), ways, k)


@kernel
def touching(word, ways, k):
    """Return the cells of a block that touch a set cell of the neighbouring block."""
    return _along(moved(word, ways[k, OVER_DOWN], ways[k, OVER_UP]) & ways[k, SIDE], ways, k)


@kernel
def meetings(directions, is_26):
    """
    Return where the blocks of a node meet each other and those of the nodes around it.

    For each direction and each node around (or the node itself) the cells of the node whose
    neighbour in that direction lies there: both nodes' words, one moved, give all pairs of
    neighbouring blocks at once.

    Parameters
    ----------
    directions : (d,) array of int64
        As ``x + 3 y + 9 z``, see `FACES`.
    is_26 : bool
        Whether cells of neighbouring blocks touch over corners; else over faces.

    Returns
    -------
    starts : (d + 1,) array of int64
        Where the rows of each direction begin.
    nodes : (k,) array of int64
        The node around, as ``x + 3 y + 9 z`` like the directions; 13 is the node itself.
    ways : (k, 11) array of uint64
        The cells; by how much they are shifted up or down (the other is 0) to their neighbours.
        Of blocks that are such neighbours: the cells at the side of the one, how much up or down
        they are shifted to what they touch in the other, and which of those spread along x up and
        down, y up and down, z.
    """
    starts, nodes = np.empty(directions.size + 1, np.int64), np.empty(124, np.int64)
    ways, k = np.zeros((124, 11), np.uint64), 0
    for place in range(directions.size):
        starts[place], direction = k, directions[place]
        dx, dy, dz = direction % 3 - 1, (direction // 3) % 3 - 1, direction // 9 - 1
        for node in range(27):
            nx, ny, nz = node % 3 - 1, (node // 3) % 3 - 1, node // 9 - 1
            if (nx and nx != dx) or (ny and ny != dy) or (nz and nz != dz):
                continue
            for bit in range(64):
                x, y, z = (bit & 3) + dx, ((bit >> 2) & 3) + dy, (bit >> 4) + dz
                # arithmetic shifts: -1 below the node, 0 in it, 1 above
                if x >> 2 == nx and y >> 2 == ny and z >> 2 == nz:
                    ways[k, CELLS] |= _ONE << np.uint64(bit)
                if x >> 2 == dx and y >> 2 == dy and z >> 2 == dz:
                    ways[k, SIDE] |= _ONE << np.uint64(bit)
            nodes[k] = node
            to = dx - 4 * nx + 4 * (dy - 4 * ny) + 16 * (dz - 4 * nz)
            over = -(3 * dx + 12 * dy + 48 * dz)
            ways[k, UP], ways[k, DOWN] = max(to, 0), max(-to, 0)
            ways[k, OVER_UP], ways[k, OVER_DOWN] = max(over, 0), max(-over, 0)
            if is_26:
                if dx == 0:
                    ways[k, _X_UP], ways[k, _X_DOWN] = ~_X3, ~_X0
                if dy == 0:
                    ways[k, _Y_UP], ways[k, _Y_DOWN] = ~_Y3, ~_Y0
                if dz == 0:
                    ways[k, _ALONG_Z] = ~np.uint64(0)
            k += 1
    starts[-1] = k
    return starts, nodes[:k], ways[:k]


@kernel
def at_sides(word, leaves, start, borders, sides):
    """
    Find the children of a node that may reach a neighbour in each direction.

    Parameters
    ----------
    word : uint64
        The node's children.
    leaves : array of uint64
        Cells of blocks.
    start : int
        Which of them is the first child.
    borders : (27,) array of uint64
        For each direction the cells of a block that reach beyond it that way.
    sides : (27,) array of uint64
        Out: for each direction the children that have one of these cells.
    """
    sides[:] = 0
    while word:
        low = word & (~word + _ONE)
        word ^= low
        own = leaves[start]
        start += 1
        if own:
            for k in range(sides.size):  # not 27: unrolled it would not be vectorized
                sides[k] |= low if own & borders[k] else np.uint64(0)
