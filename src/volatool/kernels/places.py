"""Blocks by place: columns numbered, bits summed over places, tops of columns of cells."""

from __future__ import annotations

import numpy as np

from volatool.kernels._jit import kernel
from volatool.kernels.contiguity import popcount


@kernel
def project_columns(words, columns, n_columns):
    """
    Project the blocks of a level onto the x-y plane.

    Parameters
    ----------
    words : (n,) array of uint64
        Occupancy words.
    columns : (n,) array of int64
        Which column of blocks each is of, below `n_columns`.
    n_columns : int

    Returns
    -------
    flat : (n_columns,) array of uint64
        Bits ``x + 4 y`` of the columns of cells that any block of the column has.
    """
    flat = np.zeros(n_columns, np.uint64)
    for i in range(words.size):
        word = words[i] | (words[i] >> np.uint64(32))
        flat[columns[i]] |= (word | (word >> np.uint64(16))) & np.uint64(0xFFFF)
    return flat


@kernel
def column_children(words, columns, flat, ranks, n_cells):
    """
    Return the columns of the cells of blocks, the blocks of the next level.

    Parameters
    ----------
    words, columns
        As in `project_columns`.
    flat : (m,) array of uint64
        As `project_columns` returned it.
    ranks : (m,) array of int64
        Set bits before each.
    n_cells : int
        Set bits of `words`.

    Returns
    -------
    children : (n_cells,) array of int64
        For each set bit in order the rank of its column: columns are a tree of 4 x 4 like blocks
        one of 4 x 4 x 4, so that nothing need be sorted.
    """
    children = np.empty(n_cells, np.int64)
    place = 0
    for i in range(words.size):
        word = words[i]
        own, before = flat[columns[i]], ranks[columns[i]]
        while word:
            low = word & (~word + np.uint64(1))
            column = np.uint64(popcount(low - np.uint64(1)) & 15)
            children[place] = before + popcount(own & ((np.uint64(1) << column) - np.uint64(1)))
            place += 1
            word ^= low
    return children


@kernel
def sum_places(places, cells, added, removed, far_added, far_removed, n_places):
    """
    Sum the bits of blocks by place.

    Parameters
    ----------
    places : (n,) array of int64
        Which place each block is of, below `n_places`.
    cells : (n, 3) array of int32
        x, y, z of each block.
    added, removed, far_added, far_removed : (n,) arrays of uint64
        Bits of blocks.
    n_places : int

    Returns
    -------
    sums : (n_places, 6) array of int64
        Bits of each kind; the lowest and the highest layer of cells added or removed, large and -1
        where there is none.
    """
    sums = np.zeros((n_places, 6), np.int64)
    sums[:, 4] = np.int64(1) << 40
    sums[:, 5] = -1
    for i in range(places.size):
        row = places[i]
        both = added[i] | removed[i]
        if not both:
            continue
        sums[row, 0] += popcount(added[i])
        sums[row, 1] += popcount(removed[i])
        sums[row, 2] += popcount(far_added[i])
        sums[row, 3] += popcount(far_removed[i])
        layer = 4 * np.int64(cells[i, 2])
        for digit in range(4):
            if both >> np.uint64(16 * digit) & np.uint64(0xFFFF):
                sums[row, 4] = min(sums[row, 4], layer + digit)
                sums[row, 5] = max(sums[row, 5], layer + digit)
    return sums


@kernel
def top_layers(places, cells, words, n_places):
    """
    Highest cell set in each of the 16 columns of cells of a column of blocks.

    Parameters
    ----------
    places : (n,) array of int64
        Which column of blocks each block is of, below `n_places`.
    cells : (n, 3) array of int32
        x, y, z of each block.
    words : (n,) array of uint64
        Their bits.
    n_places : int

    Returns
    -------
    tops : (n_places, 16) array of int32
        Layer of the highest cell by ``x + 4 y`` inside the blocks; -1 where there is none.
    """
    tops = np.full((n_places, 16), -1, np.int32)
    for i in range(places.size):
        layer = np.int32(4 * cells[i, 2])
        seen = np.uint64(0)
        for digit in range(3, -1, -1):
            fresh = (words[i] >> np.uint64(16 * digit)) & np.uint64(0xFFFF) & ~seen
            seen |= fresh
            while fresh:
                low = fresh & (~fresh + np.uint64(1))
                column = popcount(low - np.uint64(1))
                tops[places[i], column] = max(tops[places[i], column], layer + digit)
                fresh ^= low
    return tops


@kernel
def compare_tops(before, after, noise):
    """
    Count and sum how tops moved.

    Parameters
    ----------
    before, after : (n, 16) arrays of int32
        As `top_layers` returned them.
    noise : int
        Moves of so many layers are not among those up and down.

    Returns
    -------
    found : (6,) array of int64
        Columns of both, of `after` only, of `before` only; layers up, down, and the sum of all.
    """
    found = np.zeros(6, np.int64)
    for i in range(before.shape[0]):
        for column in range(16):
            old, new = before[i, column], after[i, column]
            if old < 0 or new < 0:
                found[1] += np.int64(new >= 0)
                found[2] += np.int64(old >= 0)
                continue
            step = np.int64(new - old)
            found[0] += 1
            found[5] += step
            if step > noise:
                found[3] += step
            elif step < -noise:
                found[4] -= step
    return found
