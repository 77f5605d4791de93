"""From points and cells to voxels: down the rank directory, all levels in one loop.

A *directory* has a row a block, level after level from the root: its word, and the row of its
first child. Both are on one line of the cache. Rows of children that don't exist go on counting:
those of the deepest level are the voxels.
"""

from __future__ import annotations

import numpy as np

from volatool.kernels._jit import kernel
from volatool.kernels.contiguity import popcount

_ONE = np.uint64(1)
_ULPS = 4 * float(np.finfo(np.float64).eps)


@kernel
def fill_directory(words, first_child, rows):
    """
    Write the rows of one level.

    Parameters
    ----------
    words : (n,) array of uint64
        Occupancy words of the level.
    first_child : int
        Row of the first block of the next level.
    rows : (n, 2) array of uint64
        Set: the words, and the row of the first child of each.
    """
    child = np.uint64(first_child)
    for i in range(words.size):
        rows[i, 0] = words[i]
        rows[i, 1] = child
        child += np.uint64(popcount(words[i]))


@kernel
def child_row(directory, row, bit):
    """
    Row of a cell's block in the next level.

    Parameters
    ----------
    directory : (n, 2) array of uint64
        The levels.
    row : int64
        Of the block that the cell is in.
    bit : int64
        Number of the cell in it.

    Returns
    -------
    child : int64
        -1 if the cell is not set.
    """
    word = directory[row, 0]
    flag = _ONE << np.uint64(bit)
    if not word & flag:
        return np.int64(-1)
    return np.int64(directory[row, 1]) + popcount(word & (flag - _ONE))


@kernel
def bit_of(x, y, z, shift):
    """Return the number in its block of the cell of (x, y, z), `shift` bits above the deepest."""
    return ((x >> shift) & 3) | (((y >> shift) & 3) << 2) | (((z >> shift) & 3) << 4)


@kernel
def row_of(directory, level, x, y, z):
    """
    Row of a cell of a level: of its block in the next level.

    Parameters
    ----------
    directory : (n, 2) array of uint64
        The levels.
    level : int
        From 0 (the root block itself, whatever x, y, z).
    x, y, z : int64
        Of the cell, from the cube's corner, inside the grid.

    Returns
    -------
    row : int64
        -1 if the cell is not set.
    """
    row = np.int64(0)
    for i in range(level):
        row = child_row(directory, row, bit_of(x, y, z, 2 * (level - 1 - i)))
        if row < 0:
            break
    return row


@kernel
def find(directory, cells, level, start, found):
    """
    Place of cells in VOLA order.

    Parameters
    ----------
    directory : (n, 2) array of uint64
        The levels.
    cells : (m, 3) array of int64
        x, y, z; outside the grid is not set.
    level : int
        Of the cells, from 1.
    start : int
        Row of the first block of the next level.
    found : (m,) array of int64
        Set: rank of the cell in its level, -1 if it is not set.
    """
    size = 1 << (2 * level)
    for i in range(found.size):
        x, y, z = cells[i]
        if (x | y | z) < 0 or x >= size or y >= size or z >= size:
            found[i] = -1
            continue
        row = row_of(directory, level, x, y, z)
        found[i] = row - start if row >= 0 else -1


@kernel
def _axis_cell(place, corner, side, size):
    """Cell of a coordinate, -1 outside; as `Volume.cell_indices` has it."""
    error = _ULPS * max(abs(place), abs(corner))
    away = place - corner
    if not (away >= -error and away <= side + error and error < np.inf):
        return np.int64(-1)
    return np.int64(min(max(away + error, 0.0) * (size / side), size - 1.0))


@kernel
def contains(directory, last, jump, jump_level, points, corner, side, z_ratio, depth, contained):
    """
    Tell which points fall into a voxel.

    Parameters
    ----------
    directory : (n, 2) array of uint64
        The levels; the last row is an empty block whose children are itself.
    last : (m + 1,) array of uint64
        Words of the deepest level and a zero: half as many bytes as their rows.
    jump : (64**jump_level,) array of int
        Row of the block in each cell of level `jump_level`, the last row where there is none.
    jump_level : int
        Less than the depth.
    points : (k, 3) array of float64
        x, y, z; z in its own unit.
    corner : (3,) array of float64
        Of the cube.
    side : float
        Of the cube, greater than 0. Cells are half-open.
    z_ratio : float
        Horizontal units a vertical unit.
    depth : int
        Number of levels.
    contained : (k,) array of bool
        Set.

    Notes
    -----
    Points well inside a cell take a short way to it, those within rounding error of a face (or
    outside) the exact one. There is next to nothing for the processor to guess wrong: points that
    are lost go on through the empty block.
    """
    size = 1 << (2 * depth)
    scale = size / side
    x0, y0, z0 = corner
    # twice what the exact way may shift a place, in cells
    error = 2.0 * _ULPS * (max(abs(x0), abs(y0), abs(z0)) + 2.0 * side) * scale
    near = 0.5 - error
    lost = np.int64(directory.shape[0] - 1)
    first = lost - (last.size - 1)
    wide = 2 * jump_level
    top = 2 * (depth - jump_level)
    for i in range(contained.size):
        px, py, pz = points[i, 0], points[i, 1], points[i, 2] * z_ratio
        tx, ty, tz = (px - x0) * scale, (py - y0) * scale, (pz - z0) * scale
        # whatever becomes of NaN and numbers too large for an int64: they are not `near` it
        x, y, z = np.int64(tx), np.int64(ty), np.int64(tz)
        is_clear = (
            (abs(tx - x - 0.5) < near)
            & (abs(ty - y - 0.5) < near)
            & (abs(tz - z - 0.5) < near)
            & (np.uint64(x | y | z) < np.uint64(size))
        )
        if not is_clear:
            x = _axis_cell(px, x0, side, float(size))
            y = _axis_cell(py, y0, side, float(size))
            z = _axis_cell(pz, z0, side, float(size))
            if (x | y | z) < 0:
                contained[i] = False
                continue
        row = np.int64(jump[(x >> top) | ((y >> top) << wide) | ((z >> top) << (2 * wide))])
        shift = top - 2
        while shift > 0:
            word = directory[row, 0]
            flag = _ONE << np.uint64(bit_of(x, y, z, shift))
            child = np.int64(directory[row, 1]) + popcount(word & (flag - _ONE))
            row = child if word & flag else lost
            shift -= 2
        contained[i] = (last[row - first] >> np.uint64(bit_of(x, y, z, 0))) & _ONE
