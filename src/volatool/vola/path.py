"""Ways through free space that keep a distance from occupied voxels."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from volatool.cube import MAX_DEPTH
from volatool.errors import OptionError, ResourceError
from volatool.model import F64, I64
from volatool.vola.clearance import segment_clearance
from volatool.vola.passable import ROUNDING, End, PathEndError, Place, Space
from volatool.vola.straighten import clear_of_segments, length_of, straightened
from volatool.vola.tree import lattice_of, tree_of
from volatool.vola.volume import Volume

__all__ = ["MAX_CELLS", "Path", "PathEndError", "find_path"]

MAX_CELLS = 1 << 21
"""Cells that a search may look at by default; some 110 bytes each, taken as they are needed."""

_LEAST_ROOM = 1 << 14
_COARSER = 2
"""Levels above the deepest at which the first, coarse plan stops going into detail."""

_COARSE_ROOMS = 2
_NEAR = 4
"""Cells of that level about the ends within which it does not stop."""

_HASTE = 1.5
"""Weight of the distance ahead in the plan: 1 looks at hundreds of times as many cells."""


@dataclass(frozen=True, slots=True, eq=False)
class Path:
    """
    A way from one place to another.

    Parameters
    ----------
    points : (m, 3) array of float64
        Corners of the line, both ends included, in units of the CRS (z in the vertical unit).
    length : float
        In the horizontal unit of the CRS; heights count ``z_ratio`` times.
    clearance : float
        Least distance of the whole line from an occupied voxel's box, same unit; infinity in an
        empty volume.
    factor : float
        What is proved of the length: no way over the centres of the level's cells, with 26 steps
        that cut no corner, is shorter than ``length / factor``. 1: none is shorter.
    plan : mapping of int to int
        Cells of the plan by level (0 is the cube), largest first; empty for a straight line.
    looked_at : int
        Cells that the search looked at.
    """

    points: F64
    length: float
    clearance: float
    factor: float
    plan: Mapping[int, int]
    looked_at: int

    def __repr__(self) -> str:
        return (
            f"<Path of {len(self.points)} points, length {self.length:g}, "
            f"clearance {self.clearance:g}>"
        )

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON; a clearance without anything to keep from is None."""
        return {
            "length": self.length,
            "clearance": self.clearance if math.isfinite(self.clearance) else None,
            "factor": self.factor,
            "points": self.points.tolist(),
            "plan": {str(level): n for level, n in self.plan.items()},
            "looked_at": self.looked_at,
        }


def find_path(
    volume: Volume,
    a: ArrayLike,
    b: ArrayLike,
    clearance: float = 0.0,
    *,
    z: tuple[float, float] | None = None,
    level: int | None = None,
    factor: float = 1.5,
    smooth: bool = True,
    max_cells: int = MAX_CELLS,
) -> Path | None:
    """
    Find a short way between two places through the free cells of the cube.

    Parameters
    ----------
    volume : Volume
        The volume. What is not occupied is taken to be free.
    a, b : (3,) array of float
        The ends, in units of the CRS (z in the vertical unit).
    clearance : float
        Distance that the whole line keeps from the boxes of occupied cells, in the horizontal
        unit of the CRS, to one part in 1e9. Away from its ends it keeps half a cell in any case.
    z : tuple of 2 float, optional
        Lowest and highest z of the line, in the vertical unit; no limit by default.
    level : int, optional
        Level of the cells, 1 to the volume's depth; the deepest by default.
    factor : float
        How many times as long as the shortest way over cell centres it may be; 1 for none shorter.
    smooth : bool
        Pull the line straight where the distance allows; it never becomes longer.
    max_cells : int
        Most cells that the search may look at, rounded down to a power of two.

    Returns
    -------
    path : Path or None
        None when there is no way.

    Raises
    ------
    PathEndError
        ``E_PATH_END``: an end is outside the cube or the heights, in an occupied cell, or nearer to
        one than `clearance`.
    ResourceError
        ``E_SIZE``: neither a way nor that there is none was found within `max_cells`, or the level
        is deeper than 10.
    OptionError
        ``E_OPTION``: a clearance below 0, a factor below 1, heights that are none, a level that is
        not there.

    Notes
    -----
    A way is a line that goes from `a` to the centre of its cell, or of one around it, from there
    over centres of cells that keep the clearance, by 26 steps between which all cells do (no
    corner is cut), and so on to `b`. Whether there is one is decided exactly: by A* over the
    largest cells, of any level, that are passable as a whole. Coarse cells lead through the open,
    fine ones through the gaps. Its line is taken when it is within `factor` of a lower bound;
    otherwise A* over the deepest cells looks for one that is. Where that needs more than
    `max_cells`, the line stays, and its own `factor` says what is proved of it.
    """
    if not (math.isfinite(clearance) and clearance >= 0):
        raise OptionError(f"a clearance is 0 or more, not {clearance}")
    if not factor >= 1:
        raise OptionError(f"a factor is 1 or more, not {factor}")
    low, high = (-math.inf, math.inf) if z is None else z
    if not low <= high:
        raise OptionError(f"heights are the lower and the higher, not {low} and {high}")
    level = volume.depth if level is None else level
    volume.n_cells(level)  # refuses a level that is not there
    if level > MAX_DEPTH:
        raise ResourceError(
            f"paths end at level {MAX_DEPTH}, not {level}: give a coarser level", "E_SIZE"
        )
    lattice, tree = lattice_of(volume, level), tree_of(volume, level)
    space = Space(volume, level, lattice, tree, clearance, (low, high))
    start, goal = space.end(a, "start"), space.end(b, "goal")
    search = _Search(space, start, goal, factor, smooth, max_cells)
    path = search.path()
    if path is not None:  # the ends as they were given, to the last bit
        path.points[0], path.points[-1] = a, b
    return path


