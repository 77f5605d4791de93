"""Break lines and water from vector files, in the CRS of a tile; needs the extra ``vector``."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from volatool.errors import CodedWarning, CRSError, FormatError, InputNotFoundError, OptionError
from volatool.model import CrsInfo

RIVERS = frozenset({"river", "stream", "canal", "ditch", "drain", "riverbank", "flowing"})
"""Values of a type field that make a water polygon a river: its surface is not level."""

TYPE_FIELDS = ("type", "kind", "fclass", "class", "water", "waterway", "natural")
LEVEL_FIELDS = ("level", "height", "elevation", "elev", "wse", "z")

Geometries = NDArray[Any]


@dataclass(frozen=True, slots=True)
class Lake:
    """
    A polygon whose surface is one level.

    Parameters
    ----------
    polygon : shapely.Polygon or MultiPolygon
        In the tile's CRS.
    level : float or None
        In the vertical unit, when the file says it.
    """

    polygon: Any
    level: float | None


@dataclass(frozen=True, slots=True)
class Barriers:
    """
    What no spring crosses.

    Parameters
    ----------
    lines : tuple of shapely geometries
        Break lines and banks of rivers, in the tile's CRS.
    lakes : tuple of Lake
        Water that is level.
    n_lines, n_rivers : int
        Features that are break lines; that are rivers.
    warnings : tuple of CodedWarning
        ``W_VECTOR_CRS``.
    """

    lines: tuple[Any, ...]
    lakes: tuple[Lake, ...] = ()
    n_lines: int = 0
    n_rivers: int = 0
    warnings: tuple[CodedWarning, ...] = ()


def read_barriers(breaklines: str | None, water: str | None, crs: CrsInfo) -> Barriers:
    """
    Read vector files.

    Parameters
    ----------
    breaklines : str or None
        Path of lines, and of polygons whose outlines count: no spring crosses them.
    water : str or None
        Path of polygons. A lake gets one level: the mean height of its 3-D outline, or a number in
        one of `LEVEL_FIELDS`, or else what the ground along its shore says. A polygon whose type
        field holds one of `RIVERS`, and a line, is only cut along, as break lines are.
    crs : CrsInfo
        Of the tile; a layer in another one is reprojected.

    Raises
    ------
    InputNotFoundError, FormatError
        ``E_NOT_FOUND``; ``E_NOT_VECTOR``: not a vector file, or one without lines and polygons.
    OptionError
        ``E_NO_EXTRA``: pyogrio or shapely is not installed.
    CRSError
        ``E_CRS``: the layer can't be brought into the tile's CRS.
    """
    try:
        import shapely
    except ImportError as error:
        raise no_extra() from error

    warnings: list[CodedWarning] = []
    lines: list[Any] = []
    lakes: list[Lake] = []
    n_lines = n_rivers = 0
    if breaklines is not None:
        shapes, _ = read_shapes(breaklines, crs, warnings)
        lines += [outline(shape) for shape in shapes]
        n_lines = len(shapes)
    if water is not None:
        shapes, fields = read_shapes(water, crs, warnings)
        for k, shape in enumerate(shapes):
            is_area = shapely.get_dimensions(shape) == 2
            is_river = not is_area or _is_river({name: fields[name][k] for name in fields})
            if is_river:
                lines.append(outline(shape))
                n_rivers += 1
                continue
            level = _level(shape, {name: fields[name][k] for name in fields})
            lakes.append(Lake(shapely.force_2d(shape), level))
    return Barriers(tuple(lines), tuple(lakes), n_lines, n_rivers, tuple(warnings))


def outline(shape: Any) -> Any:
    """Return the lines of a geometry: polygons' rings, lines themselves, in two dimensions."""
    import shapely

    flat = shapely.force_2d(shape)
    return shapely.boundary(flat) if shapely.get_dimensions(flat) == 2 else flat


def no_extra(option: str = "--breaklines and --water") -> OptionError:
    """Return the error for an option whose packages are not installed."""
    return OptionError(
        f"{option}: needs pyogrio and shapely: pip install 'volatool[vector]'", "E_NO_EXTRA"
    )


