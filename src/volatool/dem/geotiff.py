"""DEMs written as Cloud-Optimised GeoTIFFs.

===========  ==========================================================================
content      how
===========  ==========================================================================
heights      one band float32, void cells -9999 = nodata; unit and description on the band
layout       COG: tiles of 512, deflate with predictor, averaged overviews without nodata
place        affine transform, CRS as compound WKT when the vertical part is known,
             AREA_OR_POINT=Area (a value stands for its whole cell)
statistics   STATISTICS_MINIMUM, MAXIMUM, MEAN, STDDEV, VALID_PERCENT of the full raster
provenance   the tags the caller gives, beside TIFFTAG_SOFTWARE
===========  ==========================================================================

Read again by `volatool.dem.raster`; rasterio is imported here and in `volatool.dem.gdal` only.
"""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from volatool import resources
from volatool._version import __version__
from volatool.dem.gdal import BLOCK, gdal
from volatool.dem.grid import Grid
from volatool.dem.recheck import check_dem
from volatool.dem.statistics import RasterStatistics
from volatool.dem.surfaces import NODATA, Dem
from volatool.errors import OutputError
from volatool.scratch import no_space

Layer = Literal["flag", "count", "distance", "sigma"]

MAX_THREADS = 4
"""Threads that pack the tiles of a file; the bytes don't depend on their number."""

_DESCRIPTIONS = {
    "dtm": "elevation, bare earth",
    "dsm": "elevation, first returns",
    "min": "elevation, lowest point per cell",
    "max": "elevation, highest point per cell",
    "mean": "elevation, mean of the points per cell",
    "idw": "elevation, bare earth, inverse distances",
    "tin": "elevation, bare earth, linear on triangles",
    "emap": "elevation, EMap of scans",
    "flag": "0 void, 1 measured, 2 filled",
    "count": "points of the surface per cell",
    "distance": "distance to the nearest measured cell",
    "sigma": "standard error of the elevation at the cell's centre",
}


_COG = {
    "driver": "COG",
    "COMPRESS": "DEFLATE",
    "LEVEL": "6",
    "PREDICTOR": "YES",
    "BLOCKSIZE": str(BLOCK),
    "OVERVIEWS": "IGNORE_EXISTING",
    "BIGTIFF": "IF_SAFER",
    "GEOTIFF_VERSION": "1.1",
}


def write_dem(
    path: Path,
    dem: Dem,
    tags: Mapping[str, str] | None = None,
    *,
    directory: Path | None = None,
) -> None:
    """
    Write a DEM's heights as a Cloud-Optimised GeoTIFF.

    Parameters
    ----------
    path : pathlib.Path
        Output; replaced when it exists. Temporary names and renaming are the caller's.
    dem : Dem
        Heights, grid, CRS, units.
    tags : mapping of str to str, optional
        Provenance for the dataset's tags.
    directory : pathlib.Path, optional
        For the temporary copy that GDAL needs; the system's by default.

    Raises
    ------
    OutputError
        The file could not be written or did not read back.
    """

    def heights(start: int, stop: int) -> NDArray[Any]:
        rows = dem.z[start:stop]
        rows = np.where(np.isnan(rows), np.float32(NODATA), rows)
        dem.scratch.relax(dem.z, start, stop)
        return rows

    all_tags = {"surface": dem.surface, "ground_source": dem.ground_source, **(tags or {})}
    profile = _profile(dem, "float32", NODATA, dem.crs.unit_z, _DESCRIPTIONS[dem.surface])
    _write(path, profile, heights, all_tags, "AVERAGE", directory)


def write_layer(
    path: Path,
    dem: Dem,
    kind: Layer,
    tags: Mapping[str, str] | None = None,
    *,
    directory: Path | None = None,
) -> None:
    """
    Write a layer beside the heights: what each cell is.

    Parameters
    ----------
    path : pathlib.Path
        Output; replaced when it exists.
    dem : Dem
        The DEM.
    kind : str
        ``"flag"`` (uint8), ``"count"`` (uint32), ``"distance"`` (float32, horizontal unit;
        nodata when nothing is measured) or ``"sigma"`` (float32, vertical unit; nodata where
        void, and everywhere when nothing tells the noise).
    tags, directory
        As for `write_dem`.
    """
    layer: NDArray[Any] | None = getattr(dem, kind)
    is_float = kind in ("distance", "sigma")

    def values(start: int, stop: int) -> NDArray[Any]:
        if layer is None:  # standard errors that nothing tells
            return np.full((stop - start, dem.grid.width), NODATA, np.float32)
        rows = layer[start:stop]
        if is_float:
            rows = np.where(np.isfinite(rows), rows, np.float32(NODATA))
        return rows

    unit = {"distance": dem.crs.unit_xy, "sigma": dem.crs.unit_z}.get(kind)
    nodata = NODATA if is_float else None
    dtype = "float32" if layer is None else str(layer.dtype)
    profile = _profile(dem, dtype, nodata, unit, _DESCRIPTIONS[kind])
    _write(path, profile, values, dict(tags or {}), "AVERAGE" if is_float else "MODE", directory)
    if kind == "distance" and layer is not None:
        dem.scratch.free(layer)


