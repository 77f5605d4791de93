"""Which cells may be filled: distances to measured cells, the hull, and the largest gap."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from volatool.emap.system import strips
from volatool.scratch import Scratch

VOID, MEASURED, FILLED = 0, 1, 2
"""Values of the flag layer."""


def distance_cells(cells: NDArray[np.uint8], wanted: int, scratch: Scratch) -> NDArray[np.float32]:
    """
    Return the exact distance of each cell's centre to the nearest centre of a wanted cell.

    Parameters
    ----------
    cells : (h, w) array of uint8
        Cells; those equal to `wanted` have distance 0.
    wanted : int
        Value.
    scratch : Scratch
        Where the result lives.

    Returns
    -------
    distance : (h, w) array of float32
        In cells; infinite without a wanted cell. Give it back with ``scratch.free``.
    """
    from volatool.kernels import binning

    height, width = cells.shape
    columns = scratch.zeros(cells.shape, np.int32)
    pieces = list(strips(height, width))
    for is_down, order in ((True, pieces), (False, pieces[::-1])):
        for start, stop in order:
            binning.column_distances(cells, wanted, start, stop, is_down, columns)
            scratch.relax(cells, start, stop)
            scratch.relax(columns, start, stop)
    out: NDArray[np.float32] = scratch.zeros(cells.shape, np.float32)
    for start, stop in pieces:
        binning.row_distances(columns, start, stop, out)
        scratch.relax(columns, start, stop)
        scratch.relax(out, start, stop)
    scratch.free(columns)
    return out


def fill_flags(flag: NDArray[np.uint8], max_gap: float, margin: float, scratch: Scratch) -> None:
    """
    Mark the void cells that may be filled.

    A cell is filled when it is inside the convex hull of the measured cells (widened by a
    margin) and every disc of radius `max_gap` with its centre in the grid that covers it holds
    a measured cell too. So gaps up to twice `max_gap` wide are filled whole, larger ones are
    left whole, without a rim of guesses, and no filled cell is farther than `max_gap` from data.

    Parameters
    ----------
    flag : (h, w) array of uint8
        `MEASURED` and `VOID`; `FILLED` is set.
    max_gap : float
        Radius, in cells.
    margin : float
        Widening of the hull, in cells.
    scratch : Scratch
        Where distances live.
    """
    height, width = flag.shape
    spans = hull_spans(flag, math.ceil(margin))
    distance = distance_cells(flag, MEASURED, scratch)
    centre = scratch.zeros(flag.shape, np.uint8)
    any_centre = False
    for start, stop in strips(height, width):
        part = distance[start:stop] > max_gap
        any_centre = any_centre or bool(part.any())
        centre[start:stop] = part
        scratch.relax(distance, start, stop)
        scratch.relax(centre, start, stop)
    scratch.free(distance)
    covered = distance_cells(centre, 1, scratch) if any_centre else None
    scratch.free(centre)
    cols = np.arange(width)
    for start, stop in strips(height, width):
        inside = (cols >= spans[start:stop, :1]) & (cols <= spans[start:stop, 1:])
        if covered is not None:
            inside &= covered[start:stop] > max_gap
            scratch.relax(covered, start, stop)
        rows = flag[start:stop]
        rows[inside & (rows == VOID)] = FILLED
        scratch.relax(flag, start, stop)
    if covered is not None:
        scratch.free(covered)


def hull_spans(flag: NDArray[np.uint8], margin: int) -> NDArray[np.int64]:
    """
    Return the first and last column of each row inside the hull of the measured cells.

    Parameters
    ----------
    flag : (h, w) array of uint8
        `MEASURED` and others.
    margin : int
        Cells by which the hull is widened (a square's worth).

    Returns
    -------
    spans : (h, 2) array of int64
        First and last column; first > last outside.
    """
    from volatool.kernels import binning

    height, width = flag.shape
    spans: NDArray[np.int64] = binning.row_spans(flag, MEASURED)
    rows = np.flatnonzero(spans[:, 1] >= 0)
    if not len(rows):
        return np.tile(np.array((width, -1)), (height, 1))
    first, last = int(rows[0]), int(rows[-1])
    every = np.arange(first, last + 1)
    left = np.floor(_envelope(rows, spans[rows, 0], every)).astype(np.int64)
    right = -np.floor(_envelope(rows, -spans[rows, 1], every)).astype(np.int64)
    result = np.empty((height, 2), np.int64)
    result[:] = (width, -1)
    margin = min(margin, max(height, width))
    for shift in range(-margin, margin + 1):
        low, high = max(0, first + shift), min(height, last + 1 + shift)
        if low >= high:
            continue
        own = slice(low - first - shift, high - first - shift)
        np.minimum(result[low:high, 0], left[own] - margin, out=result[low:high, 0])
        np.maximum(result[low:high, 1], right[own] + margin, out=result[low:high, 1])
    return result


def _envelope(
    x: NDArray[np.int64], y: NDArray[np.int64], at: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Largest convex function below the points (x, y), x ascending, evaluated at places."""
    hull: list[tuple[int, int]] = []
    for px, py in zip(x.tolist(), y.tolist(), strict=True):
        while len(hull) >= 2:
            (ax, ay), (bx, by) = hull[-2:]
            if (bx - ax) * (py - ay) > (by - ay) * (px - ax):
                break
            hull.pop()
        hull.append((px, py))
    corner_x, corner_y = zip(*hull, strict=True)
    return np.asarray(np.interp(at, corner_x, corner_y), np.float64)
