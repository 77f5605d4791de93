"""ESRI ASCII grids for import: the middle of each cell at its height; else columns of numbers.

The header is ncols, nrows, xllcorner or xllcenter, yllcorner or yllcenter, cellsize (or dx and dy)
and, if any, NODATA_value; rows come from north to south. A file ``.prj`` beside it names the CRS.
Only the top surface is filled: a height says nothing of what is below.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from volatool.errors import CodedWarning, CRSError, FormatError, TruncatedError
from volatool.imports import text
from volatool.imports.model import Batch, ImportedPoints
from volatool.model import CrsInfo
from volatool.options import ConvertOptions

_KEYS = frozenset(
    ("ncols", "nrows", "xllcorner", "xllcenter", "yllcorner", "yllcenter", "cellsize", "dx", "dy")
) | {"nodata_value"}
_HEAD_BYTES = 1 << 12
_NODATA = -9999.0


def read(path: Path, options: ConvertOptions) -> ImportedPoints:
    """
    Open a grid.

    Parameters
    ----------
    path : pathlib.Path
        The file; read in blocks of lines.
    options : ConvertOptions
        ``columns``, if it is no grid.

    Raises
    ------
    FormatError, TruncatedError
        A header that makes no sense; values that are missing, too many, or no numbers.
    """
    with path.open("rb") as file:
        head = file.read(_HEAD_BYTES)
    words = head.split(None, 1)
    if not words or words[0].lower().decode("latin-1") not in _KEYS:
        return text.read(path, options)
    header, start, line = _header(head)
    shape = int(header["nrows"]), int(header["ncols"])
    size = path.stat().st_size
    if shape[0] * shape[1] > (size - start) // 2 + 1:  # a digit and a separator each
        raise TruncatedError(
            f"claims {shape[0]} x {shape[1]} cells, more than its {size} bytes can hold"
        )
    warnings: list[CodedWarning] = []

    def batches(n_rows: int) -> Iterator[Batch]:
        return _batches(path, header, shape, start, line, n_rows, warnings)

    return ImportedPoints("asc", batches, crs=_prj(path), warnings=warnings)


def _header(head: bytes) -> tuple[dict[str, float], int, int]:
    """Return the entries, the first byte and the first line of the values."""
    header: dict[str, float] = {}
    at, number = 0, 1
    for line in head.splitlines(keepends=True):
        words = line.decode("latin-1").split()
        if words and words[0].lower() in _KEYS:
            try:
                header[words[0].lower()] = float(words[1])
            except (IndexError, ValueError) as error:
                raise FormatError(f"line {number}: {line[:60]!r} has no number") from error
        elif words:
            break
        at, number = at + len(line), number + 1
    header.setdefault("dx", header.get("cellsize", np.nan))
    header.setdefault("dy", header.get("cellsize", np.nan))
    for axis in "xy":
        if f"{axis}llcenter" not in header:
            header[f"{axis}llcenter"] = (
                header.get(f"{axis}llcorner", np.nan) + header[f"d{axis}"] / 2
            )
    needed = ("ncols", "nrows", "xllcenter", "yllcenter", "dx", "dy")
    if not all(np.isfinite(header.get(key, np.nan)) for key in needed):
        raise FormatError("its header lacks ncols, nrows, a corner or cellsize")
    if not all(header[key] > 0 for key in ("ncols", "nrows", "dx", "dy")) or not all(
        header[key] == int(header[key]) for key in ("ncols", "nrows")
    ):
        raise FormatError("its header has ncols, nrows or a cell size that is no positive number")
    return header, at, number


def _batches(
    path: Path,
    header: dict[str, float],
    shape: tuple[int, int],
    start: int,
    line: int,
    n_rows: int,
    warnings: list[CodedWarning],
) -> Iterator[Batch]:
    n_total, n_read, n_void = shape[0] * shape[1], 0, 0
    nodata = header.get("nodata_value", _NODATA)
    for block in text.blocks(path, start, line):
        values = _numbers(block)
        if n_read + len(values) > n_total:
            raise FormatError(
                f"has more values than {shape[0]} rows of {shape[1]} (from line {block.first_line})"
            )
        place = np.arange(n_read, n_read + len(values))
        n_read += len(values)
        there = (values != nodata) & (values == values)
        n_void += len(values) - int(np.count_nonzero(there))
        row, column = np.divmod(place[there], shape[1])
        xyz = np.column_stack(
            [
                header["xllcenter"] + column * header["dx"],
                header["yllcenter"] + (shape[0] - 1 - row) * header["dy"],
                values[there],
            ]
        )
        for at in range(0, len(xyz), n_rows):
            yield Batch(int(place[0]) + at, xyz[at : at + n_rows])
    if n_read < n_total:
        raise TruncatedError(f"ends at value {n_read} of {n_total}")
    note_void(warnings, n_void)


def note_void(warnings: list[CodedWarning], n_void: int) -> None:
    """Say once how many cells of a raster have no height."""
    if n_void and not any(warning.code == "W_NODATA" for warning in warnings):
        text = f"{n_void} cells without a height (nodata) were left out"
        warnings.append(CodedWarning("W_NODATA", text, n_void))


def _numbers(block: text.Block) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    try:
        return np.array(block.data.split(), np.float64)
    except ValueError:
        for number, line in enumerate(block.data.split(b"\n"), block.first_line):
            try:
                np.array(line.split(), np.float64)
            except ValueError as error:
                raise FormatError(f"line {number}: {error}") from error
        raise


def _prj(path: Path) -> CrsInfo | None:
    """Return the CRS of the file beside; None if there is none, or none that is known."""
    from volatool.points.crs import crs_from_user

    beside = path.with_suffix(".prj")
    try:
        return crs_from_user(beside.read_text("utf-8")[: 1 << 16], "wkt")
    except (OSError, UnicodeDecodeError, CRSError):
        return None
