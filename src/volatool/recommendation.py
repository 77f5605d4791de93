"""Voxel and cell size for a set of tiles, with the curve that they follow from."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import Any

from volatool.cube import Cube
from volatool.dem.cell import CANDIDATES, COVERAGE
from volatool.dem.parameters import Parameters
from volatool.errors import OptionError
from volatool.occupancy.depth import MIN_OCCUPANCY, choose_depth
from volatool.occupancy.levels import counts_from_rows
from volatool.report import Report
from volatool.tables import aligned

SCHEMA = "volatool.recommend/1"


def recommend(
    summary: Report,
    *,
    parameters: Parameters | None = None,
    min_occupancy: float = MIN_OCCUPANCY,
    n_tiles: int | None = None,
    factor: float = 1.0,
    metres_per_unit: Fraction | None = None,
) -> dict[str, Any]:
    """
    Recommend a depth and a cell for a set.

    Parameters
    ----------
    summary : Report
        The sum over the tiles that were looked at.
    parameters : Parameters, optional
        Cell and spacing measured on points; by default they are estimated from the density.
    min_occupancy : float
        Threshold of the depth.
    n_tiles : int, optional
        Tiles of the whole set; those of the summary by default.
    factor : float
        Points of the whole set over those of the tiles looked at: sizes are multiplied by it.
    metres_per_unit : Fraction, optional
        Of the horizontal unit, for candidates of the cell; 1 by default.

    Returns
    -------
    document : dict
        JSON: ``voxel``, ``dem``, ``curve``, ``expected``, ``tiles``, ``warnings``.
    """
    source, cube = dict(summary.input or {}), dict(summary.cube or {})
    low, high = cube.get("sides") or (cube["side"], cube["side"])
    counts = counts_from_rows(summary.levels)
    n_points = source["points_used"]
    choice = choose_depth(
        counts,
        sys.maxsize if n_points is None else n_points,
        cube=Cube((0.0, 0.0, 0.0), high),
        threshold=min_occupancy,
    )
    curve = [_row(row, (low, high), row["level"] == choice.depth) for row in summary.levels]
    chosen = curve[choice.depth - 1]
    dem = _dem(source, parameters, metres_per_unit or Fraction(1))
    area = _area(source)
    expected = {
        "volume_bytes": round(chosen["volume_bytes"] * factor),
        "volume_with_metadata_bytes": round(chosen["volume_with_metadata_bytes"] * factor),
        "dem_cells": None
        if dem is None or area is None
        else round(area * factor / dem["cell"] ** 2),
        "is_extrapolated": factor != 1.0,
        "factor": factor,
    }
    return {
        "schema": SCHEMA,
        "tiles": {"looked_at": summary.tiles or 1, "all": n_tiles or summary.tiles or 1},
        "unit": cube["unit"],
        "voxel": {
            "depth": choice.depth,
            "cells": chosen["cells"],
            "sides": [low, high],
            "occupancy": choice.occupancy,
            "threshold": min_occupancy,
            "margin": choice.margin,
            "reason": choice.reason,
        },
        "dem": dem,
        "curve": curve,
        "expected": expected,
        "warnings": [
            warning.to_dict()
            for warning in (*choice.warnings, *summary.warnings)
            if warning.code in ("W_LOW_OCCUPANCY", "W_CUBE_SIDES", "W_SUMMARY_LEVELS")
        ],
    }


def _row(row: Mapping[str, Any], sides: tuple[float, float], is_chosen: bool) -> dict[str, Any]:
    return {
        "level": row["level"],
        "cells": [side / 4 ** row["level"] for side in sides],
        "occupancy": row["occupancy"],
        "voxels": row["voxels"],
        "points_per_voxel": row["points_per_voxel"],
        "volume_bytes": row["sparse_bytes"],
        "volume_with_metadata_bytes": 2 * row["sparse_bytes"],
        "is_recommended": is_chosen,
    }


def _area(source: Mapping[str, Any]) -> float | None:
    """Return the area of the boxes of all tiles."""
    density = source["density"]["all_per_area_bbox"]
    return source["points_read"] / density if density else None


def _dem(
    source: Mapping[str, Any], parameters: Parameters | None, metres_per_unit: Fraction
) -> dict[str, Any] | None:
    """Return the cell and why; None where nothing tells the density."""
    if parameters is not None:
        cell, spacing = float(parameters.cell), parameters.spacing
        reason = (
            f"the median of the smallest cells of which {COVERAGE:.0%} hold a point of the "
            f"surface, measured on points; their mean spacing is {spacing:.3g}"
        )
        return {"cell": cell, "spacing": spacing, "is_measured": True, "reason": reason}
    densities = source["density"]
    if not densities["all_per_area_bbox"] or not densities["all_per_area_occupied"]:
        return None
    # boxes, as covered area is counted in cells that a small tile's points don't fill
    part = (densities["first_per_area_occupied"] or 0.0) / densities["all_per_area_occupied"]
    density = part * densities["all_per_area_bbox"]
    if not density:
        return None
    # points at random leave exp(-density * cell**2) of the cells empty
    least = math.sqrt(-math.log(1 - COVERAGE) / density)
    candidates = [float(value / metres_per_unit) for value in CANDIDATES]
    cell = next((value for value in candidates if value >= least), candidates[-1])
    reason = (
        f"estimated: {density:.3g} first returns per square unit of the tiles' boxes, at random, "
        f"fill {COVERAGE:.0%} of the cells from {least:.3g} on; ground points are fewer"
    )
    return {"cell": cell, "spacing": density**-0.5, "is_measured": False, "reason": reason}


def sample(items: Sequence[Any], most: int) -> list[Any]:
    """
    Return at most so many of a sequence, at equal steps.

    Raises
    ------
    OptionError
        Less than one is asked for.

    Examples
    --------
    >>> sample(range(10), 4)
    [0, 2, 5, 7]
    """
    if most < 1:
        raise OptionError(f"--sample must be at least 1, got {most}")
    if most >= len(items):
        return list(items)
    return [items[k * len(items) // most] for k in range(most)]


def as_text(document: Mapping[str, Any]) -> str:
    """Return a recommendation for people."""
    voxel, dem, expected = document["voxel"], document["dem"], document["expected"]
    unit = f" {document['unit']}" if document["unit"] else ""
    n, total = document["tiles"]["looked_at"], document["tiles"]["all"]
    lines = [
        f"Voxels: depth {voxel['depth']}, cells of {_span(voxel['cells'])}{unit} "
        f"(cubes of side {_span(voxel['sides'])})",
        f"  {voxel['reason']}",
    ]
    if dem is not None:
        lines += [f"Elevation model: cells of {dem['cell']:g}{unit}", f"  {dem['reason']}"]
    else:
        lines.append("Elevation model: nothing tells the density of the points; give the tiles")
    cells = [["Lvl", "Cell", "Occup", "Voxels", "Pts/Voxel", "Volume(MB)", "with metadata"]]
    for row in document["curve"]:
        per_voxel = row["points_per_voxel"]
        cells.append(
            [
                f"{row['level']}{'*' if row['is_recommended'] else ''}",
                _span(row["cells"]),
                f"{row['occupancy']:.2%}",
                f"{row['voxels']:,}",
                "-" if per_voxel is None else f"{per_voxel:.2f}",
                f"{row['volume_bytes'] / 1e6:,.3f}",
                f"{row['volume_with_metadata_bytes'] / 1e6:,.3f}",
            ]
        )
    lines += ["", aligned(cells), ""]
    size = (
        f"volumes {expected['volume_bytes'] / 1e6:,.3f} MB, with metadata "
        f"{expected['volume_with_metadata_bytes'] / 1e6:,.3f} MB, before gzip"
    )
    if expected["dem_cells"] is not None:
        size += f"; elevation model {expected['dem_cells']:,} cells"
    if expected["is_extrapolated"]:
        lines.append(
            f"Looked at {n} of {total} tiles; sizes below are theirs times "
            f"{expected['factor']:.4g}, by the points that the headers tell of"
        )
    lines.append(f"Expected for {total} tiles: {size}")
    return "\n".join(lines)


def _span(values: Sequence[float]) -> str:
    low, high = (f"{value:.4g}" for value in values)
    return low if low == high else f"{low} to {high}"
