"""The EMap paper's experiment: drives over the terrain, and the errors of each method on them."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from volatool.emap.live import EMap
from volatool.errors import OptionError
from volatool.model import F64, Progress, no_progress
from volatool.papers import emap_octomap
from volatool.papers.emap_literal import Literal, Uncoupled
from volatool.papers.emap_scene import Drive, Nodes, Scan, scans, terrain

SIDE = 40
"""Nodes a side: 1600 of them, 16 a square metre."""

CELL = 0.25
"""Metres between nodes."""

WIDE = 80
"""Nodes a side when the window is to hold the paper's radius of 10 m."""

RESOLUTION = 0.1
"""Metres: edge of OctoMap's voxels (the paper gives none)."""

MARGIN = 20
"""Cells round the window that are solved with it, where a method has a margin."""

BASELINE = "octomap"
RECOMMENDED = "emap"


class Mapper(Protocol):
    """What takes scans and gives the heights of nodes."""

    def update(self, scan: Scan) -> None:
        """Add a scan."""

    def heights(self, nodes: Nodes) -> F64:
        """Return the nodes' heights after the last scan, a (side, side) array in metres."""


class _Live:
    """An `EMap` that takes all returns, or only those in the present window."""

    def __init__(
        self, preset: str, attach: str | None = None, *, margin: int = MARGIN, drop: bool = False
    ) -> None:
        self._map = EMap(cell=CELL, preset=preset, attach=attach, margin=margin)
        self._drop = drop

    def update(self, scan: Scan) -> None:
        points = scan.points
        if self._drop:
            points = points[Nodes.around(scan.sensor, SIDE, CELL).holds(points)]
        self._map.update(points)

    def heights(self, nodes: Nodes) -> F64:
        z, _, _ = self._map.solve_window(nodes.centre, nodes.side)
        return z


class _OctoMap:
    """The baseline."""

    def __init__(self, reach: float) -> None:
        self._map = emap_octomap.OctoMapTop(RESOLUTION)
        self._reach = reach

    def update(self, scan: Scan) -> None:
        self._map.update(scan.sensor, scan.points)

    def heights(self, nodes: Nodes) -> F64:
        return self._map.heights(nodes, self._reach)


@dataclass(frozen=True, slots=True)
class Method:
    """
    A way to make a surface of scans.

    Parameters
    ----------
    key, title : str
        Name in the JSON, and in tables.
    start : callable
        Makes the mapper for one run.
    is_wide : bool
        Its window of 80 x 80 nodes is looked at too.
    """

    key: str
    title: str
    start: Callable[[Drive], Mapper]
    is_wide: bool = False


METHODS = (
    Method(
        BASELINE,
        "OctoMap 0.1 m, topmost occupied voxels",
        lambda drive: _OctoMap(drive.max_range),
        is_wide=True,
    ),
    Method(
        RECOMMENDED,
        "EMap, recommended: bending springs, bilinear, margin 20",
        lambda drive: _Live("emap"),
        is_wide=True,
    ),
    Method(
        "emap-nearest",
        "as recommended, points pull on the nearest node",
        lambda drive: _Live("emap", "nearest"),
    ),
    Method(
        "emap-window",
        "as recommended, solved on the 1600 nodes alone",
        lambda drive: _Live("emap", margin=0),
    ),
    Method(
        "emap-drop",
        "as recommended, 1600 nodes, returns outside them thrown away",
        lambda drive: _Live("emap", margin=0, drop=True),
    ),
    Method(
        "paper",
        "preset paper: stretching springs, nearest node, margin 20",
        lambda drive: _Live("paper"),
    ),
    Method(
        "paper-window",
        "preset paper, solved on the 1600 nodes alone",
        lambda drive: _Live("paper", margin=0),
    ),
    Method(
        "paper-drop",
        "preset paper, 1600 nodes, returns outside them thrown away",
        lambda drive: _Live("paper", margin=0, drop=True),
    ),
    Method(
        "uncoupled",
        "diagonal matrix made solvable: means of each node's own returns",
        lambda drive: Uncoupled(SIDE, CELL),
    ),
    Method(
        "literal",
        "equation 3 as printed (root of the magnitude)",
        lambda drive: Literal(side=SIDE, cell=CELL),
    ),
    Method(
        "literal-signed",
        "equation 3, the sign of the move put back, vertical distances",
        lambda drive: Literal(signed=True, vertical=True, side=SIDE, cell=CELL),
    ),
)


