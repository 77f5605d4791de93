"""Points held out of a fit: scattered ones and whole blocks of them, chosen by hashes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from volatool.dem.gather import ROW, SHARE, SurfacePoints
from volatool.dem.grid import Grid, grid_for
from volatool.scratch import Scratch, Spool

BLOCK_M = Fraction(10)
"""Smallest edge of a held-out block in metres, where the tile is large enough."""

BLOCK_SPACINGS = 10
"""And in mean spacings of the points."""

TILE_PARTS = 5
"""A block is at most such a part of the tile's longer side."""

POINT_SALT, BLOCK_SALT, FEW_SALT = 11, 12, 13


@dataclass(frozen=True, slots=True)
class Split:
    """
    Which points are held out; hangs on the points' stored integers, not on their order.

    Parameters
    ----------
    blocks : Grid
        Square blocks over the tile.
    chosen : (h, w) array of bool
        Blocks that are held out whole.
    share : float
        Part of the other points that is held out, scattered.
    salt : int
        Another salt, another choice.
    """

    blocks: Grid
    chosen: NDArray[np.bool_]
    share: float
    salt: int = 0

    def held(self, points: SurfacePoints, rows: NDArray[np.int32]) -> NDArray[np.bool_]:
        """
        Return which points are held out.

        Parameters
        ----------
        points : SurfacePoints
            For the scaling.
        rows : (n, 3) array of int32
            Stored x, y, z.
        """
        from volatool.kernels import chance

        bits = np.empty(len(rows), np.uint64)
        chance.hash_rows(rows, POINT_SALT + self.salt, bits)
        out: NDArray[np.bool_] = bits < np.uint64(int(self.share * 2.0**64))
        return out | self.chosen.ravel()[self.block_of(points, rows)]

    def block_of(self, points: SurfacePoints, rows: NDArray[np.int32]) -> NDArray[np.int64]:
        """Return the number of each point's block, row by row from the top left."""
        col, row = self.blocks.places(rows, points.scale, points.offset)
        q = np.minimum(col.astype(np.int64), self.blocks.width - 1)
        r = np.minimum(row.astype(np.int64), self.blocks.height - 1)
        return r * self.blocks.width + q


def block_edge(points: SurfacePoints, spacing: float, metres_per_unit: Fraction | None) -> Fraction:
    """Return the edge of a block: 10 m or 10 spacings, at most a fifth of the tile's side."""
    assert points.box is not None
    left, bottom, right, top = points.box
    edge = max(BLOCK_M / (metres_per_unit or 1), Fraction(BLOCK_SPACINGS * spacing))
    side = max(right - left, top - bottom)
    edge = min(edge, side / TILE_PARTS) if side else edge
    return edge.limit_denominator(1000) or edge


def split(
    points: SurfacePoints,
    scattered: float,
    blocked: float,
    spacing: float,
    metres_per_unit: Fraction | None,
    salt: int = 0,
) -> Split:
    """
    Choose points to hold out: some scattered, some in whole blocks.

    Parameters
    ----------
    points : SurfacePoints
        At least one point.
    scattered, blocked : float
        Parts of the points, about.
    spacing : float
        Mean spacing of the points, in the horizontal unit.
    metres_per_unit : Fraction or None
        Of the CRS; None counts as 1.
    salt : int
        Another salt, another choice.

    Returns
    -------
    split : Split
        Of the blocks that hold points, those with the smallest hashes of their place: at least
        one, and never all.
    """
    from volatool.dem.cell import occupied
    from volatool.kernels import chance

    assert points.box is not None
    blocks = grid_for(points.box, block_edge(points, spacing, metres_per_unit))
    left, top, edge = blocks.exact
    row, col = np.nonzero(occupied(points, blocks))
    places = np.column_stack([col + int(left / edge), row - int(top / edge), np.zeros_like(col)])
    bits = np.empty(len(row), np.uint64)
    chance.hash_rows(places.astype(np.int32), BLOCK_SALT + salt, bits)
    n = min(len(row) - 1, max(1, round(blocked * len(row))))
    chosen = np.zeros((blocks.height, blocks.width), bool)
    first = np.argsort(bits, kind="stable")[:n]
    chosen[row[first], col[first]] = True
    return Split(blocks, chosen, scattered / (1 - blocked), salt)


class Some:
    """
    Some of a surface's points, picked anew at each pass.

    Parameters
    ----------
    points : SurfacePoints
        All points; must stay open.
    keep : callable
        Tells which of some rows are taken.
    """

    def __init__(
        self, points: SurfacePoints, keep: Callable[[NDArray[np.int32]], NDArray[np.bool_]]
    ) -> None:
        self.points, self.keep = points, keep
        self.n_rows = sum(map(len, self.pieces()))

    def __len__(self) -> int:
        return self.n_rows

    def pieces(self) -> Iterator[NDArray[np.int32]]:
        """Yield the rows in order."""
        for rows in self.points.pieces():
            some = rows[self.keep(rows)]
            if len(some):
                yield some

    def close(self) -> None:
        """Do nothing: the rows belong to the whole."""

    def as_points(self) -> SurfacePoints:
        """Return the same as points, over the extent of all."""
        return replace(self.points, spool=self, beyond=None)  # type: ignore[arg-type]


def part(points: SurfacePoints, chosen: Split, *, held: bool) -> SurfacePoints:
    """
    Return the points held out, or the others, over the same extent; nothing is copied.

    Parameters
    ----------
    points : SurfacePoints
        All points; must stay open.
    chosen : Split
        Which are held out.
    held : bool
        Those, or the others.
    """
    return Some(points, lambda rows: chosen.held(points, rows) == held).as_points()


def within(points: SurfacePoints, grid: Grid) -> SurfacePoints:
    """Return the points that lie on a grid, over the same extent; nothing is copied."""
    box = points.box
    left, top, cell = grid.exact
    right, bottom = left + grid.width * cell, top - grid.height * cell
    if box is None or (left <= box[0] and bottom <= box[1] and box[2] <= right and box[3] <= top):
        return points

    def keep(rows: NDArray[np.int32]) -> NDArray[np.bool_]:
        col, row = grid.places(rows, points.scale, points.offset)
        found: NDArray[np.bool_] = (col >= 0) & (col <= grid.width)
        return found & (row >= 0) & (row <= grid.height)

    return Some(points, keep).as_points()


def some(points: SurfacePoints, limit: int, scratch: Scratch) -> SurfacePoints:
    """
    Return points for many readings: about so many at most, by a hash, in a spool of their own.

    Parameters
    ----------
    points : SurfacePoints
        Any.
    limit : int
        More are thinned evenly.
    scratch : Scratch
        Where they wait; close the result after use.
    """
    from volatool.kernels import chance

    spool = Spool(scratch, ROW, SHARE)
    share = limit / max(1, len(points))
    for rows in points.pieces():
        if share < 1:
            bits = np.empty(len(rows), np.uint64)
            chance.hash_rows(rows, FEW_SALT, bits)
            rows = rows[bits < np.uint64(int(share * 2.0**64))]
        spool.append(rows)
    return replace(points, spool=spool, beyond=None)
