"""Triangles to the cells that they touch, and to points spread over them."""

from __future__ import annotations

import numpy as np

from volatool.kernels._jit import kernel

TOLERANCE = 1e-9
"""Cells are taken so much larger, in cells: what rounding might miss is touched."""


@kernel
def _touches(corners, normal, middle, half):
    """
    Whether a triangle meets a closed cube whose range its own box meets.

    Separating axes: the triangle's normal and the nine products of its edges with the axes.
    """
    radius = half * (abs(normal[0]) + abs(normal[1]) + abs(normal[2]))
    distance = 0.0
    for a in range(3):
        distance += normal[a] * (corners[0, a] - middle[a])
    if abs(distance) > radius:
        return False
    for e in range(3):
        f = (e + 1) % 3
        for a in range(3):
            b = (a + 1) % 3
            c = (a + 2) % 3
            # axis = unit vector a x edge: components b and c only
            edge_b = corners[f, b] - corners[e, b]
            edge_c = corners[f, c] - corners[e, c]
            low, high = np.inf, -np.inf
            for v in range(3):
                place = (corners[v, c] - middle[c]) * edge_b - (corners[v, b] - middle[b]) * edge_c
                low, high = min(low, place), max(high, place)
            radius = half * (abs(edge_b) + abs(edge_c))
            if low > radius or high < -radius:
                return False
    return True


@kernel
def _descend(corners, depth, cells, at, limit):
    """Append the cells that one triangle touches to `cells` from `at` on; return how many.

    Above `limit` it stops: a triangle may touch more cells than can ever be counted.
    """
    low = np.empty(3)
    high = np.empty(3)
    side = np.float64(np.int64(4) ** depth)
    for a in range(3):
        low[a] = min(corners[0, a], corners[1, a], corners[2, a]) - TOLERANCE
        high[a] = max(corners[0, a], corners[1, a], corners[2, a]) + TOLERANCE
        low[a], high[a] = max(low[a], -1.0), min(high[a], side + 1.0)  # indices must fit
    normal = np.empty(3)
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        normal[a] = (corners[1, b] - corners[0, b]) * (corners[2, c] - corners[0, c]) - (
            corners[1, c] - corners[0, c]
        ) * (corners[2, b] - corners[0, b])
    n_found = 0
    middle = np.empty(3)
    first = np.empty(3, np.int64)
    last = np.empty(3, np.int64)
    stack = np.empty((64 * depth + 1, 4), np.int64)
    stack[0, :] = 0
    n_stack = 1
    while n_stack and n_found <= limit:
        n_stack -= 1
        level = stack[n_stack, 0] + 1
        size = np.int64(4) ** (depth - level)
        x0, y0, z0 = stack[n_stack, 1] * 4, stack[n_stack, 2] * 4, stack[n_stack, 3] * 4
        for a in range(3):
            start = (x0, y0, z0)[a]
            first[a] = max(start, np.int64(np.ceil(low[a] / size)) - 1)
            last[a] = min(start + 3, np.int64(np.floor(high[a] / size)))
        half = size / 2 + TOLERANCE
        for z in range(first[2], last[2] + 1):
            middle[2] = (z + 0.5) * size
            for y in range(first[1], last[1] + 1):
                middle[1] = (y + 0.5) * size
                for x in range(first[0], last[0] + 1):
                    middle[0] = (x + 0.5) * size
                    if not _touches(corners, normal, middle, half):
                        continue
                    if level < depth:
                        stack[n_stack, 0] = level
                        stack[n_stack, 1] = x
                        stack[n_stack, 2] = y
                        stack[n_stack, 3] = z
                        n_stack += 1
                    else:
                        if at + n_found < len(cells):
                            cells[at + n_found, 0] = x
                            cells[at + n_found, 1] = y
                            cells[at + n_found, 2] = z
                        n_found += 1
    return n_found


