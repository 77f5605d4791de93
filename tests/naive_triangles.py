"""Which cells triangles touch, by clipping each against each cell; no separating axes."""

from __future__ import annotations

import itertools

import numpy as np


def touches(triangle, low, high, slack=1e-9):
    """Whether something of a triangle is left after cutting off all that is outside a box."""
    polygon = [np.array(corner, float) for corner in triangle]
    for axis, (edge, sign) in itertools.product(range(3), ((low, 1), (high, -1))):
        kept = []
        for here, there in zip(polygon, polygon[1:] + polygon[:1], strict=True):
            a = sign * (here[axis] - edge[axis]) + slack
            b = sign * (there[axis] - edge[axis]) + slack
            if a >= 0:
                kept.append(here)
            if a * b < 0:
                kept.append(here + (there - here) * (a / (a - b)))
        polygon = kept
        if not polygon:
            return False
    return True


def touched_cells(triangles, depth):
    """Return the set of cells (x, y, z) that triangles touch, in cells of the level."""
    found = set()
    for triangle in np.asarray(triangles, float):
        first = np.maximum(np.ceil(triangle.min(axis=0)).astype(int) - 1, 0)
        last = np.minimum(np.floor(triangle.max(axis=0)).astype(int), 4**depth - 1)
        ranges = [range(a, b + 1) for a, b in zip(first, last, strict=True)]
        for cell in itertools.product(*ranges):
            low = np.array(cell, float)
            if touches(triangle, low, low + 1):
                found.add(cell)
    return found
