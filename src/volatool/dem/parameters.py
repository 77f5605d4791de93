"""Cell and point spacing for a set of tiles, out of the reports of a first run over them."""

from __future__ import annotations

import json
import math
import statistics
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from volatool.errors import FormatError, InputError, InputNotFoundError, OptionError
from volatool.model import CrsInfo, as_fraction
from volatool.naming import SET_SUFFIX

if TYPE_CHECKING:
    from volatool.catalog.headers import HeaderIndex
    from volatool.options import ConvertOptions
    from volatool.points.source import Source

MEASURED_TILES = 9
"""Tiles of a set that are read to find what all have in common."""


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
        A report (``NAME.stats.json``), or one a line as ``--json`` prints them; or the set of a
        mosaic, whose first line tells.

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
        state = path.stat()
        stamp = (state.st_mtime_ns, state.st_size)
    except (OSError, ValueError):
        stamp = (0, 0)  # reading it says what is wrong
    return _read_parameters(path, stamp)


@lru_cache(maxsize=2)  # each tile of a set asks, more than once
def _read_parameters(path: Path, stamp: tuple[int, int]) -> Parameters:
    del stamp  # a file that has changed is another one
    try:
        with path.open(encoding="utf-8-sig") as stream:
            text = stream.readline() if path.name.endswith(SET_SUFFIX) else stream.read()
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


def measure_parameters(
    index: HeaderIndex, options: ConvertOptions, most: int = MEASURED_TILES
) -> Parameters:
    """
    Return what the tiles of a set have in common, measured on some of them.

    Parameters
    ----------
    index : HeaderIndex
        The tiles, at least one.
    options : ConvertOptions
        ``cell`` and the selection of points.
    most : int
        Tiles that are read: of those with at least a quarter of the median number of points, at
        equal steps through the list.

    Returns
    -------
    parameters : Parameters
        The spacing of the points of all of them taken together; the cell that was asked for, or
        the median of those that the rule for one tile chooses.
    """
    from volatool.opening import open_source

    enough = statistics.median(index.n_points) / 4
    numbers = [number for number, n in enumerate(index.n_points) if n >= enough]
    steps = min(most, len(numbers))
    chosen = [numbers[k * len(numbers) // steps] for k in range(steps)]
    measured = []
    for number in chosen:
        with open_source(index.paths[number], options) as source:
            measured.append(_measured(source, options))
    crs = index.crs_at(chosen[0])
    # areas and points are summed, not spacings: so it is that of the points of all in one
    area = sum(spacing**2 * n for spacing, n, _ in measured)
    n_points = sum(n for _, n, _ in measured)
    if not n_points:
        raise InputError("none of the tiles that were looked at has a point for the surface")
    if isinstance(options.cell, str):
        cell = statistics.median_low([cell for _, n, cell in measured if n])
    else:
        cell = options.cell.in_units(crs.metres_per_unit_xy)
    return Parameters(cell, math.sqrt(area / n_points), crs.unit_xy)


def _measured(source: Source, options: ConvertOptions) -> tuple[float, int, Fraction]:
    """Return spacing and number of a tile's surface points, and the cell that suits them."""
    from volatool import resources
    from volatool.dem.cell import choose_cell, mean_spacing
    from volatool.dem.gather import SurfaceGatherer
    from volatool.points.select import selection_for
    from volatool.scratch import Scratch

    unit = source.crs.metres_per_unit_xy
    selection = selection_for(options)
    with Scratch(resources.working_budget(options.memory)) as scratch:
        surface = SurfaceGatherer(options.surface, scratch, source.header.dimensions)
        names = selection.attributes(source.header) | surface.attributes
        for chunk in source.chunks(names, options.chunk_points):
            mask = selection.mask(chunk, {})
            surface.add(chunk if mask is None else chunk.take(mask))
        points = surface.result(source.crs)
        try:
            return mean_spacing(points, unit), len(points), choose_cell(points, unit).cell
        finally:
            points.close()


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
