"""A grid taken from an existing raster: its cells, corner and extent."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from volatool.dem.grid import Grid
from volatool.errors import CRSError
from volatool.model import CrsInfo


def grid_like(path: Path, crs: CrsInfo, option: str = "--like") -> Grid:
    """
    Return the cells of a raster in the CRS of a tile.

    Parameters
    ----------
    path : pathlib.Path
        A GeoTIFF with square cells, north up; its corner may lie anywhere.
    crs : CrsInfo
        Of the tile; a tile or a raster without one is taken at its word.
    option : str
        What named the raster, for the message.

    Raises
    ------
    CRSError
        ``E_CRS``: the raster is in another horizontal CRS.
    InputNotFoundError, FormatError, ResourceError
        Not there; not such a raster; too many cells.
    """
    from volatool.dem.raster import read_grid

    grid, wkt = read_grid(path)
    if wkt is not None and crs.wkt2 is not None:
        import pyproj

        mine, theirs = (_horizontal(pyproj.CRS.from_wkt(text)) for text in (crs.wkt2, wkt))
        codes = (mine.to_authority(), theirs.to_authority())
        is_same = mine.equals(theirs, ignore_axis_order=True)
        if not is_same and (None in codes or codes[0] != codes[1]):
            raise CRSError(
                f"{option} {path}: is in {theirs.name}, the tile in {mine.name}; give --to-crs, or "
                "a raster in the tile's CRS"
            )
    return grid


def _horizontal(crs: Any) -> Any:
    """Return the horizontal part of a CRS."""
    return crs.sub_crs_list[0] if crs.is_compound else crs
