"""Table 1 of the VOLA paper, measured: look-ups and memory of dense, sparse and octree."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from volatool.model import F64, I64, Bool, Progress, no_progress
from volatool.occupancy.levels import CELLS, dense_bytes
from volatool.papers import emap_octomap
from volatool.papers.vola_scene import DEEPEST, SIDE, surface
from volatool.vola.strips import level_strips
from volatool.vola.volume import Volume
from volatool.vola.words import ranks_of

POINTS = 500_000
"""Points of the surface."""

QUERIES = 200_000
"""Cells looked up in a run."""

RUNS = 7
"""Timed runs, of which the median counts; one more goes before."""

DEPTHS = tuple(range(2, DEEPEST + 1))

DENSE_LIMIT_BYTES = 256 << 20
"""Dense levels are made and timed up to here."""

_WORDS_COUNTED = 20_000_000
"""Words that a timed run without ranks may count."""

_SEED = 1


def memory(
    points: int = POINTS, depths: Sequence[int] = DEPTHS, progress: Progress = no_progress
) -> dict[str, Any]:
    """
    Return what the same surface takes as dense and sparse VOLA and as an octree, exactly.

    Parameters
    ----------
    points : int
        Points of the surface.
    depths : sequence of int
        2 to 8.
    progress : callable, optional
        Told (depths done, depths).

    Returns
    -------
    found : dict
        ``points``, ``side_m``, ``octree`` (name and version of the octree library, or None) and
        ``depths``: a dict each of sizes in bytes, without headers, all levels. ``rank_bytes`` is
        the directory that makes sparse look-ups O(h), in memory alone; octree values are None
        without the library.
    """
    whole = surface(points)
    rows = []
    for depth in depths:
        volume = whole.truncated(depth)
        blocks = sum(map(len, volume.levels))
        nodes, octree_bytes = _octree_size(volume)
        rows.append(
            {
                "depth": depth,
                "cell_m": volume.cell(),
                "voxels": volume.n_voxels,
                "blocks": blocks,
                "dense_bytes": dense_bytes(depth),
                "sparse_bytes": 8 * blocks,
                "rank_bytes": 8 * blocks,
                "octree_bytes": octree_bytes,
                "octree_nodes": nodes,
                "bits_per_voxel": 64 * blocks / volume.n_voxels,
            }
        )
        progress(len(rows), len(depths))
    return {
        "points": points,
        "side_m": SIDE,
        "octree": emap_octomap.version() if emap_octomap.is_available() else None,
        "depths": rows,
    }


def _octree(volume: Volume) -> Any:
    """Return the voxels in an OctoMap tree; the cube's middle is its origin, to fit 16 levels."""
    import pyoctomap

    tree: Any = pyoctomap.OcTree(volume.cell())
    tree.updateNodes(_moved(volume.centers()), True, True)
    tree.updateInnerOccupancy()
    return tree


def _moved(places: NDArray[np.floating[Any]]) -> F64:
    return np.ascontiguousarray(places - SIDE / 2, np.float64)


def _octree_size(volume: Volume) -> tuple[int | None, int | None]:
    """Return nodes and bytes as the OctoMap library counts them."""
    if not emap_octomap.is_available():
        return None, None
    tree = _octree(volume)
    return int(tree.calcNumNodes()), int(tree.memoryUsage())


def times(
    points: int = POINTS,
    depths: Sequence[int] = DEPTHS,
    *,
    queries: int = QUERIES,
    runs: int = RUNS,
    progress: Progress = no_progress,
) -> dict[str, Any]:
    """
    Time look-ups on the surface.

    Parameters
    ----------
    points : int
        Points of the surface.
    depths : sequence of int
        2 to 8.
    queries : int
        Cells a run: voxels drawn at random, so that no look-up ends early.
    runs : int
        Timed runs.
    progress : callable, optional
        Told (depths done, depths).

    Returns
    -------
    found : dict
        CPU nanoseconds a look-up, medians. ``depths``: a dict each with ``dense_ns`` (None beyond
        `DENSE_LIMIT_BYTES`) and ``sparse_ns``, both of the loop alone; ``find_ns`` (`Volume.find`,
        which checks the cells too), ``in_order_ns`` (the same cells in VOLA order),
        ``anywhere_ns`` (cells drawn from the whole cube: most end early), ``without_ranks_ns`` (as
        the toolkit does it), ``octree_ns`` (through its Python binding). ``fits``: a
        constant for dense, lines for sparse. ``popcount``: a word by table and by arithmetic.
    """
    whole = surface(points)
    rows = []
    for depth in depths:
        rows.append(_times_at(whole.truncated(depth), queries, runs))
        progress(len(rows), len(depths))
    return {
        "queries": queries,
        "runs": runs,
        "depths": rows,
        "fits": {"dense": constant([row["dense_ns"] for row in rows])}
        | {
            name: line([(row["depth"], row[f"{name}_ns"]) for row in rows])
            for name in ("sparse", "in_order")
        },
        "popcount": _popcount_times(whole, runs),
    }


def constant(values: Sequence[float | None]) -> dict[str, float]:
    """
    Return mean, least and most of the values that are not None.

    Examples
    --------
    >>> constant([1.0, 3.0, None])
    {'mean': 2.0, 'least': 1.0, 'most': 3.0}
    """
    known = [value for value in values if value is not None]
    return {"mean": sum(known) / len(known), "least": min(known), "most": max(known)}


