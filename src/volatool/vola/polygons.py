"""Polygons that a census is taken in: from a vector file or as WKT; needs the extra ``vector``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from volatool.errors import CodedWarning, FormatError, InputError
from volatool.model import CrsInfo

_WKT_STARTS = ("POLYGON", "MULTIPOLYGON", "GEOMETRYCOLLECTION")
_LARGEST_WKT = 1 << 26


@dataclass(frozen=True, slots=True)
class Polygons:
    """
    Polygons in the CRS of a volume.

    Parameters
    ----------
    shapes : tuple of shapely Polygon or MultiPolygon
        In the order of the file.
    fields : tuple of dict
        What the file says of each, by lower-case name; numbers, text or None.
    warnings : tuple of CodedWarning
        ``W_VECTOR_CRS``.
    """

    shapes: tuple[Any, ...]
    fields: tuple[dict[str, Any], ...]
    warnings: tuple[CodedWarning, ...] = ()


def read_polygons(source: str, crs: CrsInfo) -> Polygons:
    """
    Read polygons.

    Parameters
    ----------
    source : str
        Path of a vector file (GeoJSON, GeoPackage, Shapefile, ...), or of a text file with one WKT
        polygon a line (what follows a ``#`` is passed over), or WKT itself. WKT says no CRS: it is
        taken to be in the volume's.
    crs : CrsInfo
        Of the volume; a layer in another one is reprojected.

    Raises
    ------
    InputError
        ``E_NOT_FOUND``; ``E_NOT_VECTOR``: no polygons, or a file that is none of these.
    OptionError
        ``E_NO_EXTRA``: pyogrio or shapely is not installed.
    CRSError
        ``E_CRS``: the layer can't be brought into the volume's CRS.
    """
    from volatool.dem import vectors

    try:
        import shapely
    except ImportError as error:
        raise vectors.no_extra("--polygon") from error

    text = _wkt(source)
    warnings: list[CodedWarning] = []
    if text is not None:
        lines = [line.split("#", 1)[0] for line in text.splitlines()]
        one = len(lines) == 1
        shapes = [
            _from_wkt(line, _short(source) if one else f"{_short(source)}: line {number}")
            for number, line in enumerate(lines, 1)
            if line.strip()
        ]
        fields: list[dict[str, Any]] = [{} for _ in shapes]
    else:
        found, columns = vectors.read_shapes(source, crs, warnings, option="--polygon")
        shapes = list(found)
        fields = [
            {name: _plain(values[k]) for name, values in columns.items()}
            for k in range(len(shapes))
        ]
    areas = [k for k, shape in enumerate(shapes) if shapely.get_dimensions(shape) == 2]
    if not areas:
        raise FormatError(f"{_short(source)}: has no polygons", "E_NOT_VECTOR")
    return Polygons(
        tuple(shapely.force_2d(shapes[k]) for k in areas),
        tuple(fields[k] for k in areas),
        tuple(warnings),
    )


def _wkt(source: str) -> str | None:
    """Return WKT that is given outright or is in a text file; None for other files."""
    if _is_wkt(source):
        return source
    path = Path(source)
    try:
        if not path.is_file() or path.stat().st_size > _LARGEST_WKT:
            return None
        with path.open("rb") as file:
            head = file.read(64).removeprefix(b"\xef\xbb\xbf").lstrip().upper()
        if not head.startswith(tuple(start.encode() for start in _WKT_STARTS)):
            return None
        return path.read_text(encoding="utf-8-sig")
    except (OSError, ValueError) as error:
        raise InputError(f"{_short(source)}: can't be read ({error})") from error


def _from_wkt(line: str, place: str) -> Any:
    import shapely

    try:
        shape = shapely.from_wkt(line)
    except shapely.errors.ShapelyError as error:
        raise FormatError(f"{place}: is not WKT ({error})", "E_NOT_VECTOR") from error
    if not all(map(_is_finite, shapely.get_coordinates(shape).ravel().tolist())):
        raise FormatError(f"{place}: has coordinates that are not finite", "E_NOT_VECTOR")
    return shape if shapely.is_valid(shape) else shapely.make_valid(shape).buffer(0)


def _is_finite(value: float) -> bool:
    return abs(value) != float("inf") and value == value


def _is_wkt(source: str) -> bool:
    return source.lstrip().upper().startswith(_WKT_STARTS)


def _short(source: str) -> str:
    """Return the beginning of long WKT, and the whole of a file's name."""
    return f"{source[:57]}..." if _is_wkt(source) and len(source) > 60 else source


def _plain(value: Any) -> Any:
    """Return a field's value as JSON takes it."""
    item = value.item() if hasattr(value, "item") else value
    return item if item is None or isinstance(item, str | int | float | bool) else str(item)
