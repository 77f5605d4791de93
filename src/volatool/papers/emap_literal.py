"""The EMap paper's equation 3 taken at its word, and a net whose nodes do not feel each other."""

from __future__ import annotations

import numpy as np

from volatool.model import F64
from volatool.papers.emap_scene import Nodes, Scan

K = 10.0
"""N/m: the paper's example of a spring; that of a point is taken to be as stiff."""


class _Rolling:
    """Values of the nodes of a window that follows the sensor, by whole cells; new ones are 0."""

    def __init__(self, side: int, cell: float, n_values: int) -> None:
        self.values = np.zeros((n_values, side, side))
        self.nodes: Nodes | None = None
        self.side, self.cell = side, cell

    def roll(self, sensor: F64) -> Nodes:
        """Move to the sensor and return the nodes there."""
        nodes = Nodes.around(sensor, self.side, self.cell)
        if self.nodes is not None:
            moved = np.zeros_like(self.values)
            down, right = nodes.row - self.nodes.row, nodes.col - self.nodes.col
            new_rows, old_rows = _overlap(down, self.side)
            new_cols, old_cols = _overlap(right, self.side)
            moved[:, new_rows, new_cols] = self.values[:, old_rows, old_cols]
            self.values = moved
        self.nodes = nodes
        return nodes


def _overlap(shift: int, side: int) -> tuple[slice, slice]:
    """Return what a window and the same window moved by `shift` share, in each one's indices."""
    shift = max(-side, min(side, shift))
    new = slice(max(0, -shift), side - max(0, shift))
    return new, slice(new.start + shift, new.stop + shift)


class Literal:
    """
    Energy set to zero, springs on the diagonal, element-wise root: [Lock2022]_, section 3.

    Each scan moves node s by ``sqrt(sum_j k d_sj^2 / (n_s k))``, with d_sj the distance in space
    to each point j whose nearest node it is and n_s its 2 to 4 neighbours. The printed equation
    asks for the root of the negative of that; this is the root of its magnitude.

    Parameters
    ----------
    signed : bool
        Put the lost sign back: that of the points' mean height above the node.
    vertical : bool
        Take vertical distances.
    side, cell : int, float
        Nodes a side and metres between them.
    """

    def __init__(
        self, *, signed: bool = False, vertical: bool = False, side: int = 40, cell: float = 0.25
    ) -> None:
        self.signed, self.vertical = signed, vertical
        self._window = _Rolling(side, cell, 1)
        neighbours = np.full((side, side), 4.0)
        for edge in (0, -1):
            neighbours[edge] -= 1
            neighbours[:, edge] -= 1
        self._stiffness = K * neighbours

    def update(self, scan: Scan) -> None:
        """Add a scan; points outside the window are left out (on its rim they do more harm)."""
        nodes = self._window.roll(scan.sensor)
        z = self._window.values[0]
        x, y, h = scan.points[nodes.holds(scan.points)].T
        row, col = nodes.indices(x, y)
        above = h - z[row, col]
        squares = above**2
        if not self.vertical:
            squares += (x - nodes.x[col]) ** 2 + (y - nodes.y[row]) ** 2
        index = row * nodes.side + col
        n = nodes.side**2
        pull = K * np.bincount(index, squares, n).reshape(z.shape)
        step = np.sqrt(pull / self._stiffness)
        if self.signed:
            step *= np.sign(np.bincount(index, above, n)).reshape(z.shape)
        z += step

    def heights(self, nodes: Nodes) -> F64:
        """Return the heights after the last scan."""
        return np.array(self._window.values[0])


class Uncoupled:
    """
    Springs to the points alone: a node is the mean of the points that it is nearest to.

    What is left of equation 3 with its diagonal matrix once it is made solvable: nodes without a
    point of their own stay where they started.

    Parameters
    ----------
    side, cell : int, float
        Nodes a side and metres between them.
    """

    def __init__(self, side: int = 40, cell: float = 0.25) -> None:
        self._window = _Rolling(side, cell, 2)

    def update(self, scan: Scan) -> None:
        """Add a scan; points outside the window are left out."""
        nodes = self._window.roll(scan.sensor)
        x, y, h = scan.points[nodes.holds(scan.points)].T
        row, col = nodes.indices(x, y)
        index = row * nodes.side + col
        sums, counts = self._window.values.reshape(2, -1)
        sums += np.bincount(index, h, sums.size)
        counts += np.bincount(index, minlength=sums.size)

    @property
    def empty(self) -> float:
        """Share of the nodes without a point."""
        return float(np.mean(self._window.values[1] == 0))

    def heights(self, nodes: Nodes) -> F64:
        """Return the means; 0 without a point."""
        sums, counts = self._window.values
        return np.asarray(sums / np.maximum(counts, 1), np.float64)
