"""The table per level: blocks, occupancy, contiguity and encoded sizes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from volatool.model import I64, LevelCounts

CELLS = 64
"""Cells of a block."""

PAIRS = 144
"""Face-sharing pairs of cells in a full block."""


@dataclass(frozen=True, slots=True)
class LevelRow:
    """
    One level of a volume, or the same level of several volumes taken together.

    Parameters
    ----------
    level : int
        1 is the coarsest.
    cell : float
        Edge of a cell, unit of the cube. The largest one when volumes differ.
    blocks : int
        Stored blocks.
    voxels : int
        Cells set; the blocks of the next level.
    occupancy : float
        Cells set / (64 x stored blocks).
    occupancy_voxel_weighted : float
        The same seen from a voxel, E[n^2] / (64 E[n]) for n cells set in a block.
    occupancy_histogram : tuple of 65 int
        Blocks with 0 .. 64 cells set.
    contiguous_pairs_mean : float
        Face-sharing pairs of set cells inside a block, mean over the blocks.
    contiguous_fraction : float
        The same as a part of the 144 pairs of a full block.
    contiguous_expected : float
        What the mean would be if each block's cells were set at random:
        ``144 n (n - 1) / (64 * 63)``, mean over the blocks.
    block_fill : float
        Stored blocks as a part of all blocks of the level.
    voxel_fill : float
        Cells set as a part of all cells of the level.
    points_per_voxel : float or None
        None when the number of points is not known.
    dense_bytes, sparse_bytes : int
        All levels down to this one, occupancy only, without the header.
    reduction : float
        dense_bytes / sparse_bytes.
    """

    level: int
    cell: float
    blocks: int
    voxels: int
    occupancy: float
    occupancy_voxel_weighted: float
    occupancy_histogram: tuple[int, ...]
    contiguous_pairs_mean: float
    contiguous_fraction: float
    contiguous_expected: float
    block_fill: float
    voxel_fill: float
    points_per_voxel: float | None
    dense_bytes: int
    sparse_bytes: int
    reduction: float

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON object of the report."""
        names = self.__dataclass_fields__
        values = {name: getattr(self, name) for name in names}
        return values | {"occupancy_histogram": list(self.occupancy_histogram)}


def dense_bytes(depth: int, tiles: int = 1) -> int:
    """
    Return the size of all dense levels down to `depth`, without the header.

    Examples
    --------
    >>> dense_bytes(5, tiles=356)
    48539947808
    """
    return tiles * 8 * ((1 << 6 * depth) - 1) // 63


def expected_pairs(n: int) -> float:
    """
    Return the mean number of face-sharing pairs of `n` cells set at random in a block.

    Examples
    --------
    >>> round(expected_pairs(32), 2)
    35.43
    """
    return PAIRS * n * (n - 1) / (CELLS * (CELLS - 1))


def occupancy_of(counts: LevelCounts) -> float:
    """Return cells set / (64 x stored blocks); 0 without blocks."""
    return counts.voxels / (CELLS * counts.blocks) if counts.blocks else 0.0


def level_rows(
    counts: Sequence[LevelCounts],
    side: float | Fraction,
    n_points: int | None = None,
    *,
    tiles: int = 1,
) -> tuple[LevelRow, ...]:
    """
    Make the table from the counts of a volume, or of several added up.

    Parameters
    ----------
    counts : sequence of LevelCounts
        Of levels 1, 2, ...
    side : float or Fraction
        Edge of the cube.
    n_points : int, optional
        Points that made the voxels.
    tiles : int
        How many volumes the counts are the sum of.

    Returns
    -------
    rows : tuple of LevelRow
        One for each level.
    """
    rows = []
    blocks_so_far = 0
    for level, count in enumerate(counts, 1):
        blocks_so_far += count.blocks
        voxels = count.voxels
        histogram = [int(value) for value in count.histogram]
        # Python's integers: sums of squares over data sets don't fit 64 bits
        squares = sum(k * k * value for k, value in enumerate(histogram))
        expected = sum(k * (k - 1) * value for k, value in enumerate(histogram))
        expected_mean = PAIRS * expected / (CELLS * (CELLS - 1)) / max(count.blocks, 1)
        pairs_mean = count.contiguous_pairs / max(count.blocks, 1)
        dense, sparse = dense_bytes(level, tiles), 8 * blocks_so_far
        rows.append(
            LevelRow(
                level=level,
                cell=float(Fraction(side) / 4**level),
                blocks=count.blocks,
                voxels=voxels,
                occupancy=occupancy_of(count),
                occupancy_voxel_weighted=squares / (CELLS * voxels) if voxels else 0.0,
                occupancy_histogram=tuple(histogram),
                contiguous_pairs_mean=pairs_mean,
                contiguous_fraction=pairs_mean / PAIRS,
                contiguous_expected=expected_mean,
                block_fill=count.blocks / (tiles * CELLS ** (level - 1)),
                voxel_fill=voxels / (tiles * CELLS**level),
                points_per_voxel=n_points / voxels if n_points is not None and voxels else None,
                dense_bytes=dense,
                sparse_bytes=sparse,
                reduction=dense / sparse if sparse else 0.0,
            )
        )
    return tuple(rows)


def add_counts(tables: Iterable[Sequence[LevelCounts]]) -> list[LevelCounts]:
    """
    Add the counts of several volumes, level by level.

    Parameters
    ----------
    tables : iterable of sequences of LevelCounts
        One sequence for each volume.

    Returns
    -------
    counts : list of LevelCounts
        Down to the deepest level that every volume has: a sum in which some are missing would
        compare with nothing.
    """
    total: list[LevelCounts] | None = None
    for counts in tables:
        if total is None:
            total = list(counts)
        else:
            total = [a + b for a, b in zip(total, counts, strict=False)]
    return total or []


def counts_from_rows(rows: Iterable[Mapping[str, Any]]) -> list[LevelCounts]:
    """
    Return the counts that the ``levels`` of a report were made from.

    Parameters
    ----------
    rows : iterable of dict
        As `LevelRow.to_dict` returns them.
    """
    counts = []
    for row in rows:
        histogram: I64 = np.array(row["occupancy_histogram"], np.int64)
        pairs = round(row["contiguous_pairs_mean"] * row["blocks"])
        counts.append(LevelCounts(int(row["blocks"]), histogram, pairs))
    return counts