def _profile(
    dem: Dem, dtype: str, nodata: float | None, unit: str | None, description: str
) -> dict[str, Any]:
    return {
        "grid": dem.grid,
        "wkt": dem.crs.wkt2,
        "dtype": dtype,
        "nodata": nodata,
        "unit": unit,
        "description": description,
    }


def copy_as_cog(source: Path, path: Path, *, is_float: bool, directory: Path | None = None) -> None:
    """
    Write a raster again as a Cloud-Optimised GeoTIFF, block by block, its tags too.

    Parameters
    ----------
    source, path : pathlib.Path
        Any raster, such as a VRT; the output, replaced when it exists.
    is_float : bool
        Overviews are means; else the most frequent values.
    directory : pathlib.Path, optional
        For GDAL's temporary files; the system's by default.

    Raises
    ------
    OutputError
        The file could not be written. Reading it back is the caller's.
    """
    import rasterio.shutil

    with _temporary_folder(directory) as folder, gdal(path, is_output=True, temporary=folder):
        rasterio.shutil.copy(
            source,
            path,
            OVERVIEW_RESAMPLING="AVERAGE" if is_float else "MODE",
            NUM_THREADS=_threads(),
            **_COG,
        )


def _threads() -> str:
    return str(min(MAX_THREADS, resources.n_threads()))


@contextlib.contextmanager
def _temporary_folder(directory: Path | None) -> Iterator[Path]:
    """Make a folder for GDAL's temporary files."""
    where = directory or Path(tempfile.gettempdir())
    try:
        folder = tempfile.TemporaryDirectory(
            prefix="volatool-", dir=directory, ignore_cleanup_errors=True
        )
    except OSError as error:
        raise no_space(where, error.strerror or str(error)) from error
    with folder as name:
        yield Path(name)


def _write(
    path: Path,
    profile: dict[str, Any],
    rows: Callable[[int, int], NDArray[Any]],
    tags: dict[str, str],
    resampling: str,
    directory: Path | None,
) -> None:
    import rasterio
    import rasterio.shutil
    from affine import Affine
    from rasterio.crs import CRS
    from rasterio.windows import Window

    grid: Grid = profile["grid"]
    nodata = profile["nodata"]
    statistics = RasterStatistics()
    with _temporary_folder(directory) as folder, gdal(path, is_output=True, temporary=folder):
        # GDAL writes a COG only as a copy of a whole raster
        plain = folder / "plain.tif"
        with rasterio.open(
            plain,
            "w",
            driver="GTiff",
            width=grid.width,
            height=grid.height,
            count=1,
            dtype=profile["dtype"],
            nodata=nodata,
            crs=CRS.from_wkt(profile["wkt"]) if profile["wkt"] else None,
            transform=Affine(*grid.transform),
            tiled=True,
            blockxsize=BLOCK,
            blockysize=BLOCK,
            BIGTIFF="IF_SAFER",
            GEOTIFF_VERSION="1.1",
        ) as file:
            for start in range(0, grid.height, BLOCK):
                stop = min(grid.height, start + BLOCK)
                values = rows(start, stop)
                statistics.add(values, nodata)
                file.write(values, 1, window=Window(0, start, grid.width, stop - start))
            file.set_band_description(1, profile["description"])
            if profile["unit"]:
                file.set_band_unit(1, profile["unit"])
            software = {"TIFFTAG_SOFTWARE": f"volatool {__version__}", "AREA_OR_POINT": "Area"}
            file.update_tags(**dict(sorted({**tags, **software}.items())))
            file.update_tags(1, **statistics.tags())
        rasterio.shutil.copy(
            plain,
            path,
            OVERVIEW_RESAMPLING=resampling,
            NUM_THREADS=_threads(),
            **_COG,
        )
    # GDAL takes a full disk at the end of a file for success: read all of it
    problems = check_dem(path)
    if problems:
        raise OutputError(f"{path}: does not read back ({problems[0][1]})")