def read_shapes(
    name: str,
    crs: CrsInfo,
    warnings: list[CodedWarning],
    option: str = "--breaklines and --water",
) -> tuple[Geometries, dict[str, NDArray[Any]]]:
    """
    Read the lines and polygons of a file.

    Parameters
    ----------
    name : str
        Path of a vector file.
    crs : CrsInfo
        Of the tile; a layer in another one is reprojected.
    warnings : list of CodedWarning
        Gets ``W_VECTOR_CRS``.
    option : str
        What asks for them.

    Returns
    -------
    shapes : (n,) array of shapely geometries
        In the tile's CRS, polygons repaired.
    fields : dict of str to (n,) array
        By lower-case name.

    Raises
    ------
    VolatoolError
        See `read_barriers`.
    """
    try:
        import pyogrio
        import shapely
    except ImportError as error:
        raise no_extra(option) from error

    path = Path(name)
    if not path.exists():
        raise InputNotFoundError(f"{name}: no such file")
    try:
        meta, _, wkb, columns = pyogrio.raw.read(path, force_2d=False)
        shapes = shapely.from_wkb(wkb)
    except (pyogrio.errors.DataSourceError, pyogrio.errors.DataLayerError) as error:
        raise FormatError(
            f"{name}: not a vector file that GDAL reads ({error})", "E_NOT_VECTOR"
        ) from error
    except (shapely.errors.ShapelyError, ValueError, TypeError, RuntimeError) as error:
        raise FormatError(f"{name}: its shapes can't be read ({error})", "E_NOT_VECTOR") from error
    kept = np.array(
        [s is not None and not s.is_empty and shapely.get_dimensions(s) >= 1 for s in shapes], bool
    )
    if not kept.any():
        raise FormatError(f"{name}: has no lines or polygons", "E_NOT_VECTOR")
    shapes = shapes[kept]
    if not np.isfinite(shapely.get_coordinates(shapes)).all():
        raise FormatError(f"{name}: has coordinates that are not finite", "E_NOT_VECTOR")
    fields = {
        str(field).lower(): np.asarray(column, object)[kept]
        for field, column in zip(meta["fields"], columns, strict=True)
    }
    return _moved(name, shapes, meta["crs"], crs, warnings), fields


def _moved(
    name: str, shapes: Geometries, layer: str | None, crs: CrsInfo, warnings: list[CodedWarning]
) -> Geometries:
    """Return the shapes in the tile's CRS, polygons repaired."""
    import shapely

    def say(message: str) -> None:
        warnings.append(CodedWarning("W_VECTOR_CRS", f"{name}: {message}"))

    if layer is None or crs.wkt2 is None:
        if (layer is None) != (crs.wkt2 is None):
            which = "the file" if layer is None else "the tile"
            say(f"{which} has no CRS; the shapes are taken to be in the same as the points")
    else:
        from volatool.points.crs_places import mover

        left, bottom, right, top = shapely.total_bounds(shapes)
        move = mover(layer, crs)
        largest = max(abs(left), abs(right), abs(bottom), abs(top))
        if move is not None and move.is_from_degrees and largest > 360.5:
            # GeoJSON of projected coordinates without a CRS counts as degrees
            say("the CRS is in degrees, the numbers are not; taken to be in the tile's CRS")
            move = None
        if move is not None:
            shapes = shapely.transform(shapes, move, interleaved=False)
            if not np.isfinite(shapely.get_coordinates(shapes)).all():
                raise CRSError(f"{name}: can't be brought into the tile's CRS")
    areas = shapely.get_dimensions(shapes) == 2
    broken = areas & ~shapely.is_valid(shapes)
    if broken.any():
        shapes = shapes.copy()
        shapes[broken] = [shape.buffer(0) for shape in shapely.make_valid(shapes[broken])]
        shapes = np.array(shapes, object)
    return shapes


def _is_river(fields: dict[str, Any]) -> bool:
    return any(str(fields.get(name) or "").strip().lower() in RIVERS for name in TYPE_FIELDS)


def _level(shape: Any, fields: dict[str, Any]) -> float | None:
    """Return the level that a polygon has by itself."""
    import shapely

    for name in LEVEL_FIELDS:
        try:
            value = float(fields.get(name))  # type: ignore[arg-type]
        except (TypeError, ValueError):
            continue
        if math.isfinite(value):
            return value
    if shapely.has_z(shape):
        heights = shapely.get_coordinates(shape, include_z=True)[:, 2]
        if np.isfinite(heights).all() and heights.any():
            return float(np.mean(heights))
    return None
