"""Octree nodes of two bits a child, as OctoMap's binary trees have them; Morton keys of voxels."""

from __future__ import annotations

import numpy as np

from volatool.kernels._jit import kernel

DEPTH = 16
"""Levels of a tree: a voxel has a key of 16 bits on each axis."""

FREE, OCCUPIED, INNER = 1, 2, 3
"""What two bits say of a child; 0 is unknown."""

CUT, TOO_DEEP, NO_CHILDREN = -1, -2, -3
"""What `count_leaves` says of nodes that are no tree."""

_STACK = 8 * DEPTH + 8


@kernel
def _spread(value):
    """Return the 16 low bits, each in a third of the places."""
    value = (value | (value << np.uint64(16))) & np.uint64(0x0000FF0000FF)
    value = (value | (value << np.uint64(8))) & np.uint64(0x00F00F00F00F)
    value = (value | (value << np.uint64(4))) & np.uint64(0x0C30C30C30C3)
    return (value | (value << np.uint64(2))) & np.uint64(0x249249249249)


@kernel
def _gather(value):
    """Return every third bit, 16 of them, side by side."""
    value = value & np.uint64(0x249249249249)
    value = (value | (value >> np.uint64(2))) & np.uint64(0x0C30C30C30C3)
    value = (value | (value >> np.uint64(4))) & np.uint64(0x00F00F00F00F)
    value = (value | (value >> np.uint64(8))) & np.uint64(0x0000FF0000FF)
    return (value | (value >> np.uint64(16))) & np.uint64(0xFFFF)


@kernel
def morton_keys(cells, offset):
    """
    Morton keys of voxels.

    Parameters
    ----------
    cells : (n, 3) array of int32
        x, y, z.
    offset : int
        Added to each; the sums are 0 to 65535.

    Returns
    -------
    keys : (n,) array of uint64
        Three bits a level, root first, ``x + 2 y + 4 z``.
    """
    keys = np.empty(len(cells), np.uint64)
    for i in range(len(cells)):
        x = _spread(np.uint64(cells[i, 0] + offset))
        y = _spread(np.uint64(cells[i, 1] + offset))
        z = _spread(np.uint64(cells[i, 2] + offset))
        keys[i] = x | (y << np.uint64(1)) | (z << np.uint64(2))
    return keys


@kernel
def pruned_leaves(keys):
    """
    Largest cubes that voxels fill: what OctoMap prunes to one leaf.

    Parameters
    ----------
    keys : (n,) array of uint64
        Morton keys, ascending, none twice.

    Returns
    -------
    leaves : (m,) array of uint64
        The first key of each cube, ascending.
    heights : (m,) array of uint8
        Levels above a voxel's: the cube has ``8 ** height`` voxels.
    """
    leaves = np.empty(keys.size, np.uint64)
    heights = np.empty(keys.size, np.uint8)
    n = 0
    i = 0
    while i < keys.size:
        key = keys[i]
        height = 0
        count = np.int64(1)
        # keys ascend, so a cube is full when its last voxel is where it would be
        while height < DEPTH:
            more = count * 8
            if i + more > keys.size or np.int64(key) % more:
                break
            if keys[i + more - 1] != key + np.uint64(more - 1):
                break
            height += 1
            count = more
        leaves[n] = key
        heights[n] = height
        n += 1
        i += count
    return leaves[:n].copy(), heights[:n].copy()


@kernel
def _shared_levels(a, b):
    """Return how many levels from the root two keys have in common."""
    difference = a ^ b
    level = DEPTH
    while difference:
        difference >>= np.uint64(3)
        level -= 1
    return level


@kernel
def count_inner(leaves, heights):
    """
    Inner nodes of the tree of some leaves.

    Parameters
    ----------
    leaves : (n,) array of uint64
        First Morton key of each, ascending, no cube in another.
    heights : (n,) array of uint8
        Levels above a voxel's.

    Returns
    -------
    n_inner : int64
        The root counts, unless it is the only leaf.
    """
    n_inner = np.int64(0)
    for i in range(leaves.size):
        known = 0 if i == 0 else _shared_levels(leaves[i - 1], leaves[i]) + 1
        n_inner += max(DEPTH - np.int64(heights[i]) - known, 0)
    return n_inner


