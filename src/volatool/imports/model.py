"""What every reader of a foreign format returns: batches of coordinates and numbers as stored."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from volatool.cube import Cube
from volatool.errors import CodedWarning
from volatool.model import F64, U64, CrsInfo

ATTRIBUTES: Mapping[str, tuple[int, Any]] = {
    "red": (65535, np.uint16),
    "green": (65535, np.uint16),
    "blue": (65535, np.uint16),
    "intensity": (65535, np.uint16),
    "classification": (255, np.uint8),
    "return_number": (15, np.uint8),
    "number_of_returns": (15, np.uint8),
}
"""Attributes of a `PointChunk` that other formats have: largest value and type."""

_ALIASES = {
    "x": "x easting east lon longitude coordx",
    "y": "y northing north lat latitude coordy",
    "z": "z elevation height altitude elev alt coordz",
    "red": "red r diffusered",
    "green": "green g diffusegreen",
    "blue": "blue b diffuseblue",
    "intensity": "intensity i reflectance reflectivity intensities remission scalarintensity",
    "classification": "classification class c label classcode scalarclassification scalarlabel",
    "return_number": "returnnumber returnno scalarreturnnumber",
    "number_of_returns": "numberofreturns returns numreturns nreturns scalarnumberofreturns",
}
_ROLES = {alias: name for name, aliases in _ALIASES.items() for alias in aliases.split()}


def role_of(name: str) -> str | None:
    """
    Return the axis or attribute that a column, property or field is called by; None if unknown.

    Examples
    --------
    >>> role_of("Number Of Returns"), role_of("scalar_Intensity"), role_of("gps_time")
    ('number_of_returns', 'intensity', None)
    """
    return _ROLES.get("".join(c for c in name.lower() if c.isalnum()))


def point_name(row: int) -> str:
    """Return how a row is called in messages where the file has no lines."""
    return f"point {row}"


@dataclass(frozen=True, slots=True)
class Batch:
    """
    Consecutive points of a file.

    Parameters
    ----------
    start : int
        Number of the first one, from 0.
    xyz : (n, 3) array of float64
        Coordinates as the file has them.
    attributes : mapping of str to (n,) array of numbers
        By the names of `ATTRIBUTES`, unscaled, of any numeric type.
    where : callable
        Says where in the file a row of this batch stands, given its number in the file.
    """

    start: int
    xyz: F64
    attributes: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    where: Callable[[int], str] = point_name


@dataclass(frozen=True, slots=True)
class ToolkitPoints:
    """
    What the original toolkit takes from a file.

    Parameters
    ----------
    n_channels : int
        Bytes of metadata a point; 0: none, whatever is asked for.
    batches : callable
        Given whether metadata is wanted, yields (n, 3) coordinates and (n,) uint64 words or None.
    box : tuple of 6 float or None
        Where it has a rule of its own; else that of the points.
    """

    n_channels: int
    batches: Callable[[bool], Iterator[tuple[F64, U64 | None]]]
    box: tuple[float, float, float, float, float, float] | None = None


@dataclass(slots=True)
class ImportedPoints:
    """
    A file that can be read, as often as wanted.

    Parameters
    ----------
    format : str
        Name in the registry.
    batches : callable
        Given the most points a batch may have, yields batches in file order.
    attributes : frozenset of str
        Names that each batch has.
    grid : (Cube, int) or None
        Cube and depth whose voxels the points are the centres of, z in the horizontal unit.
    crs : CrsInfo or None
        What the file names.
    keeps_nan : bool
        A row of NaN is a point that is not there; it is left out and counted. Else it is an error.
    is_cubic : bool
        The file's unit of z is that of x and y (cells are cubes), whatever the CRS says.
    is_final : bool
        The grid is that of the options, and the points' axes are those of the volume.
    warnings : list of CodedWarning
        Grows while reading.
    toolkit : ToolkitPoints or None
        None: the original toolkit does not read this format, or not so that it can be repeated.
    """

    format: str
    batches: Callable[[int], Iterator[Batch]]
    attributes: frozenset[str] = frozenset()
    grid: tuple[Cube, int] | None = None
    crs: CrsInfo | None = None
    keeps_nan: bool = False
    is_cubic: bool = False
    is_final: bool = False
    warnings: list[CodedWarning] = field(default_factory=list)
    toolkit: ToolkitPoints | None = None


def sliced(
    xyz: F64, attributes: Mapping[str, NDArray[Any]], n_rows: int, start: int = 0
) -> Iterator[Batch]:
    """
    Yield arrays in batches.

    Parameters
    ----------
    xyz : (n, 3) array of numbers
        Converted to float64 batch by batch.
    attributes : mapping of str to (n,) array
        Beside them.
    n_rows : int
        Most rows of a batch.
    start : int
        Number of the first row.
    """
    for at in range(0, len(xyz), n_rows):
        part = slice(at, at + n_rows)
        with np.errstate(invalid="ignore"):  # signalling NaNs
            rows = np.asarray(xyz[part], np.float64)
        yield Batch(start + at, rows, {name: v[part] for name, v in attributes.items()})


def mapped(path: Path, dtype: np.dtype[Any], offset: int, n_rows: int) -> NDArray[Any]:
    """Return records of a file, mapped; the caller has checked that they are there."""
    if not n_rows:
        return np.empty(0, dtype)
    return np.memmap(path, dtype, "r", offset, (n_rows,))


def plain_toolkit(
    batches: Callable[[int], Iterator[Batch]],
    box: tuple[float, float, float, float, float, float] | None = None,
) -> ToolkitPoints:
    """Return what the toolkit takes of formats from which it takes no metadata."""

    def bare(with_metadata: bool) -> Iterator[tuple[F64, U64 | None]]:
        for batch in batches(1 << 18):
            missing = np.isnan(batch.xyz).any(axis=1)  # as its reader of PCD leaves them out
            yield batch.xyz[~missing] if missing.any() else batch.xyz, None

    return ToolkitPoints(0, bare, box)
