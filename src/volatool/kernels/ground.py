"""The ground filter's loops: lowest points, lone low ones, how hard a point pulls, what is ground.

Points come as stored. Their places are worked out a block at a time, so that one pass over the
points does for a whole stage.
"""

import numpy as np

from volatool.kernels._jit import kernel
from volatool.kernels.binning import BLOCK, places
from volatool.kernels.spring import accumulate

NONE = np.int32(np.iinfo(np.int32).max)
"""Stored z of the lowest point of a cell without points; a point as high as this counts as none."""

NO_LIMIT = np.int64(np.iinfo(np.int64).min)
"""Limit of a cell whose points are all high enough."""


@kernel
def cell_numbers(col, row, h, w, first, last, numbers):
    """
    Give each point the number of its cell, row by row.

    Parameters
    ----------
    col, row : (n,) arrays of float64
        Places in cells; on the right and bottom edge a point counts to the last cell.
    h, w : int
        Rows and columns.
    first, last : int
        Only rows ``first <= r < last`` count.
    numbers : (n,) array of int64
        Set; -1 for points outside.
    """
    for i in range(col.size):
        r = min(np.int64(row[i]), h - 1)
        inside = (col[i] >= 0.0) & (col[i] <= w) & (row[i] >= 0.0) & (row[i] <= h)
        inside &= (r >= first) & (r < last)
        numbers[i] = r * w + min(np.int64(col[i]), w - 1) if inside else -1


@kernel
def lowest(best, rows, lattice, first, last):
    """
    Lowest point of each cell, whatever the order of the points.

    Parameters
    ----------
    best : (h, w, 3) array of int32
        Stored x, y, z of the lowest point so far, `NONE` without any. Ties: smallest x, then
        smallest y.
    rows : (n, 3) array of int32
        Stored x, y, z.
    lattice : (2, 4) array of int64
        Of the grid, for `places`.
    first, last : int
        Only rows ``first <= r < last`` of cells are looked at.
    """
    h, w = best.shape[:2]
    flat = best.reshape(3 * h * w)
    col, row = np.empty(BLOCK), np.empty(BLOCK)
    numbers, which = np.empty(BLOCK, np.int64), np.empty(BLOCK, np.int64)
    for start in range(0, rows.shape[0], BLOCK):
        part = rows[start : start + BLOCK]
        n = part.shape[0]
        places(part, lattice, col[:n], row[:n])
        cell_numbers(col[:n], row[:n], h, w, first, last, numbers[:n])
        # first, without a branch, those that may be lower: the loads needn't wait for each other
        n_lower = 0
        for i in range(n):
            place = 3 * numbers[i]
            numbers[n_lower] = place
            which[n_lower] = i
            n_lower += (place >= 0) & (part[i, 2] <= flat[max(place, 0) + 2])
        for k in range(n_lower):
            _lower(part[which[k]], flat, numbers[k])


@kernel
def _lower(point, flat, place):
    """Take a point as a cell's lowest if it is."""
    x, y, z = point[0], point[1], point[2]
    old_x, old_y, old_z = flat[place], flat[place + 1], flat[place + 2]
    if z < old_z or (z == old_z and (x < old_x or (x == old_x and y < old_y))):
        flat[place] = x
        flat[place + 1] = y
        flat[place + 2] = z


@kernel
def take_lowest(best, start, stop):
    """
    Lowest points of rows of cells, in cell order.

    Parameters
    ----------
    best : (h, w, 3) array of int32
        Of `lowest`.
    start, stop : int
        Rows.

    Returns
    -------
    rows : (n, 3) array of int32
        One point per cell that holds any.
    """
    w = best.shape[1]
    rows = np.empty(((stop - start) * w, 3), np.int32)
    n = 0
    for r in range(start, stop):
        for q in range(w):
            rows[n] = best[r, q]
            n += best[r, q, 2] != NONE
    return rows[:n].copy()


