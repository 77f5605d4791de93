"""How many neighbours voxels have: exactly, or inside their block alone."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from volatool.errors import OptionError
from volatool.model import I64, U64

if TYPE_CHECKING:
    from volatool.vola.volume import Volume

MAX_RADIUS = 16.0
"""Largest radius, in cells."""

_SQUARES = {6: 1.0, 18: 2.0, 26: 3.0}
_SLAB = 1 << 18


@dataclass(frozen=True, slots=True)
class NeighbourError:
    """
    What counting inside blocks alone misses, over all voxels of a volume.

    Parameters
    ----------
    connectivity : int
        Neighbours of a cell: 6, 18 or 26.
    voxels : int
        Voxels counted at.
    mean_exact, mean_by_block : float
        Mean number of neighbours that are set, across the borders of blocks and inside them.
    share : float
        Part of the neighbours that is found inside blocks; 1 without any.
    share_if_full : float
        The same where every cell is set: 0.75 of 6, 0.5625 of 26.
    right : float
        Part of the voxels whose count is right.
    rmse : float
        Root mean square of what is missed per voxel.
    """

    connectivity: int
    voxels: int
    mean_exact: float
    mean_by_block: float
    share: float
    share_if_full: float
    right: float
    rmse: float

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON object."""
        return {name: getattr(self, name) for name in self.__slots__}


def count(
    volume: Volume,
    xyz: ArrayLike,
    *,
    connectivity: int = 26,
    radius: float | None = None,
    exact: bool = True,
) -> I64:
    """
    Count the voxels around the cells that points fall into.

    Parameters
    ----------
    volume : Volume
        The voxels.
    xyz : (n, 3) array of float
        In units of the CRS, z in the vertical unit. The cell need not be set, and is not counted.
    connectivity : int
        Neighbours of a cell: the 6 that share a face, 18 with those that share an edge, or all 26.
    radius : float, optional
        In cells, instead: those whose centre is at most so far from the centre of the cell; up to
        `MAX_RADIUS`.
    exact : bool
        Across the borders of blocks. False: only neighbours in the cell's own 4 x 4 x 4 block, by
        one mask and popcount [Byrne2018]_; never more than the exact count (`error_by_block`).

    Returns
    -------
    counts : (n,) array of int64
        -1 for points outside the cube or not finite.

    Raises
    ------
    OptionError
        Another connectivity, or a radius that is not in 0 to `MAX_RADIUS`.
    """
    return count_cells(
        volume,
        volume.cell_indices(xyz),
        connectivity=connectivity,
        radius=radius,
        exact=exact,
    )


def count_cells(
    volume: Volume,
    cells: I64,
    *,
    connectivity: int = 26,
    radius: float | None = None,
    exact: bool = True,
) -> I64:
    """
    Count the voxels around cells; see `count`.

    Parameters
    ----------
    volume : Volume
        The voxels.
    cells : (n, 3) array of int64
        x, y, z inside the grid, set or not; negative for none.
    connectivity, radius, exact
        As for `count`.
    """
    from volatool.kernels import neighbours

    square = _square(connectivity)
    if radius is not None:
        if not 0 <= radius <= MAX_RADIUS:
            raise OptionError(f"the radius must be 0 to {MAX_RADIUS:g} cells, got {radius:g}")
        square = float(radius) ** 2
    offsets, masks = _masks(square)
    if not exact:
        own = (offsets == 0).all(axis=1)
        offsets, masks = offsets[own], np.ascontiguousarray(masks[:, own])
    counts = np.empty(len(cells), np.int64)
    neighbours.count(volume.directory.rows, volume.depth, cells, offsets, masks, counts)
    return counts


def error_by_block(volume: Volume, connectivity: int = 26) -> NeighbourError:
    """
    Measure what counting inside blocks alone misses.

    Parameters
    ----------
    volume : Volume
        All its voxels are counted at.
    connectivity : int
        6, 18 or 26.

    Returns
    -------
    error : NeighbourError
        Exact.
    """
    offsets, masks = _masks(_square(connectivity))
    own = (offsets == 0).all(axis=1)
    voxels = volume.voxels()
    sums = np.zeros(4, np.int64)  # exact, by block, right, squares of what is missed
    for start in range(0, len(voxels), _SLAB):
        cells = voxels[start : start + _SLAB].astype(np.int64)
        exact = count_cells(volume, cells, connectivity=connectivity)
        inside = count_cells(volume, cells, connectivity=connectivity, exact=False)
        missed = exact - inside
        sums += [exact.sum(), inside.sum(), (missed == 0).sum(), (missed**2).sum()]
    n_exact, n_inside, n_right, squares = sums.tolist()
    n = len(voxels)
    return NeighbourError(
        connectivity=connectivity,
        voxels=n,
        mean_exact=n_exact / max(n, 1),
        mean_by_block=n_inside / max(n, 1),
        share=n_inside / n_exact if n_exact else 1.0,
        share_if_full=int(np.bitwise_count(masks[:, own]).sum(dtype=np.int64))
        / int(np.bitwise_count(masks).sum(dtype=np.int64)),
        right=n_right / n if n else 1.0,
        rmse=float(np.sqrt(squares / max(n, 1))),
    )


def _square(connectivity: int) -> float:
    if connectivity not in _SQUARES:
        raise OptionError(f"a cell has 6, 18 or 26 neighbours, not {connectivity}")
    return _SQUARES[connectivity]


@functools.lru_cache(maxsize=8)
def _masks(square: float) -> tuple[I64, U64]:
    """
    Return where neighbours up to a distance are.

    Parameters
    ----------
    square : float
        Of the distance, in cells.

    Returns
    -------
    offsets : (k, 3) array of int64
        Blocks that hold some, from a cell's own.
    masks : (64, k) array of uint64
        For each cell of a block, which cells of those blocks they are.
    """
    reach = int(np.sqrt(square) + 1e-9)
    steps = np.arange(-reach, reach + 1)
    around = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), -1).reshape(-1, 3)
    squares = (around**2).sum(axis=1)
    around = around[(squares <= square) & (squares > 0)]
    far = -(-reach // 4)  # blocks on either side
    width = 2 * far + 1
    masks = np.zeros((64, width**3), np.uint64)
    for bit in range(64):
        cells = around + np.array([bit & 3, bit >> 2 & 3, bit >> 4])
        local, block = cells & 3, (cells >> 2) + far
        place = (block[:, 0] * width + block[:, 1]) * width + block[:, 2]
        flag = np.uint64(1) << (local @ [1, 4, 16]).astype(np.uint64)
        np.bitwise_or.at(masks[bit], place, flag)
    used = np.bitwise_or.reduce(masks, axis=0) != 0
    used[(width**3) // 2] = True  # the own block, for counting inside it
    sides = np.arange(-far, far + 1)
    blocks = np.stack(np.meshgrid(sides, sides, sides, indexing="ij"), -1).reshape(-1, 3)
    return np.ascontiguousarray(blocks[used]), np.ascontiguousarray(masks[:, used])
