"""Points per area while they pass by: the maps of the VOLA paper's Figures 4 to 7."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from volatool.model import F64, I64, U64, Bounds, PointChunk

MOST_CELLS = 400
"""Cells along the longer side of a map, at most."""

_MERGE = 1 << 21
_HALF = 1 << 31


@dataclass(frozen=True, slots=True)
class DensityMap:
    """
    Points per cell of a map.

    Parameters
    ----------
    counts : (h, w) array of int64
        Row 0 is the southernmost.
    bounds : Bounds
        Of the cells, in units of the CRS.
    cell : float
        Edge.
    """

    counts: I64
    bounds: Bounds
    cell: float

    def per_area(self, metres_per_unit: float | None) -> F64:
        """
        Return points a square metre (a square unit, if its length is not known).

        Parameters
        ----------
        metres_per_unit : float or None
            Length of the horizontal unit.
        """
        density: F64 = self.counts / (self.cell * (metres_per_unit or 1.0)) ** 2
        return density


class DensityGatherer:
    """
    Counts points in square cells on multiples of their edge, in any order of the chunks.

    Parameters
    ----------
    cell : float
        Edge, in units of the CRS; see `cell_for`. It becomes larger if there are too many cells,
        and in `result` until the map has no more than `MOST_CELLS` a side.
    """

    def __init__(self, cell: float) -> None:
        self.cell = cell
        self._keys: list[U64] = []
        self._counts: list[I64] = []
        self._held = 0

    def add(self, chunk: PointChunk) -> None:
        """
        Count points.

        Parameters
        ----------
        chunk : PointChunk
            Those that are used.
        """
        if not len(chunk):
            return
        xy = chunk.xyz()[:, :2]
        farthest = float(np.abs(xy).max())
        while farthest / self.cell >= _HALF - 1:  # the header's box was no help
            self._coarsen()
        columns, rows = (np.floor(xy / self.cell).astype(np.int64) + _HALF).T.astype(np.uint64)
        keys, counts = np.unique(rows << np.uint64(32) | columns, return_counts=True)
        self._keys.append(keys)
        self._counts.append(counts)
        self._held += len(keys)
        if self._held > _MERGE:
            self._merge()
            while self._held > _MERGE // 2:
                self._coarsen()

    def _merge(self) -> None:
        keys, place = np.unique(np.concatenate(self._keys), return_inverse=True)
        counts = np.zeros(len(keys), np.int64)
        np.add.at(counts, place, np.concatenate(self._counts))
        self._keys, self._counts, self._held = [keys], [counts], len(keys)

    def _coarsen(self) -> None:
        """Make cells twice as large."""
        self.cell *= 2
        if self._keys:
            columns, rows = (places // 2 + _HALF for places in self._places())
            self._keys = [rows.astype(np.uint64) << np.uint64(32) | columns.astype(np.uint64)]
            self._merge()

    def _places(self) -> tuple[I64, I64]:
        """Return column and row of all cells, merged."""
        self._merge()
        low = np.uint64((1 << 32) - 1)
        columns = (self._keys[0] & low).astype(np.int64) - _HALF
        return columns, (self._keys[0] >> np.uint64(32)).astype(np.int64) - _HALF

    def result(self) -> DensityMap | None:
        """Return the map; None without points."""
        if not self._keys:
            return None
        columns, rows = self._places()
        longer = max(int(np.ptp(columns)), int(np.ptp(rows))) + 1
        factor = -(-longer // MOST_CELLS)
        columns, rows = columns // factor, rows // factor
        left, bottom = int(columns.min()), int(rows.min())
        counts = np.zeros((int(np.ptp(rows)) + 1, int(np.ptp(columns)) + 1), np.int64)
        np.add.at(counts, (rows - bottom, columns - left), self._counts[0])
        cell = self.cell * factor
        height, width = counts.shape
        corner = left * cell, bottom * cell
        bounds = Bounds(*corner, corner[0] + width * cell, corner[1] + height * cell)
        return DensityMap(counts, bounds, cell)


def cell_for(extent: float) -> float:
    """
    Return an edge of 1, 2 or 5 times a power of ten that cuts an extent into 80 to 200 cells.

    Parameters
    ----------
    extent : float
        Longer side of a box; 1 is returned for what is not a positive number.

    Examples
    --------
    >>> cell_for(100.0), cell_for(1000.0), cell_for(0.0)
    (0.5, 5.0, 1.0)
    """
    if not (extent > 0 and math.isfinite(extent)):
        return 1.0
    least = extent / 200
    power = 10.0 ** math.floor(math.log10(least))
    return next(power * step for step in (1, 2, 5, 10) if power * step >= least * (1 - 1e-9))