@kernel
def low_limits(best, drop, reach, part, start, stop, limits):
    """
    Find the stored height below which a cell's points are suspiciously low.

    Parameters
    ----------
    best : (h, w, 3) array of int32
        Of `lowest`.
    drop : float
        How far below its surroundings a cell's lowest point must be, in stored steps of z.
    reach : int
        The surroundings are ``2 reach + 1`` cells a side, the cell itself included.
    part : float
        Quantile of the surroundings' lowest points that stands for them, by linear interpolation.
    start, stop : int
        Rows.
    limits : (h, w) array of int64
        Rows are set: the smallest z that isn't too low, or `NO_LIMIT`.
    """
    h, w = best.shape[:2]
    around = np.empty((2 * reach + 1) ** 2)
    for r in range(start, stop):
        for q in range(w):
            limits[r, q] = NO_LIMIT
            if best[r, q, 2] == NONE:
                continue
            own = np.float64(best[r, q, 2])
            first_r, last_r = max(r - reach, 0), min(r + reach + 1, h)
            first_q, last_q = max(q - reach, 0), min(q + reach + 1, w)
            # nearly all cells are told apart by counting: enough neighbours about as low
            n = 0
            n_near = 0
            for i in range(first_r, last_r):
                for j in range(first_q, last_q):
                    if best[i, j, 2] != NONE:
                        around[n] = best[i, j, 2]
                        n += 1
                        n_near += best[i, j, 2] <= own + drop
            place = part * (n - 1)
            lower = np.int64(np.floor(place))
            upper = min(lower + 1, n - 1)
            if n_near > upper:
                continue
            _sort_lowest(around, n, upper + 1)
            level = around[lower] + (place - lower) * (around[upper] - around[lower])
            if own < level - drop:
                limits[r, q] = np.int64(np.ceil(level - drop))


@kernel
def _sort_lowest(values, n, n_sorted):
    """Move the lowest of the first n values to the front, in order; at least one of them."""
    # by insertion, as they are few; np.sort in a kernel has numba import SciPy (0.1 s)
    for i in range(1, n):
        value = values[i]
        at = min(i, n_sorted)
        if at == n_sorted:
            if value >= values[at - 1]:
                continue
            values[i] = values[at - 1]
            at -= 1
        while at > 0 and values[at - 1] > value:
            values[at] = values[at - 1]
            at -= 1
        values[at] = value


@kernel
def spare_large(limits, largest, start, stop, out):
    """
    Forget the limits of cells that stand together in larger groups: they are terrain.

    Parameters
    ----------
    limits : (h, w) array of int64
        Of `low_limits`.
    largest : int
        Cells of a group, joined by sides or corners, up to which its limits hold.
    start, stop : int
        Rows.
    out : (h, w) array of int64
        Rows are set; `NO_LIMIT` where there is none.
    """
    h, w = limits.shape
    rows = np.empty(largest + 1, np.int64)
    cols = np.empty(largest + 1, np.int64)
    for r in range(start, stop):
        for q in range(w):
            out[r, q] = limits[r, q]
            if limits[r, q] == NO_LIMIT:
                continue
            rows[0] = r
            cols[0] = q
            n = 1
            k = 0
            while k < n and n <= largest:
                for i in range(max(rows[k] - 1, 0), min(rows[k] + 2, h)):
                    for j in range(max(cols[k] - 1, 0), min(cols[k] + 2, w)):
                        if limits[i, j] == NO_LIMIT or n > largest:
                            continue
                        known = False
                        for m in range(n):
                            known = known or (rows[m] == i and cols[m] == j)
                        if not known:
                            rows[n] = i
                            cols[n] = j
                            n += 1
                k += 1
            if n > largest:
                out[r, q] = NO_LIMIT


@kernel
def limit_at(limits, col, row):
    """
    Limit of the low guard at a place.

    Parameters
    ----------
    limits : (h, w) array of int64
        Smallest stored z to keep, by cell.
    col, row : float
        Place in cells.

    Returns
    -------
    limit : int64
        That of the nearest cell for places outside.
    """
    h, w = limits.shape
    r = min(max(np.int64(row), 0), h - 1)
    return limits[r, min(max(np.int64(col), 0), w - 1)]


@kernel
def drop_low(best, lattice, limits, start, stop, again):
    """
    Forget the lowest points of cells when they are below the limit of the low guard.

    Parameters
    ----------
    best : (h, w, 3) array of int32
        Of `lowest`.
    lattice : (2, 4) array of int64
        Of the grid of the limits.
    limits : (h', w') array of int64
        Smallest stored z to keep, by cells of their own.
    start, stop : int
        Rows of `best`.
    again : (h, w) array of uint8
        Rows are set: 1 where the lowest point was dropped and others may be in the cell.

    Returns
    -------
    n_again : int
        Such cells.
    """
    w = best.shape[1]
    col, row = np.empty(w), np.empty(w)
    n_again = 0
    for r in range(start, stop):
        places(best[r], lattice, col, row)
        for q in range(w):
            z = best[r, q, 2]
            is_low = z != NONE and z < limit_at(limits, col[q], row[q])
            again[r, q] = is_low
            n_again += is_low
            if is_low:
                best[r, q, :] = NONE
    return n_again


