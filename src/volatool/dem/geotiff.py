"""DEM to and from Cloud-Optimised GeoTIFF; the only importer of rasterio.

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
"""

from __future__ import annotations

import contextlib
import math
import shutil
import tempfile
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from volatool._version import __version__
from volatool.dem.grid import MAX_CELLS, Grid
from volatool.dem.statistics import RasterStatistics
from volatool.dem.surfaces import NODATA, Dem
from volatool.errors import FormatError, InputNotFoundError, OutputError, ResourceError
from volatool.model import F64
from volatool.scratch import no_space

BLOCK = 512
"""Edge of a tile of the file."""

CACHE_MB = 16
"""GDAL's block cache; its default is 5 % of the machine's memory."""

Layer = Literal["flag", "count", "distance", "sigma"]

Problem = tuple[str, str, int | None]
"""Code, message, and byte offset if known, as in ``volatool validate``."""

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


@dataclass(frozen=True, slots=True)
class DemFile:
    """
    What a DEM file holds.

    Parameters
    ----------
    z : (h, w) array of float32
        Heights, NaN where the file has nodata.
    grid : Grid
        Where the cells are.
    wkt : str or None
        Coordinate reference system.
    unit, description : str or None
        Of the band.
    tags, statistics : dict
        Dataset tags; ``STATISTICS_...`` of the band.
    """

    z: NDArray[np.float32]
    grid: Grid
    wkt: str | None
    unit: str | None
    description: str | None
    tags: dict[str, str] = field(default_factory=dict)
    statistics: dict[str, float] = field(default_factory=dict)


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


LEAST_FREE_BYTES = 1 << 20
"""With less room than this in a folder after a failed write, the folder was full."""


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


@contextlib.contextmanager
def _gdal(path: Path, is_output: bool, temporary: Path | None = None) -> Iterator[None]:
    """Quiet, small and single-threaded GDAL; its errors become ours."""
    import rasterio
    from rasterio._err import CPLE_BaseError
    from rasterio.errors import CRSError, RasterioError

    options = {
        "GDAL_CACHEMAX": CACHE_MB,
        "GDAL_NUM_THREADS": "1",
        "GDAL_PAM_ENABLED": "NO",
        "GDAL_DISABLE_READDIR_ON_OPEN": "EMPTY_DIR",
        "CPL_TMPDIR": str(temporary or tempfile.gettempdir()),
    }
    try:
        with rasterio.Env(**options):
            yield
    except UnicodeEncodeError as error:
        raise OutputError(
            f"{path!a}: GDAL takes names in Unicode only; rename the tile, or leave the elevation "
            "model out (--no-dem)"
        ) from error
    except (RasterioError, CRSError, CPLE_BaseError, OSError) as error:
        if isinstance(error, (OutputError, FormatError)):
            raise
        if temporary is not None and _is_full(temporary) and not _is_full(path.parent):
            raise no_space(temporary.parent, "it is full") from error
        if is_output:
            raise OutputError(f"{path}: can't be written ({error})") from error
        raise FormatError(f"{path}: not a readable GeoTIFF ({error})") from error


def _is_full(folder: Path) -> bool:
    return shutil.disk_usage(folder).free < LEAST_FREE_BYTES


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
    with _temporary_folder(directory) as folder, _gdal(path, is_output=True, temporary=folder):
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
            driver="COG",
            COMPRESS="DEFLATE",
            LEVEL="6",
            PREDICTOR="YES",
            BLOCKSIZE=str(BLOCK),
            OVERVIEWS="IGNORE_EXISTING",
            OVERVIEW_RESAMPLING=resampling,
            BIGTIFF="IF_SAFER",
            NUM_THREADS="1",
            GEOTIFF_VERSION="1.1",
        )
    # GDAL takes a full disk at the end of a file for success: read all of it
    problems = check_dem(path)
    if problems:
        raise OutputError(f"{path}: does not read back ({problems[0][1]})")


def read_dem(path: Path) -> DemFile:
    """
    Read a DEM.

    Parameters
    ----------
    path : pathlib.Path
        A GeoTIFF of one band with square cells, north up.

    Raises
    ------
    InputNotFoundError, FormatError
        Not there; not such a file.
    """
    import rasterio

    if not path.exists():
        raise InputNotFoundError(f"{path}: no such file")
    with _gdal(path, is_output=False), rasterio.open(path) as file:
        t = file.transform
        if file.count != 1 or t.b or t.d or not math.isclose(t.a, -t.e):
            raise FormatError(f"{path}: not a raster of one band with square cells, north up")
        z = file.read(1).astype(np.float32)
        if file.nodata is not None:
            z[z == np.float32(file.nodata)] = np.nan
        return DemFile(
            z,
            Grid(t.c, t.f, t.a, file.width, file.height),
            file.crs.to_wkt(version="WKT2_2019") if file.crs else None,
            file.units[0],
            file.descriptions[0],
            file.tags(),
            _statistics(file.tags(1)),
        )


