"""OctoMap's binary tree in plain Python: nodes as nested lists, one voxel at a time."""

from __future__ import annotations

import struct

FREE, OCCUPIED = "free", "occupied"


def build(voxels, low=(0, 0, 0), edge=65536, free=None):
    """
    Return what a cube is: None (unknown), FREE, OCCUPIED or a list of its 8 children.

    `free` is a (corner, edge) in keys: what is not occupied in it is free.
    """
    if not voxels:
        if free is not None:
            (corner, size) = free
            if size >= edge and all(c <= v < c + size for c, v in zip(corner, low, strict=True)):
                return FREE
            if all(v <= c < v + edge for c, v in zip(corner, low, strict=True)):
                pass  # the free cube is further down
            else:
                return None
        else:
            return None
    if edge == 1:
        return OCCUPIED
    half = edge // 2
    children = []
    for k in range(8):
        corner = [low[axis] + half * (k >> axis & 1) for axis in range(3)]
        inside = [
            v for v in voxels if all(c <= w < c + half for c, w in zip(corner, v, strict=True))
        ]
        children.append(build(inside, tuple(corner), half, free))
    if all(child == OCCUPIED for child in children):
        return OCCUPIED
    return children


def nodes(tree):
    """Return the stored nodes in pre-order."""
    word = 0
    for k, child in enumerate(tree):
        flag = {None: 0, FREE: 1, OCCUPIED: 2}[child] if not isinstance(child, list) else 3
        word |= flag << (2 * k)
    stored = [word]
    for child in tree:
        if isinstance(child, list):
            stored += nodes(child)
    return stored


def size(tree):
    """Return the number of nodes, leaves too."""
    if tree is None:
        return 0
    return 1 + (sum(map(size, tree)) if isinstance(tree, list) else 0)


def body(voxels, free=None):
    """Return the tree's size and the bytes after the header; keys from 0."""
    tree = build([tuple(map(int, v)) for v in voxels], free=free)
    if tree is None:
        return 0, b""
    stored = nodes(tree)
    return size(tree), struct.pack(f"<{len(stored)}H", *stored)


def leaves(data):
    """Return the occupied and the free leaves of a body: (x, y, z, edge) in keys."""
    words = iter(struct.unpack(f"<{len(data) // 2}H", data))
    found = {OCCUPIED: [], FREE: []}

    def visit(low, edge):
        word = next(words)
        half = edge // 2
        inner = []
        for k in range(8):
            corner = tuple(low[axis] + half * (k >> axis & 1) for axis in range(3))
            flag = word >> (2 * k) & 3
            if flag == 3:
                inner.append(corner)
            elif flag:
                found[FREE if flag == 1 else OCCUPIED].append((*corner, half))
        for corner in inner:
            visit(corner, half)

    visit((0, 0, 0), 65536)
    return found[OCCUPIED], found[FREE]
