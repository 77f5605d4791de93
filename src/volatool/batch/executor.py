"""Where units are worked on: what all executors have in common, and the one without workers."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Sequence
from functools import partial
from typing import Protocol

from volatool.batch.work import Result, Unit, Work, perform


class Watcher:
    """
    Told how a run gets on; this one does nothing.

    All calls are made in the thread of the run.
    """

    def planned(self, sizes: Sequence[int], n_done: int) -> None:
        """
        Take note of what there is to do, before the work begins.

        Parameters
        ----------
        sizes : sequence of int
            Bytes of each input, by index; 0 for those that are done already, 1 where it is unknown.
        n_done : int
            Inputs that an earlier run has done.
        """

    def started(self, unit: Unit) -> None:
        """Take note of a unit being worked on (once more, if its worker was lost)."""

    def advanced(self, unit: Unit, done: int, total: int) -> None:
        """Take note of how many of a unit's points are done."""

    def finished(self, unit: Unit, result: Result) -> None:
        """Take note of a unit that is done or has failed, for good."""

    def ended(self) -> None:
        """Take note that the run is over, or was stopped."""


class Executor(Protocol):
    """Works on units somewhere."""

    in_order: bool
    """Units should come in the order of the inputs; otherwise the largest first."""

    def results(
        self, units: Iterable[Unit], watcher: Watcher
    ) -> Generator[tuple[Unit, Result], None, None]:
        """
        Work on units with `volatool.batch.work.perform`.

        Parameters
        ----------
        units : iterable of Unit
            Taken only as fast as they can be worked on, so that memory does not grow with their
            number.
        watcher : Watcher
            Told of ``started`` and, where that can be known, ``advanced``.

        Yields
        ------
        unit, result : Unit, Result
            In the order in which they finish. When a worker is lost, its unit is tried once more
            (`Unit.again`); when that worker is lost too, the result is `volatool.batch.work.lost`.

        Notes
        -----
        Closing the generator, which is also what an exception in its user comes to, stops the work:
        when ``close`` returns, no worker writes any more.
        """
        ...


class Serial:
    """
    Works in this process, on one unit after the other.

    Parameters
    ----------
    work : callable
        What is done with a unit.
    """

    in_order = True

    def __init__(self, work: Work = perform) -> None:
        self.work = work

    def results(
        self, units: Iterable[Unit], watcher: Watcher
    ) -> Generator[tuple[Unit, Result], None, None]:
        """Work on units; see `Executor.results`."""
        for unit in units:
            watcher.started(unit)
            yield unit, self.work(unit, partial(watcher.advanced, unit))