def read_grid(path: Path) -> tuple[Grid, str | None]:
    """
    Return the cells of a raster without reading them, and its CRS.

    Parameters
    ----------
    path : pathlib.Path
        A GeoTIFF with square cells, north up.

    Returns
    -------
    grid, wkt : Grid, str or None

    Raises
    ------
    InputNotFoundError, FormatError
        Not there; not such a file.
    """
    import rasterio

    if not path.exists():
        raise InputNotFoundError(f"{path}: no such file")
    with _gdal(path, is_output=False), rasterio.open(path) as file:
        t = file.transform
        if t.b or t.d or not t.a > 0 or not math.isclose(t.a, -t.e) or t.is_identity:
            raise FormatError(f"{path}: not a raster with a place, square cells and north up")
        if file.width * file.height > MAX_CELLS:
            raise ResourceError(
                f"{path}: has {file.width} x {file.height} cells, more than any model of volatool "
                "may have",
                "E_SIZE",
            )
        wkt = file.crs.to_wkt(version="WKT2_2019") if file.crs else None
        return Grid(t.c, t.f, t.a, file.width, file.height), wkt


@dataclass(frozen=True, slots=True)
class Place:
    """
    Where a raster's cells are, which need not be square.

    Parameters
    ----------
    left, top : float
        Its upper left corner.
    step_x, step_y : float
        Edges of a cell, above zero.
    wkt : str or None
        Coordinate reference system.
    """

    left: float
    top: float
    step_x: float
    step_y: float
    wkt: str | None


def read_place(path: Path) -> Place:
    """
    Return where the cells of an elevation model are.

    Parameters
    ----------
    path : pathlib.Path
        A GeoTIFF of one band, north up.

    Raises
    ------
    InputNotFoundError, FormatError, ResourceError
        Not there; not such a file; more than `MAX_CELLS` cells.
    """
    with _elevations(path) as file:
        t = file.transform
        wkt = file.crs.to_wkt(version="WKT2_2019") if file.crs else None
        return Place(t.c, t.f, t.a, -t.e, wkt)