@dataclass(slots=True)
class _Search:
    """One search; lengths and places are in cells."""

    space: Space
    start: Place
    goal: Place
    factor: float
    smooth: bool
    max_cells: int
    looked_at: int = 0

    def path(self) -> Path | None:
        """Return the way, None if there is none."""
        line = np.stack([self.start.place, self.goal.place])
        if self.smooth and self._is_clear(line):
            return self._result(line, length_of(line), {})
        start, goal = self.space.linked(self.start), self.space.linked(self.goal)
        if not len(start) or not len(goal):
            return None
        planned = self._plan(start, goal)
        if planned is None:
            return None
        line, plan = planned
        line = self._pulled(line)
        bound = _least_length(start, goal)
        if length_of(line) > self.factor * bound:
            shorter, proved = self._shorter(start, goal, length_of(line))
            bound = max(bound, proved)
            if shorter is not None:
                shorter = self._pulled(shorter)
                if length_of(shorter) < length_of(line):
                    line = shorter
        return self._result(line, bound, plan)

    def _is_clear(self, line: F64) -> bool:
        """Tell whether a straight line keeps what its ends do."""
        ends = segment_clearance(self.space.tree, line, line)
        need = max(self.space.least, min(self.space.usual, float(ends.min())), ROUNDING)
        return clear_of_segments(self.space.tree, line[:1], line[1:], need)

    def _pulled(self, line: F64) -> F64:
        if not self.smooth:
            return line
        return straightened(self.space.tree, line, self.space.least, self.space.usual)

    def _result(self, line: F64, bound: float, plan: Mapping[int, int]) -> Path:
        lattice = self.space.lattice
        length = length_of(line)
        nearest = float(segment_clearance(self.space.tree, line[:-1], line[1:]).min())
        return Path(
            points=lattice.to_crs(line),
            length=length * lattice.step,
            clearance=nearest * lattice.step,
            factor=max(1.0, length / bound) if bound > 0 else 1.0,
            plan=plan,
            looked_at=self.looked_at,
        )

    def _rooms(self) -> list[int]:
        """Return sizes to try: eight times as much each time, up to the limit."""
        most = 1 << max(int(self.max_cells), 1024).bit_length() - 1
        rooms = [_LEAST_ROOM << 3 * k for k in range(20)]
        return [*(room for room in rooms if room < most), most]

    def _plan(self, start: End, goal: End) -> tuple[F64, dict[int, int]] | None:
        """
        Return a line over the largest passable cells and their number by level.

        First without going into detail away from the ends. What that does not find is looked for
        in full, from both ends in turn: a pocket that one of them is in is soon exhausted.
        """
        from volatool.kernels import roam

        depth = self.space.tree.depth
        rooms = self._rooms()
        for finest in range(max(depth - _COARSER, 1), depth):
            for room in rooms[:_COARSE_ROOMS]:
                status, planned = self._roam(start, goal, finest, room)
                if planned is not None:
                    return planned
                if status == roam.EXHAUSTED:
                    break
        for room in rooms:
            status, planned = self._roam(start, goal, depth, room)
            if status != roam.OUT_OF_ROOM:
                return planned
            status, planned = self._roam(goal, start, depth, room)
            if status != roam.OUT_OF_ROOM:
                return None if planned is None else (planned[0][::-1], planned[1])
        raise ResourceError(
            f"no path was found by looking at {room} cells, nor that there is none: allow more "
            "cells, or give a coarser level",
            "E_SIZE",
        )

    def _roam(
        self, start: End, goal: End, finest: int, room: int
    ) -> tuple[int, tuple[F64, dict[int, int]] | None]:
        """Search once; return how it ended, and the line and its cells by level."""
        from volatool.kernels import roam

        tree = self.space.tree
        near = float(_NEAR * 4 ** (tree.depth - finest))
        status, keys, entries, looked_at = roam.roam(
            tree.words, tree.first, tree.depth, self.space.rule, start.cells,
            start.lengths, goal.cells, start.place, goal.place, _HASTE, finest, near, room,
        )  # fmt: skip
        self.looked_at += looked_at
        if status != roam.FOUND:
            return status, None
        cells = _unpacked(keys)
        line = np.vstack([start.place, _line(cells, entries, goal, tree.depth), goal.place])
        counts = Counter(cells[:, 0].tolist())
        return status, (_without_repeats(line), {level: counts[level] for level in sorted(counts)})

    def _shorter(self, start: End, goal: End, length: float) -> tuple[F64 | None, float]:
        """Return a line within the factor if there may be one, and what no way is shorter than."""
        from volatool.kernels import gridpath, roam

        tree, rule = self.space.tree, self.space.rule
        proved = 0.0
        for room in self._rooms():
            status, cells, looked_at, least = gridpath.walk(
                tree.words, tree.first, tree.depth, rule, start.cells, start.lengths,
                goal.cells, goal.lengths, float(self.factor), length / self.factor, room,
            )  # fmt: skip
            self.looked_at += looked_at
            proved = max(proved, least)
            if status == roam.EXHAUSTED:
                break
            if status == roam.FOUND:
                line = np.vstack([start.place, _corners(cells + 0.5), goal.place])
                return _without_repeats(line), proved
        return None, proved


