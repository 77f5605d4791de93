"""What `diff` says: one JSON object, GeoJSON of the places that changed, or text."""

from __future__ import annotations

import functools
import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from volatool._version import __version__
from volatool.encodings import output_stream
from volatool.errors import CodedWarning, InputError
from volatool.model import F64, Bool
from volatool.outputs import OutputSet
from volatool.units import format_quantity
from volatool.vola.algebra import voxel_edge, voxel_size
from volatool.vola.diff import Difference, diff
from volatool.vola.volume import Volume

SCHEMA = "volatool.diff/1"
_DEGREE_DIGITS = 8  # a millimetre
_COORDINATE_DIGITS = 4


def compare(
    a: Volume, b: Volume, *, names: tuple[str, str], **options: Any
) -> tuple[Difference, tuple[CodedWarning, ...]]:
    """
    Compare two volumes that were read from files.

    Parameters
    ----------
    a, b : Volume
        Before and after.
    names : tuple of 2 str
        Of the files, for errors.
    **options
        Of `volatool.vola.diff.diff`.

    Returns
    -------
    difference : Difference
    warnings : tuple of CodedWarning
        Of the files, ``W_DEPTH`` when levels of one were left out, ``W_RESAMPLED``.
    """
    try:
        difference = diff(a, b, **options)
    except InputError as error:
        raise type(error)(f"{names[0]} and {names[1]}: {error}", error.code) from error
    warnings = [*a.info.warnings, *b.info.warnings]
    if difference.is_resampled:
        warnings.append(
            CodedWarning(
                "W_RESAMPLED",
                f"{names[1]} was brought to the grid of {names[0]}: its voxels may lie up to half "
                "a cell off, what lies outside that cube is left out",
            )
        )
    if not difference.is_resampled and a.depth != b.depth:
        deeper = names[0] if a.depth > b.depth else names[1]
        warnings.append(
            CodedWarning(
                "W_DEPTH",
                f"{deeper} has {max(a.depth, b.depth)} levels, the other volume "
                f"{min(a.depth, b.depth)}: these are compared",
            )
        )
    return difference, tuple(warnings)


def document(
    difference: Difference, names: tuple[str, str], warnings: tuple[CodedWarning, ...] = ()
) -> dict[str, Any]:
    """
    Return what changed, as JSON.

    Parameters
    ----------
    difference : Difference
        As `volatool.vola.diff.diff` returned it.
    names : tuple of 2 str
        Of the files.
    warnings : tuple of CodedWarning
        What came up.
    """
    a, b = difference.a, difference.b
    crs = a.crs if a.crs.horizontal is not None else b.crs
    changes, surface = difference.changes, difference.surface()
    added, removed = difference.at_significant_places()
    measure = functools.partial(_measured, difference)
    return {
        "schema": SCHEMA,
        "tool": {"name": "volatool", "version": __version__},
        "a": _side(a, names[0], measure),
        "b": _side(b, names[1], measure),
        "grid": {
            "origin": list(a.cube.origin),
            "side": a.cube.side,
            "depth": a.depth,
            "cell": float(voxel_edge(a)),
            "unit": crs.unit_xy,
            "z_scale": float(crs.z_ratio),
            "resampled": difference.is_resampled,
            "crs": crs.to_dict(),
        },
        "options": {
            "noise": difference.noise,
            "min_voxels": difference.min_voxels,
            "level": changes.level,
            "by": changes.by,
        },
        "both": measure(difference.n_both),
        "added": {
            **measure(difference.n_added),
            "significant": measure(difference.n_significant_added),
        },
        "removed": {
            **measure(difference.n_removed),
            "significant": measure(difference.n_significant_removed),
        },
        "places": {
            "level": changes.level,
            "edge": float(voxel_edge(a) * 4 ** (a.depth - changes.level + 1)),
            "by": changes.by,
            "changed": len(changes),
            "significant": int(np.count_nonzero(changes.is_significant)),
            "added": measure(added),
            "removed": measure(removed),
        },
        "surface": {
            "columns_both": surface.n_both,
            "columns_added": surface.n_added,
            "columns_removed": surface.n_removed,
            "raised": measure(surface.raised),
            "lowered": measure(surface.lowered),
            "net": measure(surface.net),
        },
        "warnings": [warning.to_dict() for warning in warnings],
    }


def _side(volume: Volume, name: str, measure: Any) -> dict[str, Any]:
    info = volume.info
    return {
        "name": name,
        "source": info.source_name,
        "points": info.n_points,
        **measure(len(volume)),
    }