def height_rows(path: Path) -> Iterator[tuple[int, F64]]:
    """
    Yield an elevation model some rows at a time, from the north.

    Parameters
    ----------
    path : pathlib.Path
        As for `read_place`.

    Yields
    ------
    first, heights : int, (h, w) array of float64
        Number of the first row; NaN where there is no value.
    """
    from rasterio.windows import Window

    with _elevations(path) as file:
        rows = max(1, BLOCK * BLOCK * 4 // file.width)
        for start in range(0, file.height, rows):
            window = Window(0, start, file.width, min(rows, file.height - start))
            cells = file.read(1, window=window)
            with np.errstate(invalid="ignore"):  # signalling NaNs
                heights = cells.astype(np.float64)
                nodata = file.nodata
                if nodata is not None:  # which an integer type need not be able to hold
                    is_float = cells.dtype.kind == "f"
                    heights[heights == (cells.dtype.type(nodata) if is_float else nodata)] = np.nan
            scale, offset = file.scales[0], file.offsets[0]
            yield start, heights if (scale, offset) == (1.0, 0.0) else heights * scale + offset


@contextlib.contextmanager
def _quiet_about_place() -> Iterator[None]:
    """Keep rasterio from warning of a raster without a place, which is refused anyway."""
    from rasterio.errors import NotGeoreferencedWarning

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        yield


@contextlib.contextmanager
def _elevations(path: Path) -> Iterator[Any]:
    import rasterio

    if not path.exists():
        raise InputNotFoundError(f"{path}: no such file")
    with (
        _gdal(path, is_output=False),
        _quiet_about_place(),
        rasterio.open(path, driver="GTiff") as file,
    ):
        t = file.transform
        if file.count != 1 or t.b or t.d or not (t.a > 0 > t.e) or "complex" in file.dtypes[0]:
            raise FormatError(f"{path}: not a raster of one band, north up")
        if file.width * file.height > MAX_CELLS:
            raise ResourceError(
                f"{path}: has {file.width} x {file.height} cells, more than any model of volatool "
                "may have",
                "E_SIZE",
            )
        yield file


def read_heights_at(path: Path, x: F64, y: F64) -> tuple[F64, NDArray[np.bool_]]:
    """
    Return a raster's values at places, bilinear between the cells' centres.

    Parameters
    ----------
    path : pathlib.Path
        A GeoTIFF of one band with square cells, north up.
    x, y : (n,) arrays of float64
        Places, in the raster's CRS.

    Returns
    -------
    values : (n,) array of float64
        NaN off the raster and where one of the four cells has no value. Within half a cell of
        the rim the outermost centres' value holds.
    inside : (n,) array of bool
        On the raster.

    Raises
    ------
    InputNotFoundError, FormatError
        Not there; not such a file.
    """
    values = np.full(len(x), np.nan)
    with _one_band(path) as (file, read):
        col, row = _places(file, x, y)
        inside = (col >= 0) & (col <= file.width) & (row >= 0) & (row <= file.height)
        for k in np.flatnonzero(inside):
            u = min(max(col[k] - 0.5, 0.0), file.width - 1.0)
            v = min(max(row[k] - 0.5, 0.0), file.height - 1.0)
            q, r = int(u), int(v)
            part_x, part_y = u - q, v - r
            # a cell without weight need not have a value, nor be there
            n, m = 1 + (part_x > 0), 1 + (part_y > 0)
            cells = read(q, r, n, m)
            across = np.array([1 - part_x, part_x][:n])
            down = np.array([1 - part_y, part_y][:m])
            values[k] = down @ cells @ across
    return values, inside


def read_values_at(path: Path, x: F64, y: F64) -> F64:
    """
    Return the values of the cells that hold places; NaN off the raster and for nodata.

    Parameters
    ----------
    path, x, y
        As for `read_heights_at`.
    """
    values = np.full(len(x), np.nan)
    with _one_band(path) as (file, read):
        col, row = _places(file, x, y)
        inside = (col >= 0) & (col <= file.width) & (row >= 0) & (row <= file.height)
        for k in np.flatnonzero(inside):
            q, r = min(int(col[k]), file.width - 1), min(int(row[k]), file.height - 1)
            values[k] = read(q, r, 1, 1)[0, 0]
    return values


@contextlib.contextmanager
def _one_band(path: Path) -> Iterator[tuple[Any, Callable[[int, int, int, int], F64]]]:
    """Open a raster of one band, north up; gives it and a function that reads a window."""
    import rasterio
    from rasterio.windows import Window

    if not path.exists():
        raise InputNotFoundError(f"{path}: no such file")
    with _gdal(path, is_output=False), rasterio.open(path) as file:
        t = file.transform
        if file.count != 1 or t.b or t.d or not math.isclose(t.a, -t.e):
            raise FormatError(f"{path}: not a raster of one band with square cells, north up")

        def read(col: int, row: int, width: int, height: int) -> F64:
            cells = file.read(1, window=Window(col, row, width, height))
            values = np.asarray(cells, np.float64)
            if file.nodata is not None:
                values[cells == cells.dtype.type(file.nodata)] = np.nan
            return values

        yield file, read


def _places(file: Any, x: F64, y: F64) -> tuple[F64, F64]:
    t = file.transform
    return (x - t.c) / t.a, (y - t.f) / t.e


def read_profile(path: Path) -> dict[str, Any]:
    """
    Return what the file says without reading its cells, for ``volatool info``.

    Parameters
    ----------
    path : pathlib.Path
        A raster that GDAL opens.

    Returns
    -------
    facts : dict
        ``width``, ``height``, ``cell``, ``bounds`` (left, bottom, right, top), ``dtype``,
        ``block`` (rows, columns of a tile of the file), ``nodata``, ``unit``, ``description``,
        ``crs_name``, ``crs_wkt2``, ``overviews``, ``layout``, ``statistics``, ``tags``.

    Raises
    ------
    InputNotFoundError, FormatError
        Not there; not a raster.
    """
    import rasterio

    if not path.exists():
        raise InputNotFoundError(f"{path}: no such file")
    with _gdal(path, is_output=False), rasterio.open(path) as file:
        wkt = file.crs.to_wkt(version="WKT2_2019") if file.crs else None
        return {
            "width": file.width,
            "height": file.height,
            "cell": file.transform.a,
            "bounds": list(file.bounds),
            "dtype": file.dtypes[0],
            "block": list(file.block_shapes[0]),
            "nodata": file.nodata,
            "unit": file.units[0],
            "description": file.descriptions[0],
            "crs_name": wkt.split('"')[1] if wkt else None,
            "crs_wkt2": wkt,
            "overviews": file.overviews(1),
            "layout": file.tags(ns="IMAGE_STRUCTURE").get("LAYOUT"),
            "statistics": _statistics(file.tags(1)),
            "tags": file.tags(),
        }


def _statistics(tags: Mapping[str, str]) -> dict[str, float]:
    """Return the numbers of a band's statistics tags; tags that aren't numbers are left out."""
    found = {}
    for name, value in tags.items():
        if name.startswith("STATISTICS_"):
            with contextlib.suppress(ValueError):
                found[name] = float(value)
    return found


def check_dem(path: Path) -> list[Problem]:
    """
    Return what is wrong with a DEM file; nothing if it is sound.

    Parameters
    ----------
    path : pathlib.Path
        The file.

    Returns
    -------
    problems : list of (code, message, offset)
        ``E_CORRUPT``: unreadable. ``E_NOT_COG``: no tiles or overviews missing. ``E_STATISTICS``:
        the tags don't agree with the cells.
    """
    import rasterio

    problems: list[Problem] = []
    try:
        with _gdal(path, is_output=False), rasterio.open(path) as file:
            if file.count != 1:
                problems.append(("E_CORRUPT", f"{file.count} bands instead of one", None))
            if file.tags(ns="IMAGE_STRUCTURE").get("LAYOUT") != "COG":
                problems.append(("E_NOT_COG", "the layout is not that of a COG", None))
            if max(file.shape) > BLOCK and not file.overviews(1):
                problems.append(("E_NOT_COG", "overviews are missing", None))
            tags = file.tags(1)
            statistics = RasterStatistics()
            for rows in _rows_of(file, path):
                statistics.add(rows, file.nodata)
            found = statistics.tags()
            for name in ("STATISTICS_MINIMUM", "STATISTICS_MAXIMUM"):
                if name in tags and tags[name] != found.get(name):
                    message = f"{name} is {tags[name]}, the cells say {found.get(name)}"
                    problems.append(("E_STATISTICS", message, None))
    except FormatError as error:
        problems.append(("E_CORRUPT", str(error), None))
    return problems


def _rows_of(file: Any, path: Path) -> Iterator[NDArray[Any]]:
    """Yield the first band of an opened raster, some rows at a time."""
    from rasterio.windows import Window

    if file.width * file.height > MAX_CELLS:
        raise FormatError(
            f"{path}: claims {file.width} x {file.height} cells, more than any model of "
            "volatool has"
        )
    rows = max(1, BLOCK * BLOCK // file.width)
    for start in range(0, file.height, rows):
        window = Window(0, start, file.width, min(rows, file.height - start))
        yield file.read(1, window=window)


@dataclass(frozen=True, slots=True)
class RasterFacts:
    """
    What the cells of a raster say.

    Parameters
    ----------
    width, height : int
        Cells.
    cell : float
        Edge of a cell, horizontal unit.
    nodata : float or None
        The value of void cells.
    n_void : int
        How many there are.
    low, high : float or None
        Range of the others; None if there are none.
    """

    width: int
    height: int
    cell: float
    nodata: float | None
    n_void: int
    low: float | None
    high: float | None


def raster_facts(path: Path) -> RasterFacts:
    """
    Return size and range of a raster, from all of its cells.

    Raises
    ------
    FormatError, InputNotFoundError
        It can't be read.
    """
    import rasterio

    with _gdal(path, is_output=False), rasterio.open(path) as file:
        statistics = RasterStatistics()
        for rows in _rows_of(file, path):
            statistics.add(rows, file.nodata)
        n_known = sum(statistics.counts)
        return RasterFacts(
            file.width,
            file.height,
            file.transform.a,
            file.nodata,
            file.width * file.height - n_known,
            statistics.low if n_known else None,
            statistics.high if n_known else None,
        )


def flag_counts(path: Path) -> list[int]:
    """
    Return how many cells of a flag layer are void, measured and filled.

    Raises
    ------
    FormatError, InputNotFoundError
        It can't be read, or is no flag layer.
    """
    import rasterio

    with _gdal(path, is_output=False), rasterio.open(path) as file:
        if file.dtypes[0] != "uint8":
            raise FormatError(f"{path}: a flag layer has bytes, this one has {file.dtypes[0]}")
        counts = np.zeros(256, np.int64)
        for rows in _rows_of(file, path):
            counts += np.bincount(rows.ravel(), minlength=256)
    if counts[3:].any():
        raise FormatError(f"{path}: flags are 0, 1 and 2, this layer has {counts.nonzero()[0][-1]}")
    return [int(n) for n in counts[:3]]