@kernel
def lowest_again(best, rows, lattice, again, low_lattice, limits, first, last):
    """
    Lowest point of the cells that lost theirs to the low guard, of the points that it keeps.

    Parameters
    ----------
    best, rows, lattice, first, last
        As for `lowest`.
    again, limits : arrays
        As `drop_low` has them.
    low_lattice : (2, 4) array of int64
        Of the grid of the limits.
    """
    h, w = again.shape
    cells, flat = again.reshape(h * w), best.reshape(3 * h * w)
    col, row = np.empty(BLOCK), np.empty(BLOCK)
    numbers = np.empty(BLOCK, np.int64)
    for start in range(0, rows.shape[0], BLOCK):
        part = rows[start : start + BLOCK]
        n = part.shape[0]
        places(part, lattice, col[:n], row[:n])
        cell_numbers(col[:n], row[:n], h, w, first, last, numbers[:n])
        for i in range(n):
            if numbers[i] >= 0 and cells[numbers[i]]:
                places(part[i : i + 1], low_lattice, col[i : i + 1], row[i : i + 1])
                if part[i, 2] >= limit_at(limits, col[i], row[i]):
                    _lower(part[i], flat, 3 * numbers[i])


@kernel
def heights(z, col, row, fit):
    """
    Height of a surface at points, as the data springs see it.

    Parameters
    ----------
    z : (h, w) array of float64
        Heights of the nodes, at least 2 a side.
    col, row : (n,) arrays of float64
        Places in cells from the top left corner, on the grid.
    fit : (n,) array of float64
        Set.
    """
    h, w = z.shape
    for i in range(col.size):
        x = max(col[i] - 0.5, 0.0)
        y = max(row[i] - 0.5, 0.0)
        q = min(np.int64(x), w - 2)
        r = min(np.int64(y), h - 2)
        u = min(x - q, 1.0)
        v = min(y - r, 1.0)
        fit[i] = (1.0 - v) * ((1.0 - u) * z[r, q] + u * z[r, q + 1]) + v * (
            (1.0 - u) * z[r + 1, q] + u * z[r + 1, q + 1]
        )


@kernel
def slope_at(z, col, row, cell):
    """
    Steepness of a surface at a place: central differences of the nodes, read bilinearly.

    Parameters
    ----------
    z : (h, w) array of float64
        Heights of the nodes, at least 2 a side.
    col, row : float
        Place in cells from the top left corner.
    cell : float
        Edge of a cell in the unit of the heights.

    Returns
    -------
    slope : float
        Rise over run.
    """
    h, w = z.shape
    x = min(max(col - 0.5, 0.0), w - 1.0)
    y = min(max(row - 0.5, 0.0), h - 1.0)
    q = min(np.int64(x), w - 2)
    r = min(np.int64(y), h - 2)
    u = x - q
    v = y - r
    east = 0.0
    south = 0.0
    if 1 <= q < w - 2 and 1 <= r < h - 2:
        for a in range(2):
            for b in range(2):
                part = (v if a else 1.0 - v) * (u if b else 1.0 - u)
                east += part * (z[r + a, q + b + 1] - z[r + a, q + b - 1]) / 2
                south += part * (z[r + a + 1, q + b] - z[r + a - 1, q + b]) / 2
        return np.sqrt(east * east + south * south) / cell
    for a in range(2):
        for b in range(2):
            part = (v if a else 1.0 - v) * (u if b else 1.0 - u)
            left, right = max(q + b - 1, 0), min(q + b + 1, w - 1)
            up, down = max(r + a - 1, 0), min(r + a + 1, h - 1)
            east += part * (z[r + a, right] - z[r + a, left]) / (right - left)
            south += part * (z[down, q + b] - z[up, q + b]) / (down - up)
    return np.sqrt(east * east + south * south) / cell


@kernel
def pull_of(rise, tau):
    """
    Weight of a point's spring: whole at or below the surface, little far above.

    Parameters
    ----------
    rise : float
        Point minus surface.
    tau : float
        Rise up to which it pulls in full, same unit.

    Returns
    -------
    weight : float
        1 up to tau, ``1 / (1 + ((rise - tau) / tau)^2)^2`` above.
    """
    if rise <= tau:
        return 1.0
    over = (rise - tau) / tau
    squared = 1.0 + over * over
    return 1.0 / (squared * squared)


