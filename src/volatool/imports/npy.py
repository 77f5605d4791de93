"""NumPy arrays for import: (n, 3+) rows of points, records with fields x, y, z, or a 3-D grid.

The array is mapped, never held. A 3-D array is an occupancy grid with axes x, y, z: cells that are
not 0 (nor NaN) are occupied, each with an edge of 1 from the corner 0, 0, 0; or, of as many cells a
side as the volume of ``--cube-from`` has, the cells of that cube.
"""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from volatool.errors import CodedWarning, FormatError, TruncatedError
from volatool.imports.columns import columns_of
from volatool.imports.grid import cell_points, voxel_points
from volatool.imports.model import Batch, ImportedPoints, plain_toolkit
from volatool.model import I32
from volatool.options import ConvertOptions
from volatool.points.frames import MAX_COLUMNS, Reader, npy_header
from volatool.reference import reference

TOOLKIT_SIDE = 256
"""The toolkit takes grids of this side only, and gives them the box 0 .. 255."""

_SLAB_CELLS = 1 << 22


def read(path: Path, options: ConvertOptions) -> ImportedPoints:
    """
    Open an array.

    Parameters
    ----------
    path : pathlib.Path
        The file.
    options : ConvertOptions
        ``columns``.

    Raises
    ------
    FormatError, TruncatedError
        No array of one of these kinds; it is not all there.
    """
    return points_of(mapped_array(path), "npy", options)


def mapped_array(path: Path) -> NDArray[Any]:
    """
    Map the array of a file.

    Parameters
    ----------
    path : pathlib.Path
        Written by ``numpy.save``.

    Raises
    ------
    FormatError, TruncatedError
        No such file; an array of Python objects; the file ends early.
    """
    with path.open("rb") as file:
        if file.read(6) != b"\x93NUMPY":
            raise FormatError("is no NumPy array", "E_NOT_IMPORT")
        file.seek(0)
        shape, is_fortran, dtype = npy_header(Reader(file, b"", 0, path.name), "byte 0")
        start = file.tell()
    if dtype.hasobject:
        raise FormatError("holds Python objects, which may be programs; they are not read")
    n_bytes = int(np.prod(shape, dtype=object)) * dtype.itemsize
    size = path.stat().st_size
    if start + n_bytes > size:
        raise TruncatedError(f"ends at byte {size}; its array {shape} goes on to {start + n_bytes}")
    if not n_bytes:
        return np.zeros(shape, dtype)
    return np.memmap(path, dtype, "r", start, shape, order="F" if is_fortran else "C")


def points_of(array: NDArray[Any], name: str, options: ConvertOptions) -> ImportedPoints:
    """
    Return an array's points, whichever kind it is.

    Parameters
    ----------
    array : array
        Points or grid.
    name : str
        Of the format.
    options : ConvertOptions
        ``columns``.
    """
    if array.dtype.names is not None and array.ndim == 1:
        return _records(array, name, options)
    if array.ndim == 2 and 3 <= array.shape[1] <= MAX_COLUMNS and array.dtype.kind in "fiu":
        return _rows(array, name, options)
    if array.ndim == 3 and array.dtype.kind in "fiub":
        return _grid(array, name, options)
    raise FormatError(
        f"an array {array.shape} of {array.dtype} is neither rows of x, y, z nor a 3-D grid",
        "E_NOT_IMPORT",
    )


def _rows(array: NDArray[Any], name: str, options: ConvertOptions) -> ImportedPoints:
    warnings: list[CodedWarning] = []
    columns = columns_of(options.columns, None, array.shape[1], warnings)

    def batches(n_rows: int) -> Iterator[Batch]:
        for at in range(0, len(array), n_rows):
            part = array[at : at + n_rows]
            with np.errstate(invalid="ignore"):  # signalling NaNs
                xyz = part[:, list(columns.axes)].astype(np.float64)
            yield Batch(at, xyz, {k: np.array(part[:, c]) for k, c in columns.attributes.items()})

    return ImportedPoints(
        name, batches, frozenset(columns.attributes), keeps_nan=True, warnings=warnings
    )


def _records(array: NDArray[Any], name: str, options: ConvertOptions) -> ImportedPoints:
    names = [
        field
        for field in array.dtype.names or ()
        if array.dtype[field].kind in "fiub" and not array.dtype[field].shape
    ]
    columns = columns_of(options.columns, names, len(names), [])

    def batches(n_rows: int) -> Iterator[Batch]:
        for at in range(0, len(array), n_rows):
            part = array[at : at + n_rows]
            with np.errstate(invalid="ignore"):
                xyz = np.column_stack([part[names[c]].astype(np.float64) for c in columns.axes])
            found = {role: np.array(part[names[c]]) for role, c in columns.attributes.items()}
            yield Batch(at, xyz, found)

    return ImportedPoints(name, batches, frozenset(columns.attributes), keeps_nan=True)


def _grid(array: NDArray[Any], name: str, options: ConvertOptions) -> ImportedPoints:
    def slabs(is_one: bool) -> Iterator[I32]:
        thick = max(1, _SLAB_CELLS // max(1, array.shape[1] * array.shape[2]))
        for x in range(0, array.shape[0], thick):
            slab = np.asarray(array[x : x + thick])
            filled = slab == 1 if is_one else (slab != 0) & (slab == slab)
            cells = np.argwhere(filled)
            cells[:, 0] += x
            yield cells.astype(np.int32)

    def toolkit_batches(n_rows: int) -> Iterator[Batch]:
        for cells in slabs(True):
            yield Batch(0, cells.astype(np.float64))

    if options.cube_from is not None:
        found = reference(options.cube_from)
        if array.shape == (4**found.depth,) * 3:
            return voxel_points(name, lambda: slabs(False), found.cube, found.depth, found.crs)
    zero = Fraction(0)
    shape = [max(1, n) for n in array.shape]
    points = cell_points(name, lambda: slabs(False), shape, (zero, zero, zero), Fraction(1))
    if name == "npy" and array.shape == (TOOLKIT_SIDE,) * 3:
        last = TOOLKIT_SIDE - 1.0
        points.toolkit = plain_toolkit(toolkit_batches, (0.0, 0.0, 0.0, last, last, last))
    return points
