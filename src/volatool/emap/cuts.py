"""Which springs of a grid are missing or weaker: cuts along break lines and shores."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from volatool.emap.lines import Lines
from volatool.emap.system import Evidence, strips
from volatool.errors import OptionError
from volatool.scratch import Scratch


@dataclass(frozen=True, slots=True)
class Cuts:
    """
    Factors of the edges between neighbouring nodes, on the springs that act along them.

    A stretching spring has its edge's factor. A second difference has the smaller of its two edges'
    factors, a twist the smallest of the four around its quad: where an edge is cut, no spring holds
    the two sides together.

    Parameters
    ----------
    edges : (h, 2, w) array of float32
        ``edges[r, 0, q]`` of the edge from node (r, q) to the east, ``edges[r, 1, q]`` to the
        south; 0 cut, 1 whole, between for weaker springs. Edges that would leave the grid are 1.
    lines : Lines, optional
        The lines along which edges are cut: a point then pulls only on those of its four nodes that
        no line separates it from, weights made to sum to one again. Without lines, points pull on
        all four, and so couple both sides of a cut that runs between them.
    scratch : Scratch
        Where the array lives.
    """

    edges: NDArray[np.float32]
    lines: Lines | None = None
    scratch: Scratch = field(default_factory=Scratch, repr=False)

    def __post_init__(self) -> None:
        edges = self.edges
        if edges.ndim != 3 or edges.shape[1] != 2 or edges.dtype != np.float32:
            raise OptionError(f"cuts need (h, 2, w) float32, got {edges.shape} {edges.dtype}")

    @classmethod
    def none(cls, height: int, width: int, scratch: Scratch | None = None) -> Cuts:
        """Return a grid's edges, all whole, to be cut by writing into ``edges``."""
        scratch = Scratch() if scratch is None else scratch
        edges = scratch.zeros((height, 2, width), np.float32)
        for start, stop in strips(height, width):
            edges[start:stop] = 1.0
            scratch.relax(edges, start, stop)
        return cls(edges, scratch=scratch)

    @classmethod
    def along(cls, lines: Lines) -> Cuts:
        """
        Return a grid's edges, cut where lines cross them.

        Notes
        -----
        Decided exactly, in steps of 1/4096 cell. A node on a line counts as left of it, or above it
        if the line runs along the row.
        """
        from volatool.kernels.lines import cut_edges

        height, width = lines.quads.shape
        whole = cls.none(height, width, lines.scratch)
        cut_edges(lines.segments, whole.edges)
        return cls(whole.edges, lines, lines.scratch)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of nodes."""
        height, _, width = self.edges.shape
        return height, width

    def count(self) -> int:
        """Return how many edges are cut."""
        height, width = self.shape
        return sum(
            int(np.count_nonzero(self.edges[start:stop] == 0))
            for start, stop in strips(height, width)
        )

    def islands(self, evidence: Evidence) -> NDArray[np.bool_]:
        """
        Return the nodes that no uncut path connects to a point.

        Nothing holds them: a solve leaves them where they start, and a DEM leaves them void.

        Parameters
        ----------
        evidence : Evidence
            Of the same grid; before a solve consumes it.

        Returns
        -------
        islands : (h, w) array of bool
            In the scratch; give it back with ``scratch.free``.
        """
        from volatool.kernels import islands

        height, width = self.shape
        labels = self.scratch.zeros((height, width), np.int32)
        held: NDArray[np.bool_] = self.scratch.zeros((height, width), np.bool_)
        for start, stop in strips(height, width):
            held[start:stop] = evidence.data[start:stop, 0] > 0
            islands.join_rows(self.edges, held, labels, start, stop)
            evidence.scratch.relax(evidence.data, start, stop)
        islands.unheld(labels, held)
        self.scratch.free(labels)
        return held

    def free(self) -> None:
        """Give the memory back; the cuts must not be used any more."""
        self.scratch.free(self.edges)
        if self.lines is not None:
            self.lines.free()
