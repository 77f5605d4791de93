"""The ground filter's loops: lone low points, slope, how hard a point pulls, what is ground."""

import numpy as np

from volatool.kernels._jit import kernel


@kernel
def low_limits(best, counts, drop, reach, part, start, stop, limits):
    """
    Find the stored height below which a cell's points are suspiciously low.

    Parameters
    ----------
    best : (h, w, 3) array of int32
        Stored x, y, z of the lowest point of each cell.
    counts : (h, w) array of uint32
        Points per cell; `best` is valid where it is not zero.
    drop : float
        How far below its surroundings a cell's lowest point must be, in stored steps of z.
    reach : int
        The surroundings are ``2 reach + 1`` cells a side, the cell itself included.
    part : float
        Quantile of the surroundings' lowest points that stands for them, by linear interpolation.
    start, stop : int
        Rows.
    limits : (h, w) array of int64
        Rows are set: the smallest z that isn't too low, or the least int64 where no point is.
    """
    h, w = counts.shape
    around = np.empty((2 * reach + 1) ** 2)
    nothing = np.iinfo(np.int64).min
    for r in range(start, stop):
        for q in range(w):
            limits[r, q] = nothing
            if counts[r, q] == 0:
                continue
            own = np.float64(best[r, q, 2])
            first_r, last_r = max(r - reach, 0), min(r + reach + 1, h)
            first_q, last_q = max(q - reach, 0), min(q + reach + 1, w)
            # nearly all cells are told apart by counting: enough neighbours about as low
            n = 0
            n_near = 0
            for i in range(first_r, last_r):
                for j in range(first_q, last_q):
                    if counts[i, j]:
                        around[n] = best[i, j, 2]
                        n += 1
                        n_near += best[i, j, 2] <= own + drop
            place = part * (n - 1)
            lower = np.int64(np.floor(place))
            upper = min(lower + 1, n - 1)
            if n_near > upper:
                continue
            ranked = np.sort(around[:n])
            level = ranked[lower] + (place - lower) * (ranked[upper] - ranked[lower])
            if own < level - drop:
                limits[r, q] = np.int64(np.ceil(level - drop))


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
        Rows are set; the least int64 where there is no limit.
    """
    h, w = limits.shape
    nothing = np.iinfo(np.int64).min
    rows = np.empty(largest + 1, np.int64)
    cols = np.empty(largest + 1, np.int64)
    for r in range(start, stop):
        for q in range(w):
            out[r, q] = limits[r, q]
            if limits[r, q] == nothing:
                continue
            rows[0] = r
            cols[0] = q
            n = 1
            k = 0
            while k < n and n <= largest:
                for i in range(max(rows[k] - 1, 0), min(rows[k] + 2, h)):
                    for j in range(max(cols[k] - 1, 0), min(cols[k] + 2, w)):
                        if limits[i, j] == nothing or n > largest:
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
                out[r, q] = nothing


@kernel
def not_low(rows, col, row, limits, first, last, keep):
    """
    Clear the flag of points that lie below the limit of their cell.

    Parameters
    ----------
    rows : (n, 3) array of int32
        Stored x, y, z.
    col, row : (n,) arrays of float64
        Places in cells.
    limits : (h, w) array of int64
        Smallest stored z to keep.
    first, last : int
        Only points in rows ``first <= r < last`` are looked at.
    keep : (n,) array of bool
        Set to False for low points.
    """
    h, w = limits.shape
    for i in range(col.size):
        r = min(max(np.int64(row[i]), 0), h - 1)
        if first <= r < last:
            q = min(max(np.int64(col[i]), 0), w - 1)
            if rows[i, 2] < limits[r, q]:
                keep[i] = False


@kernel
def slopes(z, col, row, cell, first, last, out):
    """
    Steepness of a surface at points: central differences, read bilinearly.

    Parameters
    ----------
    z : (h, w) array of float64
        Heights of the nodes, at least 2 a side.
    col, row : (n,) arrays of float64
        Places in cells from the top left corner.
    cell : float
        Edge of a cell in the unit of the heights.
    first, last : int
        Only points whose upper node row is in ``first <= r < last`` are read.
    out : (n,) array of float64
        Rise over run, set for the points read.
    """
    h, w = z.shape
    for i in range(col.size):
        x = min(max(col[i] - 0.5, 0.0), w - 1.0)
        y = min(max(row[i] - 0.5, 0.0), h - 1.0)
        q = min(np.int64(x), w - 2)
        r = min(np.int64(y), h - 2)
        if r < first or r >= last:
            continue
        u = x - q
        v = y - r
        east = 0.0
        south = 0.0
        for a in range(2):
            for b in range(2):
                part = (v if a else 1.0 - v) * (u if b else 1.0 - u)
                left, right = max(q + b - 1, 0), min(q + b + 1, w - 1)
                up, down = max(r + a - 1, 0), min(r + a + 1, h - 1)
                east += part * (z[r + a, right] - z[r + a, left]) / (right - left)
                south += part * (z[down, q + b] - z[up, q + b]) / (down - up)
        out[i] = np.sqrt(east * east + south * south) / cell


@kernel
def pulls(rise, slope, base, per_slope, out):
    """
    Weight of each point's spring: whole for points at or below the surface, little far above.

    Parameters
    ----------
    rise : (n,) array of float64
        Point minus surface.
    slope : (n,) array of float64
        Of `slopes`.
    base, per_slope : float
        ``tau = base + per_slope min(slope, 1)``, in the unit of `rise`.
    out : (n,) array of float64
        Set: 1 up to tau, ``1 / (1 + ((rise - tau) / tau)^2)^2`` above.
    """
    for i in range(rise.size):
        tau = base + per_slope * min(slope[i], 1.0)
        if rise[i] <= tau:
            out[i] = 1.0
        else:
            over = (rise[i] - tau) / tau
            squared = 1.0 + over * over
            out[i] = 1.0 / (squared * squared)