@dataclass(frozen=True, slots=True)
class Run:
    """
    Errors of one drive.

    Parameters
    ----------
    number : int
        The run; y offset in metres.
    n_points : int
        Returns of all its scans.
    errors : dict of (n_evaluated, 40, 40) arrays of float64
        Height less terrain at the nodes after each evaluated scan, in metres, by method.
    wide : dict of (n_evaluated, 80, 80) arrays of float64
        The same in windows of 20 m x 20 m, for some methods.
    distance, wide_distance : arrays of float64
        The nodes' horizontal distance to the sensor, in metres; shapes as above.
    empty : (n_evaluated,) array of float64
        Share of the 1600 nodes that no return was nearest to while they were in the window.
    """

    number: int
    n_points: int
    errors: dict[str, F64]
    wide: dict[str, F64]
    distance: F64
    wide_distance: F64
    empty: F64


def available_methods() -> tuple[Method, ...]:
    """Return the methods that can run here: all, or all but OctoMap."""
    has_octomap = emap_octomap.is_available()
    return tuple(m for m in METHODS if m.key != BASELINE or has_octomap)


def run_drive(drive: Drive, number: int, progress: Progress = no_progress) -> Run:
    """
    Drive once with all methods.

    Parameters
    ----------
    drive : Drive
        The set-up.
    number : int
        The run.
    progress : callable, optional
        Told (scans done, scans).

    Returns
    -------
    run : Run
        The errors.
    """
    methods = available_methods()
    mappers = {method.key: method.start(drive) for method in methods}
    shape = (drive.n_evaluated, SIDE, SIDE)
    errors = {method.key: np.empty(shape) for method in methods}
    wide = {m.key: np.empty((drive.n_evaluated, WIDE, WIDE)) for m in methods if m.is_wide}
    distance, wide_distance = np.empty(shape), np.empty((drive.n_evaluated, WIDE, WIDE))
    empty = np.empty(drive.n_evaluated)
    n_points = k = 0
    for scan in scans(drive, number):
        n_points += len(scan.points)
        for mapper in mappers.values():
            mapper.update(scan)
        if scan.evaluated:
            for views, r, side in ((errors, distance, SIDE), (wide, wide_distance, WIDE)):
                nodes = Nodes.around(scan.sensor, side, CELL)
                truth = terrain(*nodes.places())
                r[k] = nodes.distance(scan.sensor)
                for key, view in views.items():
                    view[k] = mappers[key].heights(nodes) - truth
            uncoupled = mappers["uncoupled"]
            assert isinstance(uncoupled, Uncoupled)
            empty[k] = uncoupled.empty
            k += 1
        progress(scan.number + 1, drive.n_scans)
    return Run(number, n_points, errors, wide, distance, wide_distance, empty)


def run_drives(
    drive: Drive, n_runs: int, *, jobs: int = 1, progress: Progress = no_progress
) -> list[Run]:
    """
    Drive `n_runs` times.

    Parameters
    ----------
    drive : Drive
        The set-up.
    n_runs : int
        Runs 0, 1, ..., at y = 0, 1, ... metres.
    jobs : int
        Runs at a time, each in a process of its own when more than one.
    progress : callable, optional
        Told (scans done, scans of all runs).

    Returns
    -------
    runs : list of Run
        By number; the same whatever `jobs` is.

    Raises
    ------
    OptionError
        Less than one run or job.
    """
    if n_runs < 1 or jobs < 1:
        raise OptionError(f"--runs and --jobs must be at least 1, got {n_runs}, {jobs}")
    total = n_runs * drive.n_scans
    if jobs == 1 or n_runs == 1:

        def told(number: int) -> Progress:
            return lambda done, _: progress(number * drive.n_scans + done, total)

        return [run_drive(drive, number, told(number)) for number in range(n_runs)]
    runs = []
    for run in _in_processes(drive, n_runs, min(jobs, n_runs)):
        runs.append(run)
        progress(len(runs) * drive.n_scans, total)
    return sorted(runs, key=lambda run: run.number)


def _in_processes(drive: Drive, n_runs: int, jobs: int) -> Iterator[Run]:
    context = multiprocessing.get_context("spawn")  # forks of numba's threads may hang
    with ProcessPoolExecutor(jobs, mp_context=context) as pool:
        waiting = [pool.submit(run_drive, drive, number) for number in range(n_runs)]
        for future in as_completed(waiting):
            yield future.result()
