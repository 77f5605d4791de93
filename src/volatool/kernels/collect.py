"""Points into a builder: path keys in the order of the file, sums of attributes in a hash table."""

from __future__ import annotations

import numpy as np

from volatool.kernels._jit import kernel
from volatool.kernels.quantize import OUTSIDE, path_keys
from volatool.kernels.reduce import ROW

NEXT, KEYS, OUT, ROWS = range(4)
"""Fields of a tally: next point, keys written, points outside, rows in use."""

BLOCK = 2048
"""Points whose cells are found together, in vectors."""

EMPTY = np.int32(-1)
"""A slot without a row."""


@kernel
def collect_keys(x, y, z, is_affine, table, lines, depth, keys, tally, box):
    """
    Write the path keys of points that are in the cube.

    Parameters
    ----------
    x, y, z : (n,) arrays of int32
        Stored integers.
    is_affine, table, lines, depth
        As for `quantize.path_keys`.
    keys : (n,) array of uint64
        Filled from its start; a key that follows an equal one is left out.
    tally : (4,) array of int64
        ``KEYS`` is set, ``OUT`` added to.
    box : (6,) array of int64
        Smallest x, y, z, then largest, of the points inside. Widened.
    """
    cells = np.empty(BLOCK, np.uint64)
    n_keys = n_outside = np.int64(0)
    last = OUTSIDE
    for start in range(0, x.size, BLOCK):
        xs, ys, zs = x[start : start + BLOCK], y[start : start + BLOCK], z[start : start + BLOCK]
        path_keys(xs, ys, zs, is_affine, table, lines, depth, cells)
        _widen(box, xs, ys, zs, cells)
        for i in range(xs.size):
            key = cells[i]
            n_outside += np.int64(key == OUTSIDE)
            keys[n_keys] = key
            n_keys += np.int64(key != last and key != OUTSIDE)
            last = key
    tally[KEYS] = n_keys
    tally[OUT] += n_outside


@kernel
def _widen(box, x, y, z, cells):
    """Grow a box to hold the points that are in a cell."""
    x0, y0, z0 = np.int32(2**31 - 1), np.int32(2**31 - 1), np.int32(2**31 - 1)
    x1, y1, z1 = np.int32(-(2**31)), np.int32(-(2**31)), np.int32(-(2**31))
    n_inside = np.int64(0)
    for i in range(x.size):
        if cells[i] != OUTSIDE:
            n_inside += 1
            x0, y0, z0 = min(x0, x[i]), min(y0, y[i]), min(z0, z[i])
            x1, y1, z1 = max(x1, x[i]), max(y1, y[i]), max(z1, z[i])
    if n_inside:
        box[0], box[1], box[2] = min(box[0], x0), min(box[1], y0), min(box[2], z0)
        box[3], box[4], box[5] = max(box[3], x1), max(box[4], y1), max(box[5], z1)


