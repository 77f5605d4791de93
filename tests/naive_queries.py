"""Plain twins of the queries: every voxel looked at, one thing at a time."""

from __future__ import annotations

import math


def interval(origin, direction, cell, size, limit):
    """
    The t at which the points of a ray are in a cell: (low, is_open, high, is_open), or None.

    Half-open cells, the cube's far face closed.
    """
    low, low_open, high, high_open = 0.0, False, limit, False
    for o, d, k in zip(origin, direction, cell, strict=True):
        is_last = k == size - 1
        if d == 0:
            if not (k <= o < k + 1 or (is_last and o == k + 1)):
                return None
            continue
        near, far = (k - o) / d, (k + 1 - o) / d
        near_open, far_open = False, not is_last
        if d < 0:
            near, far, near_open, far_open = far, near, far_open, near_open
        if (near, near_open) > (low, low_open):
            low, low_open = near, near_open
        if (far, not far_open) < (high, not high_open):
            high, high_open = far, far_open
    if low > high or (low == high and (low_open or high_open)):
        return None
    return low, low_open, high, high_open


def first_hit(voxels, origin, direction, size, limit=math.inf, skip=()):
    """(t, voxel) of the voxel whose interval begins first, or None."""
    found = []
    for cell in voxels:
        if cell in skip:
            continue
        span = interval(origin, direction, cell, size, limit)
        if span is not None:
            found.append((span[0], span[1], cell))
    return None if not found else (min(found)[0], min(found)[2])
