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


def half_open(cell, point, size):
    """Whether a point in cells falls into a cell."""
    return all(
        k <= p < k + 1 or (k == size - 1 and p == size) for k, p in zip(cell, point, strict=True)
    )


def meets_box(cell, low, high, size):
    """Whether a point of a closed box falls into a cell."""
    return all(
        k <= b and (a < k + 1 or (k == size - 1 and a == size))
        for k, a, b in zip(cell, low, high, strict=True)
    )


def runs(voxels, x, y):
    """(lowest, highest) z of each run of a column, top to bottom."""
    layers = sorted((z for vx, vy, z in voxels if (vx, vy) == (x, y)), reverse=True)
    found = []
    for z in layers:
        if found and found[-1][0] == z + 1:
            found[-1][0] = z
        else:
            found.append([z, z])
    return [tuple(run) for run in found]


def neighbours(voxels, cell, square, *, in_block=False):
    """Voxels whose distance to a cell is at most the root of `square`, without itself."""
    n = 0
    for voxel in voxels:
        d = sum((a - b) ** 2 for a, b in zip(voxel, cell, strict=True))
        same_block = all(a // 4 == b // 4 for a, b in zip(voxel, cell, strict=True))
        n += 0 < d <= square and (same_block or not in_block)
    return n
