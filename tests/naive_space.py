"""Plain Python twins of components, clearance and path: sets of cells, one thing at a time."""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Iterable, Iterator, Sequence

Cell = tuple[int, int, int]
Point = Sequence[float]

DIRECTIONS = [d for d in itertools.product((-1, 0, 1), repeat=3) if any(d)]


def components(cells: Iterable[Cell], connectivity: int) -> list[set[Cell]]:
    """Components by flooding, in the order of their first cell."""
    steps = [d for d in DIRECTIONS if connectivity == 26 or sum(map(abs, d)) == 1]
    left = dict.fromkeys(cells)
    found = []
    while left:
        seed = next(iter(left))
        del left[seed]
        component, queue = {seed}, [seed]
        while queue:
            x, y, z = queue.pop()
            for dx, dy, dz in steps:
                cell = (x + dx, y + dy, z + dz)
                if cell in left:
                    del left[cell]
                    component.add(cell)
                    queue.append(cell)
        found.append(component)
    return found


def clearance(cells: Iterable[Cell], point: Point, inset: float = 0.0) -> float:
    """Distance in cells from a point to the nearest cell's box, shrunk by `inset` on all sides."""
    return math.sqrt(
        min(
            (
                sum(
                    max(k + inset - p, p - (k + 1 - inset), 0.0) ** 2
                    for k, p in zip(cell, point, strict=True)
                )
                for cell in cells
            ),
            default=math.inf,
        )
    )


def allowed_cells(cells: set[Cell], size: int, clear: float) -> set[Cell]:
    """Free cells of a cube whose centres keep a distance, in cells."""
    return {
        cell
        for cell in itertools.product(range(size), repeat=3)
        if cell not in cells and (not clear or clearance(cells, [k + 0.5 for k in cell]) >= clear)
    }


def moves(cell: Cell, allowed: set[Cell]) -> Iterator[tuple[Cell, float]]:
    """Steps to the 26 cells around that cut no corner: all cells between must be allowed too."""
    for step in DIRECTIONS:
        between = itertools.product(*[{0, d} for d in step])
        if all(tuple(k + d for k, d in zip(cell, s, strict=True)) in allowed for s in between):
            x, y, z = (k + d for k, d in zip(cell, step, strict=True))
            yield (x, y, z), math.sqrt(sum(map(abs, step)))


def shortest(allowed: set[Cell], starts: dict[Cell, float], goals: dict[Cell, float]) -> float:
    """Length in cells of the shortest way, lengths before and after it added; inf without one."""
    best = math.inf
    lengths = dict(starts)
    heap = [(length, cell) for cell, length in starts.items()]
    heapq.heapify(heap)
    while heap:
        length, cell = heapq.heappop(heap)
        if length > lengths[cell]:
            continue
        if cell in goals:
            best = min(best, length + goals[cell])
        for there, step in moves(cell, allowed):
            if length + step < lengths.get(there, math.inf):
                lengths[there] = length + step
                heapq.heappush(heap, (length + step, there))
    return best
