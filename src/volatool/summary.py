"""Reports of many inputs summed into one, as the VOLA paper sums the tiles of a data set."""

from __future__ import annotations

import json
import math
import sys
from array import array
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any

from volatool.cube import Cube
from volatool.encodings import added_rows
from volatool.errors import CodedWarning, FormatError, InputNotFoundError, OptionError
from volatool.model import LevelCounts
from volatool.occupancy.depth import MIN_OCCUPANCY, Choice, choose_depth, fixed_depth, stop_level
from volatool.occupancy.levels import add_counts, counts_from_rows, level_rows
from volatool.report import Report

REPORT_SUFFIXES = (".json", ".jsonl")
"""What a file of reports ends in; tiles and volumes don't."""

_TOTALS = (
    "bytes",
    "las_equivalent_bytes",
    "points_header",
    "points_read",
    "points_used",
)
_COMMON = ("las_version", "point_format", "compressed", "crs")
_COUNTED = ("dropped", "classes", "returns")
_OTHER_CELLS = 2
"""Times that the longest cube's side may be the shortest's before cells are said to differ."""


def summarize(reports: Iterable[Report]) -> Report:
    """
    Sum reports; see `Summary`.

    Parameters
    ----------
    reports : iterable of Report
        Of inputs that have a volume; empty ones are counted, but add nothing.
    """
    summary = Summary()
    for report in reports:
        summary.add(report)
    return summary.report()


