"""Points beyond a tile's edge, so that its elevation model meets the neighbours' at the seam.

Only what matters is read: of each neighbour the header, and of those whose box meets the buffer
the points inside it. A data gap at the seam lets what lies behind it bear on the tile, so that the
buffer grows beyond it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from volatool import resources
from volatool.dem.cell import mean_spacing, occupied
from volatool.dem.gather import ROW, SHARE, Beyond, SurfaceGatherer, SurfacePoints
from volatool.dem.grid import Grid, extended
from volatool.errors import CodedWarning, CRSError, VolatoolError
from volatool.model import Bounds, CrsInfo, as_fraction
from volatool.naming import SET_SUFFIX
from volatool.remote.path import path_of
from volatool.scratch import Scratch, Spool

if TYPE_CHECKING:
    from volatool.options import ConvertOptions
    from volatool.points.source import Source

Box = tuple[Fraction, Fraction, Fraction, Fraction]

LEAST_CELLS = 32
"""Cells beyond a seam, or beyond a gap at it, after which the surface is the same to 1 mm."""

LEAST_SPACINGS = 12
"""The same where cells are finer than the points."""

FILTER_M = 128
"""The same in metres where the ground filter chooses the points: eight of its coarsest cells."""

MOST_CELLS = 512
"""No buffer that is chosen is wider."""

GAP_SPACINGS, GAP_CELLS = 5, 10
"""A gap is made of empty squares of so many mean spacings, at least so many cells a side."""


@dataclass(frozen=True, slots=True)
class Seam:
    """
    What a tile's elevation model is made from and where.

    Parameters
    ----------
    points : SurfacePoints
        The tile's and those in the buffer.
    own, grid : Grid
        The tile's cells; those to solve for: the buffer's too, where any file is.
    document : dict
        The report's ``dem.buffer``.
    warnings : tuple of CodedWarning
        What came up.
    """

    points: SurfacePoints
    own: Grid
    grid: Grid
    document: dict[str, Any]
    warnings: tuple[CodedWarning, ...] = ()


@dataclass(frozen=True, slots=True)
class Neighbour:
    """A file that may have points beyond a tile's edge, with its header's box and CRS."""

    path: Path
    box: Box | None
    crs: CrsInfo = field(hash=False)

    def meets(self, box: Box) -> bool:
        """Whether points may lie in a box; a header without one may mean any place."""
        mine = self.box
        return mine is None or (
            mine[0] <= box[2] and box[0] <= mine[2] and mine[1] <= box[3] and box[1] <= mine[3]
        )


@lru_cache(maxsize=1 << 16)
def _neighbour(path: Path, stamp: tuple[int, int], options: ConvertOptions) -> Neighbour | None:
    """Return what a header says, None without points; once for a file that many tiles have."""
    from volatool.opening import open_source

    del stamp  # a file that has changed is another one
    with open_source(path, options) as source:
        header = source.header
        left, bottom, _, right, top, _ = header.box
        if not source.n_points:
            return None
        if not (left <= right and bottom <= top and np.all(np.isfinite(header.box))):
            return Neighbour(path, None, source.crs)
        sides = [as_fraction(value) for value in (left, bottom, right, top)]
        box = (sides[0], sides[1], sides[2], sides[3])
        return Neighbour(path, box, source.crs)


def find_neighbours(source: Source, options: ConvertOptions, box: Box) -> list[Neighbour]:
    """
    Return the files named by ``--neighbours`` but the tile itself, their headers read.

    Parameters
    ----------
    source : Source
        The tile.
    options : ConvertOptions
        Names: folders, files, patterns, ``@list``; CRS options hold for neighbours too. Of an index
        of headers (``NAME.set.json``) those near the tile are taken, and no header is read.
    box : tuple of 4 Fraction
        No buffer is wider: left, bottom, right, top.

    Raises
    ------
    VolatoolError
        As of the neighbour's own; ``E_NOT_FOUND`` for one that is not there.
    """
    from volatool.batch.plan import expand
    from volatool.catalog.headers import opening_options

    own = path_of(source.path).resolve()
    found = []
    names = [name for name in options.neighbours if not name.endswith(SET_SUFFIX)]
    for name in set(options.neighbours).difference(names):
        found += [item for item in _indexed(Path(name), box) if item.path != own]
    for path in expand(names) if names else ():
        if path.resolve() == own:
            continue
        try:
            state = path.stat()
            stamp = (state.st_mtime_ns, state.st_size)
        except (OSError, ValueError):
            stamp = (0, 0)  # opening it says what is wrong
        try:
            neighbour = _neighbour(path, stamp, opening_options(options))
        except VolatoolError as error:
            raise type(error)(f"neighbour {error}", error.code) from error
        if neighbour is not None:
            found.append(neighbour)
    return found


def _indexed(path: Path, box: Box) -> list[Neighbour]:
    """Return the files of an index that a box meets."""
    from volatool.catalog.headers import read_set

    index = read_set(path)
    found = []
    for number in index.near(*(float(side) for side in box)):
        left, bottom, _, right, top, _ = (float(side) for side in index.boxes[number])
        sides = None
        if not math.isnan(left):
            sides = (as_fraction(left), as_fraction(bottom), as_fraction(right), as_fraction(top))
        found.append(Neighbour(index.paths[number], sides, index.crs_at(number)))
    return found


def meet_neighbours(
    surface: SurfaceGatherer,
    own: Grid,
    source: Source,
    options: ConvertOptions,
    scratch: Scratch,
    gap: float,
) -> Seam:
    """
    Return the tile's points with those beyond its edge that bear on its elevation model.

    Parameters
    ----------
    surface : SurfaceGatherer
        Has seen the tile's points.
    own : Grid
        The tile's cells.
    source : Source
        The tile.
    options : ConvertOptions
        ``neighbours``, ``buffer``, and the selection of points, which holds for neighbours too.
    scratch : Scratch
        Where points wait.
    gap : float
        ``max_gap`` in cells: what is filled depends on points up to twice as far away.
    """
    # with --like the cells may go on where no file is: that is no gap
    tile = sides_of(own) if surface.box is None else common(sides_of(own), surface.box)
    spacing = surface.spacing(source.crs) / own.cell
    cells = max(LEAST_CELLS, math.ceil(max(2 * gap, LEAST_SPACINGS * spacing)))
    if surface.is_bare and not surface.has_ground:
        cells = max(
            cells, math.ceil(FILTER_M / float(source.crs.metres_per_unit_xy or 1) / own.cell)
        )
    if options.buffer is not None:
        length = options.buffer.in_units(source.crs.metres_per_unit_xy)
        cells = math.ceil(length / own.exact[2])
    files = find_neighbours(source, options, sides_of(own.padded(max(MOST_CELLS, cells))))
    while True:
        box, near, grid = _reach(files, own, cells)
        for item in near:
            _check_crs(item, source)
        beyond, used, warnings = _read(near, box, surface, options, scratch)
        points = surface.result(source.crs, beyond, resources.n_threads())
        spacing = mean_spacing(points, source.crs.metres_per_unit_xy) / own.cell
        needed, is_open = _needed(points, own, tile, grid, near, spacing)
        wider = min(max(MOST_CELLS, cells), max(needed, 3 * cells if is_open else 0))
        is_enough = wider <= cells or _reach(files, own, wider)[2] == grid
        if options.buffer is not None or is_enough:
            break
        beyond.spool.close()
        if points.spool is not surface.spool:
            points.spool.close()
        cells = wider
    if needed > cells and _reach(files, own, needed)[2] != grid:
        warnings.append(
            CodedWarning(
                "W_SEAM_GAP",
                f"a gap in the data at the tile's edge needs a buffer of {needed} cells or more, "
                f"this one has {cells}: the models of neighbours may differ there by more than "
                "1 mm; give a longer --buffer",
            )
        )
    document = {
        "cells": cells,
        "length": float(cells * own.exact[2]),
        "neighbours": used,
        "points": len(beyond.spool),
    }
    if points.spool is not surface.spool:  # the ground filter's
        surface.close()
        beyond.spool.close()
    return Seam(points, own, grid, document, tuple(warnings))


def _reach(files: list[Neighbour], own: Grid, cells: int) -> tuple[Box, list[Neighbour], Grid]:
    """Return the box of a buffer, the files that meet it, and the cells that any file is in."""
    box = sides_of(own.padded(cells))
    near = [item for item in files if item.meets(box)]
    grid = own
    for item in near:
        grid = extended(grid, box if item.box is None else common(item.box, box))
    return box, near, grid


def sides_of(grid: Grid) -> Box:
    """Return exact left, bottom, right, top of a grid."""
    left, top, cell = grid.exact
    return (left, top - grid.height * cell, left + grid.width * cell, top)


def common(one: Box, other: Box) -> Box:
    """Return what two boxes that meet have in common."""
    return (
        max(one[0], other[0]),
        max(one[1], other[1]),
        min(one[2], other[2]),
        min(one[3], other[3]),
    )


def _check_crs(item: Neighbour, source: Source) -> None:
    """Refuse points that are in another CRS or other units."""
    mine, theirs = source.crs, item.crs
    for what, a, b in (
        ("CRS", mine.horizontal, theirs.horizontal),
        ("horizontal unit", mine.metres_per_unit_xy, theirs.metres_per_unit_xy),
        ("vertical unit", mine.unit_z or mine.unit_xy, theirs.unit_z or theirs.unit_xy),
        ("vertical CRS", mine.vertical, theirs.vertical),
    ):
        # a file that says nothing is taken for one like the tile
        if a is not None and b is not None and a != b:
            raise CRSError(
                f"neighbour {item.path.name}: its {what} is {b}, the tile's is {a}; "
                "give --to-crs, or --crs if one of them is wrong"
            )


def _read(
    near: list[Neighbour],
    box: Box,
    surface: SurfaceGatherer,
    options: ConvertOptions,
    scratch: Scratch,
) -> tuple[Beyond, list[str], list[CodedWarning]]:
    """Read the points of the neighbours inside a box."""
    from volatool.opening import open_source
    from volatool.points.reader import PointSource
    from volatool.points.select import selection_for

    beyond = Beyond(Spool(scratch, ROW, SHARE))
    used, warnings = [], []
    sides = (float(box[0]), float(box[1]), float(box[2]), float(box[3]))
    selection = replace(selection_for(options), bounds=Bounds(*sides))
    for item in near:
        before, n_seen, n_ground = len(beyond.spool), 0, 0
        with open_source(item.path, options) as source:
            names = selection.attributes(source.header) | (
                surface.wanted & source.header.dimensions
            )
            room = max(1000, (options.memory // 8) // (source.header.record_bytes + 100))
            size = min(options.chunk_points, room)
            # the box of points that are reprojected is in another CRS than the file's octree
            where = {"near": sides} if isinstance(source, PointSource) else {}
            for chunk in source.chunks(names, size, **where):
                mask = selection.mask(chunk, {})
                taken = chunk if mask is None else chunk.take(mask)
                n_seen += len(taken)
                n_ground += surface.add_beyond(taken, beyond)
        if len(beyond.spool) > before:
            used.append(item.path.name)
        if surface.is_bare and n_seen and bool(n_ground) != surface.has_ground:
            with_it, without = ("the tile", "it") if surface.has_ground else ("it", "the tile")
            warnings.append(
                CodedWarning(
                    "W_NEIGHBOUR_GROUND",
                    f"neighbour {item.path.name}: {with_it} has points of the ground class (2) and "
                    f"{without} has none; the seam is between two kinds of ground",
                )
            )
    return beyond, used, warnings


def _needed(
    points: SurfacePoints, own: Grid, tile: Box, grid: Grid, near: list[Neighbour], spacing: float
) -> tuple[int, bool]:
    """
    Return the cells that a buffer must have, and whether a gap at the seam goes on beyond it.

    Gaps are empty squares inside the files' boxes, side by side.
    """
    from scipy.ndimage import label

    edge = max(GAP_CELLS, math.ceil(GAP_SPACINGS * spacing))
    # squares begin at the tile's corner, so that none is partly inside
    before = [-(-_offset(own, grid, axis) // edge) for axis in (0, 1)]
    top, left, cell = own.exact[1], own.exact[0], own.exact[2]
    shape = [
        before[axis] + -(-((grid.height, grid.width)[axis] - _offset(own, grid, axis)) // edge)
        for axis in (0, 1)
    ]
    corner = (left - before[1] * edge * cell, top + before[0] * edge * cell)
    squares = Grid(
        float(corner[0]),
        float(corner[1]),
        float(edge * cell),
        shape[1],
        shape[0],
        (*corner, edge * cell),
    )
    empty = occupied(points, squares) == 0
    inside = np.zeros(empty.shape, bool)
    rows, cols = _squares_of(sides_of(own), squares)
    for box in (tile, *(item.box or sides_of(grid) for item in near)):
        inside[_squares_of(box, squares, is_half=True)] = True
    numbers, _ = label(empty & inside)
    # a gap touches the seam if it has a square in the tile or next to it
    around = tuple(slice(max(0, part.start - 1), part.stop + 1) for part in (rows, cols))
    at_seam = np.unique(numbers[around])
    found = np.argwhere(np.isin(numbers, at_seam[at_seam > 0]))
    if not len(found):
        return LEAST_CELLS, False
    reach = 0
    is_open = False
    for axis, part in enumerate((rows, cols)):
        low, high = int(found[:, axis].min()), int(found[:, axis].max())
        reach = max(reach, (part.start - low) * edge, (high + 1 - part.stop) * edge)
        is_open |= low < part.start and low == 0
        is_open |= high >= part.stop and high == empty.shape[axis] - 1
    return (reach + LEAST_CELLS if reach > 0 else LEAST_CELLS), is_open


def _offset(own: Grid, grid: Grid, axis: int) -> int:
    """Return rows above (axis 0) or columns left of a grid inside another."""
    if axis == 0:
        return int((grid.exact[1] - own.exact[1]) / own.exact[2])
    return int((own.exact[0] - grid.exact[0]) / own.exact[2])


def _squares_of(box: Box, squares: Grid, is_half: bool = False) -> tuple[slice, slice]:
    """Return the rows and columns of squares that meet a box, or whose middle is in it."""
    left, top, edge = squares.exact
    ends = (
        (top - box[3], top - box[1], squares.height),
        (box[0] - left, box[2] - left, squares.width),
    )
    parts = []
    for low, high, n in ends:
        if is_half:
            first, last = (
                math.ceil(low / edge - Fraction(1, 2)),
                math.floor(high / edge + Fraction(1, 2)),
            )
        else:
            first, last = math.floor(low / edge), math.ceil(high / edge)
        first = min(max(0, first), n)
        parts.append(slice(first, max(first, min(n, last))))
    return parts[0], parts[1]


def seam_warning(options: ConvertOptions, surface: str, has_springs: bool) -> list[CodedWarning]:
    """Say when tiles of a set choose the stiffness each for itself."""
    if not options.neighbours or has_springs or options.preset != "emap":
        return []
    if surface not in ("dtm", "dsm"):
        return []
    return [
        CodedWarning(
            "W_SEAM_SPRINGS",
            "the stiffness follows from this tile's points, that of its neighbours from theirs: "
            "models differ a little along the seam; --params-from gives all of them the same",
        )
    ]
