"""The rank directory of a volume: how any cell is found in a few steps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from volatool.model import I64, U64
from volatool.vola.words import frozen

_JUMP_LEVELS = 3
_JUMP_SHARE = 16


@dataclass(frozen=True, slots=True)
class Directory:
    """
    All blocks of a volume in one array, and a table that jumps over the first levels.

    Parameters
    ----------
    rows : (n + 1, 2) array of uint64
        A row a block, level after level from the root: its word and the row of its first child.
        The last row is nobody's: an empty block whose children are itself.
    last : (m + 1,) array of uint64
        Words of the deepest level and a zero, for look-ups of voxels alone.
    starts : tuple of int
        Row of the first block of each level, and the number of blocks: depth + 1 numbers.
    jump : (64**jump_level,) array of int32 or int64
        Row of the block in each cell of level `jump_level`, cells by ``x + S (y + S z)``; the last
        row where there is none.
    jump_level : int
        From 0; less than the depth.
    """

    rows: U64
    last: U64
    starts: tuple[int, ...]
    jump: NDArray[np.int32 | np.int64]
    jump_level: int

    @property
    def depth(self) -> int:
        """Number of levels."""
        return len(self.starts) - 1

    @classmethod
    def of(cls, levels: tuple[U64, ...]) -> Directory:
        """
        Return the directory of a volume's levels.

        Parameters
        ----------
        levels : tuple of (n,) arrays of uint64
            Occupancy words, the root level first.
        """
        from volatool.kernels import locate, words

        starts = np.cumsum([0, *map(len, levels)])
        n_rows = int(starts[-1])
        rows = np.empty((n_rows + 1, 2), np.uint64)
        for level_words, start, stop in zip(levels, starts[:-1], starts[1:], strict=True):
            locate.fill_directory(level_words, stop, rows[start:stop])
        rows[n_rows] = 0, n_rows
        # a small volume gets a small table
        deepest = min(_JUMP_LEVELS, len(levels) - 1)
        level = max(j for j in range(deepest + 1) if j == 0 or 64**j <= _JUMP_SHARE * n_rows)
        kind = np.int32 if n_rows < 2**31 else np.int64
        jump = np.full(64**level, n_rows, kind)
        cells = np.zeros((1, 3), np.int32)
        for i in range(level):
            cells = words.child_cells(levels[i], cells, int(starts[i + 2] - starts[i + 1]))
        x, y, z = cells.T
        jump[x + ((y + (z << 2 * level)) << 2 * level)] = starts[level] + np.arange(len(cells))
        jump.flags.writeable = False
        last = np.append(levels[-1], np.uint64(0))
        return cls(frozen(rows), frozen(last), tuple(starts.tolist()), jump, level)

    def find(self, cells: I64, level: int) -> I64:
        """
        Return the rank of cells in their level.

        Parameters
        ----------
        cells : (n, 3) array of int64, C-contiguous
            x, y, z; outside the grid is not set.
        level : int
            Of the cells, 1 to depth.

        Returns
        -------
        ranks : (n,) array of int64
            -1 where the cell is not set.
        """
        from volatool.kernels import locate

        found = np.empty(len(cells), np.int64)
        locate.find(self.rows, cells, level, self.starts[level], found)
        return found
