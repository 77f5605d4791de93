"""Cell size from the data: the smallest cell that most of the data can fill; mean spacing."""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from volatool.dem.gather import SurfacePoints
from volatool.dem.grid import Grid, grid_for

CANDIDATES = tuple(Fraction(value) for value in ("0.1", "0.25", "0.5", "1", "2", "5", "10"))
"""Cell edges in metres."""

FOOTPRINT = Fraction(10)
"""Edge in metres of the cells that make the data's footprint."""

SCAN_FOOTPRINT, SCAN_EXTENT, SCAN_DENSITY = Fraction(2), 100, 10
"""The same for scans from the ground: points within 100 m, more than 10 per square metre."""

COVERAGE = 0.6
"""Part of the cells inside the footprint that must hold a point."""

SPACING_CELL = Fraction(5)
"""Edge in metres of the cells over which the mean spacing is taken."""


MAX_LARGE = 1 << 24
"""Cells of a footprint, 41 km a side: bounds memory when a few points lie far off."""


@dataclass(frozen=True, slots=True)
class CellChoice:
    """
    The cell that was chosen and why.

    Parameters
    ----------
    cell : Fraction
        Edge, in units of the CRS.
    cell_m : Fraction
        The same as it was tried, in metres (or in units when the CRS says none).
    coverage : float
        Part of the footprint's cells that hold a point.
    """

    cell: Fraction
    cell_m: Fraction
    coverage: float


def choose_cell(
    points: SurfacePoints, metres_per_unit: Fraction | None, *, least: Fraction | None = None
) -> CellChoice:
    """
    Return the smallest candidate at which 60 % of the cells in the data's footprint hold a point.

    The footprint is made of the 10 m cells that hold any point of the surface; of 2 m cells for
    scans from the ground (many points within 100 m), whose density falls off fast. Candidates are
    the edges that divide it; those that the number of points rules out are skipped. None suits:
    the largest.

    Parameters
    ----------
    points : SurfacePoints
        The surface's points.
    metres_per_unit : Fraction or None
        Of the CRS; None counts as 1.
    least : Fraction, optional
        No cell is smaller than this, in units of the CRS (but none is larger than the largest).

    Returns
    -------
    choice : CellChoice
        In units of the CRS.
    """
    from volatool.kernels import binning

    unit = metres_per_unit or Fraction(1)
    box = points.box
    if box is None or not len(points):
        return CellChoice(Fraction(1) / unit, Fraction(1), 0.0)
    width, height = (box[2] - box[0]) * unit, (box[3] - box[1]) * unit
    is_scan = max(width, height) < SCAN_EXTENT and len(points) > SCAN_DENSITY * width * height
    footprint = SCAN_FOOTPRINT if is_scan else FOOTPRINT
    candidates = [cell for cell in CANDIDATES if footprint % cell == 0]
    if least is not None:
        candidates = [cell for cell in candidates if cell >= least * unit] or candidates[-1:]
    large = grid_for(box, footprint / unit, MAX_LARGE)
    cells = occupied(points, large)
    n_large = int(np.count_nonzero(cells))
    # empty cells share a number with the one before: no point asks for theirs
    number = np.cumsum(cells, dtype=np.int32).reshape(cells.shape) - np.int32(1)
    coverage = 0.0
    for cell_m in candidates:
        parts = int(footprint / cell_m)
        n_cells = n_large * parts**2
        if len(points) < COVERAGE * n_cells and cell_m != candidates[-1]:
            continue
        left, top, edge = large.exact
        small = Grid(
            large.left,
            large.top,
            float(edge / parts),
            large.width * parts,
            large.height * parts,
            (left, top, edge / parts),
        )
        bits = np.zeros(-(-n_cells // 8), np.uint8)
        n_set = 0
        for rows in points.pieces():
            col, row = small.places(rows, points.scale, points.offset)
            n_set += binning.mark_parts(col, row, number, parts, bits)
        coverage = n_set / n_cells
        if coverage >= COVERAGE:
            break
    return CellChoice(cell_m / unit, cell_m, coverage)


def occupied(points: SurfacePoints, grid: Grid) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
    """Return the (h, w) array of uint8 that is 1 in cells that hold a point of the surface."""
    from volatool.kernels import surface

    cells = np.zeros((grid.height, grid.width), np.uint8)
    lattice = grid.lattice(points.scale, points.offset)
    for rows in points.pieces():
        surface.mark_cells(rows, lattice, cells)
    return cells


def mean_spacing(points: SurfacePoints, metres_per_unit: Fraction | None) -> float:
    """
    Return the mean spacing s of the points where there are points.

    ``s = sqrt(A / n)``: n points; A the area of the cells that hold any, cells of 5 m or, for
    sparse points, of 1.5 times the spacing over the bounding box. Voids don't count, and s does
    not depend on the DEM's cell.

    Parameters
    ----------
    points : SurfacePoints
        At least one point.
    metres_per_unit : Fraction or None
        Of the CRS; None counts as 1.

    Returns
    -------
    spacing : float
        In units of the CRS.
    """
    box = points.box
    if box is None or not len(points):
        return float(SPACING_CELL / (metres_per_unit or 1))
    area = float((box[2] - box[0]) * (box[3] - box[1]))
    edge = max(
        float(SPACING_CELL / (metres_per_unit or 1)),
        1.5 * math.sqrt(area / len(points)),
        2 * math.sqrt(area / MAX_LARGE),
    )
    cells = occupied(points, grid_for(box, edge))
    return math.sqrt(np.count_nonzero(cells) * edge**2 / len(points))
