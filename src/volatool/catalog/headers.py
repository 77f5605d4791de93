"""A spatial index of point files by their headers, and the file by which tiles share it."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from fractions import Fraction
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from volatool.errors import FormatError, InputNotFoundError, VolatoolError
from volatool.model import F64, CrsInfo
from volatool.options import ConvertOptions
from volatool.points.header import LasHeader
from volatool.report import dumps

SET_SUFFIX = ".set.json"
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
    boxes: list[tuple[float, ...]] = []
    numbers: dict[CrsInfo, int] = {}
    crs_of: list[int] = []
    n_points: list[int] = []
    failed: dict[Path, VolatoolError] = {}
    for path, header, crs, n in headers_of(paths, options, failed):
        box = header.box
        is_box = np.all(np.isfinite(box)) and all(box[k] <= box[3 + k] for k in range(3))
        kept.append(path)
        boxes.append(box if is_box else (np.nan,) * 6)
        crs_of.append(numbers.setdefault(crs, len(numbers)))
        n_points.append(n)
    array = np.array(boxes, np.float64).reshape(-1, 6)
    return HeaderIndex(kept, array, list(numbers), crs_of, n_points, failed)


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
    from volatool.tile import open_source

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


def set_document(index: HeaderIndex, cell: float, spacing: float) -> bytes:
    """
    Return the file that the tiles of a mosaic share: headers, and what all models have in common.

    Parameters
    ----------
    index : HeaderIndex
        Of all tiles; paths are made absolute.
    cell, spacing : float
        Of the models, in the horizontal unit.

    Returns
    -------
    document : bytes
        JSON; `dem.parameters.read_parameters` takes it, too.
    """
    unit = index.crs_at(0).unit_xy if len(index) else None
    document = {
        "schema": SCHEMA,
        "dem": {"cell": cell, "spacing": spacing},
        "input": {"crs": {"unit_xy": unit}},
        "crs": [crs_document(crs) for crs in index.crs],
        "tiles": {
            "paths": [str(path.resolve()) for path in index.paths],
            "boxes": index.boxes.tolist(),
            "crs": list(index.crs_of),
            "points": list(index.n_points),
        },
    }
    return (dumps(document) + "\n").encode()


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
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        if document["schema"] != SCHEMA:
            raise ValueError(f"schema {document['schema']!r}")
        tiles = document["tiles"]
        boxes = np.array(tiles["boxes"], np.float64).reshape(-1, 6)  # None becomes NaN
        paths = [Path(name) for name in tiles["paths"]]
        if not len(paths) == len(boxes) == len(tiles["crs"]) == len(tiles["points"]):
            raise ValueError("columns of different lengths")
        return HeaderIndex(
            paths,
            boxes,
            [crs_from_document(one) for one in document["crs"]],
            [int(number) for number in tiles["crs"]],
            [int(number) for number in tiles["points"]],
        )
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise FormatError(f"{path}: not a set of tiles ({error})", "E_NOT_REPORT") from error


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