def _measured(difference: Difference, n_voxels: int) -> dict[str, Any]:
    """Return a number of voxels and their volume, exact up to the last rounding."""
    size = n_voxels * voxel_size(difference.a)
    crs = difference.a.crs if difference.a.crs.metres_per_unit_xy else difference.b.crs
    metres = crs.metres_per_unit_xy
    return {
        "voxels": n_voxels,
        "volume": float(size),
        "volume_m3": None if metres is None else float(size * metres**3),
    }


def significant_volume(difference: Difference) -> float:
    """Return the volume added and removed at significant places, in cubed units of the CRS."""
    return float(sum(difference.at_significant_places()) * voxel_size(difference.a))


def geojson_lines(
    difference: Difference,
    summary: dict[str, Any],
    *,
    keep_crs: bool = False,
    significant_only: bool = False,
) -> tuple[Iterator[str], tuple[CodedWarning, ...]]:
    """
    Return the places that changed as lines of a GeoJSON FeatureCollection (RFC 7946).

    Parameters
    ----------
    difference : Difference
        As `volatool.vola.diff.diff` returned it.
    summary : dict
        As `document` returned it: the member ``volatool``.
    keep_crs : bool
        Coordinates of the volumes' CRS, named in a member ``crs`` (of GeoJSON before RFC 7946,
        which many programs read), in place of WGS 84 longitudes and latitudes.
    significant_only : bool
        Leave out places whose changes are noise-like.

    Returns
    -------
    lines : iterator of str
        A line a feature.
    warnings : tuple of CodedWarning
        ``W_NO_CRS``: the CRS is not known, so that coordinates are those of the volumes.
    """
    changes = difference.changes
    chosen: Bool = changes.is_significant if significant_only else np.ones(len(changes), np.bool_)
    low = difference.corners(changes.blocks[chosen], changes.level)
    high = difference.corners(changes.blocks[chosen] + 1, changes.level)
    x = np.column_stack([low[:, 0], high[:, 0], high[:, 0], low[:, 0], low[:, 0]])
    y = np.column_stack([low[:, 1], low[:, 1], high[:, 1], high[:, 1], low[:, 1]])
    warnings: tuple[CodedWarning, ...] = ()
    digits = _COORDINATE_DIGITS
    if not keep_crs:
        moved = _degrees(difference, x, y)
        if moved is None:
            text = "no way from the CRS to degrees is known: coordinates are those of the volumes"
            warnings = (CodedWarning("W_NO_CRS", text),)
            keep_crs = True
        else:
            (x, y), digits = moved, _DEGREE_DIGITS
    x, y = _counterclockwise(np.round(x, digits), np.round(y, digits))
    head: dict[str, Any] = {"type": "FeatureCollection", "volatool": summary}
    name = summary["grid"]["crs"]["horizontal"]
    if keep_crs and name is not None:
        if name.startswith("EPSG:"):
            name = "urn:ogc:def:crs:EPSG::" + name.removeprefix("EPSG:")
        head["crs"] = {"type": "name", "properties": {"name": name}}
    features = _features(difference, chosen, x, y, in_degrees=not keep_crs)
    return _collection(head, features), warnings


def _degrees(difference: Difference, x: F64, y: F64) -> tuple[F64, F64] | None:
    from volatool.points.crs_places import lonlat

    for crs in (difference.a.crs, difference.b.crs):
        found = lonlat(crs, x.ravel(), y.ravel())
        if found is not None and all(np.isfinite(values).all() for values in found):
            lon, lat = found
            return lon.reshape(x.shape), lat.reshape(y.shape)
    return None


def _counterclockwise(x: F64, y: F64) -> tuple[F64, F64]:
    """Turn rings round that an axis of the CRS pointing south or west has mirrored."""
    area = ((x[:, 2] - x[:, 0]) * (y[:, 3] - y[:, 1])) - ((x[:, 3] - x[:, 1]) * (y[:, 2] - y[:, 0]))
    turned = (area < 0)[:, None]
    return np.where(turned, x[:, ::-1], x), np.where(turned, y[:, ::-1], y)


