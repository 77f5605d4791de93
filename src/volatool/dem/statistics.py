"""Statistics of a raster, gathered row by row, as the tags that GDAL keeps them in."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray


class RasterStatistics:
    """Statistics of a raster from its rows, top to bottom."""

    def __init__(self) -> None:
        self.n_cells = 0
        self.counts: list[int] = []
        self.sums: list[float] = []
        self.squares: list[float] = []
        self.low, self.high = math.inf, -math.inf
        self.shift: float | None = None

    def add(self, rows: NDArray[Any], nodata: float | None) -> None:
        """
        Add rows.

        Parameters
        ----------
        rows : (n, w) array
            Values.
        nodata : float or None
            The value that doesn't count.
        """
        self.n_cells += rows.size
        values = rows.ravel() if nodata is None else rows[rows != rows.dtype.type(nodata)]
        if not len(values):
            return
        if self.shift is None:
            self.shift = float(values[0])
        self.low, self.high = (
            min(self.low, float(values.min())),
            max(self.high, float(values.max())),
        )
        off = values.astype(np.float64)
        del values  # rasters are wide: no copy more than needed
        off -= self.shift
        self.counts.append(len(off))
        self.sums.append(float(off.sum()))
        self.squares.append(float(np.square(off, out=off).sum()))

    def tags(self) -> dict[str, str]:
        """Return the tags that gdalinfo and GIS programs look for; none without values."""
        n = sum(self.counts)
        if not n or self.shift is None:
            return {}
        mean = math.fsum(self.sums) / n
        variance = max(0.0, math.fsum(self.squares) / n - mean**2)
        values = {
            "MAXIMUM": self.high,
            "MEAN": self.shift + mean,
            "MINIMUM": self.low,
            "STDDEV": math.sqrt(variance),
        }
        tags = {f"STATISTICS_{name}": f"{value:.10g}" for name, value in values.items()}
        # never 100 unless it is: GDAL takes that for "no nodata"
        tags["STATISTICS_VALID_PERCENT"] = f"{math.floor(1e4 * n / self.n_cells) / 100:.4g}"
        return tags