@kernel
def inner_nodes(leaves, heights, value, n_inner, free_level):
    """
    Nodes with children, in pre-order: what an OctoMap binary tree stores.

    Parameters
    ----------
    leaves, heights : (n,) arrays of uint64 and uint8
        As for `count_inner`.
    value : int
        What the leaves are: `OCCUPIED` or `FREE`.
    n_inner : int
        As `count_inner` returned it.
    free_level : int
        Other children of nodes from this level on (the root's is 0) are free; with 17 they are
        unknown, as are all above.

    Returns
    -------
    nodes : (n_inner,) array of uint16
        Two bits a child, the first lowest.
    n_free : int64
        Children that became free.
    """
    nodes = np.empty(n_inner, np.uint16)
    here = np.zeros(DEPTH + 1, np.int64)  # node of each level on the way to the leaf
    n = np.int64(0)
    n_free = np.int64(0)
    for i in range(leaves.size):
        key = leaves[i]
        level = DEPTH - np.int64(heights[i])
        known = 0 if i == 0 else _shared_levels(leaves[i - 1], key) + 1
        for depth in range(known, level):
            nodes[n] = 0x5555 if depth >= free_level else 0
            n_free += 8 if depth >= free_level else 0
            here[depth] = n
            n += 1
        for depth in range(max(known, 1), level + 1):
            shift = 2 * np.int64((key >> np.uint64(3 * (DEPTH - depth))) & np.uint64(7))
            flag = value if depth == level else INNER
            parent = here[depth - 1]
            nodes[parent] = (nodes[parent] & ~(3 << shift)) | (flag << shift)
            n_free -= 1 if depth - 1 >= free_level else 0
    return nodes, n_free


@kernel
def count_leaves(nodes):
    """
    Check that nodes are one tree and count its leaves.

    Parameters
    ----------
    nodes : (n,) array of uint16
        From a file: anything. At least one.

    Returns
    -------
    used : int64
        Nodes of the tree; what follows is not part of it. `CUT`, `TOO_DEEP` or `NO_CHILDREN` (a
        node other than the root) when they are no tree.
    place : int64
        Where that was seen.
    n_occupied, n_free : int64
        Leaves.
    """
    levels = np.empty(_STACK, np.int64)
    levels[0] = 0
    waiting = 1
    at = np.int64(0)
    n_occupied = np.int64(0)
    n_free = np.int64(0)
    while waiting > 0:
        waiting -= 1
        level = levels[waiting]
        if at >= nodes.size:
            return CUT, at, n_occupied, n_free
        node = np.int64(nodes[at])
        if level == DEPTH:
            return TOO_DEEP, at, n_occupied, n_free
        if node == 0 and level > 0:
            return NO_CHILDREN, at, n_occupied, n_free
        for child in range(8):
            value = (node >> (2 * child)) & 3
            n_occupied += value == OCCUPIED
            n_free += value == FREE
            if value == INNER:
                levels[waiting] = level + 1
                waiting += 1
        at += 1
    return at, at, n_occupied, n_free


@kernel
def find_leaves(nodes, n_occupied, n_free):
    """
    Leaves of a tree that `count_leaves` found whole.

    Parameters
    ----------
    nodes : (n,) array of uint16
        The tree.
    n_occupied, n_free : int
        Its leaves.

    Returns
    -------
    occupied, free : (n, 4) arrays of int32
        Lowest keys x, y, z and the edge in voxels (65536 at most), in the order of the file.
    """
    occupied = np.empty((n_occupied, 4), np.int32)
    free = np.empty((n_free, 4), np.int32)
    keys = np.empty(_STACK, np.uint64)
    levels = np.empty(_STACK, np.int64)
    keys[0] = 0
    levels[0] = 0
    waiting = 1
    at = np.int64(0)
    i = np.int64(0)
    j = np.int64(0)
    while waiting > 0:
        waiting -= 1
        key = keys[waiting]
        level = levels[waiting] + 1
        node = np.int64(nodes[at])
        at += 1
        shift = np.uint64(3 * (DEPTH - level))
        for child in range(8):
            value = (node >> (2 * child)) & 3
            lowest = key | (np.uint64(child) << shift)
            if value == OCCUPIED:
                _put(occupied, i, lowest, level)
                i += 1
            elif value == FREE:
                _put(free, j, lowest, level)
                j += 1
        for child in range(7, -1, -1):  # the first one comes next
            if (node >> (2 * child)) & 3 == INNER:
                keys[waiting] = key | (np.uint64(child) << shift)
                levels[waiting] = level
                waiting += 1
    return occupied, free


@kernel
def _put(leaves, row, key, level):
    leaves[row, 0] = _gather(key)
    leaves[row, 1] = _gather(key >> np.uint64(1))
    leaves[row, 2] = _gather(key >> np.uint64(2))
    leaves[row, 3] = 1 << (DEPTH - level)


@kernel
def expanded(leaves, n_cells, offset):
    """
    Voxels of leaves.

    Parameters
    ----------
    leaves : (n, 4) array of int32
        Lowest keys x, y, z and the edge.
    n_cells : int
        The sum of their edges cubed.
    offset : int
        Added to the keys.

    Returns
    -------
    cells : (n_cells, 3) array of int32
        x, y, z; x fastest inside a leaf.
    """
    cells = np.empty((n_cells, 3), np.int32)
    at = np.int64(0)
    for i in range(len(leaves)):
        edge = leaves[i, 3]
        for z in range(edge):
            for y in range(edge):
                for x in range(edge):
                    cells[at, 0] = leaves[i, 0] + x + offset
                    cells[at, 1] = leaves[i, 1] + y + offset
                    cells[at, 2] = leaves[i, 2] + z + offset
                    at += 1
    return cells
