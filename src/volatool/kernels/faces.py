"""Faces of sets of cells: which are on the outside, and how they join to rectangles."""

from __future__ import annotations

import numpy as np

from volatool.kernels._jit import kernel

_ONE = np.uint64(1)


@kernel
def pack(cells, slow, middle, fast):
    """
    Numbers by which cells sort along an axis.

    Parameters
    ----------
    cells : (n, 3) array of int32
        0 to ``2**20 - 1``.
    slow, middle, fast : int
        Axes; cells that differ along `fast` only have numbers that differ as they do.

    Returns
    -------
    keys : (n,) array of uint64
        20 bits an axis.
    """
    keys = np.empty(len(cells), np.uint64)
    for i in range(len(cells)):
        keys[i] = (
            (np.uint64(cells[i, slow]) << np.uint64(40))
            | (np.uint64(cells[i, middle]) << np.uint64(20))
            | np.uint64(cells[i, fast])
        )
    return keys


@kernel
def exposed(keys, order):
    """
    Cells without a neighbour along the fastest axis.

    Parameters
    ----------
    keys : (n,) array of uint64
        Of `pack`, ascending, none twice.
    order : (n,) array of int64
        Which cell each is.

    Returns
    -------
    lower, upper : arrays of int64
        Which cells have none below, and none above.
    """
    lower = np.empty(keys.size, np.int64)
    upper = np.empty(keys.size, np.int64)
    n_lower = 0
    n_upper = 0
    for i in range(keys.size):
        # the axis has 20 bits of its own and its ends are no neighbours of the next row's
        place = keys[i] & np.uint64(0xFFFFF)
        if i == 0 or keys[i - 1] + _ONE != keys[i] or place == 0:
            lower[n_lower] = order[i]
            n_lower += 1
        if i + 1 == keys.size or keys[i] + _ONE != keys[i + 1] or place == 0xFFFFF:
            upper[n_upper] = order[i]
            n_upper += 1
    return lower[:n_lower].copy(), upper[:n_upper].copy()


@kernel
def _row_end(keys, start):
    """Return where the row of a face ends: all but the fastest axis are the same."""
    row = keys[start] >> np.uint64(20)
    end = start + 1
    while end < keys.size and keys[end] >> np.uint64(20) == row:
        end += 1
    return end


@kernel
def _find(keys, low, high, key):
    """Return where a key is in an ascending part of an array, -1 if it is not."""
    while low < high:
        middle = (low + high) >> 1
        if keys[middle] < key:
            low = middle + 1
        else:
            high = middle
    if low < keys.size and keys[low] == key:
        return low
    return np.int64(-1)


@kernel
def rectangles(keys, labels):
    """
    Join the faces of layers to rectangles, greedily: first along the row, then row by row.

    Parameters
    ----------
    keys : (n,) array of uint64
        Layer, row, column of each face, of `pack`; ascending, none twice.
    labels : (n,) array of int64
        Only faces of one label are joined.

    Returns
    -------
    firsts : (m,) array of int64
        Which face is the lowest corner of each rectangle, ascending.
    sizes : (m, 2) array of int32
        Rows and columns. Each face is in exactly one.
    """
    n = keys.size
    is_used = np.zeros(n, np.bool_)
    row_ends = np.empty(n, np.int64)  # of the row that each face is in
    start = 0
    while start < n:
        end = _row_end(keys, start)
        row_ends[start:end] = end
        start = end
    firsts = np.empty(n, np.int64)
    sizes = np.empty((n, 2), np.int32)
    m = 0
    for i in range(n):
        if is_used[i]:
            continue
        label = labels[i]
        j = i + 1
        while j < row_ends[i] and keys[j] == keys[j - 1] + _ONE:
            if is_used[j] or labels[j] != label:
                break
            j += 1
        columns = j - i
        is_used[i:j] = True
        rows = 1
        key = keys[i]
        here = i
        while True:
            # the next row begins where this one ends; its key tells whether it is the next one
            start = row_ends[here]
            key += np.uint64(1 << 20)
            if start >= n or keys[start] >> np.uint64(20) != key >> np.uint64(20):
                break
            here = _find(keys, start, row_ends[start], key)
            if here < 0 or here + columns > row_ends[start]:
                break
            if keys[here + columns - 1] != key + np.uint64(columns - 1):
                break
            fits = True
            for k in range(here, here + columns):
                if is_used[k] or labels[k] != label:
                    fits = False
                    break
            if not fits:
                break
            is_used[here : here + columns] = True
            rows += 1
        firsts[m] = i
        sizes[m, 0] = rows
        sizes[m, 1] = columns
        m += 1
    return firsts[:m].copy(), sizes[:m].copy()
