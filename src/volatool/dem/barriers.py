"""Break lines and lakes on the grid of a DEM: cut springs, levels, and islands without ground."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from volatool.dem.distance import FILLED, VOID
from volatool.dem.gather import ROW, SHARE, SurfacePoints
from volatool.dem.grid import Grid
from volatool.dem.vectors import Barriers, Lake, outline
from volatool.emap.cuts import Cuts
from volatool.emap.lines import Lines, fixed_point
from volatool.emap.system import Evidence, strips
from volatool.errors import CodedWarning
from volatool.model import F64
from volatool.scratch import Scratch, Spool

SHORE_PERCENT = 10.0
"""Of the heights along a shore, the percentile that is the lake's level: water lies at or below
the ground around it, and a few low points must not decide."""

SHORE_CELLS, SHORE_SPACINGS = 2.0, 2.0
"""Width of the band along a shore, the larger of the two; widened threefold, up to `WIDENINGS`
times, until it holds `SHORE_POINTS`."""

SHORE_POINTS = 10
WIDENINGS = 4

RIM = 4.0
"""Cells beyond the grid at which lines are cut off."""


@dataclass(slots=True)
class Placed:
    """
    Barriers on a grid.

    Parameters
    ----------
    cuts : Cuts or None
        Springs that are missing; None where no line comes near.
    lakes : (h, w) array of int32
        Number of the lake whose polygon holds a node, from 1 on; 0 elsewhere.
    levels : (n,) array of float64
        Height of each lake, NaN if nothing says it.
    scratch : Scratch
        Where grids live.
    document : dict
        The report's ``dem.barriers``.
    warnings : list of CodedWarning
        What came up.
    islands : (h, w) array of bool or None
        Nodes that hang on no point, once `hold` has seen the evidence.
    """

    cuts: Cuts | None
    lakes: NDArray[np.int32]
    levels: F64
    scratch: Scratch
    document: dict[str, Any]
    warnings: list[CodedWarning] = field(default_factory=list)
    islands: NDArray[np.bool_] | None = None

    @property
    def lines(self) -> Lines | None:
        """Lines that are cut along."""
        return None if self.cuts is None else self.cuts.lines

    def dry(self, points: SurfacePoints, outer: Grid) -> SurfacePoints:
        """
        Return the points that lie in no lake's cell, to be closed; the same ones if all do.

        A surface that runs on under the water without points is what the land says; nothing has to
        be cut at the shore, and the solver keeps its pace however long the shore is.

        Parameters
        ----------
        points : SurfacePoints
            Ground.
        outer : Grid
            The grid that the barriers were placed on.
        """
        spool = Spool(self.scratch, ROW, SHARE)
        for rows in points.pieces():
            row, col = _cells(rows, points, outer)
            kept = rows[self.lakes[row, col] == 0]
            if len(kept):
                spool.append(kept)
        if not len(spool) or len(spool) == len(points):
            spool.close()
            return points
        return replace(points, spool=spool, beyond=None)

    def hold(self, evidence: Evidence, weight: float) -> None:
        """
        Hold the nodes that hang on no point where they are, so that the equations have a solution.

        Parameters
        ----------
        evidence : Evidence
            Of all points; changed.
        weight : float
            Stiffness of a point's spring.
        """
        if self.cuts is None:
            return
        self.islands = self.cuts.islands(evidence)
        for start, stop in strips(*evidence.shape):
            evidence.data[start:stop, 0] += weight * self.islands[start:stop]
            evidence.relax(start, stop)

    def flood(self, z: F64, base: float) -> None:
        """Set the lakes' nodes to their levels, given heights above `base`."""
        heights = np.concatenate([[0.0], self.levels - base])
        for start, stop in strips(*z.shape):
            numbers = self.lakes[start:stop]
            wet = numbers > 0
            z[start:stop][wet] = heights[numbers[wet]]
            self.scratch.relax(z, start, stop)

    def settle(self, flag: NDArray[np.uint8]) -> None:
        """Set the flags of a DEM's cells (the grid without its rim) that are lakes or islands."""
        known = np.concatenate([[False], np.isfinite(self.levels)])
        n_islands = 0
        for start, stop in strips(*flag.shape):
            numbers = self.lakes[start + 1 : stop + 1, 1:-1]
            lost = numbers > 0
            if self.islands is not None:
                lost |= self.islands[start + 1 : stop + 1, 1:-1]
            lost &= ~known[numbers]
            n_islands += int(np.count_nonzero(lost & (flag[start:stop] != VOID) & (numbers == 0)))
            flag[start:stop][lost] = VOID
            flag[start:stop][known[numbers]] = FILLED
            self.scratch.relax(flag, start, stop)
        if n_islands:
            self.warnings.append(
                CodedWarning(
                    "W_ISLAND",
                    f"{n_islands} cells are closed off by break lines without a point inside: left "
                    "void",
                    n_islands,
                )
            )

    def free(self) -> None:
        """Give the memory back."""
        self.scratch.free(self.lakes)
        if self.islands is not None:
            self.scratch.free(self.islands)
        if self.cuts is not None:
            self.cuts.free()


