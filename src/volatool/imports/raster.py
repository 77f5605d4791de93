"""GeoTIFF elevation models for import: the middle of each cell at its height, CRS kept.

Only the top surface is filled: a height says nothing of what is below.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from volatool.errors import CodedWarning
from volatool.imports.asc import note_void
from volatool.imports.model import Batch, ImportedPoints
from volatool.options import ConvertOptions


def read(path: Path, options: ConvertOptions) -> ImportedPoints:
    """
    Open an elevation model.

    Parameters
    ----------
    path : pathlib.Path
        One band, north up; read some rows at a time.
    options : ConvertOptions
        Not looked at.

    Raises
    ------
    FormatError, ResourceError
        No such raster; it claims more cells than any model may have.
    """
    from volatool.dem.raster import height_rows, read_place
    from volatool.points.crs import crs_from_user

    place = read_place(path)
    crs = None if place.wkt is None else crs_from_user(place.wkt, "wkt")
    warnings: list[CodedWarning] = []

    def batches(n_rows: int) -> Iterator[Batch]:
        n_void, start = 0, 0
        for first, heights in height_rows(path):
            there = np.isfinite(heights)
            n_void += heights.size - int(np.count_nonzero(there))
            row, column = np.nonzero(there)
            xyz = np.column_stack(
                [
                    place.left + (column + 0.5) * place.step_x,
                    place.top - (first + row + 0.5) * place.step_y,
                    heights[there],
                ]
            )
            for at in range(0, len(xyz), n_rows):
                yield Batch(start + at, xyz[at : at + n_rows])
            start += len(xyz)
        note_void(warnings, n_void)

    return ImportedPoints("tif", batches, crs=crs, warnings=warnings)