def line(pairs: Sequence[tuple[float, float | None]]) -> dict[str, float] | None:
    """
    Fit a line by least squares.

    Parameters
    ----------
    pairs : sequence of (x, y)
        Those with y None are left out.

    Returns
    -------
    fit : dict or None
        ``at_zero``, ``slope`` and ``correlation`` (0 if all y are equal); None for fewer than 2
        pairs.

    Examples
    --------
    >>> line([(1, 3.0), (2, 5.0), (3, 7.0), (4, None)])
    {'at_zero': 1.0, 'slope': 2.0, 'correlation': 1.0}
    """
    known = np.array([(x, y) for x, y in pairs if y is not None], np.float64)
    if len(known) < 2:
        return None
    x, y = known.T
    away = x - x.mean(), y - y.mean()
    slope = float(away[0] @ away[1] / (away[0] @ away[0]))
    spread = float(np.sqrt((away[0] @ away[0]) * (away[1] @ away[1])))
    return {
        "at_zero": float(y.mean() - slope * x.mean()),
        "slope": slope,
        "correlation": float(away[0] @ away[1]) / spread if spread else 0.0,
    }


def _times_at(volume: Volume, queries: int, runs: int) -> dict[str, Any]:
    rng = np.random.default_rng([_SEED, volume.depth])
    rows = np.sort(rng.integers(0, volume.n_voxels, queries))
    ordered: I64 = volume.voxels()[rows].astype(np.int64)
    shuffled = ordered[rng.permutation(queries)]
    anywhere = rng.integers(0, 4**volume.depth, (queries, 3))
    few = shuffled[: max(20, min(queries, _WORDS_COUNTED // sum(map(len, volume.levels))))]
    found = np.empty(queries, np.bool_)
    return {
        "depth": volume.depth,
        "dense_ns": _dense_ns(volume, shuffled, found, runs),
        "sparse_ns": _ns(descent(volume, shuffled), queries, runs),
        "in_order_ns": _ns(descent(volume, ordered), queries, runs),
        "anywhere_ns": _ns(descent(volume, anywhere), queries, runs),
        "find_ns": _ns(lambda: volume.find(shuffled), queries, runs),
        "without_ranks_ns": _without_ranks_ns(volume, few, runs),
        "octree_ns": _octree_ns(volume, shuffled, runs),
    }


def _ns(work: Callable[[], object], n: int, runs: int) -> float:
    """Return the median CPU time of a run over `n`, in nanoseconds."""
    laps = np.empty(runs)
    work()
    for lap in range(runs):
        begin = time.process_time_ns()
        work()
        laps[lap] = time.process_time_ns() - begin
    return float(np.median(laps)) / n


def descent(volume: Volume, cells: I64) -> Callable[[], I64]:
    """
    Return a function that looks cells up level by level with ranks, without checks.

    Parameters
    ----------
    volume : Volume
        Where.
    cells : (m, 3) array of int64
        Inside the grid.
    """
    from volatool.kernels import lookup

    ranks = [ranks_of(words) for words in volume.levels]
    here = np.empty(len(cells), np.int64)

    def work() -> I64:
        here[:] = 0
        for i, (level, rank) in enumerate(zip(volume.levels, ranks, strict=True)):
            lookup.descend(level, rank, cells, 2 * (volume.depth - 1 - i), here)
        return here

    return work


def dense_found(volume: Volume, cells: I64, found: Bool) -> Callable[[], None] | None:
    """
    Return a function that looks cells up in the dense deepest level; None if that is too large.

    Parameters
    ----------
    volume : Volume
        Small enough for `DENSE_LIMIT_BYTES`, or not.
    cells : (m, 3) array of int64
        Inside the grid.
    found : (m,) array of bool
        Set by the function.
    """
    from volatool.kernels import lookup

    if 8 * CELLS ** (volume.depth - 1) > DENSE_LIMIT_BYTES:
        return None
    words, _ = level_strips(volume, volume.depth).full(volume.depth)
    return lambda: lookup.dense(words, cells, 2 * volume.depth, found)


def _dense_ns(volume: Volume, cells: I64, found: Bool, runs: int) -> float | None:
    work = dense_found(volume, cells, found)
    return None if work is None else _ns(work, len(cells), runs)


def without_ranks(volume: Volume, cells: I64, found: Bool) -> Callable[[], None]:
    """Return a function that looks cells up by counting bits from the level's beginning."""
    from volatool.kernels import lookup

    words = np.concatenate(volume.levels)
    starts = np.cumsum([0, *map(len, volume.levels)])
    return lambda: lookup.counting(words, starts, cells, found)


def _without_ranks_ns(volume: Volume, cells: I64, runs: int) -> float:
    work = without_ranks(volume, cells, np.empty(len(cells), np.bool_))
    return _ns(work, len(cells), runs)


def _octree_ns(volume: Volume, cells: I64, runs: int) -> float | None:
    if not emap_octomap.is_available():
        return None
    tree = _octree(volume)
    places = _moved((cells[: 1 << 15] + 0.5) * volume.cell())
    return _ns(lambda: tree.getLabels(places), len(places), min(runs, 3))


def _popcount_times(volume: Volume, runs: int) -> dict[str, float]:
    """Return the time to count the bits of a word by a table and by arithmetic."""
    from volatool.kernels import lookup

    words = volume.levels[-1]
    table = np.bitwise_count(np.arange(1 << 16, dtype=np.uint16))
    return {
        "table_ns": _ns(lambda: lookup.count_by_table(words, table), len(words), runs),
        "arithmetic_ns": _ns(lambda: lookup.count_by_arithmetic(words), len(words), runs),
    }
