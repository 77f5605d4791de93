"""Pulling a line straight where it keeps clear of occupied voxels."""

from __future__ import annotations

import numpy as np

from volatool.model import F64
from volatool.vola.clearance import segment_clearance
from volatool.vola.tree import Tree

_ROUNDS = 6
_MOST_POINTS = 2000
_ROUNDING = 1e-9
_GAIN = 1e-4


def length_of(line: F64) -> float:
    """Return the length of a line of (n, 3) points."""
    return float(np.sqrt((np.diff(line, axis=0) ** 2).sum(axis=1)).sum())


def clear_of_segments(tree: Tree, start: F64, end: F64, need: float) -> bool:
    """Tell whether one segment, given as two (1, 3) arrays, keeps a distance in cells."""
    from volatool.kernels import nearest

    squares = np.array([need * need])
    nearest.segment_clearances(tree.words, tree.first, tree.depth, start, end, squares)
    return bool(squares[0] >= need * need)


def straightened(tree: Tree, line: F64, least: float, usual: float) -> F64:
    """
    Pull a line straight.

    Parameters
    ----------
    tree : Tree
        The nodes of the volume.
    line : (n, 3) array of float64
        Its corners in lattice coordinates.
    least : float
        Distance, in cells, that all of it keeps.
    usual : float
        Distance that a shortcut keeps too, unless what it replaces came nearer.

    Returns
    -------
    line : (m, 3) array of float64
        The same ends, nowhere longer.

    Notes
    -----
    Greedy shortcuts from the front and from the back in turn; between the rounds each segment is
    halved, so that corners can be cut ever closer.
    """
    for _ in range(_ROUNDS):
        before = length_of(line)
        line = _shortcut(tree, line, least, usual)
        line = _shortcut(tree, line[::-1], least, usual)[::-1]
        if len(line) == 2 or len(line) > _MOST_POINTS:
            break
        if length_of(line) > before * (1 - _GAIN):
            break
        line = _halved(line)
    return _shortcut(tree, line, least, usual) if len(line) > 2 else line


def _halved(line: F64) -> F64:
    halved = np.empty((2 * len(line) - 1, 3))
    halved[::2] = line
    halved[1::2] = (line[1:] + line[:-1]) / 2
    return halved


def _shortcut(tree: Tree, line: F64, least: float, usual: float) -> F64:
    """Leave out points from the first on: twice as many as long as that goes, then halving."""
    line = np.ascontiguousarray(line)
    kept = segment_clearance(tree, line[:-1], line[1:])
    last = len(line) - 1

    def is_clear(i: int, j: int) -> bool:
        need = max(least, min(usual, float(kept[i:j].min())) * (1 - _ROUNDING), _ROUNDING)
        return clear_of_segments(tree, line[i : i + 1], line[j : j + 1], need)

    chosen = [0]
    while chosen[-1] < last:
        here = chosen[-1]
        good, step = here + 1, 2
        while here + step <= last and is_clear(here, here + step):
            good = here + step
            step *= 2
        bad = min(here + step, last + 1)
        while bad - good > 1:
            middle = (good + bad) // 2
            if is_clear(here, middle):
                good = middle
            else:
                bad = middle
        chosen.append(good)
    return line[chosen]
