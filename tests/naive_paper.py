"""Plain twins of what the VOLA paper's tables are made with: cells as sets, chances by counting."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import combinations

Cell = tuple[int, int, int]

CELLS = [(bit % 4, bit // 4 % 4, bit // 16) for bit in range(64)]


def beside(a: Cell, b: Cell) -> bool:
    """Tell whether two cells share a face."""
    return sum(abs(i - j) for i, j in zip(a, b, strict=True)) == 1


FACES = [(a, b) for a, b in combinations(CELLS, 2) if beside(a, b)]


def components(word: int) -> int:
    """Connected components of a block, by walking from cell to cell."""
    left = {CELLS[bit] for bit in range(64) if word >> bit & 1}
    found = 0
    while left:
        found += 1
        front = [left.pop()]
        while front:
            cell = front.pop()
            near = {other for other in left if beside(cell, other)}
            left -= near
            front += near
    return found


def moments(n: int) -> tuple[float, float]:
    """Mean and mean square of the face-sharing pairs of n of 64 cells, over all pairs of faces."""

    def chance(k: int) -> float:
        value = 1.0
        for i in range(k):
            value *= max(n - i, 0) / (64 - i)
        return value

    mean = sum(chance(2) for _ in FACES)
    square = sum(chance(len({*one, *other})) for one in FACES for other in FACES)
    return mean, square


def dense_has(cells: Iterable[Cell], side: int) -> list[int]:
    """The dense words of cells, ``linear = x + y s + z s s``."""
    words = [0] * max(side**3 // 64, 1)
    for x, y, z in cells:
        linear = x + y * side + z * side * side
        words[linear // 64] |= 1 << linear % 64
    return words
