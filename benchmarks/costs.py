"""What a command takes: wall time, CPU time and peak memory of its whole process tree."""

from __future__ import annotations

import os
import shlex
import statistics
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path

SAMPLE_S = 0.02
SAMPLES_PER_SEARCH = 5
"""Samples between two looks for new processes, which cost more than a sample."""

PROC = Path("/proc")


@dataclass(frozen=True, slots=True)
class Cost:
    """
    What one run took.

    Parameters
    ----------
    wall_s, cpu_s : float
        Time from start to end; user and system time of all processes.
    peak_mib : float
        Largest resident memory of all processes together.
    """

    wall_s: float
    cpu_s: float
    peak_mib: float

    def to_dict(self) -> dict[str, float]:
        """Return the numbers by name."""
        return asdict(self)


def median(costs: Sequence[Cost]) -> Cost:
    """Return the median of each number."""
    return Cost(*(statistics.median(getattr(c, f.name) for c in costs) for f in fields(Cost)))


def run(command: list[str], allowed: Sequence[int] = ()) -> Cost | None:
    """
    Run a command and measure it.

    Parameters
    ----------
    command : list of str
        Program and arguments.
    allowed : sequence of int
        Exit codes, besides 0, that don't end the benchmark.

    Returns
    -------
    cost : Cost
        CPU time is that of the process and of those it has waited for. None after one of the
        allowed codes.
    """
    start = time.perf_counter()
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) as child:
        watch = TreeWatch(child.pid)
        assert child.stderr is not None
        message = child.stderr.read()
        _, status, usage = os.wait4(child.pid, 0)
        wall = time.perf_counter() - start
        watch.stop()
        child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode in allowed:
        return None
    if child.returncode:
        sys.exit(f"{shlex.join(command)}\nexit code {child.returncode}\n{message.decode()}")
    peak = watch.peak_bytes / 2**20
    if not PROC.is_dir():  # of the largest process then
        peak = usage.ru_maxrss / (2**20 if sys.platform == "darwin" else 2**10)
    return Cost(wall, usage.ru_utime + usage.ru_stime, peak)


class TreeWatch:
    """
    Samples the resident memory of a process and its descendants until it is stopped.

    Parameters
    ----------
    pid : int
        The root.

    Attributes
    ----------
    peak_bytes : int
        Largest sum seen, and at least the largest process's own peak, which the kernel keeps:
        a sum can miss what lasts less than `SAMPLE_S`. Pages that processes share count in each.
    """

    def __init__(self, pid: int) -> None:
        self.peak_bytes = 0
        self._root = pid
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End the sampling."""
        self._ended.set()
        self._thread.join()

    def _watch(self) -> None:
        pids, turn = [self._root], 0
        while not self._ended.wait(SAMPLE_S if turn else 0):
            if turn % SAMPLES_PER_SEARCH == 0:
                pids = descendants(self._root)
            memory = [resident(pid) for pid in pids]
            peaks = [own_peak for _, own_peak in memory]
            self.peak_bytes = max(self.peak_bytes, sum(now for now, _ in memory), *peaks)
            turn += 1


def resident(pid: int | str) -> tuple[int, int]:
    """Return resident bytes of a process now and at its peak; 0, 0 once it is gone."""
    found = {"VmRSS": 0, "VmHWM": 0}
    try:
        lines = (PROC / str(pid) / "status").read_text().splitlines()
    except OSError:
        return 0, 0
    for line in lines:
        name, _, value = line.partition(":")
        if name in found:
            found[name] = int(value.split()[0]) << 10
    return found["VmRSS"], found["VmHWM"]


def descendants(root: int) -> list[int]:
    """Return a process and all below it."""
    children: dict[int, list[int]] = {}
    for entry in os.scandir(PROC) if PROC.is_dir() else ():
        if entry.name.isdigit():
            try:
                stat = Path(entry.path, "stat").read_text()
            except OSError:
                continue  # it ended meanwhile
            parent = int(stat.rsplit(")", 1)[1].split()[1])
            children.setdefault(parent, []).append(int(entry.name))
    found = [root]
    for pid in found:
        found += children.get(pid, [])
    return found


def forget_peak() -> None:
    """Make this process's peak memory start anew (Linux)."""
    try:
        (PROC / "self" / "clear_refs").write_text("5")
    except OSError:
        return
