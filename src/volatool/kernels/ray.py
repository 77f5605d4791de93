"""Rays through a volume: from plane to plane, whole empty blocks at a time.

The cells that a ray meets are those that one of its points falls into, cells being half-open: a
plane between two cells belongs to the cell above it. So going up, a ray has changed cells *at* the
plane, going down only *after* it. A place on a ray is therefore (t, after), ordered by t first;
a ray through an edge or a corner first makes all its steps up, then all those down.

The t of a plane is always ``(plane - origin) / direction``, never summed up: equal planes give
equal floats, and one step over an empty block agrees exactly with many small ones. The walk is
that of [Amanatides1987]_; the hierarchy and the order of ties are ours.
"""

from __future__ import annotations

import math

import numpy as np

from volatool.kernels._jit import kernel
from volatool.kernels.locate import bit_of, child_row


@kernel
def is_at_or_above(plane, origin, direction, t, after):
    """
    Tell on which side of a plane a ray is at a place; on the plane counts as above.

    Parameters
    ----------
    plane, origin, direction : float
        Of one axis; the direction is not 0.
    t : float
        The ray is at ``origin + t * direction``.
    after : bool
        Right after it.
    """
    at = (plane - origin) / direction
    if direction > 0.0:
        return at <= t
    return at > t or (at == t and not after)


@kernel
def cell_at(origin, direction, t, after, size):
    """
    Cell of one axis at a place on a ray.

    Parameters
    ----------
    origin, direction : float
        Of the axis, in cells.
    t, after : float, bool
        The place, inside the cube.
    size : int
        Cells of the axis.

    Returns
    -------
    cell : int64
        0 to ``size - 1``; the far face of the cube belongs to the last cell.
    """
    last = np.int64(size - 1)
    guess = np.int64(min(max(math.floor(origin + t * direction), 0.0), float(last)))
    if direction == 0.0:
        return guess
    for _ in range(3):  # a guess it is: what counts is which planes are behind
        if guess > 0 and not is_at_or_above(guess, origin, direction, t, after):
            guess -= 1
        elif guess < last and is_at_or_above(guess + 1, origin, direction, t, after):
            guess += 1
        else:
            return guess
    low, high = np.int64(0), last  # the origin is so far away that t is coarse
    while low < high:
        middle = (low + high + 1) // 2
        if is_at_or_above(middle, origin, direction, t, after):
            low = middle
        else:
            high = middle - 1
    return low


@kernel
def _span(origin, direction, limit, size):
    """Return the t at which a ray enters the closed cube and leaves it; NaN if it doesn't."""
    t_in, t_out = 0.0, limit
    for axis in range(3):
        o, d = origin[axis], direction[axis]
        if d == 0.0:
            if not (o >= 0.0 and o <= size):
                return np.nan, np.nan
            continue
        near, far = (0.0 - o) / d, (size - o) / d
        t_in = max(t_in, min(near, far))
        t_out = min(t_out, max(near, far))
    if t_in <= t_out and t_in < np.inf:
        return t_in, t_out
    return np.nan, np.nan


@kernel
def _exit(origin, direction, cell, shift, size):
    """Return the place (t, after) at which a ray leaves the cell of `cell`, `shift` bits up."""
    t, after = np.inf, True
    for axis in range(3):
        o, d = origin[axis], direction[axis]
        if d == 0.0:
            continue
        plane = (cell[axis] >> shift) << shift
        is_late = True
        if d > 0.0:
            plane += np.int64(1) << shift
            is_late = plane == size  # the far face of the cube is still inside
        at = (plane - o) / d
        if at < t or (at == t and after and not is_late):
            t, after = at, is_late
    return t, after


@kernel
def _cast(directory, depth, origin, direction, limit, skip, cell, rows):
    """First voxel of one ray: (row, t, blocks); the row is -1 without. `cell` is set to it."""
    size = np.int64(1) << (2 * depth)
    blocks = 0
    t, t_out = _span(origin, direction, limit, float(size))
    if math.isnan(t):
        return np.int64(-1), np.inf, blocks
    after = False
    for axis in range(3):
        cell[axis] = cell_at(origin[axis], direction[axis], t, after, size)
    level = 0
    rows[0] = 0
    blocks = 1
    while True:
        shift = 2 * (depth - 1 - level)
        bit = bit_of(cell[0], cell[1], cell[2], shift)
        child = child_row(directory, rows[level], bit)
        if child >= 0:
            if level < depth - 1:
                level += 1
                rows[level] = child
                blocks += 1
                continue
            is_end = False
            for k in range(2):
                is_end = is_end or (
                    cell[0] == skip[k, 0] and cell[1] == skip[k, 1] and cell[2] == skip[k, 2]
                )
            if not is_end:
                return child, t, blocks
        t, after = _exit(origin, direction, cell, shift, size)
        if t > t_out or (t == t_out and after):
            return np.int64(-1), np.inf, blocks
        changed = np.int64(0)
        for axis in range(3):
            index = cell_at(origin[axis], direction[axis], t, after, size)
            changed |= index ^ cell[axis]
            cell[axis] = index
        while changed >> (2 * (depth - level)):  # up to a block that holds both cells
            level -= 1


@kernel
def cast(directory, depth, origins, directions, limits, skips, cells, found, ts, blocks):
    """
    First voxel that each ray meets.

    Parameters
    ----------
    directory : (m, 2) array of uint64
        The levels, see `volatool.kernels.locate`.
    depth : int
        Number of levels.
    origins, directions : (n, 3) arrays of float64
        In cells from the cube's corner. The largest component of a direction is best near 1;
        zero all over means the origin alone.
    limits : (n,) array of float64
        Largest t, inclusive.
    skips : (n, 2, 3) array of int64
        Two cells that are passed through though they are set; -1 for none.
    cells : (n, 3) array of int64
        Set: the voxel, -1 without.
    found : (n,) array of int64
        Set: row of the voxel in the directory, -1 without.
    ts : (n,) array of float64
        Set: where the ray comes into it, 0 if it starts there; infinity without.
    blocks : (n,) array of int64
        Set: how many blocks were looked into.

    Notes
    -----
    What is not finite meets nothing.
    """
    rows = np.zeros(depth, np.int64)
    cell = np.zeros(3, np.int64)
    for i in range(found.size):
        row, t, n = _cast(
            directory, depth, origins[i], directions[i], limits[i], skips[i], cell, rows
        )
        found[i], ts[i], blocks[i] = row, t, n
        for axis in range(3):
            cells[i, axis] = cell[axis] if row >= 0 else -1
