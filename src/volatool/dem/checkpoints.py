"""Checkpoints as surveyors keep them: text with a column each for x, y, z, and maybe more."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from volatool.errors import FormatError
from volatool.model import F64

NAMES = {
    "x": ("x", "easting", "east", "e", "x_m", "x_ft"),
    "y": ("y", "northing", "north", "n", "y_m", "y_ft"),
    "z": ("z", "elevation", "elev", "height", "h", "z_m", "z_ft"),
    "id": ("id", "name", "point", "point_id", "pointid", "pt", "number", "no"),
    "cover": ("cover", "landcover", "land_cover", "type", "class", "nva_vva"),
}
"""Column heads, in lower case, that are understood."""

VEGETATED = ("vva", "vegetated", "vegetation", "veg", "forest", "grass", "shrub")
OPEN = ("nva", "non-vegetated", "nonvegetated", "bare", "open", "urban", "")


@dataclass(frozen=True, slots=True)
class Checkpoints:
    """
    Surveyed points.

    Parameters
    ----------
    x, y, z : (n,) arrays of float64
        Coordinates.
    ids : tuple of str
        Names; the line number where there is none.
    vegetated : (n,) array of bool
        Under vegetation: assessed apart (VVA).
    """

    x: F64
    y: F64
    z: F64
    ids: tuple[str, ...]
    vegetated: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]

    def __len__(self) -> int:
        return len(self.ids)


def parse(text: str, name: str) -> Checkpoints:
    r"""
    Return the checkpoints of a text.

    Fields are parted by commas, semicolons, tabs or blanks, whichever the first line has. With a
    line of heads, columns go by name (`NAMES`), else they are x, y, z or, of four, name, x, y, z.
    Empty lines and those that begin with ``#`` don't count.

    Parameters
    ----------
    text : str
        Content of the file.
    name : str
        Of the file, for messages.

    Raises
    ------
    FormatError
        ``E_CHECKPOINTS``: no points, a missing column, or a field that is not a number.

    Examples
    --------
    >>> parse("id,x,y,z\na,1,2,3.5\n", "points.csv").z
    array([3.5])
    """
    lines = [
        (number, line)
        for number, line in enumerate(text.removeprefix("\ufeff").splitlines(), 1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    if not lines:
        raise FormatError(f"{name}: no checkpoints in it", "E_CHECKPOINTS")
    separator = _separator(lines[0][1])
    rows = [(number, _fields(line, separator)) for number, line in lines]
    columns, body = _columns(rows, name)
    values: dict[str, list[float]] = {axis: [] for axis in "xyz"}
    ids, vegetated = [], []
    width = len(rows[0][1])
    for number, fields in body:
        if len(fields) != width:
            raise FormatError(
                f"{name}: line {number} has {len(fields)} fields, the first line has {width}; "
                "numbers need a decimal point, not a decimal comma",
                "E_CHECKPOINTS",
            )
        for axis in "xyz":
            values[axis].append(_number(fields[columns[axis]], f"{name}: line {number}, {axis}"))
        ids.append(fields[columns["id"]] if "id" in columns else str(number))
        vegetated.append(_is_vegetated(fields, columns, f"{name}: line {number}"))
    if not ids:
        raise FormatError(f"{name}: no checkpoints below the line of heads", "E_CHECKPOINTS")
    x, y, z = (np.array(values[axis]) for axis in "xyz")
    return Checkpoints(x, y, z, tuple(ids), np.array(vegetated, bool))


def _separator(line: str) -> str | None:
    """Return what parts the fields: one of ``; tab ,`` or None for blanks."""
    return next((mark for mark in (";", "\t", ",") if mark in line), None)


def _fields(line: str, separator: str | None) -> list[str]:
    if separator is None:
        return line.split()
    return [field.strip() for field in next(csv.reader([line], delimiter=separator))]


def _columns(
    rows: Sequence[tuple[int, list[str]]], name: str
) -> tuple[dict[str, int], Sequence[tuple[int, list[str]]]]:
    """Return the place of each column and the rows below the heads."""
    first = rows[0][1]
    if not any(_is_number(field) for field in first):
        heads = [field.lower() for field in first]
        found = {}
        for column, known in NAMES.items():
            place = next((heads.index(head) for head in known if head in heads), None)
            if place is not None:
                found[column] = place
        missing = [axis for axis in "xyz" if axis not in found]
        if missing:
            raise FormatError(
                f"{name}: no column {missing[0]}; the heads are {', '.join(first)}, known ones "
                f"for it are {', '.join(NAMES[missing[0]])}",
                "E_CHECKPOINTS",
            )
        return found, rows[1:]
    if len(first) < 3:
        raise FormatError(
            f"{name}: line {rows[0][0]} has {len(first)} fields; x, y, z are needed",
            "E_CHECKPOINTS",
        )
    if len(first) == 4:
        return {"id": 0, "x": 1, "y": 2, "z": 3}, rows
    return {"x": 0, "y": 1, "z": 2}, rows


def _is_number(field: str) -> bool:
    try:
        float(field.replace(",", "."))
    except ValueError:
        return False
    return True


def _number(field: str, where: str) -> float:
    try:
        value = float(field)
    except ValueError:
        hint = ""
        if "," in field and _is_number(field):
            hint = f"; write the decimal comma as a point: {field.replace(',', '.')}"
        raise FormatError(f"{where}: {field!r} is not a number{hint}", "E_CHECKPOINTS") from None
    if not math.isfinite(value):
        raise FormatError(f"{where}: {field!r} is not finite", "E_CHECKPOINTS")
    return value


def _is_vegetated(fields: list[str], columns: dict[str, int], where: str) -> bool:
    if "cover" not in columns:
        return False
    word = fields[columns["cover"]].lower()
    if word not in VEGETATED + OPEN:
        raise FormatError(
            f"{where}: cover {word!r} is not understood; write NVA or VVA", "E_CHECKPOINTS"
        )
    return word in VEGETATED