def _features(
    difference: Difference, chosen: Bool, x: F64, y: F64, *, in_degrees: bool
) -> Iterator[str]:
    from volatool.catalog.footprint import geometry_of

    changes = difference.changes
    size = float(voxel_size(difference.a))
    columns = 2 if changes.by == "column" else 3
    layers = np.column_stack([changes.first, changes.last + 1])[chosen]
    heights = difference.faces(layers[..., None] * np.ones(3))[..., 2]
    values: list[list[Any]] = [
        _chosen(column, chosen)
        for column in (
            changes.added,
            changes.removed,
            changes.significant_added,
            changes.significant_removed,
            changes.is_significant,
            changes.blocks[:, :columns],
        )
    ]
    rings = np.stack([x, y], axis=-1)
    crosses = np.ptp(x, axis=1) > 180 if in_degrees else np.zeros(len(x), np.bool_)
    for ring, is_cut, height, *row in zip(rings, crosses.tolist(), heights, *values, strict=True):
        added, removed, far_added, far_removed, is_significant, block = row
        feature = {
            "type": "Feature",
            "properties": {
                "added": added,
                "removed": removed,
                "significant_added": far_added,
                "significant_removed": far_removed,
                "significant": is_significant,
                "significance": round((far_added + far_removed) / (added + removed), 4),
                "volume_added": added * size,
                "volume_removed": removed * size,
                "z_min": round(float(height[0]), _COORDINATE_DIGITS),
                "z_max": round(float(height[1]), _COORDINATE_DIGITS),
                "level": changes.level,
                "block": block,
            },
            "geometry": geometry_of(ring, _DEGREE_DIGITS)
            if is_cut
            else {"type": "Polygon", "coordinates": [ring.tolist()]},
        }
        yield json.dumps(feature, sort_keys=True, separators=(",", ":"))


def _chosen(column: NDArray[Any], chosen: Bool) -> list[Any]:
    values: list[Any] = column[chosen].tolist()
    return values


def _collection(head: dict[str, Any], features: Iterator[str]) -> Iterator[str]:
    """Yield the collection, a feature a line: files of two runs can be compared by lines."""
    text = json.dumps(head, sort_keys=True, separators=(",", ":"), allow_nan=False)
    yield text[:-1] + ',"features":['
    previous = None
    for feature in features:
        if previous is not None:
            yield previous + ","
        previous = feature
    if previous is not None:
        yield previous
    yield "]}"


def text(summary: dict[str, Any]) -> str:
    """Return a `document` for people."""
    grid, places, surface = summary["grid"], summary["places"], summary["surface"]
    unit = grid["unit"] or "unit"
    lines = [
        f"A {summary['a']['name']}: {summary['a']['voxels']:,} voxels",
        f"B {summary['b']['name']}: {summary['b']['voxels']:,} voxels",
        f"voxels of {grid['cell']:g} {unit}, depth {grid['depth']}"
        + (", B resampled to the grid of A" if grid["resampled"] else ""),
        "",
        f"{'':24}{'voxels':>14}{'volume':>18}{'of them significant':>22}",
    ]
    rows = [("in both", summary["both"], None)]
    for name, title in (("added", "added (B only)"), ("removed", "removed (A only)")):
        rows.append((title, summary[name], summary[name]["significant"]))
    for title, row, far in rows:
        line = f"{title:24}{row['voxels']:>14,}{_amount(row, unit):>18}"
        lines.append(line + (f"{far['voxels']:>22,}" if far is not None else ""))
    what = "columns" if places["by"] == "column" else "blocks"
    lines += [
        "",
        f"{places['significant']:,} of {places['changed']:,} changed {what} of "
        f"{places['edge']:g} {unit} are significant: at least "
        f"{summary['options']['min_voxels']} voxels without one of the other volume within "
        f"{summary['options']['noise']}",
        f"in them {_amount(places['added'], unit)} added, "
        f"{_amount(places['removed'], unit)} removed",
        "",
        f"tops of {surface['columns_both']:,} columns of voxels in both: "
        f"{_amount(surface['raised'], unit)} raised, {_amount(surface['lowered'], unit)} lowered, "
        f"net {_amount(surface['net'], unit)}",
    ]
    return "\n".join(lines)


def _amount(row: dict[str, Any], unit: str) -> str:
    if row["volume_m3"] is not None:
        return f"{format_quantity(row['volume_m3'])} m3"
    return f"{format_quantity(row['volume'])} {unit}3"


def write_lines(lines: Iterable[str], path: Path, overwrite: bool) -> None:
    """
    Write lines to a file that appears whole or not at all.

    Parameters
    ----------
    lines : iterable of str
        Without ends of lines.
    path : pathlib.Path
        The file.
    overwrite : bool
        Replace one that exists.
    """
    with OutputSet(overwrite) as outputs:
        with output_stream(outputs.add(path)) as stream:
            for line in lines:
                stream.write((line + "\n").encode())
        outputs.commit()
