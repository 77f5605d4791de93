"""Evidence of points anywhere in the world: square blocks on a lattice, made when they are met."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from volatool.emap.system import Evidence, Springs
from volatool.errors import ResourceError
from volatool.model import F64, I64
from volatool.scratch import Scratch

SIDE = 32
"""Quads along a side of a block."""

FARTHEST = 1 << 40
"""Cells from the origin beyond which a float no longer tells where in a cell a point is."""

FADED = 0.01
"""Where all evidence is weaker than this against a fresh scan's it counts as much as this.

What was seen long ago and not since keeps its shape: weaker still, it would stiffen to a plane.
"""


@dataclass(slots=True)
class _Block:
    """One block; evidence as it was when `updates` was the map's."""

    quads: F64
    counts: NDArray[np.uint32]
    updates: int

    def fade(self, forget: float, updates: int) -> None:
        """Weaken the evidence to what it is now."""
        if forget < 1 and updates > self.updates:
            factor = forget ** (updates - self.updates)
            self.quads *= factor if factor > 1e-100 else 0.0  # below lie slow, denormal numbers
        self.updates = updates


class Blocks:
    """
    World-anchored evidence; memory grows with the area that points were seen in, nothing else.

    Columns count cells east from x = 0 and rows cells south from y = 0, so that rows run from
    north to south as in every grid; the node of cell (r, q) is at (r + 0.5, q + 0.5).

    Parameters
    ----------
    springs : Springs
        Weight and attachment of the points.
    forget : float
        Factor on all earlier evidence at each update; 1 forgets nothing.
    max_weight : float
        Bound of the weight that the points between four nodes have together.
    max_bytes : int
        Ceiling of the blocks' memory.
    """

    def __init__(self, springs: Springs, forget: float, max_weight: float, max_bytes: int) -> None:
        from volatool.kernels import quads

        self.springs = springs
        self.forget = forget
        self.max_weight = max_weight
        self.max_bytes = max_bytes
        self.updates = 0
        self._blocks: dict[tuple[int, int], _Block] = {}
        self._shape = (SIDE, SIDE, quads.SIZE)
        self._block_bytes = SIDE * SIDE * quads.SIZE * 8 + (SIDE + 1) ** 2 * 4

    def __len__(self) -> int:
        return len(self._blocks)

    @property
    def n_bytes(self) -> int:
        """Memory of the blocks."""
        return len(self._blocks) * self._block_bytes

    def add(self, col: F64, row: F64, heights: F64, weights: F64) -> None:
        """
        Forget a step, then add a scan.

        Parameters
        ----------
        col, row : (n,) arrays of float64
            Places in cells from the world's origin, at most `FARTHEST`.
        heights : (n,) array of float64
            Counted from one and the same level in all calls.
        weights : (n,) or (1,) array of float64
            Stiffness of the points' springs.

        Raises
        ------
        ResourceError
            ``E_MEMORY``: the points would take more blocks than allowed; nothing has changed.
        """
        from volatool.kernels import quads

        keys, order, borders = _by_block(col, row)
        n_new = sum(key not in self._blocks for key in keys)
        if (len(self._blocks) + n_new) * self._block_bytes > self.max_bytes:
            raise ResourceError(
                f"the points spread over {n_new} blocks of {SIDE} x {SIDE} cells not seen before, "
                f"{n_new * self._block_bytes / 2**20:.0f} MiB; the map may hold "
                f"{self.max_bytes / 2**20:.0f} MiB: set bounds or a radius, a larger cell, or more "
                "memory"
            )
        self.updates += 1
        for number, key in enumerate(keys):
            block = self._blocks.get(key)
            if block is None:
                counts = np.zeros((SIDE + 1, SIDE + 1), np.uint32)
                block = self._blocks[key] = _Block(np.zeros(self._shape), counts, self.updates)
            block.fade(self.forget, self.updates)
            quads.add_points(
                block.quads,
                block.counts,
                col,
                row,
                heights,
                weights,
                order,
                borders[number],
                borders[number + 1],
                key[1] * SIDE,
                key[0] * SIDE,
                self.springs.is_nearest,
                self.max_weight,
            )

    def evidence(
        self, top: int, left: int, height: int, width: int, scratch: Scratch | None = None
    ) -> Evidence:
        """
        Return the evidence of a window.

        Parameters
        ----------
        top, left : int
            Row and column of its first node.
        height, width : int
            Nodes; at least 2 a side.
        scratch : Scratch, optional
            Where it lives.

        Returns
        -------
        evidence : Evidence
            Couplings that leave the window are on the diagonal (see `quads.gather`).
        """
        from volatool.kernels import quads

        evidence = Evidence(height, width, scratch)
        for key, block, factor in self._weighed(top, left, height, width):
            quads.gather(
                block.quads,
                factor,
                key[1] * SIDE - left,
                key[0] * SIDE - top,
                evidence.data,
                evidence.right,
            )
        return evidence

    def pull(self, top: int, left: int, sample: int, forces: NDArray[np.float32]) -> None:
        """
        Add random forces of the points' springs, with their stencil as covariance.

        Parameters
        ----------
        top, left : int
            Row and column of the window's first node.
        sample : int
            Number of the first sample.
        forces : (h, w, m) array of float32
            Of samples ``sample .. sample + m``, added to; at most 64 in all.
        """
        from volatool.kernels import quads

        height, width = forces.shape[:2]
        for key, block, factor in self._weighed(top, left, height, width):
            row, col = key[0] * SIDE, key[1] * SIDE
            quads.pull(block.quads, factor, col - left, row - top, col, row, sample, forces)

    def _weighed(
        self, top: int, left: int, height: int, width: int
    ) -> Iterator[tuple[tuple[int, int], _Block, float]]:
        """Yield the blocks that reach into a window and what their evidence counts now."""
        found = list(self._touching(top - 1, left - 1, height + 1, width + 1))
        ages = [self.updates - block.updates for _, block in found]
        youngest = min(ages, default=0)
        # where all has faded the surface stays as it is, whatever that is worth
        level = max(self.forget**youngest, FADED)
        for (key, block), age in zip(found, ages, strict=True):
            yield key, block, level * self.forget ** (age - youngest)

    def counts(self, top: int, left: int, height: int, width: int) -> NDArray[np.uint32]:
        """Return the number of points ever seen in each cell of a window."""
        counts = np.zeros((height, width), np.uint32)
        for key, block in self._touching(top - 1, left - 1, height + 1, width + 1):
            r, q = key[0] * SIDE - top, key[1] * SIDE - left
            rows = slice(max(r, 0), min(r + SIDE + 1, height))
            cols = slice(max(q, 0), min(q + SIDE + 1, width))
            if rows.start < rows.stop and cols.start < cols.stop:
                counts[rows, cols] += block.counts[
                    rows.start - r : rows.stop - r, cols.start - q : cols.stop - q
                ]
        return counts

    def extent(self) -> tuple[int, int, int, int] | None:
        """Return first row, first column, height and width of the cells seen; None without any."""
        tops, lefts, bottoms, rights = [], [], [], []
        for (i, j), block in self._blocks.items():
            rows, cols = np.nonzero(block.counts)
            tops.append(i * SIDE + int(rows.min()))
            bottoms.append(i * SIDE + int(rows.max()))
            lefts.append(j * SIDE + int(cols.min()))
            rights.append(j * SIDE + int(cols.max()))
        if not tops:
            return None
        top, left = min(tops), min(lefts)
        return top, left, max(bottoms) + 1 - top, max(rights) + 1 - left

    def drop_beyond(self, row: float, col: float, distance: float) -> int:
        """
        Forget blocks that lie wholly farther from a place than a distance, all in cells.

        Returns
        -------
        n_dropped : int
            Blocks dropped.
        """
        far = []
        for i, j in self._blocks:
            gap_r = max(i * SIDE - row, row - (i + 1) * SIDE - 1, 0.0)
            gap_q = max(j * SIDE - col, col - (j + 1) * SIDE - 1, 0.0)
            if gap_r * gap_r + gap_q * gap_q > distance * distance:
                far.append((i, j))
        for key in far:
            del self._blocks[key]
        return len(far)

    def _touching(
        self, top: int, left: int, height: int, width: int
    ) -> Iterator[tuple[tuple[int, int], _Block]]:
        """Yield the blocks with a quad in a window, in order of rows and columns."""
        rows = range(top // SIDE, (top + height - 1) // SIDE + 1)
        cols = range(left // SIDE, (left + width - 1) // SIDE + 1)
        if len(rows) * len(cols) <= len(self._blocks):
            keys = [(i, j) for i in rows for j in cols if (i, j) in self._blocks]
        else:
            keys = sorted(key for key in self._blocks if key[0] in rows and key[1] in cols)
        for key in keys:
            yield key, self._blocks[key]


def _by_block(col: F64, row: F64) -> tuple[list[tuple[int, int]], I64, list[int]]:
    """Return the blocks that points lie in, the points in order of them, and the borders there."""
    if not len(col):
        return [], np.zeros(0, np.int64), [0]
    j = np.floor((col - 0.5) / SIDE).astype(np.int64)
    i = np.floor((row - 0.5) / SIDE).astype(np.int64)
    first_i, first_j = int(i.min()), int(j.min())
    n_i, n_j = int(i.max()) - first_i + 1, int(j.max()) - first_j + 1
    i -= first_i
    j -= first_j
    if n_i * n_j < 1 << 15:  # short keys sort ten times faster
        key = (i * n_j + j).astype(np.int16)
        order = np.argsort(key, kind="stable")
    else:
        order = np.lexsort((j, i))
    i, j = i[order], j[order]
    starts = np.flatnonzero(np.concatenate(([True], (np.diff(i) != 0) | (np.diff(j) != 0))))
    keys = [
        (a + first_i, b + first_j)
        for a, b in zip(i[starts].tolist(), j[starts].tolist(), strict=True)
    ]
    return keys, order, [*starts.tolist(), len(col)]