@kernel
def collect_sums(
    x, y, z, is_affine, table, lines, depth, keys, tally, box,
    digits, code, red, green, blue, height, returns, intensity, slots, rows, ranges,
):  # fmt: skip
    """
    Write the path keys of points that are in the cube, and add their attributes to sums.

    Parameters
    ----------
    x, y, z, is_affine, table, lines, depth, keys, box
        As for `collect_keys`.
    tally : (4,) array of int64
        Work begins at point ``NEXT`` and stops when there is no free row: ``NEXT`` is less than n
        then. ``KEYS`` and ``ROWS`` go on from where they are, ``OUT`` is added to.
    digits : int
        Levels of a path key that are below its block.
    code, returns : (n,) arrays of uint8
        Class and number of returns.
    red, green, blue, intensity : (n,) arrays of uint16
    height : (n,) array of int32
        Stored heights to be summed.
    slots : (2**k,) array of int32
        Hash table: numbers of rows, `EMPTY` elsewhere; at most half of them in use.
    rows : (capacity, 8) array of int64
        Rows of sums (see `reduce`), in the order in which their keys came up.
    ranges : (4,) array of int64
        Smallest and largest height, largest colour and intensity. Widened.
    """
    cells = np.empty(BLOCK, np.uint64)
    low, high, brightest, strongest = ranges[0], ranges[1], ranges[2], ranges[3]
    i, n_keys, n_outside, n_rows = tally[0], tally[1], tally[2], tally[3]
    shift = np.uint64(6 * digits)
    last = OUTSIDE
    row = np.int64(0)
    last_name = np.int64(-1)
    is_full = False
    while i < x.size and not is_full:
        start, stop = i, min(i + BLOCK, x.size)
        xs, ys, zs = x[start:stop], y[start:stop], z[start:stop]
        path_keys(xs, ys, zs, is_affine, table, lines, depth, cells)
        _widen(box, xs, ys, zs, cells)
        while i < stop:
            key = cells[i - start]
            if key == OUTSIDE:
                n_outside += 1
                i += 1
                continue
            name = (np.int64(key >> shift) << 8) | np.int64(code[i])
            if name != last_name:
                if n_rows == rows.shape[0]:
                    is_full = True
                    break
                row = _row_of(name, slots, rows, n_rows)
                last_name = name
                n_rows = max(n_rows, row + 1)
            keys[n_keys] = key
            n_keys += np.int64(key != last)
            last = key
            r, g, b = np.int64(red[i]), np.int64(green[i]), np.int64(blue[i])
            h, strength = np.int64(height[i]), np.int64(intensity[i])
            low, high = min(low, h), max(high, h)
            brightest, strongest = max(brightest, r, g, b), max(strongest, strength)
            rows[row, 1] += 1
            rows[row, 2] += r
            rows[row, 3] += g
            rows[row, 4] += b
            rows[row, 5] += h
            rows[row, 6] += np.int64(returns[i])
            rows[row, 7] += strength
            i += 1
    ranges[0], ranges[1], ranges[2], ranges[3] = low, high, brightest, strongest
    tally[0], tally[1], tally[2], tally[3] = i, n_keys, n_outside, n_rows


@kernel
def _row_of(name, slots, rows, n_rows):
    """Return the number of the row with a key; a new one is `n_rows`, cleared."""
    mask = np.int64(slots.size - 1)
    mixed = np.uint64(name) * np.uint64(0x9E3779B97F4A7C15)
    slot = np.int64(mixed >> np.uint64(20)) & mask
    while slots[slot] != EMPTY:
        row = np.int64(slots[slot])
        if rows[row, 0] == name:
            return row
        slot = (slot + 1) & mask
    slots[slot] = n_rows
    rows[n_rows, 0] = name
    for column in range(1, ROW):
        rows[n_rows, column] = 0
    return np.int64(n_rows)


@kernel
def regroup(rows, n_rows, digits, slots):
    """
    Make the blocks of a table of sums coarser, in place.

    Parameters
    ----------
    rows : (capacity, 8) array of int64
        The first `n_rows` are in use. Changed.
    n_rows, digits : int
        Rows in use; by how many levels the blocks become coarser (0 only makes the slots anew).
    slots : (2**k,) array of int32
        Filled.

    Returns
    -------
    n_rows : int64
        Rows in use afterwards.
    """
    slots[:] = EMPTY
    kept = np.int64(0)
    sums = np.empty(ROW, np.int64)
    for i in range(n_rows):
        sums[:] = rows[i]
        name = ((sums[0] >> np.int64(8 + 6 * digits)) << 8) | (sums[0] & 255)
        row = _row_of(name, slots, rows, kept)  # kept <= i: that row has been read
        kept = max(kept, row + 1)
        for column in range(1, ROW):
            rows[row, column] += sums[column]
    return kept


@kernel
def permute_rows(rows, order):
    """
    Put rows in order, in place.

    Parameters
    ----------
    rows : (n, 8) array of int64
        Changed.
    order : (n,) array of int64
        Number of the row that belongs at each place. Used up.
    """
    held = np.empty(ROW, np.int64)
    for start in range(order.size):
        if order[start] == start:
            continue
        held[:] = rows[start]
        at = np.int64(start)
        while order[at] != start:
            source = order[at]
            rows[at] = rows[source]
            order[at] = at
            at = source
        rows[at] = held
        order[at] = at
