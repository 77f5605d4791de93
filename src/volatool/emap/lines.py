"""Lines that no spring crosses, placed on a grid: the edges they cut, what a point sees."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from volatool.model import F64
from volatool.scratch import Scratch

I64 = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Lines:
    """
    Segments on a grid, found by the quad of four nodes that they touch.

    Parameters
    ----------
    segments : (n, 4) array of int64
        x, y of both ends in 1/4096 cell from the grid's top left corner.
    quads : (h, w) array of int32
        Number of each quad that a segment touches, by its upper left node; 0 for others.
    starts, members : (m + 1,), (p,) arrays of int64
        Segments by quad.
    scratch : Scratch
        Where ``quads`` lives.
    """

    segments: I64
    quads: NDArray[np.int32]
    starts: I64
    members: I64
    scratch: Scratch = field(default_factory=Scratch, repr=False)

    @classmethod
    def place(cls, ends: F64, shape: tuple[int, int], scratch: Scratch | None = None) -> Lines:
        """
        Place segments on a grid.

        Parameters
        ----------
        ends : (n, 4) array of float64
            col, row of both ends, in cells from the top left corner; what lies more than a few
            cells outside the grid should have been cut off.
        shape : tuple of 2 int
            Rows and columns of nodes.
        scratch : Scratch, optional
            RAM by default.
        """
        from volatool.kernels import lines

        scratch = Scratch() if scratch is None else scratch
        segments = fixed_point(ends)
        height, width = shape
        none = np.empty((0, 2), np.int64)
        pairs = np.empty((lines.quads_of(segments, height, width, none), 2), np.int64)
        lines.quads_of(segments, height, width, pairs)
        pairs = pairs[np.argsort(pairs[:, 0], kind="stable")]
        found, first = np.unique(pairs[:, 0], return_index=True)
        quads = scratch.zeros(shape, np.int32)
        quads.reshape(-1)[found] = np.arange(1, len(found) + 1)
        starts = np.append(first, len(pairs)).astype(np.int64)
        return cls(segments, quads, starts, pairs[:, 1].copy(), scratch)

    @property
    def tables(self) -> tuple[NDArray[np.int32], I64, I64, I64]:
        """What the kernels take."""
        return self.quads, self.starts, self.members, self.segments

    def free(self) -> None:
        """Give the memory back; the lines must not be used any more."""
        self.scratch.free(self.quads)


def fixed_point(ends: F64) -> I64:
    """Return places in cells as whole numbers of 1/4096 cell."""
    from volatool.kernels.lines import UNITS

    return np.rint(np.asarray(ends, np.float64) * UNITS).astype(np.int64).reshape(-1, 4)
