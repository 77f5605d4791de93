"""Points to raster cells: places, occupancy, counts, extremes; distances between cells."""

import numpy as np

from volatool.kernels._jit import kernel

SMALL = 2.0**52
"""Whole numbers up to twice this are exact in float64."""

BLOCK = 512
"""Points whose places a loop works out at once: few enough to stay in the nearest cache."""


@kernel
def places(rows, lattice, col, row):
    """
    Places of points on a grid, in cells, exact at the cells' edges.

    Parameters
    ----------
    rows : (n, 3) array of int32
        Stored x, y, z.
    lattice : (2, 4) array of int64
        zero, factor, shift, length of the columns and the rows: the place is
        ``((stored - zero) factor + shift) / length``; no term may reach 2**62.
    col, row : (n,) arrays of float64
        Set. Their floor is the exact cell, their fraction the place in the cell.
    """
    for axis in range(2):
        zero, factor, shift, length = (
            lattice[axis, 0],
            lattice[axis, 1],
            lattice[axis, 2],
            lattice[axis, 3],
        )
        out = row if axis else col
        if abs(factor) * 2.0**33 + abs(shift) + 2.0 * length < SMALL:
            # all terms are whole numbers in float64: the same results, and the loop vectorizes
            _places_small(rows, axis, float(zero), float(factor), float(shift), float(length), out)
        else:
            _places_large(rows, axis, zero, factor, shift, length, out)


@kernel
def _places_small(rows, axis, zero, factor, shift, length, out):
    reciprocal = 1.0 / length
    for i in range(rows.shape[0]):
        num = (rows[i, axis] - zero) * factor + shift
        cell = np.floor(num * reciprocal)
        rest = num - cell * length
        if rest < 0.0:
            cell -= 1.0
            rest += length
        elif rest >= length:
            cell += 1.0
            rest -= length
        out[i] = cell + rest / length


@kernel
def _places_large(rows, axis, zero, factor, shift, length, out):
    reciprocal = 1.0 / length
    for i in range(rows.shape[0]):
        num = (np.int64(rows[i, axis]) - zero) * factor + shift
        cell = np.int64(np.floor(num * reciprocal))
        rest = num - cell * length
        if rest < 0:
            cell -= 1
            rest += length
        elif rest >= length:
            cell += 1
            rest -= length
        out[i] = cell + rest / length


@kernel
def mark(col, row, cells):
    """
    Set the cells that hold points.

    Parameters
    ----------
    col, row : (n,) arrays of float64
        Places in cells. On the right and bottom edge of the grid a point counts to the last cell.
    cells : (h, w) array of uint8
        Set to 1 where a point is; points outside are ignored.
    """
    h, w = cells.shape
    for i in range(col.size):
        if col[i] >= 0.0 and col[i] <= w and row[i] >= 0.0 and row[i] <= h:
            cells[min(np.int64(row[i]), h - 1), min(np.int64(col[i]), w - 1)] = 1