class Summary:
    """
    The sum of reports, added one by one in any order: of each its name and areas are kept.

    Attributes
    ----------
    tiles : int
        Reports added, the empty ones too.
    n_volumes : int
        Those of them that have a volume.
    """

    def __init__(self) -> None:
        self.tiles = 0
        self.n_volumes = 0
        self._names: list[tuple[int, str]] = []
        self._counts: list[LevelCounts] = []
        self._ends: set[int] = set()  # last levels of the reports
        self._is_partial = False
        self._options: Mapping[str, Any] = {}
        self._cubes = 0
        self._sides = (sys.float_info.max, 0.0)
        self._is_snapped = True
        self._unit = _Common()
        self._rules: set[str] = set()
        self._depths: set[int | None] = set()
        self._totals: dict[str, int | None] = dict.fromkeys(_TOTALS, 0)
        self._common = {key: _Common() for key in _COMMON}
        self._counted: dict[str, Counter[str]] = {key: Counter() for key in _COUNTED}
        self._box: list[float] = []
        self._areas = {"all_per_area_bbox": _Area(), "all_per_area_occupied": _Area()}
        self._n_first = array("d")
        self._encodings: list[dict[str, Any]] = []

    def add(self, report: Report, place: int | None = None) -> None:
        """
        Add a report.

        Parameters
        ----------
        report : Report
            Of an input, or of a summary (its tiles count one by one).
        place : int, optional
            Its number among the inputs, where reports come in another order; the sum does not
            depend on the order they come in.
        """
        self.tiles += report.tiles or 1
        if not report.levels:
            return
        first = not self.n_volumes
        self.n_volumes += 1
        counts = counts_from_rows(report.levels)
        self._counts = counts if first else add_counts((self._counts, counts))
        self._ends.add(len(counts))
        self._is_partial |= report.status == "partial"
        if first:
            self._options = report.options
        self._add_cube(report)
        self._rules.add((report.choice or {})["rule"])
        self._depths.add(report.depth)
        if report.input is not None:
            self._add_input(report.input, self.tiles if place is None else place)
        if len(self._depths) > 1:
            self._encodings = []
        else:
            rows = [dict(row) for row in report.encodings]
            self._encodings = rows if first else self._with_encodings(rows)

    def _add_cube(self, report: Report) -> None:
        cube = report.cube or {}
        self._cubes += cube.get("cubes", 1)
        side = cube["side"]
        if side is None:
            raise OptionError("a summary of cubes of several sides can't be added to another sum")
        self._sides = (min(self._sides[0], side), max(self._sides[1], side))
        self._unit.add(cube["unit"])
        self._is_snapped &= bool(cube["snapped"])

    def _add_input(self, source: Mapping[str, Any], place: int) -> None:
        self._names += [(place, name) for name in source.get("names") or [source["name"]]]
        for key in _TOTALS:
            have, more = self._totals[key], source[key]
            self._totals[key] = None if have is None or more is None else have + more
        for key, common in self._common.items():
            common.add(source[key])
        for key in _COUNTED:
            self._counted[key] += Counter(source[key])
        box = source["bbox"]
        if self._box:
            box = [*map(min, self._box[:3], box[:3]), *map(max, self._box[3:], box[3:])]
        self._box = list(box)
        self._areas["all_per_area_bbox"].add(source, "points_read", "all_per_area_bbox")
        covered = self._areas["all_per_area_occupied"].add(
            source, "points_used", "all_per_area_occupied"
        )
        self._n_first.append((source["density"]["first_per_area_occupied"] or 0.0) * covered)

    def _with_encodings(self, rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
        # the last percentages are of all: whichever report comes last
        return added_rows(
            self._encodings, rows, self._totals["las_equivalent_bytes"], self._totals["bytes"]
        )

    def report(self) -> Report:
        """
        Return the sum.

        Returns
        -------
        report : Report
            ``tiles`` is the number of inputs; levels down to the deepest that all of them have,
            the depth chosen on the sums, encodings added up if every input was measured at that
            depth.

        Raises
        ------
        OptionError
            No input has a volume.
        """
        if not self.n_volumes:
            raise OptionError("no input has a point: there is nothing to sum up")
        n_points = self._totals["points_used"]
        low, side = self._sides
        choice = self._choice(n_points, Cube((0.0, 0.0, 0.0), side))
        counts = self._counts
        if len(self._ends) == 1 and n_points is not None:
            # tiles that list every level: show as many as the sum has any use for
            counts = counts[: max(choice.depth, stop_level(counts, n_points))]
        rows = level_rows(counts, Fraction(repr(side)), n_points, tiles=self._cubes)
        same_side = low == side
        sides = {} if same_side else {"sides": [low, side]}
        is_alike = self._depths == {choice.depth}
        return Report(
            status="partial" if self._is_partial else "ok",
            input=self._input(),
            cube={
                "origin": None,
                "side": side if same_side else None,
                "unit": self._unit.value,
                "snapped": self._is_snapped,
                "cubes": self._cubes,
                **sides,
            },
            levels=tuple(
                {**row.to_dict(), "cell": row.cell if same_side else None} for row in rows
            ),
            choice={**choice.to_dict(), "cell": choice.cell if same_side else None},
            encodings=tuple(self._encodings) if is_alike else (),
            warnings=(*choice.warnings, *self._warnings(choice.depth)),
            options=self._options,
            tiles=self.tiles,
        )

    def _choice(self, n_points: int | None, cube: Cube) -> Choice:
        """Choose by occupancy on the sums, unless one depth was asked for all."""
        if "occupancy" not in self._rules and len(self._depths) == 1:
            (depth,) = self._depths
            return fixed_depth(depth or 0, cube, self._counts)
        threshold = self._options.get("min_occupancy", MIN_OCCUPANCY)
        # without the number of points no level ends the table for having as many voxels
        most = sys.maxsize if n_points is None else n_points
        return choose_depth(self._counts, most, cube=cube, threshold=threshold)

    def _warnings(self, depth: int) -> list[CodedWarning]:
        """Say what makes the depth of a set mean less than it seems."""
        found = []
        if len(self._ends) > 1:
            least, most = min(self._ends), max(self._ends)
            found.append(
                CodedWarning(
                    "W_SUMMARY_LEVELS",
                    f"the inputs list {least} to {most} levels; the sum, and the choice of the "
                    f"depth, end at level {least}: give the point files, which list all",
                )
            )
        low, high = self._sides
        if low > 0 and high > _OTHER_CELLS * low:
            found.append(
                CodedWarning(
                    "W_CUBE_SIDES",
                    f"the cubes have sides from {low:g} to {high:g}: at one depth of {depth} their "
                    f"cells are {low / 4**depth:.4g} to {high / 4**depth:.4g}; cubes of one side "
                    "(retile, --split, or --snap with --cube) give one cell",
                )
            )
        return found

    def _input(self) -> dict[str, Any]:
        used, read = self._totals["points_used"], self._totals["points_read"]
        areas = self._areas
        return {
            "name": f"{len(self._names)} tiles",
            "names": [name for _, name in sorted(self._names, key=lambda item: item[0])],
            **self._totals,
            **{key: common.value for key, common in self._common.items()},
            **{key: dict(counter) for key, counter in self._counted.items()},
            "bbox": self._box,
            "density": {
                "all_per_area_bbox": areas["all_per_area_bbox"].ratio(read or 0),
                "all_per_area_occupied": areas["all_per_area_occupied"].ratio(used or 0),
                "first_per_area_occupied": areas["all_per_area_occupied"].ratio(
                    math.fsum(self._n_first)
                ),
                "occupied_cell": None,
            },
        }


class _Common:
    """The value that all have in common; None if they differ."""

    def __init__(self) -> None:
        self.value: Any = None
        self._is_first = True

    def add(self, value: Any) -> None:
        if not self._is_first and value != self.value:
            value = None
        self._is_first, self.value = False, value


class _Area:
    """A sum of areas, which follow from tiles' own densities; None once one can't be had."""

    def __init__(self) -> None:
        self._parts = array("d")  # their exact sum is the same in any order
        self._is_known = True

    def add(self, source: Mapping[str, Any], count: str, density: str) -> float:
        """Return the area that a density was taken over; 0 where there is none."""
        value = source["density"][density]
        area: float = source[count] / value if value else 0.0
        self._is_known &= area != 0
        self._parts.append(area)
        return area

    def ratio(self, n_points: float) -> float | None:
        return n_points / math.fsum(self._parts) if self._is_known and self._parts else None


def summed_inputs(documents: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """
    Return the ``input`` objects of several reports as one.

    Parameters
    ----------
    documents : iterable of dict
        In order; ``name`` and ``names`` of the sum are for the caller to say better.
    """
    summary = Summary()
    for place, document in enumerate(documents):
        summary._add_input(document, place)
    return summary._input()


def is_report(path: Path) -> bool:
    """Whether a file is one of reports by its name."""
    return path.name.lower().endswith(REPORT_SUFFIXES)


def read_reports(path: Path) -> Iterator[Report]:
    """
    Yield the reports of a file, one or one a line.

    Parameters
    ----------
    path : pathlib.Path
        ``NAME.stats.json``, ``stats --format json`` (an array too) or ``jsonl``.

    Raises
    ------
    InputNotFoundError, FormatError
        Not there; ``E_NOT_REPORT``.
    """
    try:
        with path.open(encoding="utf-8-sig") as lines:
            if path.name.lower().endswith(".jsonl"):
                for line in lines:
                    if line.strip():
                        yield Report.from_dict(json.loads(line))
                return
            document = json.load(lines)
    except FileNotFoundError as error:
        raise InputNotFoundError(f"{path}: no such file") from error
    except OSError as error:
        raise InputNotFoundError(f"{path}: can't be read ({error.strerror})") from error
    except FormatError as error:
        raise FormatError(f"{path}: {error}", error.code) from error
    except (ValueError, RecursionError) as error:
        raise FormatError(f"{path}: is not JSON ({error})", "E_NOT_REPORT") from error
    try:
        for one in document if isinstance(document, list) else [document]:
            yield Report.from_dict(one)
    except FormatError as error:
        raise FormatError(f"{path}: {error}", error.code) from error
