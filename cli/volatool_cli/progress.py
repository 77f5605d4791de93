"""Progress of a run over tiles and points, on stderr: a bar, JSON lines, or nothing."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import Any

import click

from volatool.batch.executor import Watcher
from volatool.batch.work import Result, Unit

_LEAST_WEIGHT = 1 << 16
"""Bytes that an input counts at least: reading an empty file takes time too."""


class Quiet(Watcher):
    """Shows nothing."""

    n_skipped = 0
    """Inputs that an earlier run has done."""

    def planned(self, sizes: Sequence[int], n_done: int) -> None:
        """Keep how many inputs are done already."""
        self.n_skipped = n_done

    def aside(self) -> AbstractContextManager[Any]:
        """Return a context in which something else may be printed."""
        return nullcontext()


class Counting(Quiet):
    """Knows how much is done and how long the rest will take."""

    def __init__(self) -> None:
        self.n_done = self.n_failed = self.n_tiles = 0
        self._weights: Sequence[int] = ()
        self._done: dict[int, float] = {}  # of the units being worked on
        self._finished = self._total = 0.0
        self._began = 0.0

    def planned(self, sizes: Sequence[int], n_done: int) -> None:
        """Learn what is to be done."""
        super().planned(sizes, n_done)
        self._weights = sizes
        self.n_tiles = len(sizes) - n_done
        self._total = sum(max(size, _LEAST_WEIGHT) for size in sizes if size)
        self._began = time.monotonic()

    def started(self, unit: Unit) -> None:
        """Count a unit as being worked on."""
        self._done[unit.index] = 0.0

    def advanced(self, unit: Unit, done: int, total: int) -> None:
        """Count a part of a unit."""
        self._done[unit.index] = self._weight(unit.index) * (done / total if total else 1.0)

    def finished(self, unit: Unit, result: Result) -> None:
        """Count a unit as done or failed."""
        self._done.pop(unit.index, None)
        self._finished += self._weight(unit.index)
        self.n_done += 1
        self.n_failed += result.code is not None

    def _weight(self, index: int) -> int:
        return max(self._weights[index], _LEAST_WEIGHT)

    @property
    def bytes_total(self) -> float:
        """Bytes of all inputs to work on."""
        return self._total

    @property
    def bytes_done(self) -> float:
        """Bytes of the inputs done, and of the parts done of those being worked on."""
        return self._finished + sum(self._done.values())

    @property
    def seconds_left(self) -> float | None:
        """What the rest takes at the pace so far; None before there is any."""
        if not self.bytes_done:
            return None
        pace = (time.monotonic() - self._began) / self.bytes_done
        return pace * (self._total - self.bytes_done)


class JsonLines(Counting):
    """One JSON object a line, for programs; docs/how-to/many-tiles.md has the fields."""

    def __init__(self) -> None:
        super().__init__()
        self._percent: dict[int, int] = {}
        self._names: dict[int, str] = {}

    def started(self, unit: Unit) -> None:
        """Begin to count a unit's per cents."""
        super().started(unit)
        self._percent[unit.index], self._names[unit.index] = -1, unit.path.name

    def advanced(self, unit: Unit, done: int, total: int) -> None:
        """Print each per cent once."""
        super().advanced(unit, done, total)
        percent = 100 * done // total if total else 100
        if percent > self._percent[unit.index]:
            self._percent[unit.index] = percent
            _say(event="progress", name=unit.path.name, done=done, total=total)

    def finished(self, unit: Unit, result: Result) -> None:
        """Print how the unit ended and, when there are others, how the run stands."""
        super().finished(unit, result)
        self._percent.pop(unit.index, None)
        name = self._names.pop(unit.index, unit.path.name)
        _say(event="done" if result.code is None else "failed", name=name)
        if self.n_tiles > 1:
            left = self.seconds_left
            _say(
                event="tiles",
                done=self.n_done,
                failed=self.n_failed,
                skipped=self.n_skipped,
                total=self.n_tiles,
                seconds_left=None if left is None else round(left, 1),
            )

    def ended(self) -> None:
        """Print what is left undone."""
        for name in self._names.values():
            _say(event="failed", name=name)


def _say(**event: Any) -> None:
    click.echo(json.dumps(event, sort_keys=True), err=True)


class Bar(Counting):
    """A bar on the terminal: points of a single tile, bytes of the inputs of many."""

    def __init__(self) -> None:
        super().__init__()
        self._bar: Any = None

    def planned(self, sizes: Sequence[int], n_done: int) -> None:
        """Show the empty bar."""
        from tqdm import tqdm

        super().planned(sizes, n_done)
        self._bar = tqdm(
            total=None if self.n_tiles == 1 else self.bytes_total,
            unit="pt" if self.n_tiles == 1 else "B",
            unit_scale=True,
            file=sys.stderr,
            leave=False,
        )
        self._describe()

    def started(self, unit: Unit) -> None:
        """Show the name of a single tile."""
        super().started(unit)
        if self.n_tiles == 1:
            self._bar.set_description(unit.path.name, refresh=False)

    def advanced(self, unit: Unit, done: int, total: int) -> None:
        """Move the bar."""
        super().advanced(unit, done, total)
        if self.n_tiles == 1:
            self._bar.total = total
            self._bar.update(done - self._bar.n)
        else:
            self._move()

    def finished(self, unit: Unit, result: Result) -> None:
        """Count the tile."""
        super().finished(unit, result)
        if self.n_tiles > 1:
            self._describe()
            self._move()

    def _move(self) -> None:
        # a tile tried once more is counted again from its beginning: no bar moves back
        self._bar.update(max(0, self.bytes_done - self._bar.n))

    def _describe(self) -> None:
        if self.n_tiles > 1:
            failed = f", {self.n_failed} failed" if self.n_failed else ""
            text = f"{self.n_done}/{self.n_tiles} tiles{failed}"
            self._bar.set_description(text, refresh=False)

    def ended(self) -> None:
        """Take the bar away."""
        self._bar.close()

    def aside(self) -> AbstractContextManager[Any]:
        """Return a context without the bar, in which something else may be printed."""
        return self._bar.external_write_mode(file=sys.stderr)  # type: ignore[no-any-return]


def watcher_of(form: str, quiet: bool) -> Quiet:
    """
    Return what shows a run's progress.

    Parameters
    ----------
    form : str
        ``"auto"`` (a bar on a terminal), ``"bar"``, ``"json"`` or ``"none"``.
    quiet : bool
        No bar unless asked for by name.
    """
    if form == "json":
        return JsonLines()
    if form == "bar" or (form == "auto" and not quiet and sys.stderr.isatty()):
        return Bar()
    return Quiet()
