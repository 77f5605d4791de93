"""Which cells a tile's elevation model has, and which it is solved on, by the options."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

from volatool.dem.gather import SurfaceGatherer, SurfacePoints
from volatool.dem.grid import Grid, extended, grid_for
from volatool.dem.like import grid_like
from volatool.dem.neighbours import LEAST_CELLS, Box, Seam, common, meet_neighbours, sides_of
from volatool.dem.parameters import Parameters, check_unit, read_parameters
from volatool.dem.surfaces import gap_cells
from volatool.errors import InputError
from volatool.model import CrsInfo
from volatool.options import ConvertOptions
from volatool.points.source import Named, Source
from volatool.scratch import Scratch


def seam_of(
    surface: SurfaceGatherer, source: Source, options: ConvertOptions, scratch: Scratch
) -> Seam | None:
    """
    Return a tile's points with those of its neighbours.

    Parameters
    ----------
    surface : SurfaceGatherer
        Has seen the tile's points.
    source : Source
        The tile.
    options : ConvertOptions
        ``neighbours``, ``buffer`` and what fixes the cells.
    scratch : Scratch
        Where points wait.

    Returns
    -------
    seam : Seam or None
        None without ``--neighbours``, or without a point of the tile.
    """
    if not options.neighbours or surface.box is None:
        return None
    own = own_grid(surface.box, source, options)
    assert own is not None, "a cell that the options were checked for"
    gap, unit = options.max_gap, source.crs.metres_per_unit_xy
    cells = gap_cells(source.crs, own.cell, None if gap is None else float(gap.in_units(unit)))
    return meet_neighbours(surface, own, source, options, scratch, cells)


def grids_of(
    points: SurfacePoints, source: Named, options: ConvertOptions
) -> tuple[Grid | None, Grid | None]:
    """
    Return the cells to write and those to solve for; None where they follow from the points.

    Parameters
    ----------
    points : SurfacePoints
        With a box.
    source : Source
        The tile.
    options : ConvertOptions
        ``cell``, ``like``, ``params_from``.
    """
    box = points.box
    own = None if box is None else own_grid(box, source, options)
    if own is None or box is None or options.like is None:
        return own, own
    # points just outside bear on the surface inside
    return own, extended(own, common(box, sides_of(own.padded(LEAST_CELLS))))


def shared_parameters(options: ConvertOptions, crs: CrsInfo) -> Parameters | None:
    """
    Return what all tiles of a set have in common, if it is given.

    Parameters
    ----------
    options : ConvertOptions
        ``params_from``.
    crs : CrsInfo
        Of the tile.
    """
    if options.params_from is None:
        return None
    parameters = read_parameters(Path(options.params_from))
    check_unit(parameters, crs)
    return parameters


def own_grid(box: Box, source: Named, options: ConvertOptions) -> Grid | None:
    """
    Return a tile's cells; None when they follow from its points.

    Parameters
    ----------
    box : tuple of 4 Fraction
        Of its points.
    source : Named
        The tile.
    options : ConvertOptions
        ``cell``, ``like``, ``params_from``.
    """
    if options.like is not None:
        grid = grid_like(Path(options.like), source.crs)
        left, bottom, right, top = sides_of(grid)
        if box[0] > right or box[2] < left or box[1] > top or box[3] < bottom:
            raise InputError(f"{source.name}: no point lies inside --like {options.like}")
        return grid
    cell: Fraction | None = None
    if not isinstance(options.cell, str):
        cell = options.cell.in_units(source.crs.metres_per_unit_xy)
    elif options.params_from is not None:
        cell = read_parameters(Path(options.params_from)).cell
    return None if cell is None else grid_for(box, cell)
