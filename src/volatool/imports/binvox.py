"""binvox grids for import: the cells that are set, in the cube of the header."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from volatool.formats.binvox import MAX_CELLS, parse_binvox
from volatool.imports.grid import BYTES_A_CELL, cell_points
from volatool.imports.model import ImportedPoints
from volatool.model import I32, as_fraction
from volatool.options import ConvertOptions


def read(path: Path, options: ConvertOptions) -> ImportedPoints:
    """
    Open a grid.

    Parameters
    ----------
    path : pathlib.Path
        The file; its runs are held, and its cells while they are listed.
    options : ConvertOptions
        ``memory``.

    Raises
    ------
    FormatError, TruncatedError, ResourceError
        As for `volatool.formats.binvox.parse_binvox`; more cells than ``memory`` allows.
    """
    grid = parse_binvox(path.read_bytes())
    limit = min(MAX_CELLS, options.memory // BYTES_A_CELL)

    def cells() -> Iterator[I32]:
        yield grid.cells(limit)

    return cell_points(
        "binvox",
        cells,
        grid.shape,
        [as_fraction(value) for value in grid.translate],
        as_fraction(grid.scale) / max(grid.shape),
    )
