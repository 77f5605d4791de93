"""A grid taken from an existing raster: its cells, corner and extent."""

from __future__ import annotations

from pathlib import Path

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
        from volatool.points.crs import horizontal_difference

        names = horizontal_difference(crs.wkt2, wkt)
        if names is not None:
            raise CRSError(
                f"{option} {path}: is in {names[1]}, the tile in {names[0]}; give --to-crs, or "
                "a raster in the tile's CRS"
            )
    return grid
