"""Reports of many inputs summed into one, as the VOLA paper sums the tiles of a data set."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction
from typing import Any

from volatool.cube import Cube
from volatool.encodings import added_rows
from volatool.errors import OptionError
from volatool.model import LevelCounts
from volatool.occupancy.depth import MIN_OCCUPANCY, Choice, choose_depth, fixed_depth
from volatool.occupancy.levels import add_counts, counts_from_rows, level_rows
from volatool.report import Report


def summarize(reports: Sequence[Report]) -> Report:
    """
    Sum reports.

    Parameters
    ----------
    reports : sequence of Report
        Of inputs that have a volume; empty ones are counted, but add nothing.

    Returns
    -------
    report : Report
        ``tiles`` is their number; levels down to the deepest that all of them have, the depth
        chosen on the sums, encodings added up if every input was measured at that depth.

    Raises
    ------
    OptionError
        No input has a volume.
    """
    full = [report for report in reports if report.levels]
    if not full:
        raise OptionError("no input has a point: there is nothing to sum up")
    counts = add_counts(counts_from_rows(report.levels) for report in full)
    inputs = [report.input for report in full if report.input is not None]
    counted = [source["points_used"] for source in inputs]
    n_points = None if None in counted else sum(counted)
    cubes = sum((report.cube or {}).get("cubes", 1) for report in full)
    sides = [(report.cube or {})["side"] for report in full]
    side = max(sides)
    rows = level_rows(counts, Fraction(repr(side)), n_points, tiles=cubes)
    choice = _choice(full, counts, n_points, Cube((0.0, 0.0, 0.0), side))
    all_alike = {report.depth for report in full} == {choice.depth}
    same_side = len(set(sides)) == 1
    return Report(
        status="partial" if any(report.status == "partial" for report in full) else "ok",
        input=_input(inputs, len(full)),
        cube={
            "origin": None,
            "side": side if same_side else None,
            "unit": _common((report.cube or {})["unit"] for report in full),
            "snapped": all((report.cube or {})["snapped"] for report in full),
            "cubes": cubes,
        },
        levels=tuple({**row.to_dict(), "cell": row.cell if same_side else None} for row in rows),
        choice={**choice.to_dict(), "cell": choice.cell if same_side else None},
        encodings=tuple(_encodings(full, inputs)) if all_alike else (),
        warnings=choice.warnings,
        options=full[0].options,
        tiles=len(reports),
    )


def _choice(
    reports: Sequence[Report], counts: Sequence[LevelCounts], n_points: int | None, cube: Cube
) -> Choice:
    """Choose by occupancy on the sums, unless one depth was asked for all."""
    rules = {(report.choice or {})["rule"] for report in reports}
    depths = {report.depth for report in reports}
    if "occupancy" not in rules and len(depths) == 1:
        return fixed_depth(reports[0].depth or 0, cube, counts)
    threshold = reports[0].options.get("min_occupancy", MIN_OCCUPANCY)
    # without the number of points no level ends the table for having as many voxels
    most = sys.maxsize if n_points is None else n_points
    return choose_depth(counts, most, cube=cube, threshold=threshold)


def _input(inputs: Sequence[Mapping[str, Any]], n_volumes: int) -> dict[str, Any]:
    def total(key: str) -> Any:
        values = [source[key] for source in inputs]
        return None if any(value is None for value in values) else sum(values)

    def counted(key: str) -> dict[str, int]:
        return dict(sum((Counter(source[key]) for source in inputs), Counter()))

    boxes = [source["bbox"] for source in inputs]
    return {
        "name": f"{n_volumes} tiles",
        "names": [source["name"] for source in inputs],
        "bytes": total("bytes"),
        "las_version": _common(source["las_version"] for source in inputs),
        "point_format": _common(source["point_format"] for source in inputs),
        "compressed": _common(source["compressed"] for source in inputs),
        "las_equivalent_bytes": total("las_equivalent_bytes"),
        "points_header": total("points_header"),
        "points_read": total("points_read"),
        "points_used": total("points_used"),
        "dropped": counted("dropped"),
        "classes": counted("classes"),
        "returns": counted("returns"),
        "bbox": [min(column) for column in zip(*(box[:3] for box in boxes), strict=True)]
        + [max(column) for column in zip(*(box[3:] for box in boxes), strict=True)],
        "density": _density(inputs),
        "crs": _common(source["crs"] for source in inputs),
    }


def _density(inputs: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return points over area, both summed; a tile's areas follow from its own densities."""
    covered = [_area(source, "points_used", "all_per_area_occupied") for source in inputs]
    boxes = [_area(source, "points_read", "all_per_area_bbox") for source in inputs]
    n_first = sum(
        (source["density"]["first_per_area_occupied"] or 0.0) * area
        for source, area in zip(inputs, covered, strict=True)
    )
    return {
        "all_per_area_bbox": _ratio(sum(source["points_read"] or 0 for source in inputs), boxes),
        "all_per_area_occupied": _ratio(sum(s["points_used"] or 0 for s in inputs), covered),
        "first_per_area_occupied": _ratio(n_first, covered),
        "occupied_cell": None,
    }


def _area(source: Mapping[str, Any], count: str, density: str) -> float:
    """Return the area that a density was taken over; 0 where there is none."""
    value = source["density"][density]
    return source[count] / value if value else 0.0


def _ratio(n_points: float, areas: Sequence[float]) -> float | None:
    return n_points / sum(areas) if all(areas) else None


def _encodings(
    reports: Sequence[Report], inputs: Sequence[Mapping[str, Any]]
) -> list[dict[str, Any]]:
    las = [source["las_equivalent_bytes"] for source in inputs]
    las_bytes = None if any(value is None for value in las) else sum(las)
    input_bytes = sum(source["bytes"] for source in inputs)
    total: list[dict[str, Any]] = []
    for report in reports:
        total = added_rows(total, [dict(row) for row in report.encodings], las_bytes, input_bytes)
    return total


def _common(values: Iterable[Any]) -> Any:
    """Return the value that all have in common, None if they differ."""
    first, *others = list(values)
    return first if all(other == first for other in others) else None
