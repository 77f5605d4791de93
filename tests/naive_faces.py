"""The boundary of a set of cells, one face at a time."""

from __future__ import annotations

import itertools


def boundary(cells):
    """Return (axis, sign, cell) of each face between a cell and a place without one."""
    cells = {tuple(map(int, cell)) for cell in cells}
    faces = set()
    for cell in cells:
        for axis, sign in itertools.product(range(3), (-1, 1)):
            beside = tuple(v + sign * (k == axis) for k, v in enumerate(cell))
            if beside not in cells:
                faces.add((axis, sign, cell))
    return faces


def covered(corners):
    """Return (axis, sign, cell) of each unit face of rectangles, as often as it is covered."""
    faces = []
    for a, b, c, d in corners.tolist():
        axis = next(k for k in range(3) if a[k] == b[k] == c[k] == d[k])
        u, v = (axis + 1) % 3, (axis + 2) % 3
        # twice the signed area, by the corners in their order
        area = sum(
            p[u] * q[v] - q[u] * p[v] for p, q in zip((a, b, c, d), (b, c, d, a), strict=True)
        )
        sign = 1 if area > 0 else -1
        low = [min(a[k], c[k]) for k in range(3)]
        high = [max(a[k], c[k]) for k in range(3)]
        assert abs(area) == 2 * (high[u] - low[u]) * (high[v] - low[v]) > 0
        for i, j in itertools.product(range(low[u], high[u]), range(low[v], high[v])):
            cell = [0, 0, 0]
            cell[axis], cell[u], cell[v] = low[axis] - (sign > 0), i, j
            faces.append((axis, sign, tuple(cell)))
    return faces
