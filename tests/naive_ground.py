"""Plain twins of the ground filter's kernels: slow and obvious."""

from __future__ import annotations

import numpy as np

NOTHING = np.iinfo(np.int64).min


def low_limits(lowest, drop, reach, part):
    """Limit of each cell by the percentile of its window; `lowest` has NaN where no point is."""
    h, w = lowest.shape
    limits = np.full((h, w), NOTHING)
    for r in range(h):
        for q in range(w):
            window = lowest[max(r - reach, 0) : r + reach + 1, max(q - reach, 0) : q + reach + 1]
            if np.isnan(lowest[r, q]):
                continue
            level = np.quantile(window[~np.isnan(window)], part)
            if lowest[r, q] < level - drop:
                limits[r, q] = int(np.ceil(level - drop))
    return limits


def spare_large(limits, largest):
    """Limits of groups of at most `largest` cells, by flooding the whole group."""
    out = limits.copy()
    seen = set()
    for start in zip(*np.nonzero(limits != NOTHING), strict=True):
        if start in seen:
            continue
        group, waiting = set(), [start]
        while waiting:
            r, q = waiting.pop()
            inside = 0 <= r < limits.shape[0] and 0 <= q < limits.shape[1]
            if (r, q) in group or not inside or limits[r, q] == NOTHING:
                continue
            group.add((r, q))
            waiting += [(r + i, q + j) for i in (-1, 0, 1) for j in (-1, 0, 1)]
        seen |= group
        if len(group) > largest:
            for cell in group:
                out[cell] = NOTHING
    return out


def slope(z, col, row, cell):
    """Bilinear mean of the nodes' central differences."""
    h, w = z.shape
    down, east = np.gradient(z)
    x, y = min(max(col - 0.5, 0), w - 1), min(max(row - 0.5, 0), h - 1)
    q, r = min(int(x), w - 2), min(int(y), h - 2)
    u, v = x - q, y - r
    mean = [
        (1 - v) * ((1 - u) * g[r, q] + u * g[r, q + 1])
        + v * ((1 - u) * g[r + 1, q] + u * g[r + 1, q + 1])
        for g in (down, east)
    ]
    return np.hypot(*mean) / cell
