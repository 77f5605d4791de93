"""A spatial index of point files by their headers, and the file by which tiles share it."""

from __future__ import annotations

import json
import math
from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from fractions import Fraction
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from volatool.batch.identity import identify
from volatool.errors import FormatError, InputNotFoundError, OptionError, VolatoolError
from volatool.model import F64, CrsInfo
from volatool.options import ConvertOptions
from volatool.points.header import LasHeader
from volatool.remote.path import RemotePath, path_of
from volatool.report import dumps

SCHEMA = "volatool.set/1"

_OPENING = ("crs", "crs_default", "to_crs", "salvage", "strict")
_FRACTIONS = ("metres_per_unit_xy", "metres_per_unit_z")


@dataclass(frozen=True, slots=True)
class HeaderIndex:
    """
    Boxes and CRS of many files, searched by place.

    Parameters
    ----------
    paths : sequence of pathlib.Path
        Files that hold points.
    boxes : (n, 6) array of float64
        Least x, y, z, then greatest, as the headers say; NaN for a header without a usable box.
    crs : sequence of CrsInfo
        Those that occur, each once.
    crs_of : (n,) sequence of int
        Number of each file's CRS.
    n_points : (n,) sequence of int
        Points as the headers say.
    failed : mapping of pathlib.Path to VolatoolError
        Files whose headers can't be read.
    """

    paths: Sequence[Path]
    boxes: F64
    crs: Sequence[CrsInfo]
    crs_of: Sequence[int]
    n_points: Sequence[int]
    failed: Mapping[Path, VolatoolError] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.paths)

    def near(self, left: float, bottom: float, right: float, top: float) -> list[int]:
        """
        Return the numbers of files whose boxes meet a closed rectangle, in order.

        A file without a usable box meets every rectangle.
        """
        with np.errstate(invalid="ignore"):
            apart = (self.boxes[:, 0] > right) | (self.boxes[:, 3] < left)
            apart |= (self.boxes[:, 1] > top) | (self.boxes[:, 4] < bottom)
        return [int(number) for number in np.flatnonzero(~apart)]

    def crs_at(self, number: int) -> CrsInfo:
        """Return the CRS of a file."""
        return self.crs[self.crs_of[number]]


def opening_options(options: ConvertOptions) -> ConvertOptions:
    """Return the options that bear on how a file is opened, and no others."""
    return ConvertOptions(**{name: getattr(options, name) for name in _OPENING})


def index_headers(paths: Iterable[Path], options: ConvertOptions) -> HeaderIndex:
    """
    Read the headers of files, each once.

    Parameters
    ----------
    paths : iterable of pathlib.Path
        LAS, LAZ or COPC.
    options : ConvertOptions
        CRS and reading options; with ``to_crs`` each file is read once for its box.

    Returns
    -------
    index : HeaderIndex
        Of the files that have points, in the order given.
    """
    kept: list[Path] = []
    boxes = array("d")  # the files may be very many
    numbers: dict[CrsInfo, int] = {}
    crs_of, n_points = array("q"), array("q")
    failed: dict[Path, VolatoolError] = {}
    for path, header, crs, n in headers_of(paths, options, failed):
        box = header.box
        is_box = np.all(np.isfinite(box)) and all(box[k] <= box[3 + k] for k in range(3))
        kept.append(path)
        boxes.extend(box if is_box else (np.nan,) * 6)
        crs_of.append(numbers.setdefault(crs, len(numbers)))
        n_points.append(n)
    return HeaderIndex(kept, _rows_of(boxes), list(numbers), crs_of, n_points, failed)


def _rows_of(boxes: array[float]) -> F64:
    return np.frombuffer(boxes, np.float64).reshape(-1, 6)


def headers_of(
    paths: Iterable[Path], options: ConvertOptions, failed: dict[Path, VolatoolError]
) -> Iterator[tuple[Path, LasHeader, CrsInfo, int]]:
    """
    Yield header, CRS and number of points of each file that has any.

    Parameters
    ----------
    paths, options
        As for `index_headers`.
    failed : dict of pathlib.Path to VolatoolError
        Gets the files that can't be opened.
    """
    from volatool.opening import open_source

    plain = opening_options(options)
    for path in paths:
        try:
            with open_source(path, plain) as source:
                found = (path, source.header, source.crs, source.n_points)
        except VolatoolError as error:
            failed[path] = error
            continue
        if found[3]:
            yield found