@kernel
def touched_cells(triangles, depth, cells, limit):
    """
    Cells of a cube that triangles touch.

    Parameters
    ----------
    triangles : (m, 3, 3) array of float64
        Corners, in cells of level `depth` from the cube's corner; they may lie outside.
    depth : int
        Level of the cells, 1 to 10.
    cells : (n, 3) array of int32
        Filled with x, y, z, triangle by triangle, as far as there is room; cells that several
        triangles touch come several times.
    limit : int
        Nothing is counted any more when there are more than so many, whether or not there was
        room.

    Returns
    -------
    counts : (m,) array of int64
        Cells of each triangle; of the one that goes beyond `limit` not all, behind it 0.

    Notes
    -----
    Cells are closed, so that a triangle in the face between two touches both. From the root down:
    only children of touched cells are tested, by separating axes [AkenineMoller2001]_.
    """
    counts = np.zeros(len(triangles), np.int64)
    at = 0
    for m in range(len(triangles)):
        counts[m] = _descend(triangles[m], depth, cells, at, limit - at)
        at += counts[m]
        if at > limit:
            break
    return counts


@kernel
def _steps(length, spacing):
    """Return the steps of at most `spacing`; of a crafted one no more than an integer holds."""
    return np.int64(np.ceil(min(length / spacing, 1e15)))


@kernel
def _rows(corners, spacing):
    """Return which corner the longest edge lies opposite, its length, and rows of points."""
    lengths = np.empty(3)
    for apex in range(3):
        b, c = (apex + 1) % 3, (apex + 2) % 3
        total = 0.0
        for a in range(3):
            total += (corners[b, a] - corners[c, a]) ** 2
        lengths[apex] = np.sqrt(total)
    apex = 0
    for k in range(1, 3):
        if lengths[k] > lengths[apex]:
            apex = k
    base = lengths[apex]
    # height over the base: the distance of the apex from its line
    b, c = (apex + 1) % 3, (apex + 2) % 3
    height = 0.0
    if base > 0:
        along, square = 0.0, 0.0
        for a in range(3):
            side = corners[apex, a] - corners[b, a]
            along += side * (corners[c, a] - corners[b, a]) / base
            square += side * side
        height = np.sqrt(max(0.0, square - along * along))
    return apex, base, _steps(height, spacing)


@kernel
def count_samples(triangles, spacing, limit):
    """
    How many points `sample` puts on each triangle.

    Parameters
    ----------
    triangles : (m, 3, 3) array of float64
        Corners.
    spacing : float
        Largest distance of neighbours in a row and of rows; greater than zero.
    limit : int
        No more points of a triangle are counted when there are more than so many.

    Returns
    -------
    counts : (m,) array of int64
    """
    counts = np.empty(len(triangles), np.int64)
    for m in range(len(triangles)):
        _, base, n_rows = _rows(triangles[m], spacing)
        total = np.int64(0)
        for r in range(n_rows + 1):
            length = base * (1.0 - r / n_rows) if n_rows else base
            total += _steps(length, spacing) + 1
            if total > limit:
                break
        counts[m] = total
    return counts


@kernel
def sample(triangles, spacing, n_points):
    """
    Points on triangles, in rows parallel to the longest edge, edges and corners included.

    Parameters
    ----------
    triangles : (m, 3, 3) array of float64
        Corners.
    spacing : float
        As for `count_samples`.
    n_points : int
        Sum of its counts.

    Returns
    -------
    points : (n, 3) array of float64
        No part of a triangle is farther than `spacing` from one of its points.
    """
    points = np.empty((n_points, 3))
    at = 0
    for m in range(len(triangles)):
        corners = triangles[m]
        apex, base, n_rows = _rows(corners, spacing)
        b, c = (apex + 1) % 3, (apex + 2) % 3
        for r in range(n_rows + 1):
            up = r / n_rows if n_rows else 0.0
            n_steps = _steps(base * (1.0 - up), spacing)
            for s in range(n_steps + 1):
                along = s / n_steps if n_steps else 0.0
                for a in range(3):
                    left = corners[b, a] + up * (corners[apex, a] - corners[b, a])
                    right = corners[c, a] + up * (corners[apex, a] - corners[c, a])
                    points[at, a] = left + along * (right - left)
                at += 1
    return points
