"""Stored integers to cells, cells to path keys and back."""

from __future__ import annotations

import numpy as np

from volatool.kernels._jit import kernel

OUTSIDE = np.uint64(2**64 - 1)


@kernel
def _spread(index):
    """
    Move the 2-bit digits of a cell index (uint64 below 2**20) to every sixth bit.

    Shifts and masks of the whole number, without a loop over the levels: the same for any depth.
    """
    index = (index | (index << np.uint64(32))) & np.uint64(0x000F_0000_0000_FFFF)
    index = (index | (index << np.uint64(16))) & np.uint64(0x000F_0000_FF00_00FF)
    index = (index | (index << np.uint64(8))) & np.uint64(0x000F_00F0_0F00_F00F)
    index = (index | (index << np.uint64(4))) & np.uint64(0x00C3_0C30_C30C_30C3)
    return index


@kernel
def _interleave(ix, iy, iz):
    """Path key of one cell: the 2-bit digits of z, y, x of each level, root first."""
    return (
        _spread(np.uint64(ix))
        | (_spread(np.uint64(iy)) << np.uint64(2))
        | (_spread(np.uint64(iz)) << np.uint64(4))
    )


@kernel
def _divide(num, length, reciprocal, last):
    """Return ``min(last, num // length)`` for ``0 <= num``, the quotient below 2**21."""
    index = np.int64(num * reciprocal)
    rest = num - index * length
    index += np.int64(rest >= length) - np.int64(rest < 0)
    return min(index, last)


@kernel
def _affine_keys(x, y, z, axes, depth, keys):
    """Fill `keys` by an affine table; see `path_keys`. The compiler makes vectors of this loop."""
    last = np.int64(4) ** depth - 1
    up = np.int64(2 * depth)
    fx, sx, lx = axes[0, 0], axes[0, 1], axes[0, 2]
    fy, sy, ly = axes[1, 0], axes[1, 1], axes[1, 2]
    fz, sz, lz = axes[2, 0], axes[2, 1], axes[2, 2]
    rx, ry, rz = 1.0 / lx, 1.0 / ly, 1.0 / lz
    for i in range(x.size):
        nx = np.int64(x[i]) * fx + sx
        ny = np.int64(y[i]) * fy + sy
        nz = np.int64(z[i]) * fz + sz
        if (nx | ny | nz | (lx - nx) | (ly - ny) | (lz - nz)) < 0:  # the sign of any
            keys[i] = OUTSIDE
            continue
        ix = _divide(nx << up, lx, rx, last)
        iy = _divide(ny << up, ly, ry, last)
        iz = _divide(nz << up, lz, rz, last)
        keys[i] = _interleave(ix, iy, iz)


@kernel
def _tabulated_keys(x, y, z, first, lines, keys):
    """Fill `keys` by a table of first integers; see `path_keys`."""
    for i in range(x.size):
        ix = _look_up(x[i], first[0], lines[0, 0], lines[0, 1])
        iy = _look_up(y[i], first[1], lines[1, 0], lines[1, 1])
        iz = _look_up(z[i], first[2], lines[2, 0], lines[2, 1])
        if ix < 0 or iy < 0 or iz < 0:
            keys[i] = OUTSIDE
        else:
            keys[i] = _interleave(ix, iy, iz)


@kernel
def path_keys(x, y, z, is_affine, table, lines, depth, keys):
    """
    Path keys of points.

    Parameters
    ----------
    x, y, z : (n,) arrays of int32
        Stored integers.
    is_affine : bool
        The place of a point in the cube is an integer ratio.
    table : (3, 3) or (3, 4**depth + 1) array of int64
        Rows x, y, z. Affine: (factor, shift, length): ``num = stored * factor + shift``, inside
        the closed cube when ``0 <= num <= length``; ``length * 4**depth < 2**62``. Else: the
        smallest stored integer of each cell, then the smallest one beyond the closed cube; never
        decreasing.
    lines : (3, 2) array of float64
        Beside a table of first integers: about how many cells one step of the stored integers is,
        and the place of 0; only the speed depends on them. Where the slope is negative the table
        counts stored integers with their sign changed.
    depth : int
        Level of the cells, 1 to 10.
    keys : (n,) array of uint64
        Filled; ``2**64 - 1`` for points outside.

    Notes
    -----
    ``num * S // length`` by a float64 reciprocal, put right by the integer remainder: the
    estimate is off by at most one.
    """
    if is_affine:
        _affine_keys(x, y, z, table, depth, keys)
    else:
        _tabulated_keys(x, y, z, table, lines, keys)


@kernel
def _look_up(value, first, slope, base):
    """Last cell whose first stored integer is not above the value; -1 outside."""
    stored = np.int64(value)
    last = np.int64(first.size - 2)
    place = stored * slope + base
    if slope < 0:
        stored = -stored
    if stored < first[0] or stored >= first[last + 1]:
        return np.int64(-1)
    index = min(np.int64(max(min(place, 2.0e6), 0.0)), last)
    while first[index] > stored:
        index -= 1
    while index < last and first[index + 1] <= stored:
        index += 1
    return index


@kernel
def key_cells(keys, depth):
    """
    Cell indices of path keys.

    Parameters
    ----------
    keys : (n,) array of uint64
        Path keys at level `depth`.
    depth : int
        The level, 1 to 10.

    Returns
    -------
    cells : (n, 3) array of int32
        x, y, z.
    """
    cells = np.empty((keys.size, 3), np.int32)
    for i in range(keys.size):
        key = keys[i]
        x = y = z = 0
        for level in range(depth):
            digit = np.int64((key >> np.uint64(6 * level)) & np.uint64(63))
            x |= (digit & 3) << (2 * level)
            y |= ((digit >> 2) & 3) << (2 * level)
            z |= (digit >> 4) << (2 * level)
        cells[i, 0] = x
        cells[i, 1] = y
        cells[i, 2] = z
    return cells


@kernel
def cell_keys(cells):
    """
    Path keys of cells given by their indices.

    Parameters
    ----------
    cells : (n, 3) array of int32
        x, y, z, each from 0 to ``4**depth - 1``; the depth itself doesn't matter.

    Returns
    -------
    keys : (n,) array of uint64
    """
    keys = np.empty(cells.shape[0], np.uint64)
    for i in range(cells.shape[0]):
        keys[i] = _interleave(cells[i, 0], cells[i, 1], cells[i, 2])
    return keys