@kernel
def mark_parts(col, row, number, parts, bits):
    """
    Count cells that hold a point, in bits kept only where larger cells are occupied.

    Parameters
    ----------
    col, row : (n,) arrays of float64
        Places in (small) cells; `parts` of them make a side of a large cell.
    number : (h, w) array of int32
        Number of each occupied large cell, from 0; every point's must have one.
    parts : int
        Small cells a side of a large one.
    bits : (m,) array of uint8
        One bit per small cell of the numbered large ones, set.

    Returns
    -------
    n_new : int
        Bits that were not set before.
    """
    h, w = number.shape
    n_new = 0
    for i in range(col.size):
        q = min(np.int64(col[i]), w * parts - 1)
        r = min(np.int64(row[i]), h * parts - 1)
        large = np.int64(number[r // parts, q // parts])
        place = (large * parts + r % parts) * parts + q % parts
        bit = np.uint8(1 << (place & 7))
        if not bits[place >> 3] & bit:
            bits[place >> 3] |= bit
            n_new += 1
    return n_new


@kernel
def count(col, row, first, last, counts):
    """
    Count points per cell.

    Parameters
    ----------
    col, row : (n,) arrays of float64
        Places in cells; on the right and bottom edge a point counts to the last cell.
    first, last : int
        Only rows ``first <= r < last`` are counted.
    counts : (h, w) array of uint32
        Added to.
    """
    h, w = counts.shape
    for i in range(col.size):
        if col[i] >= 0.0 and col[i] <= w and row[i] >= 0.0 and row[i] <= h:
            r = min(np.int64(row[i]), h - 1)
            if first <= r < last:
                counts[r, min(np.int64(col[i]), w - 1)] += np.uint32(1)


@kernel
def count_inner(col, row, first, last, counts):
    """
    Count points per cell of a grid that another has a ring of cells around.

    Parameters
    ----------
    col, row : (n,) arrays of float64
        Places in cells of the outer grid; otherwise as for `count`.
    first, last : int
        Only rows ``first <= r < last`` of the outer grid are counted; those that hold its last
        cells, the ring's, make the last rows inside full.
    counts : (h, w) array of uint32
        Added to.
    """
    h, w = counts.shape
    low, high = max(first - 1, 0), last - 1 if last < h + 2 else last
    for i in range(col.size):
        x, y = col[i] - 1.0, row[i] - 1.0
        if x >= 0.0 and x <= w and y >= 0.0 and y <= h:
            r = min(np.int64(y), h - 1)
            if low <= r < high:
                counts[r, min(np.int64(x), w - 1)] += np.uint32(1)


@kernel
def extreme(rows, col, row, sign, first, last, best, counts):
    """
    Lowest or highest point of each cell, whatever the order of the points.

    Parameters
    ----------
    rows : (n, 3) array of int32
        Stored x, y, z.
    col, row : (n,) arrays of float64
        Places in cells; on the right and bottom edge a point counts to the last cell.
    sign : int
        1: lowest, -1: highest. Ties: smallest x, then smallest y.
    first, last : int
        Only rows ``first <= r < last`` are looked at.
    best : (h, w, 3) array of int32
        Stored x, y, z of the point so far; valid where `counts` is not zero.
    counts : (h, w) array of uint32
        Points per cell so far, added to.
    """
    h, w = counts.shape
    for i in range(col.size):
        if not (col[i] >= 0.0 and col[i] <= w and row[i] >= 0.0 and row[i] <= h):
            continue
        r = min(np.int64(row[i]), h - 1)
        if r < first or r >= last:
            continue
        q = min(np.int64(col[i]), w - 1)
        old = best[r, q]
        new = rows[i]
        better = counts[r, q] == 0
        if not better:
            rise = sign * (np.int64(new[2]) - np.int64(old[2]))
            better = rise < 0 or (
                rise == 0 and (new[0] < old[0] or (new[0] == old[0] and new[1] < old[1]))
            )
        if better:
            old[0] = new[0]
            old[1] = new[1]
            old[2] = new[2]
        counts[r, q] += np.uint32(1)


@kernel
def add_heights(rows, col, row, first, last, sums, counts):
    """
    Sum the heights of the points of each cell, exactly.

    Parameters
    ----------
    rows : (n, 3) array of int32
        Stored x, y, z.
    col, row : (n,) arrays of float64
        Places in cells; on the right and bottom edge a point counts to the last cell.
    first, last : int
        Only rows ``first <= r < last`` are looked at.
    sums : (h, w) array of int64
        Stored z are added to it.
    counts : (h, w) array of uint32
        Points per cell so far, added to.
    """
    h, w = counts.shape
    for i in range(col.size):
        if not (col[i] >= 0.0 and col[i] <= w and row[i] >= 0.0 and row[i] <= h):
            continue
        r = min(np.int64(row[i]), h - 1)
        if first <= r < last:
            q = min(np.int64(col[i]), w - 1)
            sums[r, q] += np.int64(rows[i, 2])
            counts[r, q] += np.uint32(1)


@kernel
def column_distances(cells, wanted, start, stop, is_down, distances):
    """
    Distance to the nearest wanted cell above (going down) or also below (going up) each cell.

    Parameters
    ----------
    cells : (h, w) array of uint8
        Cells; those equal to `wanted` have distance 0.
    wanted : int
        Value.
    start, stop : int
        Rows of this strip; strips in order going down, in reverse order going up.
    is_down : bool
        Direction; down first.
    distances : (h, w) array of int32
        Rows, in cells; ``h + w`` or more where the column has none.
    """
    h, w = cells.shape
    far = h + w
    if is_down:
        for r in range(start, stop):
            for q in range(w):
                if cells[r, q] == wanted:
                    distances[r, q] = 0
                else:
                    distances[r, q] = distances[r - 1, q] + 1 if r > 0 else far
    else:
        for r in range(stop - 1, start - 1, -1):
            if r < h - 1:
                for q in range(w):
                    distances[r, q] = min(distances[r, q], distances[r + 1, q] + 1)


@kernel
def row_distances(columns, start, stop, out):
    """
    Exact Euclidean distance to the nearest wanted cell, from the distances along columns.

    Parameters
    ----------
    columns : (h, w) array of int32
        As `column_distances` left them.
    start, stop : int
        Rows.
    out : (h, w) array of float32
        Rows are set, in cells; infinite when the grid has no wanted cell.

    Notes
    -----
    Lower envelope of parabolas along each row.
    """
    h, w = columns.shape
    places_ = np.empty(w, np.int64)
    starts = np.empty(w + 1)
    for r in range(start, stop):
        n = 0
        line = columns[r]
        for q in range(w):
            g = np.float64(line[q])
            if g >= h + w:
                continue
            border = -np.inf
            while n > 0:
                p = places_[n - 1]
                gp = np.float64(line[p])
                border = ((g * g + q * q) - (gp * gp + p * p)) / (2.0 * (q - p))
                if border > starts[n - 1]:
                    break
                n -= 1
            if n == 0:
                border = -np.inf
            places_[n] = q
            starts[n] = border
            n += 1
        if n == 0:
            out[r, :] = np.inf
            continue
        k = 0
        for q in range(w):
            while k + 1 < n and starts[k + 1] < q:
                k += 1
            p = places_[k]
            g = np.float64(line[p])
            out[r, q] = np.sqrt(g * g + np.float64((q - p) * (q - p)))


@kernel
def row_spans(cells, wanted):
    """
    First and last wanted cell of each row.

    Parameters
    ----------
    cells : (h, w) array of uint8
        Cells.
    wanted : int
        Value.

    Returns
    -------
    spans : (h, 2) array of int64
        ``w, -1`` for a row without any.
    """
    h, w = cells.shape
    spans = np.empty((h, 2), np.int64)
    for r in range(h):
        spans[r, 0] = w
        spans[r, 1] = -1
        for q in range(w):
            if cells[r, q] == wanted:
                spans[r, 0] = q
                break
        for q in range(w - 1, -1, -1):
            if cells[r, q] == wanted:
                spans[r, 1] = q
                break
    return spans
