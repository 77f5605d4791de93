"""Connected components of a level's set cells, exact across blocks."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from volatool.errors import OptionError, ResourceError
from volatool.model import F64, I32, I64, U64
from volatool.vola.tree import Lattice, first_children, lattice_of
from volatool.vola.volume import Volume

__all__ = ["CONNECTIVITIES", "Components", "components"]

CONNECTIVITIES = (6, 26)
"""Cells hang together over faces, or over faces, edges and corners."""


@dataclass(frozen=True, eq=False, repr=False)
class Components:
    """
    The connected components of a level's set cells, the largest first.

    Equal sizes are ordered by their first cell in VOLA order. ``len()`` is their number, component
    k is row k of the arrays.

    Parameters
    ----------
    level : int
        The level of the cells.
    connectivity : int
        6 or 26.
    sizes : (n,) array of int64
        Cells of each component, descending.
    boxes : (n, 6) array of int32
        Lowest x, y, z and highest x, y, z of its cells, both inclusive.
    lattice : Lattice
        Where the cells are.
    """

    level: int
    connectivity: int
    sizes: I64
    boxes: I32
    lattice: Lattice
    _words: U64
    _starts: I32
    _masks: U64
    _numbers: I32

    def __len__(self) -> int:
        return len(self.sizes)

    def __repr__(self) -> str:
        largest = f", the largest of {self.sizes[0]} cells" if len(self) else ""
        return (
            f"<Components of level {self.level}, {self.connectivity}-connected: "
            f"{len(self)}{largest}>"
        )

    @cached_property
    def labels(self) -> I32:
        """
        Component of each cell.

        Returns
        -------
        labels : (n_cells,) array of int32
            0 to ``len() - 1``, in the order of ``Volume.voxels(level)``.
        """
        from volatool.kernels import flood

        labels = np.empty(int(self.sizes.sum()), np.int32)
        flood.label(self._words, self._starts, self._masks, self._numbers, labels)
        labels.flags.writeable = False
        return labels

    @property
    def bounds(self) -> F64:
        """
        Box of each component's cells.

        Returns
        -------
        bounds : (n, 6) array of float64
            Minimum x, y, z and maximum x, y, z, in units of the CRS (z in the vertical unit).
        """
        low = self.lattice.to_crs(self.boxes[:, :3])
        return np.hstack([low, self.lattice.to_crs(self.boxes[:, 3:].astype(np.int64) + 1)])

    @property
    def volumes(self) -> F64:
        """Volume of each component's cells, in cubes of the CRS's horizontal unit."""
        return self.sizes.astype(np.float64) * self.lattice.step**3

    def rows(self, top: int | None = None) -> list[dict[str, Any]]:
        """
        Return the components as plain values.

        Parameters
        ----------
        top : int, optional
            That many of the largest; all by default.

        Returns
        -------
        rows : list of dict
            ``rank`` (from 1), ``voxels``, ``volume``, ``cells`` and ``box`` (6 numbers each).
        """
        columns: tuple[NDArray[Any], ...] = (self.sizes, self.volumes, self.boxes, self.bounds)
        lists = [column[:top].tolist() for column in columns]
        return [
            {"rank": rank, "voxels": size, "volume": volume, "cells": cells, "box": box}
            for rank, (size, volume, cells, box) in enumerate(zip(*lists, strict=True), 1)
        ]


def components(volume: Volume, connectivity: int = 26, level: int | None = None) -> Components:
    """
    Find the connected components of a level's set cells.

    Parameters
    ----------
    volume : Volume
        The volume.
    connectivity : int
        26: cells that share a face, an edge or a corner hang together. 6: a face only.
    level : int, optional
        1 to the volume's depth; the deepest by default.

    Returns
    -------
    components : Components
        The largest first.

    Raises
    ------
    OptionError
        ``E_OPTION``: another connectivity, or a level that the volume doesn't have.

    Notes
    -----
    The parts of each 64-bit block are found by flooding its bits [Byrne2018]_; parts of
    neighbouring blocks are then united in one walk over the tree.
    """
    if connectivity not in CONNECTIVITIES:
        raise OptionError(f"connectivity is 6 or 26, not {connectivity}")
    from volatool.kernels import flood

    level = volume.depth if level is None else level
    volume.n_cells(level)  # refuses a level that is not there
    is_26 = connectivity == 26
    words = volume.levels[level - 1]
    starts, masks = flood.split(words, is_26, volume.n_cells(level))
    n_parts = len(masks) - 2
    if n_parts > np.iinfo(np.int32).max:
        raise ResourceError(
            f"level {level} has {n_parts} parts of blocks, more than 2**31: "
            "ask for a coarser level",
            "E_SIZE",
        )
    numbers = np.arange(n_parts, dtype=np.int32)
    if level > 1:
        upper = np.concatenate(volume.levels[: level - 1])
        flood.unite_blocks(
            upper, first_children(upper), level - 1, words, starts, masks, is_26, numbers
        )
    sizes = flood.number(numbers, masks)
    large = np.flatnonzero(sizes >= flood.SMALL)
    large = large[np.argsort(-sizes[large], kind="stable")]
    ranks, sizes = flood.rank(sizes, large)
    boxes = np.empty((len(sizes), 6), np.int32)
    blocks = volume.voxels(level - 1) if level > 1 else np.zeros((1, 3), np.int32)
    flood.measure(starts, masks, numbers, ranks, blocks, boxes)
    return Components(
        level,
        connectivity,
        sizes,
        boxes,
        lattice_of(volume, level),
        words,
        starts,
        masks,
        numbers,
    )
