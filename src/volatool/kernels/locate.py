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
    # & and not "and": without jumps, nothing is guessed wrong half of the time
    is_inside = (away >= -error) & (away <= side + error) & (error < np.inf)
    cell = np.int64(min(max(away + error, 0.0) * (size / side), size - 1.0))
    return cell if is_inside else np.int64(-1)


@kernel
def contains(directory, jump, jump_level, points, corner, side, z_ratio, depth, contained):
    """
    Tell which points fall into a voxel.

    Parameters
    ----------
    directory : (n, 2) array of uint64
        The levels; the last row is an empty block whose children are itself.
    jump : (64**jump_level,) array of int
        Row of the block in each cell of level `jump_level`, the last row where there is none.
    jump_level : int
        Less than the depth.
    points : (m, 3) array of float64
        x, y, z; z in its own unit.
    corner : (3,) array of float64
        Of the cube.
    side : float
        Of the cube, greater than 0. Cells are half-open.
    z_ratio : float
        Horizontal units a vertical unit.
    depth : int
        Number of levels.
    contained : (m,) array of bool
        Set.
    """
    size = float(1 << (2 * depth))
    lost = np.int64(directory.shape[0] - 1)
    wide = 2 * jump_level
    top = 2 * (depth - jump_level)
    for i in range(contained.size):
        x = _axis_cell(points[i, 0], corner[0], side, size)
        y = _axis_cell(points[i, 1], corner[1], side, size)
        z = _axis_cell(points[i, 2] * z_ratio, corner[2], side, size)
        if (x | y | z) < 0:
            contained[i] = False
            continue
        cell = (x >> top) | ((y >> top) << wide) | ((z >> top) << (2 * wide))
        row = np.int64(jump[cell])
        shift = top - 2
        while shift > 0:
            # lost points go on through the empty block: cheaper than a jump guessed wrong
            word = directory[row, 0]
            flag = _ONE << np.uint64(bit_of(x, y, z, shift))
            child = np.int64(directory[row, 1]) + popcount(word & (flag - _ONE))
            row = child if word & flag else lost
            shift -= 2
        contained[i] = (directory[row, 0] >> np.uint64(bit_of(x, y, z, 0))) & _ONE
