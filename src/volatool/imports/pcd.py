"""PCD files for import: x, y, z, intensity, colour (``rgb``, ``rgba`` or r, g, b) and label.

Binary data are mapped; ascii data are read in blocks of lines; compressed data are unpacked whole.
Organized clouds mark directions without a return by NaN: those rows are left out and counted.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from volatool.errors import FormatError, TruncatedError
from volatool.imports.columns import Columns
from volatool.imports.model import Batch, ImportedPoints, mapped, plain_toolkit, role_of
from volatool.imports.text import Layout, table_batches
from volatool.options import ConvertOptions
from volatool.points import pcd

_PACKED = ("rgb", "rgba")
_COLOURS = ("red", "green", "blue")
_MAX_POINTS = 1 << 40


def read(path: Path, options: ConvertOptions) -> ImportedPoints:
    """
    Open a PCD file.

    Parameters
    ----------
    path : pathlib.Path
        The file.
    options : ConvertOptions
        Not looked at.

    Raises
    ------
    FormatError, TruncatedError
        Not such a file; it ends early.
    """
    with path.open("rb") as file:
        head = file.read(pcd.MAX_HEADER_BYTES + 1)
    header = pcd.read_header(head, _MAX_POINTS)
    size = path.stat().st_size
    roles, packed = _roles(header)
    names = frozenset(roles) | (frozenset(_COLOURS) if packed is not None else frozenset())

    if header.kind == "ascii":

        def batches(n_rows: int) -> Iterator[Batch]:
            return _ascii(path, header, roles, packed, n_rows)

        if packed is not None:
            _refuse_odd_rgb(header, packed)
    else:
        if header.kind == "binary":
            pcd.check_size(size, header)
            records = mapped(path, header.record, header.data_start, header.n_points)
            columns = {k: records[str(k)][:, 0] for k in range(len(header.fields))}
        else:
            wanted = [*header.xyz, *roles.values(), *([] if packed is None else [packed])]
            columns = pcd.unpack(path.read_bytes(), header, wanted)

        def batches(n_rows: int) -> Iterator[Batch]:
            return _binary(columns, header, roles, packed, n_rows)

    return ImportedPoints("pcd", batches, names, keeps_nan=True, toolkit=plain_toolkit(batches))


def _roles(header: pcd.PcdHeader) -> tuple[dict[str, int], int | None]:
    """Return the fields that are attributes, and the one that packs a colour."""
    roles: dict[str, int] = {}
    packed = None
    for k, name in enumerate(header.fields):
        count = header.starts[k + 1] - header.starts[k]
        role = role_of(name)
        if name.lower() in _PACKED and count == 1 and header.record[k].base.itemsize == 4:
            packed = k if packed is None else packed
        elif role not in (None, "x", "y", "z") and count == 1:
            roles.setdefault(str(role), k)
    if packed is not None or not set(_COLOURS) <= roles.keys():
        roles = {role: k for role, k in roles.items() if role not in _COLOURS}
    return roles, packed


def _colours(words: NDArray[np.uint32]) -> dict[str, NDArray[Any]]:
    """Return red, green and blue of packed words ``0x00RRGGBB``."""
    return {
        name: (words >> np.uint32(shift)).astype(np.uint8)
        for name, shift in zip(_COLOURS, (16, 8, 0), strict=True)
    }


def _binary(
    columns: dict[int, NDArray[Any]],
    header: pcd.PcdHeader,
    roles: dict[str, int],
    packed: int | None,
    n_rows: int,
) -> Iterator[Batch]:
    for at in range(0, header.n_points, n_rows):
        part = slice(at, at + n_rows)
        with np.errstate(invalid="ignore"):  # signalling NaNs
            xyz = np.column_stack([columns[k][part].astype(np.float64) for k in header.xyz])
        attributes = {role: np.ascontiguousarray(columns[k][part]) for role, k in roles.items()}
        if packed is not None:
            words = np.ascontiguousarray(columns[packed][part]).view("<u4")
            attributes |= _colours(words.astype(np.uint32))
        yield Batch(at, xyz, attributes)


def _refuse_odd_rgb(header: pcd.PcdHeader, packed: int) -> None:
    if header.record[packed].base.kind == "i":
        raise FormatError(f"field {header.fields[packed]} is of TYPE I; colours are F or U")


def _ascii(
    path: Path,
    header: pcd.PcdHeader,
    roles: dict[str, int],
    packed: int | None,
    n_rows: int,
) -> Iterator[Batch]:
    with path.open("rb") as file:
        first_line = file.read(header.data_start).count(b"\n") + 1
    places = {role: header.starts[k] for role, k in roles.items()}
    if packed is not None:
        places["rgb"] = header.starts[packed]
    x, y, z = (header.starts[k] for k in header.xyz)
    columns = Columns((x, y, z), places)
    layout = Layout(header.data_start, first_line, None, header.n_columns, None)
    n_read = 0
    is_float = packed is not None and header.record[packed].base.kind == "f"
    for batch in table_batches(path, layout, columns, n_rows, limit=header.n_points):
        n_read += len(batch.xyz)
        if packed is not None:
            attributes = dict(batch.attributes)
            numbers = attributes.pop("rgb")
            # PCL writes the bits of the colour as a float, or the whole number itself
            words = numbers.astype(np.float32).view(np.uint32) if is_float else numbers
            attributes |= _colours(words.astype(np.uint32))
            batch = Batch(batch.start, batch.xyz, attributes, batch.where)
        yield batch
    if n_read < header.n_points:
        raise TruncatedError(
            f"ends at point {n_read} of {header.n_points}, byte {path.stat().st_size}"
        )
