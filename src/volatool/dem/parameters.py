"""Cell and point spacing for a set of tiles, out of the reports of a first run over them."""

from __future__ import annotations

import json
import math
import statistics
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

from volatool.errors import FormatError, InputNotFoundError, OptionError
from volatool.model import CrsInfo, as_fraction


@dataclass(frozen=True, slots=True)
class Parameters:
    """
    What all tiles of a set have in common.

    Parameters
    ----------
    cell : Fraction
        Edge of a cell, in the horizontal unit.
    spacing : float
        Mean spacing of the points, which the stiffness follows, in the unit.
    unit : str or None
        Name of the unit.
    """

    cell: Fraction
    spacing: float
    unit: str | None


def read_parameters(path: Path) -> Parameters:
    """
    Return what the reports in a file have in common.

    Parameters
    ----------
    path : pathlib.Path
        A report (``NAME.stats.json``), or one a line as ``--json`` prints them.

    Returns
    -------
    parameters : Parameters
        The cell, which must be the same in all; the median of the spacings.

    Raises
    ------
    InputNotFoundError, FormatError
        Not there; ``E_NOT_REPORT``: no reports of elevation models made of springs.
    OptionError
        The reports' cells or units differ.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, ValueError) as error:
        raise InputNotFoundError(f"{path}: --params-from can't be read ({error})") from error
    made = [
        (report["dem"], (report.get("input") or {}).get("crs") or {})
        for report in _documents(path, text)
        if isinstance(report.get("dem"), Mapping)
    ]
    try:
        springs = [(dem, crs.get("unit_xy")) for dem, crs in made if dem.get("spacing") is not None]
        if not springs:
            raise FormatError(
                f"{path}: has no report of an elevation model made of springs (dem --json, or "
                "NAME.stats.json of convert)",
                "E_NOT_REPORT",
            )
        cells = {as_fraction(dem["cell"]) for dem, _ in springs}
        units = {unit for _, unit in springs}
        if len(cells) > 1 or len(units) > 1:
            found = ", ".join(sorted(f"{float(cell):g}" for cell in cells))
            raise OptionError(
                f"{path}: the reports have cells of {found} in units {sorted(map(str, units))}; "
                "--params-from needs those of one run with --cell"
            )
        spacing = statistics.median(float(dem["spacing"]) for dem, _ in springs)
        if not (spacing > 0 and math.isfinite(spacing)):
            raise ValueError(f"a spacing of {spacing}")
        return Parameters(cells.pop(), spacing, units.pop())
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        if isinstance(error, (FormatError, OptionError)):
            raise
        raise FormatError(f"{path}: not a whole report: {error!r}", "E_NOT_REPORT") from error


def _documents(path: Path, text: str) -> list[Mapping[str, Any]]:
    """Return the JSON objects of a file, one or one a line."""
    try:
        try:
            documents = [json.loads(text)]
        except ValueError:
            documents = [json.loads(line) for line in text.splitlines() if line.strip()]
    except (ValueError, RecursionError) as error:
        raise FormatError(f"{path}: not JSON: {error}", "E_NOT_REPORT") from error
    if not all(isinstance(document, Mapping) for document in documents):
        raise FormatError(f"{path}: not a report, nor one a line", "E_NOT_REPORT")
    return documents


def check_unit(parameters: Parameters, crs: CrsInfo) -> None:
    """
    Refuse parameters in another unit than a tile's.

    Raises
    ------
    OptionError
        ``E_OPTION``.
    """
    if parameters.unit != crs.unit_xy:
        raise OptionError(
            f"--params-from: its reports are in {parameters.unit or 'an unknown unit'}, this tile "
            f"is in {crs.unit_xy or 'an unknown unit'}"
        )
