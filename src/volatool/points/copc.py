"""Which chunks of a COPC file may have points in a rectangle, from its octree.

The octree only ever leaves out work: what it does not list is read.

======  =======  ==================================================================
bytes   type     record "copc", 1
======  =======  ==================================================================
0       4 x f64  middle x, y, z and half the side of the cube
40      2 x u64  offset and bytes of the root page of the hierarchy
======  =======  ==================================================================

A page holds entries of 32 bytes: level, x, y, z (4 x i32) of a node, offset (u64), bytes (i32) and
points (i32; -1: the offset is that of another page).
"""

from __future__ import annotations

import struct
from collections.abc import Callable

import numpy as np

from volatool.points.header import LasHeader

ENTRY = np.dtype(
    [("level", "<i4"), ("key", "<i4", 3), ("at", "<u8"), ("n_bytes", "<i4"), ("n_points", "<i4")]
)

MAX_LEVEL = 60


def chunks_outside(
    header: LasHeader,
    raw: Callable[[int, int], bytes],
    box: tuple[float, float, float, float],
) -> frozenset[int]:
    """
    Return the offsets of the chunks that have no point in a rectangle.

    Parameters
    ----------
    header : LasHeader
        Of a COPC file; of others the answer is none.
    raw : callable
        Gives bytes of the file for (offset, number).
    box : tuple of 4 float
        left, bottom, right, top.

    Returns
    -------
    offsets : frozenset of int
        None where the octree makes no sense.
    """
    found = header.find("copc", 1)
    if not found or len(found[0].data) < 56:
        return frozenset()
    middle_x, middle_y, _, half = struct.unpack_from("<4d", found[0].data)
    pages = [struct.unpack_from("<2Q", found[0].data, 40)]
    left, bottom, right, top = box
    outside: set[int] = set()
    seen: set[int] = set()
    while pages:
        at, size = pages.pop()
        if at in seen or at + size > header.size_bytes or size % ENTRY.itemsize:
            return frozenset()
        seen.add(at)
        entries = np.frombuffer(raw(at, size), ENTRY)
        level = entries["level"]
        if len(entries) * ENTRY.itemsize != size or np.any((level < 0) | (level > MAX_LEVEL)):
            return frozenset()
        nested = entries["n_points"] < 0
        pages += [(int(e["at"]), int(e["n_bytes"])) for e in entries[nested] if e["n_bytes"] > 0]
        side = 2 * half / np.exp2(level)
        x = middle_x - half + entries["key"][:, 0] * side
        y = middle_y - half + entries["key"][:, 1] * side
        # a point on a face may be of either node, and writers round
        slack = side / 1000 + max(header.scale[:2])
        far = (x - slack > right) | (x + side + slack < left)
        far |= (y - slack > top) | (y + side + slack < bottom)
        outside.update(entries["at"][far & ~nested].tolist())
    return frozenset(outside)