def place(
    barriers: Barriers, outer: Grid, points: SurfacePoints, spacing: float, scratch: Scratch
) -> Placed:
    """
    Bring barriers onto a grid.

    Parameters
    ----------
    barriers : Barriers
        In the unit of the grid's CRS.
    outer : Grid
        Nodes: those of the DEM's cells and one more all round.
    points : SurfacePoints
        Ground, for the levels of lakes.
    spacing : float
        Mean spacing of the points.
    scratch : Scratch
        Where grids live.
    """
    shape = (outer.height, outer.width)
    ends = _segments(barriers.lines, outer) if barriers.lines else np.empty((0, 4))
    cuts = Cuts.along(Lines.place(ends, shape, scratch)) if len(ends) else None
    lakes: NDArray[np.int32] = scratch.zeros(shape, np.int32)
    for k, lake in enumerate(barriers.lakes):
        _fill(lake, outer, k + 1, lakes)
    n_cells = np.zeros(len(barriers.lakes) + 1, np.int64)
    for start, stop in strips(outer.height - 2, outer.width - 2):
        part = lakes[start + 1 : stop + 1, 1:-1]
        n_cells += np.bincount(part.ravel(), minlength=len(n_cells))
        scratch.relax(lakes, start + 1, stop + 1)
    inside = [(lake, int(n)) for lake, n in zip(barriers.lakes, n_cells[1:], strict=True) if n]
    numbers = {id(lake): k + 1 for k, lake in enumerate(barriers.lakes)}
    levels = np.full(len(barriers.lakes), np.nan)
    n_shore = np.zeros(len(barriers.lakes), np.int64)
    width = max(SHORE_CELLS, SHORE_SPACINGS * spacing / outer.cell)
    unknown = [numbers[id(lake)] for lake, _ in inside if lake.level is None]
    for _ in range(WIDENINGS + 1):
        if not unknown:
            break
        heights = _shore_heights(points, outer, lakes, unknown, width, scratch)
        for number, found in heights.items():
            if len(found) >= SHORE_POINTS:
                levels[number - 1] = np.percentile(found, SHORE_PERCENT)
                n_shore[number - 1] = len(found)
        unknown = [number for number in unknown if math.isnan(levels[number - 1])]
        width *= 3
    documents = []
    for lake, n_of_lake in inside:
        k = numbers[id(lake)] - 1
        if lake.level is not None:
            levels[k] = lake.level
        documents.append(
            {
                "level": None if math.isnan(levels[k]) else float(levels[k]),
                "source": "file" if lake.level is not None else "shore",
                "points": int(n_shore[k]),
                "cells": n_of_lake,
            }
        )
    warnings = list(barriers.warnings)
    n_dry = sum(document["level"] is None for document in documents)
    if n_dry:
        warnings.append(
            CodedWarning(
                "W_LAKE_LEVEL",
                f"{n_dry} lakes have no ground near their shore to tell a level from: left void; "
                "give it in a field 'level' of the water file",
                n_dry,
            )
        )
    if not inside and not len(ends):
        warnings.append(
            CodedWarning(
                "W_VECTOR_OUTSIDE",
                "nothing of the break lines and water lies in the tile: the model is the one "
                "without them",
            )
        )
    document = {
        "lines": barriers.n_lines,
        "rivers": barriers.n_rivers,
        "cut_edges": 0 if cuts is None else cuts.count(),
        "lakes": documents,
    }
    return Placed(cuts, lakes, levels, scratch, document, warnings)


