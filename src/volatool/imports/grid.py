"""Cells of a regular grid as points: their middles, and the cube and depth that they belong to."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from fractions import Fraction

import numpy as np

from volatool.cube import MAX_DEPTH, Cube
from volatool.errors import ResourceError
from volatool.imports.model import Batch, ImportedPoints
from volatool.model import F64, I32, CrsInfo

BYTES_A_CELL = 64
"""What a cell takes while it is listed, for the limit that ``--memory`` sets."""


def cell_points(
    name: str,
    cells: Callable[[], Iterator[I32]],
    shape: Sequence[int],
    origin: Sequence[Fraction],
    cell: Fraction,
    crs: CrsInfo | None = None,
) -> ImportedPoints:
    """
    Return the points of a grid's cells.

    Parameters
    ----------
    name : str
        Of the format.
    cells : callable
        Yields (n, 3) arrays of cell numbers x, y, z from the corner, as often as called.
    shape : sequence of 3 int
        Cells along x, y, z.
    origin : sequence of 3 Fraction
        Corner, in the horizontal unit.
    cell : Fraction
        Edge of a cell, same unit.
    crs : CrsInfo, optional
        What the file says.

    Returns
    -------
    points : ImportedPoints
        Its grid is the cube at the corner with the fewest levels that holds all cells.

    Raises
    ------
    ResourceError
        ``E_SIZE``: more cells a side than `MAX_DEPTH` levels have.
    """
    longest = max(shape)
    depth = 1
    while 4**depth < longest:
        depth += 1
    if depth > MAX_DEPTH:
        raise ResourceError(
            f"has {longest} cells a side, more than the {4**MAX_DEPTH} of {MAX_DEPTH} levels",
            "E_SIZE",
        )
    return voxel_points(name, cells, Cube.from_exact(origin, cell * 4**depth), depth, crs)


def voxel_points(
    name: str,
    voxels: Callable[[], Iterator[I32]],
    cube: Cube,
    depth: int,
    crs: CrsInfo | None = None,
) -> ImportedPoints:
    """
    Return the middles of a cube's voxels as points.

    Parameters
    ----------
    name : str
        Of the format.
    voxels : callable
        Yields (n, 3) arrays of voxel numbers x, y, z, as often as called.
    cube : Cube
        Their cube.
    depth : int
        Their level.
    crs : CrsInfo, optional
        What the file says.
    """

    def batches(n_rows: int) -> Iterator[Batch]:
        start = 0
        for part in voxels():
            for at in range(0, len(part), n_rows):
                rows = part[at : at + n_rows]
                yield Batch(start + at, _middles(rows, cube, depth))
            start += len(part)

    return ImportedPoints(name, batches, grid=(cube, depth), crs=crs, is_cubic=True)


def _middles(voxels: I32, cube: Cube, depth: int) -> F64:
    cell = float(cube.exact[3] / 4**depth)
    with np.errstate(over="ignore", invalid="ignore"):  # the reader refuses what is not finite
        middles: F64 = np.asarray(cube.origin) + (voxels + 0.5) * cell
    return middles
