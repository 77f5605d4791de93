"""What was measured, as rows: ratios, targets met or not, the table, and the stored baseline."""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from costs import Cost, median
from rows import Row

TOOLKIT_RATE = 0.18e6
"""Points a second of the original toolkit at its best (DESIGN.md 4); it can't be installed."""

TOLERANCE = 0.15
MEASURES = ("wall", "cpu", "peak")


@dataclass(slots=True)
class Measured:
    """
    The runs of one row.

    Parameters
    ----------
    costs : list of Cost
        One a turn.
    units : int
        Points, or cells of the solver.
    skipped : str
        Why there are none.
    """

    costs: list[Cost] = field(default_factory=list)
    units: int = 0
    skipped: str = ""


def ratios(row: Row, measured: Mapping[str, Measured]) -> dict[str, float] | None:
    """Return the medians of the turns' ratios to the floor of the same turn; None without."""
    mine, floor = measured.get(row.name), measured.get(row.floor)
    if mine is None or floor is None or not mine.costs or not floor.costs:
        return None
    found = {}
    for measure, name in zip(MEASURES, ("wall_s", "cpu_s", "peak_mib"), strict=True):
        pairs = zip(mine.costs, floor.costs, strict=False)
        found[measure] = statistics.median(getattr(a, name) / getattr(b, name) for a, b in pairs)
    return found


def reached(row: Row, measured: Mapping[str, Measured]) -> float | None:
    """Return the number that is compared with the row's target; None if it can't be told."""
    others = [measured.get(name) for name in row.of.split()]
    if any(other is None or not other.costs for other in others):
        return None
    costs = [median(other.costs) for other in others if other is not None]
    mine = measured.get(row.name)
    if row.kind != "derived" and (mine is None or not mine.costs):
        return None
    own = median(mine.costs) if mine is not None and mine.costs else costs[0]
    units = mine.units if mine is not None else 0
    if row.reach == "wall_ratio":
        found = ratios(row, measured)
        return None if found is None else found["wall"]
    if row.reach in ("units_ratio", "peak_ratio"):
        a, b = (other for other in others if other is not None)
        if row.reach == "peak_ratio":
            return costs[0].peak_mib / costs[1].peak_mib
        return (costs[0].wall_s / a.units) / (costs[1].wall_s / b.units)
    return {
        "wall_s": own.wall_s,
        "peak_mib": own.peak_mib,
        "us_per_unit": own.cpu_s / units * 1e6 if units else None,
        "us_per_point_wall": own.wall_s / units * 1e6 if units else None,
        "faster": own.wall_s / costs[0].wall_s if costs else None,
        "toolkit": units / own.wall_s / TOOLKIT_RATE,
    }.get(row.reach)


def result_rows(rows: Sequence[Row], measured: Mapping[str, Measured]) -> list[dict[str, Any]]:
    """Return a JSON object a row; those of peers' own tables are added by the caller."""
    found = []
    for row in rows:
        mine = measured.get(row.name, Measured())
        cost = median(mine.costs) if mine.costs else None
        value = reached(row, measured)
        met = None
        if value is not None and row.limit is not None:
            met = value >= row.limit if row.at_least else value <= row.limit
        found.append(
            {
                "name": row.name,
                "group": row.group,
                "what": row.what,
                "input": None if row.kind == "derived" else row.input,
                "units": mine.units or None,
                "runs": len(mine.costs),
                "median": None if cost is None else cost.to_dict(),
                "floor": row.floor or None,
                "ratios": ratios(row, measured),
                "measure": row.reach or None,
                "reached": value,
                "target": row.limit,
                "at_least": row.at_least,
                "met": met,
                "prototype": row.prototype or None,
                "peer": row.kind == "peer",
                "skipped": mine.skipped or None,
            }
        )
    return found


_UNITS = {
    "wall_s": " s",
    "peak_mib": " MiB",
    "us_per_unit": " us/cell",
    "us_per_point_wall": " us/point",
    "faster": " x slower than ours",
    "toolkit": " x the toolkit",
}


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return the rows as a Markdown table."""
    lines = [
        "| row | what | on | wall s | CPU s | peak MiB | wall / floor | CPU / floor "
        "| reached | target | prototype |",
        "|---|---|---|---:|---:|---:|---:|---:|---:|---:|---|",
    ]
    for row in rows:
        cells = [row["name"], row["what"], row["input"] or ""]
        cost, ratio = row["median"], row["ratios"]
        if row["skipped"]:
            cells += [row["skipped"], "", ""]
        elif cost is None:
            cells += [""] * 3
        else:
            cells += [
                f"{cost['wall_s']:.3g}",
                f"{cost['cpu_s']:.3g}",
                f"{cost['peak_mib']:.0f}",
            ]
        cells += [""] * 2 if ratio is None else [f"{ratio['wall']:.2f}", f"{ratio['cpu']:.2f}"]
        unit = _UNITS.get(row["measure"] or "", "")
        value, limit = row["reached"], row["target"]
        word = {True: ", met", False: ", **not met**", None: ""}[row["met"]]
        cells.append("" if value is None else f"{value:.3g}{unit}{word}")
        cells.append("" if limit is None else f"{'>=' if row['at_least'] else '<='} {limit:g}")
        cells.append(row["prototype"] or "")
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def baseline_of(document: Mapping[str, Any]) -> dict[str, Any]:
    """Return what is stored of a result: ratios by row, the machine and what was measured."""
    return {
        "schema": document["schema"],
        "machine": document["machine"],
        "ratios": {
            row["name"]: {measure: round(row["ratios"][measure], 4) for measure in MEASURES}
            for row in document["rows"]
            if row["ratios"] is not None and not row["peer"]
        },
    }


def worse(
    now: Mapping[str, Any],
    baseline: Mapping[str, Any],
    measures: Sequence[str] = MEASURES,
    tolerance: float = TOLERANCE,
) -> list[str]:
    """
    Return a line for each ratio that is worse than the baseline's by more than the tolerance.

    Parameters
    ----------
    now, baseline : mapping
        As of `baseline_of`. Rows that only one of them has don't count.
    measures : sequence of str
        ``"wall"``, ``"cpu"``, ``"peak"``.
    tolerance : float
        Part by which a ratio may grow.
    """
    faults = []
    for name, before in baseline["ratios"].items():
        after = now["ratios"].get(name)
        for measure in measures if after is not None else ():
            grown = after[measure] / before[measure] - 1
            if grown > tolerance:
                faults.append(
                    f"{name}: {measure} is {after[measure]:.3g} times the floor's, "
                    f"{before[measure]:.3g} in the baseline ({grown:+.0%})"
                )
    return faults
