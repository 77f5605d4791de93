"""Blocks by place: columns numbered, bits summed over places, tops of columns of cells."""

from __future__ import annotations

import numpy as np

from volatool.kernels._jit import kernel
from volatool.kernels.contiguity import popcount

_ONE = np.uint64(1)


@kernel
def project_columns(words, columns, n_columns):
    """
    Project the blocks of a level onto the x-y plane.

    Parameters
    ----------
    words : (n,) array of uint64
        Occupancy words.
    columns : (n,) array of int
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
    children : (n_cells,) array of int32
        For each set bit in order the rank of its column: columns are a tree of 4 x 4 like blocks
        one of 4 x 4 x 4, so that nothing need be sorted.
    """
    children = np.empty(n_cells, np.int32)
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
def child_layers(words, layers, n_cells):
    """
    Layers of the cells that words have set.

    Parameters
    ----------
    words : (n,) array of uint64
        Occupancy words.
    layers : (n,) array of int32
        z of their blocks.
    n_cells : int
        Set bits of all words.

    Returns
    -------
    children : (n_cells,) array of int32
        z one level deeper, in the order of the words and their bits.
    """
    children = np.empty(n_cells, np.int32)
    place = 0
    for i in range(words.size):
        word = words[i]
        for digit in range(4):
            n_here = popcount((word >> np.uint64(16 * digit)) & np.uint64(0xFFFF))
            children[place : place + n_here] = 4 * layers[i] + digit
            place += n_here
    return children


@kernel
def sum_places(places, layers, added, removed, far_added, far_removed, n_places):
    """
    Sum the bits of blocks by place.

    Parameters
    ----------
    places : (n,) array of int
        Which place each block is of, below `n_places`.
    layers : (n,) array of int32
        z of each block.
    added, removed, far_added, far_removed : (n,) arrays of uint64
        Bits of blocks.
    n_places : int

    Returns
    -------
    held : (m,) array of int64
        The places that have cells added or removed.
    sums : (6, m) array of int64
        Of each of them the bits of each kind; the lowest and the highest layer of cells added or
        removed.
    """
    sums = np.zeros((n_places, 6), np.int64)
    sums[:, 5] = -1
    for i in range(places.size):
        both = added[i] | removed[i]
        if not both:
            continue
        row = places[i]
        sums[row, 0] += popcount(added[i])
        sums[row, 1] += popcount(removed[i])
        sums[row, 2] += popcount(far_added[i])
        sums[row, 3] += popcount(far_removed[i])
        lowest = 4 * np.int64(layers[i]) + (popcount((both & (~both + _ONE)) - _ONE) >> 4)
        highest = 4 * np.int64(layers[i])
        for digit in range(1, 4):
            highest += np.int64(both >> np.uint64(16 * digit) != 0)
        # one more than the lowest layer, zero where there is none as yet
        first = sums[row, 4]
        sums[row, 4] = lowest + 1 if first == 0 else min(first, lowest + 1)
        sums[row, 5] = max(sums[row, 5], highest)
    n_held = 0
    for row in range(n_places):
        n_held += np.int64(sums[row, 5] >= 0)
    held, columns = np.empty(n_held, np.int64), np.empty((6, n_held), np.int64)
    place = 0
    for row in range(n_places):
        if sums[row, 5] >= 0:
            held[place] = row
            for kind in range(6):
                columns[kind, place] = sums[row, kind] - (kind == 4)
            place += 1
    return held, columns


@kernel
def top_layers(places, layers, words, n_places):
    """
    Highest cell set in each of the 16 columns of cells of a column of blocks.

    Parameters
    ----------
    places : (n,) array of int
        Which column of blocks each block is of, below `n_places`.
    layers : (n,) array of int32
        z of each block.
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
        layer = np.int32(4 * layers[i])
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