def shared_name(path: Path) -> str:
    """
    Return the name of a file in what the workers of a set share: absolute.

    Raises
    ------
    OptionError
        A URL with a user, password or signature, which must not be in a file.
    """
    if isinstance(path, RemotePath) and path_of(str(path)) != path:
        raise OptionError(
            f"{path}: user, password and query of a URL can't be kept for the other tiles; have "
            "them found elsewhere (~/.netrc, the environment), see docs/how-to/cloud.md"
        )
    return str(path.resolve())


def set_lines(index: HeaderIndex, cell: float, spacing: float) -> Iterator[bytes]:
    """
    Yield the file that the tiles of a mosaic share: headers, and what all models have in common.

    Parameters
    ----------
    index : HeaderIndex
        Of all tiles; paths are made absolute.
    cell, spacing : float
        Of the models, in the horizontal unit.

    Yields
    ------
    line : bytes
        JSON: first an object, which `dem.parameters.read_parameters` takes, too; then for each tile
        its path, box (or null), number of its CRS, points, and identity: when a file changes, so
        does the set.

    Raises
    ------
    OptionError
        As `shared_name`.
    """
    unit = index.crs_at(0).unit_xy if len(index) else None
    document = {
        "schema": SCHEMA,
        "dem": {"cell": cell, "spacing": spacing},
        "input": {"crs": {"unit_xy": unit}},
        "crs": [crs_document(crs) for crs in index.crs],
        "tiles": len(index),
    }
    yield (dumps(document) + "\n").encode()
    for number, path in enumerate(index.paths):
        box = None if math.isnan(index.boxes[number, 0]) else index.boxes[number].tolist()
        points = index.n_points[number]
        row = [shared_name(path), box, index.crs_of[number], points, identify(path)]
        yield (json.dumps(row, sort_keys=True) + "\n").encode()


def read_set(path: Path) -> HeaderIndex:
    """
    Return the index that `set_document` wrote; kept for the next tile of this process.

    Raises
    ------
    InputNotFoundError, FormatError
        Not there; ``E_NOT_REPORT``: not such a file.
    """
    try:
        state = path.stat()
    except OSError as error:
        raise InputNotFoundError(f"{path}: can't be read ({error.strerror})") from error
    return _read_set(path, (state.st_mtime_ns, state.st_size))


@lru_cache(maxsize=2)
def _read_set(path: Path, stamp: tuple[int, int]) -> HeaderIndex:
    del stamp  # a file that has changed is another one
    names: list[str] = []
    boxes, crs_of, n_points = array("d"), array("q"), array("q")
    try:
        with path.open("rb") as lines:
            document = json.loads(next(lines, b""))
            if document["schema"] != SCHEMA:
                raise ValueError(f"schema {document['schema']!r}")
            crs = [crs_from_document(one) for one in document["crs"]]
            for line in lines:
                name, box, number, n, _ = json.loads(line)
                names.append(name)
                x0, y0, z0, x1, y1, z1 = (math.nan,) * 6 if box is None else box
                boxes.extend((x0, y0, z0, x1, y1, z1))
                crs_of.append(number)
                n_points.append(n)
        if len(names) != document["tiles"]:
            raise ValueError(f"{len(names)} tiles, told {document['tiles']}")
        return HeaderIndex(_Paths(names), _rows_of(boxes), crs, crs_of, n_points)
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise FormatError(f"{path}: not a set of tiles ({error})", "E_NOT_REPORT") from error


class _Paths(Sequence[Path]):
    """Names that become paths when they are asked for: of very many few are."""

    def __init__(self, names: Sequence[str]) -> None:
        self._names = names

    def __len__(self) -> int:
        return len(self._names)

    def __getitem__(self, number: Any) -> Any:
        if isinstance(number, slice):
            return _Paths(self._names[number])
        return path_of(self._names[number])


def crs_document(crs: CrsInfo) -> dict[str, Any]:
    """Return all of a CRS as a JSON object."""
    document = asdict(crs)
    for name in _FRACTIONS:
        if document[name] is not None:
            document[name] = str(document[name])
    return document


def crs_from_document(document: Mapping[str, Any]) -> CrsInfo:
    """Return the CRS that `crs_document` made an object of."""
    values = {one.name: document[one.name] for one in fields(CrsInfo)}
    for name in _FRACTIONS:
        if values[name] is not None:
            values[name] = Fraction(values[name])
    return CrsInfo(**values)
