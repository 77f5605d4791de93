"""GDAL through rasterio: rasters opened for reading, quiet, small and single-threaded.

Only this module and `volatool.dem.geotiff`, which writes, import rasterio.
"""

from __future__ import annotations

import contextlib
import shutil
import tempfile
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from volatool.errors import FormatError, InputNotFoundError, OutputError
from volatool.remote.path import RemotePath
from volatool.scratch import no_space

BLOCK = 512
"""Edge of a tile of the file."""

CACHE_MB = 16
"""GDAL's block cache; its default is 5 % of the machine's memory."""

LEAST_FREE_BYTES = 1 << 20
"""With less room than this in a folder after a failed write, the folder was full."""


@contextlib.contextmanager
def gdal(path: Path, is_output: bool, temporary: Path | None = None) -> Iterator[None]:
    """
    Keep GDAL quiet, small and single-threaded; its errors become ours.

    Parameters
    ----------
    path : pathlib.Path
        What is read or written, for messages.
    is_output : bool
        Whether it is written.
    temporary : pathlib.Path, optional
        Folder for GDAL's temporary files; the system's by default.

    Raises
    ------
    OutputError, FormatError, ResourceError
        It can't be written; can't be read; the temporary folder is full.
    """
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


@contextlib.contextmanager
def opened(path: Path, driver: str | None = None) -> Iterator[Any]:
    """
    Open a raster for reading.

    Parameters
    ----------
    path : pathlib.Path
        The file.
    driver : str, optional
        GDAL's name of the only format that is taken.

    Yields
    ------
    file : rasterio.DatasetReader

    Raises
    ------
    InputNotFoundError, FormatError
        Not there; not a raster.
    """
    import rasterio

    if isinstance(path, RemotePath):
        from volatool.remote.ranges import open_url

        with (
            open_url(path) as stream,
            gdal(path, is_output=False),
            rasterio.open(stream, driver=driver) as file,
        ):
            yield file
        return
    if not path.exists():
        raise InputNotFoundError(f"{path}: no such file")
    with gdal(path, is_output=False), rasterio.open(path, driver=driver) as file:
        yield file


@contextlib.contextmanager
def quiet_about_place() -> Iterator[None]:
    """Keep rasterio from warning of a raster without a place, which is refused anyway."""
    from rasterio.errors import NotGeoreferencedWarning

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        yield


def wkt_of(file: Any) -> str | None:
    """Return the coordinate reference system of an opened raster."""
    return file.crs.to_wkt(version="WKT2_2019") if file.crs else None


def read_window(file: Any, col: int, row: int, width: int, height: int) -> NDArray[Any]:
    """Return cells of the first band of an opened raster, by column and row."""
    from rasterio.windows import Window

    cells: NDArray[Any] = file.read(1, window=Window(col, row, width, height))
    return cells


def read_rows(file: Any, n_cells: int) -> Iterator[tuple[int, NDArray[Any]]]:
    """Yield the number of the first row and some whole rows, at most about `n_cells` a time."""
    rows = max(1, n_cells // file.width)
    for start in range(0, file.height, rows):
        yield start, read_window(file, 0, start, file.width, min(rows, file.height - start))