def _least_length(start: End, goal: End) -> float:
    """Return the length of the shortest way if nothing were in it."""
    steps = np.sort(np.abs(start.cells[:, None] - goal.cells[None]), axis=2)
    low, middle, high = steps[..., 0], steps[..., 1], steps[..., 2]
    lengths = math.sqrt(3) * low + math.sqrt(2) * (middle - low) + (high - middle)
    return float((lengths + start.lengths[:, None] + goal.lengths).min())


def _unpacked(keys: Any) -> I64:
    """Return level, x, y, z of `openlist.packed` keys, a row each."""
    shifts = np.array([60, 0, 20, 40], np.uint64)
    masks = np.array([15, *[(1 << 20) - 1] * 3], np.uint64)
    cells: I64 = ((keys[:, None] >> shifts) & masks).astype(np.int64)
    return cells


def _line(cells: I64, entries: F64, goal: End, depth: int) -> F64:
    """Return the corners of a line: where each cell is entered and left, and the last goal."""
    spans = 4 ** (depth - cells[:, :1])
    low, high = cells[:, 1:] * spans, (cells[:, 1:] + 1) * spans
    # of two neighbours one face is shared: where one ends on the axis the other begins
    ahead = (low[1:] == high[:-1]).astype(np.int64) - (high[1:] == low[:-1])
    exits = entries[1:] - ahead
    line = np.empty((2 * len(cells) - 1, 3))
    line[::2], line[1::2] = entries, exits
    centres = goal.cells + 0.5
    inside = ((centres > low[-1]) & (centres < high[-1])).all(axis=1)
    rest = goal.lengths + np.sqrt(((centres - entries[-1]) ** 2).sum(axis=1))
    return np.vstack([line, centres[np.argmin(np.where(inside, rest, np.inf))]])


def _without_repeats(line: F64) -> F64:
    keep = np.ones(len(line), bool)
    keep[1:] = (line[1:] != line[:-1]).any(axis=1)
    if keep.sum() == 1:
        keep[-1] = True  # both ends are one place
    return line[keep]


def _corners(line: F64) -> F64:
    """Leave out the points between two equal steps."""
    steps = np.diff(line, axis=0)
    keep = np.ones(len(line), bool)
    keep[1:-1] = (steps[1:] != steps[:-1]).any(axis=1)
    return line[keep]