@kernel
def pull(data, right, rows, lattice, zero, step, z, cell, base, per_slope, first, last):
    """
    Add the springs of points to the evidence of a sheet, each by how far it is above the last one.

    Parameters
    ----------
    data : (h, 5, w) array of float64
        Data stencil, added to: see `spring.accumulate`.
    right : (h, w) array of float64
        Right side, added to.
    rows : (n, 3) array of int32
        Stored x, y, z.
    lattice : (2, 4) array of int64
        Of the sheet's grid, for `places`.
    zero : int
        Stored z that heights are counted from.
    step : float
        A stored step of z in the unit of the heights.
    z : (h, w) array of float64
        The last sheet; (0, 0) when there is none and all pull in full.
    cell : float
        Edge of a cell in the unit of the heights.
    base, per_slope : float
        A point pulls in full up to ``base + per_slope min(slope, 1)`` above the sheet.
    first, last : int
        Only rows ``first <= r < last`` of the evidence are touched.
    """
    col, row, height = np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK)
    fit, weights = np.empty(BLOCK), np.ones(BLOCK)
    for start in range(0, rows.shape[0], BLOCK):
        part = rows[start : start + BLOCK]
        n = part.shape[0]
        places(part, lattice, col[:n], row[:n])
        lowest_row = highest_row = row[0]
        for i in range(1, n):
            lowest_row, highest_row = min(lowest_row, row[i]), max(highest_row, row[i])
        if highest_row < first - 1 or lowest_row > last + 1:
            continue
        for i in range(n):
            height[i] = (np.int64(part[i, 2]) - zero) * step
        if z.size:
            heights(z, col[:n], row[:n], fit[:n])
            for i in range(n):
                rise = height[i] - fit[i]
                weights[i] = 1.0
                if rise > base:
                    slope = slope_at(z, col[i], row[i], cell)
                    weights[i] = pull_of(rise, base + per_slope * min(slope, 1.0))
        arrays = (col[:n], row[:n], height[:n], weights[:n])
        accumulate(data, right, *arrays, False, first, last)


@kernel
def near(
    z, rows, lattice, zero, step, cell, bounds, low_lattice, limits, keep, first, last, start, stop
):
    """
    Tell which points are near a sheet and not lone low ones.

    Parameters
    ----------
    z : (h, w) array of float64
        The sheet.
    rows, lattice, zero, step, cell
        As for `pull`.
    bounds : tuple of 4 float
        Above, above per slope, below, below per slope: a point is near from
        ``-(below + below_per_slope s)`` to ``above + above_per_slope s``, both exclusive, with
        s the rise over a cell.
    low_lattice : (2, 4) array of int64
        Of the grid of the limits.
    limits : (h', w') array of int64
        Of the low guard, by cells of their own; (0, 0) without any.
    keep : (n,) array of bool
        Set for the points looked at.
    first, last : int
        Only points whose upper node row is in ``first <= r < last`` are looked at.
    start, stop : int
        Only these points are looked at.
    """
    h = z.shape[0]
    above, above_per_slope, below, below_per_slope = bounds
    col, row, fit = np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK)
    which = np.empty(BLOCK, np.int64)
    for begin in range(start, stop, BLOCK):
        part = rows[begin : min(begin + BLOCK, stop)]
        n = part.shape[0]
        places(part, lattice, col[:n], row[:n])
        m = 0
        for i in range(n):
            r = min(np.int64(max(row[i] - 0.5, 0.0)), h - 2)
            col[m], row[m], which[m] = col[i], row[i], i
            m += (r >= first) & (r < last)
        heights(z, col[:m], row[:m], fit)
        n_near = 0
        for k in range(m):
            i = which[k]
            rise = (np.int64(part[i, 2]) - zero) * step - fit[k]
            is_near = (rise < above) & (rise > -below)
            if not is_near:
                steep = slope_at(z, col[k], row[k], cell) * cell
                is_near = rise < above + above_per_slope * steep
                is_near &= rise > -(below + below_per_slope * steep)
            keep[begin + i] = is_near
            which[n_near] = i
            n_near += is_near
        if limits.size and n_near:
            places(part, low_lattice, col[:n], row[:n])
            for k in range(n_near):
                i = which[k]
                keep[begin + i] = part[i, 2] >= limit_at(limits, col[i], row[i])