def _segments(shapes: tuple[Any, ...], outer: Grid) -> F64:
    """Return the segments near the grid as (n, 4) col, row of both ends in cells."""
    import shapely

    rim = RIM * outer.cell
    box = outer.bounds
    left, bottom, right, top = box.left, box.bottom, box.right, box.top
    near = shapely.clip_by_rect(
        np.array(shapes, object), left - rim, bottom - rim, right + rim, top + rim
    )
    return _sides(near, outer)


def _sides(shapes: Any, outer: Grid) -> F64:
    """Return the segments of lines as (n, 4) col, row of both ends in cells."""
    import shapely

    parts = shapely.get_parts(shapely.get_parts(shapes))
    parts = parts[shapely.get_dimensions(parts) == 1]
    box = outer.bounds
    left, top = box.left, box.top
    xy, part = shapely.get_coordinates(parts, return_index=True)
    places = np.column_stack([(xy[:, 0] - left) / outer.cell, (top - xy[:, 1]) / outer.cell])
    joined = part[1:] == part[:-1]
    return np.hstack([places[:-1][joined], places[1:][joined]])


def _fill(lake: Lake, outer: Grid, number: int, lakes: NDArray[np.int32]) -> None:
    """Set the nodes inside a lake to its number."""
    import shapely

    from volatool.kernels.lines import fill_rings

    rim = RIM * outer.cell
    box = outer.bounds
    left, bottom, right, top = box.left, box.bottom, box.right, box.top
    near = shapely.intersection(
        lake.polygon, shapely.box(left - rim, bottom - rim, right + rim, top + rim)
    )
    if near.is_empty or shapely.get_dimensions(near) != 2:
        return
    ends = _sides(outline(near), outer)
    cols, rows = ends[:, [0, 2]], ends[:, [1, 3]]
    # a window that begins left of the lake, so that every way into it is seen
    first_row, first_col = math.floor(rows.min()) - 1, math.floor(cols.min()) - 1
    shape = (math.ceil(rows.max()) + 1 - first_row, math.ceil(cols.max()) + 1 - first_col)
    window = np.zeros(shape, np.int32)
    fill_rings(fixed_point(ends), first_row, first_col, number, window)
    low_row, low_col = max(first_row, 0), max(first_col, 0)
    part = window[low_row - first_row :, low_col - first_col :]
    part = part[: lakes.shape[0] - low_row, : lakes.shape[1] - low_col]
    target = lakes[low_row : low_row + part.shape[0], low_col : low_col + part.shape[1]]
    target[part > 0] = number


def _shore_heights(
    points: SurfacePoints,
    outer: Grid,
    lakes: NDArray[np.int32],
    wanted: list[int],
    width: float,
    scratch: Scratch,
) -> dict[int, F64]:
    """Return the heights of the points within a band of so many cells round each lake."""
    from scipy.ndimage import distance_transform_edt, find_objects

    shore: NDArray[np.int32] = scratch.zeros(lakes.shape, np.int32)
    reach = math.ceil(width)
    boxes = find_objects(lakes)
    for number in wanted:
        box = boxes[number - 1] if number <= len(boxes) else None
        if box is None:
            continue
        window = tuple(
            slice(max(part.start - reach, 0), min(part.stop + reach, n))
            for part, n in zip(box, lakes.shape, strict=True)
        )
        near = distance_transform_edt(lakes[window] != number) <= width
        shore[window][near & (lakes[window] == 0)] = number
    found: dict[int, list[F64]] = {number: [] for number in wanted}
    for rows in points.pieces():
        row, col = _cells(rows, points, outer)
        numbers = shore[row, col]
        on_shore = np.flatnonzero(numbers)
        heights = rows[on_shore, 2] * points.scale[2] + points.offset[2]
        for number in np.unique(numbers[on_shore]).tolist():
            found[number].append(heights[numbers[on_shore] == number])
    scratch.free(shore)
    return {number: np.concatenate(parts) for number, parts in found.items() if parts}


def _cells(
    rows: NDArray[np.int32], points: SurfacePoints, outer: Grid
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return row and column of the cells that points are in, or the nearest ones."""
    col, row = outer.places(rows, points.scale, points.offset)
    return (
        np.clip(np.floor(row).astype(np.int64), 0, outer.height - 1),
        np.clip(np.floor(col).astype(np.int64), 0, outer.width - 1),
    )
