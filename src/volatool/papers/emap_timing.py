"""Time of an EMap loop against the number of nodes: the paper's Figure 6."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np

from volatool.emap.live import EMap
from volatool.model import Progress, no_progress
from volatool.papers.emap_scene import Drive, scans

SIDES = (20, 40, 80, 113, 160, 226, 320)
"""Nodes a side: 400 to 102,400."""

EXTENT = 10.0
"""Metres a side of the window, whatever the number of nodes."""

WARM, TIMED = 3, 11
"""Loops before the clock counts, and counted ones."""


@dataclass(frozen=True, slots=True)
class LoopTime:
    """
    CPU time of one loop: add a scan, solve from the last heights; medians.

    Parameters
    ----------
    nodes : int
        Of the window; no margin.
    update_s, solve_s : float
        Its two parts.
    """

    nodes: int
    update_s: float
    solve_s: float

    @property
    def seconds(self) -> float:
        """Both parts."""
        return self.update_s + self.solve_s

    def to_dict(self) -> dict[str, float]:
        """Return the JSON object."""
        return {
            "nodes": self.nodes,
            "update_s": self.update_s,
            "solve_s": self.solve_s,
            "loop_s": self.seconds,
        }


def loop_times(
    drive: Drive, sides: Sequence[int] = SIDES, progress: Progress = no_progress
) -> list[LoopTime]:
    """
    Time the recommended EMap in windows of 10 m, from coarse to fine.

    Parameters
    ----------
    drive : Drive
        Whose first run gives the scans.
    sides : sequence of int
        Nodes a side.
    progress : callable, optional
        Told (sizes done, sizes).

    Returns
    -------
    times : list of LoopTime
        CPU seconds of this process: other load on the machine counts little.
    """
    first = list(islice(scans(drive, 0), WARM + TIMED))
    times = []
    for side in sides:
        live = EMap(cell=EXTENT / side, margin=0)
        laps = np.empty((len(first), 2))
        for lap, scan in zip(laps, first, strict=True):
            begin = time.process_time()
            live.update(scan.points)
            middle = time.process_time()
            live.solve_window(scan.sensor, side)
            lap[:] = middle - begin, time.process_time() - middle
        update, solve = np.median(laps[min(WARM, len(first) - 1) :], axis=0)
        times.append(LoopTime(side * side, float(update), float(solve)))
        progress(len(times), len(sides))
    return times
