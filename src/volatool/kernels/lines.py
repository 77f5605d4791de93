"""Lines on a grid: which edges they cut, which nodes they enclose, what a point sees.

Coordinates are whole numbers, `UNITS` to a cell, so that every decision is exact. Ties are decided
as if all lines were moved by a vanishing step to the right and a far smaller one down: a node on a
line lies left of it, or above it if the line is level. Rings therefore always close.
"""

import numpy as np

from volatool.kernels._jit import kernel

UNITS = 4096
HALF = UNITS // 2


@kernel
def crossed(segments, k, axis, n_lines, n_edges, out):
    """
    Edges that a segment crosses on the node lines along one axis.

    Parameters
    ----------
    segments : (n, 4) array of int64
        x, y of both ends; at most 2**28.
    k : int
        Segment.
    axis : int
        0: edges along rows (to the east), 1: edges along columns (to the south).
    n_lines, n_edges : int
        Rows and columns minus one for axis 0; columns and rows minus one for axis 1.
    out : (m, 2) array of int64
        Set to (line, edge on it, or -1 for all before the first); m is at least the number of node
        lines between the ends.

    Returns
    -------
    n : int
        How many.
    """
    ax, ay, bx, by = segments[k]
    if axis == 1:
        ax, ay, bx, by = ay, ax, by, bx
    if ay == by:
        return 0
    if ay > by:
        ax, ay, bx, by = bx, by, ax, ay
    dx, dy = bx - ax, by - ay
    # node lines at y with ay < y <= by
    first = max((ay - HALF) // UNITS + 1, 0)
    last = min((by - HALF) // UNITS, n_lines - 1)
    tie = 1 if axis == 1 and dx > 0 else 0
    n = 0
    for line in range(first, last + 1):
        y = line * UNITS + HALF
        at = ((ax - HALF) * dy + (y - ay) * dx - tie) // (dy * UNITS)
        if at < n_edges:
            out[n, 0] = line
            out[n, 1] = max(at, -1)
            n += 1
    return n


@kernel
def cut_edges(segments, edges):
    """
    Cut the edges that segments cross.

    Parameters
    ----------
    segments : (n, 4) array of int64
        x, y of both ends.
    edges : (h, 2, w) array of float32
        Factors; set to 0 where cut.
    """
    h, _, w = edges.shape
    out = np.empty((max(h, w), 2), np.int64)
    for k in range(len(segments)):
        for i in range(crossed(segments, k, 0, h, w - 1, out)):
            if out[i, 1] >= 0:
                edges[out[i, 0], 0, out[i, 1]] = 0.0
        for i in range(crossed(segments, k, 1, w, h - 1, out)):
            if out[i, 1] >= 0:
                edges[out[i, 1], 1, out[i, 0]] = 0.0


@kernel
def fill_rings(segments, top, left, value, labels):
    """
    Label the nodes that rings enclose, by the even-odd rule.

    Parameters
    ----------
    segments : (n, 4) array of int64
        All sides of all rings of a polygon.
    top, left : int
        Row and column of the first node of the window.
    value : int
        Label.
    labels : (h, w) array of int32
        Window of a grid, set where enclosed.

    Returns
    -------
    n : int
        Nodes enclosed.
    """
    h, w = labels.shape
    toggles = np.zeros((h, w), np.bool_)
    moved = segments - np.array([left, top, left, top]) * UNITS
    out = np.empty((h, 2), np.int64)
    for k in range(len(moved)):
        # what lies left of the window counts, right of it does not
        for i in range(crossed(moved, k, 0, h, w, out)):
            if out[i, 1] + 1 < w:
                toggles[out[i, 0], out[i, 1] + 1] ^= True
    n = 0
    for r in range(h):
        inside = False
        for q in range(w):
            inside ^= toggles[r, q]
            if inside:
                labels[r, q] = value
                n += 1
    return n


@kernel
def quads_of(segments, h, w, pairs):
    """
    Quads (of four nodes) that segments may touch.

    Parameters
    ----------
    segments : (n, 4) array of int64
        x, y of both ends.
    h, w : int
        Nodes.
    pairs : (m, 2) array of int64
        Set to (quad ``r w + q``, segment); with m = 0 they are only counted.

    Returns
    -------
    n : int
        How many pairs.
    """
    n = 0
    for k in range(len(segments)):
        ax, ay, bx, by = segments[k]
        if ay > by:
            ax, ay, bx, by = bx, by, ax, ay
        first, last = (ay - HALF - 1) // UNITS, (by - HALF + 1) // UNITS
        for r in range(max(first, -1), min(last, h - 1) + 1):
            low, high = min(ax, bx), max(ax, bx)
            if by > ay:
                # the part between this quad's upper and lower side, rounded outwards
                upper = min(max(r * UNITS + HALF, ay), by)
                lower = min(max((r + 1) * UNITS + HALF, ay), by)
                x0 = ax + (upper - ay) * (bx - ax) // (by - ay)
                x1 = ax + (lower - ay) * (bx - ax) // (by - ay)
                low, high = max(low, min(x0, x1) - 1), min(high, max(x0, x1) + 1)
            for q in range(
                max((low - HALF - 1) // UNITS, -1), min((high - HALF + 1) // UNITS, w - 1) + 1
            ):
                if len(pairs):
                    # points of the rim belong to the quads beside it
                    pairs[n, 0] = min(max(r, 0), h - 2) * w + min(max(q, 0), w - 2)
                    pairs[n, 1] = k
                n += 1
    return n


@kernel
def side(ax, ay, bx, by, px, py):
    """
    Side of a line on which a point lies.

    Parameters
    ----------
    ax, ay, bx, by, px, py : int64
        Line from a to b, point p.

    Returns
    -------
    side : int
        1 or -1; the line is moved by a vanishing step when the point is on it.
    """
    dx, dy = bx - ax, by - ay
    turn = dx * (py - ay) - dy * (px - ax)
    if turn == 0:
        turn = dy if dy != 0 else -dx
    return 1 if turn > 0 else -1


@kernel
def is_between(ax, ay, bx, by, px, py, nx, ny):
    """
    Whether a segment separates a point from a node.

    Parameters
    ----------
    ax, ay, bx, by : int64
        Segment.
    px, py, nx, ny : int64
        Point and node.

    Returns
    -------
    between : bool
        The way from the point to the node crosses the segment.
    """
    if side(ax, ay, bx, by, px, py) == side(ax, ay, bx, by, nx, ny):
        return False
    dx, dy = nx - px, ny - py
    first = dx * (ay - py) - dy * (ax - px)
    second = dx * (by - py) - dy * (bx - px)
    tie = -dy if dy != 0 else dx
    if first == 0:
        first = tie
    if second == 0:
        second = tie
    return (first > 0) != (second > 0)


@kernel
def is_hidden(px, py, nx, ny, number, starts, members, segments):
    """
    Whether any of a quad's segments separates two places.

    Parameters
    ----------
    px, py, nx, ny : int64
        Places.
    number, starts, members, segments
        The quad's number and the tables of `attach`.
    """
    for m in range(starts[number - 1], starts[number]):
        ax, ay, bx, by = segments[members[m]]
        if is_between(ax, ay, bx, by, px, py, nx, ny):
            return True
    return False


@kernel
def attach(x, y, h, w, nearest, quads, starts, members, segments, weights):
    """
    Nodes that a point pulls on: of the four about it those on its own side of all lines.

    Parameters
    ----------
    x, y : float64
        Place in cells from the top left corner, inside the grid.
    h, w : int
        Nodes.
    nearest : bool
        Only the one with the largest weight.
    quads : (h, w) array of int32
        Number, from 1 on, of a quad that lines touch; 0 for all others.
    starts, members : (m + 1,), (p,) arrays of int64
        Segments of quad k: ``members[starts[k - 1] : starts[k]]``.
    segments : (n, 4) array of int64
        x, y of both ends.
    weights : (4,) array of float64
        Set: of nodes (r, q), (r, q + 1), (r + 1, q), (r + 1, q + 1).

    Returns
    -------
    r, q : int
        Upper left of the four; r is -1 when lines separate the point from all of them.
    """
    a = max(x - 0.5, 0.0)
    b = max(y - 0.5, 0.0)
    q = min(np.int64(a), w - 2)
    r = min(np.int64(b), h - 2)
    u = min(a - q, 1.0)
    v = min(b - r, 1.0)
    weights[0] = (1.0 - u) * (1.0 - v)
    weights[1] = u * (1.0 - v)
    weights[2] = (1.0 - u) * v
    weights[3] = u * v
    number = quads[r, q]
    if number > 0:
        px, py = np.int64(np.rint(x * UNITS)), np.int64(np.rint(y * UNITS))
        best = -1
        for k in range(4):
            nx, ny = (q + k % 2) * UNITS + HALF, (r + k // 2) * UNITS + HALF
            if is_hidden(px, py, nx, ny, number, starts, members, segments):
                weights[k] = 0.0
            else:
                weights[k] += 1e-6  # a node may be seen and have no weight
                if best < 0 or weights[k] > weights[best]:
                    best = k
        if best < 0:
            return np.int64(-1), q
        # of what the point sees, only what the nearest of them sees too: they hang together
        px, py = (q + best % 2) * UNITS + HALF, (r + best // 2) * UNITS + HALF
        total = 0.0
        for k in range(4):
            nx, ny = (q + k % 2) * UNITS + HALF, (r + k // 2) * UNITS + HALF
            if k != best and is_hidden(px, py, nx, ny, number, starts, members, segments):
                weights[k] = 0.0
            total += weights[k]
        for k in range(4):
            weights[k] /= total
    if nearest:
        best = 0
        for k in range(1, 4):
            if weights[k] > weights[best]:
                best = k
        weights[:] = 0.0
        weights[best] = 1.0
    return r, q


@kernel
def cut_accumulate(
    data, right, col, row, height, weights, nearest, first, last, quads, starts, members, segments
):
    """
    Add the data springs of points to a grid's evidence; no spring crosses a line.

    Parameters
    ----------
    data, right, col, row, height, weights, nearest, first, last
        As in `spring.accumulate`.
    quads, starts, members, segments
        As in `attach`.
    """
    h, w = right.shape
    last_weight = weights.size - 1
    phi = np.empty(4)
    for i in range(col.size):
        x = col[i]
        y = row[i]
        if not (x >= 0.0 and x <= w and y >= 0.0 and y <= h):
            continue
        upper = min(np.int64(max(y - 0.5, 0.0)), h - 2)
        if upper + 1 < first or upper >= last:
            continue
        r, q = attach(x, y, h, w, nearest, quads, starts, members, segments, phi)
        if r < 0:
            continue
        weight = weights[min(i, last_weight)]
        pull = weight * height[i]
        if r >= first:
            data[r, 0, q] += weight * phi[0] * phi[0]
            data[r, 0, q + 1] += weight * phi[1] * phi[1]
            data[r, 1, q] += weight * phi[0] * phi[1]
            data[r, 2, q] += weight * phi[0] * phi[2]
            data[r, 2, q + 1] += weight * phi[1] * phi[3]
            data[r, 3, q] += weight * phi[0] * phi[3]
            data[r, 4, q + 1] += weight * phi[1] * phi[2]
            right[r, q] += pull * phi[0]
            right[r, q + 1] += pull * phi[1]
        if r + 1 < last:
            data[r + 1, 0, q] += weight * phi[2] * phi[2]
            data[r + 1, 0, q + 1] += weight * phi[3] * phi[3]
            data[r + 1, 1, q] += weight * phi[2] * phi[3]
            right[r + 1, q] += pull * phi[2]
            right[r + 1, q + 1] += pull * phi[3]


@kernel
def cut_interpolate(z, col, row, nearest, first, last, quads, starts, members, segments, out):
    """
    Height of a surface at points, read only from the nodes on their side of the lines.

    Parameters
    ----------
    z, col, row, nearest, first, last, out
        As in `spring.interpolate`; NaN also for points that no node belongs to.
    quads, starts, members, segments
        As in `attach`.
    """
    h, w = z.shape
    phi = np.empty(4)
    for i in range(col.size):
        x = col[i]
        y = row[i]
        if not (x >= 0.0 and x <= w and y >= 0.0 and y <= h):
            out[i] = np.nan
            continue
        upper = min(np.int64(max(y - 0.5, 0.0)), h - 2)
        if upper < first or upper >= last:
            continue
        r, q = attach(x, y, h, w, nearest, quads, starts, members, segments, phi)
        if r < 0:
            out[i] = np.nan
            continue
        out[i] = (phi[0] * z[r, q] + phi[1] * z[r, q + 1]) + (
            phi[2] * z[r + 1, q] + phi[3] * z[r + 1, q + 1]
        )
