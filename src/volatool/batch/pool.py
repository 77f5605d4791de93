"""Workers in processes of their own, watched over: one that is killed costs no other tile.

`concurrent.futures` and loky give up all pending work when a worker is killed, and pools whose
workers share one queue can be left with its lock held by a dead one. Here each worker has a pipe of
its own, and the parent waits on all pipes at once.
"""

from __future__ import annotations

import contextlib
import logging
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections.abc import Generator, Iterable, Iterator
from multiprocessing.connection import Connection, wait
from typing import Any

from volatool.batch.executor import Watcher
from volatool.batch.work import Result, Unit, Work, lost, perform
from volatool.batch.worker import Advanced, Logged, Ready
from volatool.errors import VolatoolError
from volatool.outputs import sweep

ATTEMPTS = 2
"""How often a unit is tried whose worker is lost."""

_STARTS = 5
"""Workers that may be lost in a row before any gets to its first unit."""

_PATIENCE_S = 5.0
"""How long a stopped worker may take to clean up."""

logger = logging.getLogger(__name__)


class Pool:
    """
    Works in several processes of this machine; an `Executor`.

    Parameters
    ----------
    jobs : int
        Number of processes.
    threads : int
        Cores that each may use.
    work : callable
        What they do with a unit: a function of a module.
    """

    in_order = False

    def __init__(self, jobs: int, threads: int = 1, work: Work = perform) -> None:
        self.jobs = jobs
        self.threads = threads
        self.work = work

    def results(
        self, units: Iterable[Unit], watcher: Watcher
    ) -> Generator[tuple[Unit, Result], None, None]:
        """Work on units; see `Executor.results`."""
        run = _Run(self, iter(units), watcher)
        try:
            yield from run.results()
        finally:
            run.stop()


class _Worker:
    """A process, the parent's end of its pipe, and the unit it works on."""

    def __init__(self, pool: Pool) -> None:
        self.pipe, end = multiprocessing.Pipe()
        # no fork: numba, GDAL and others have threads; no `multiprocessing.Process` either: that
        # runs the parent's main module once more, which need not be written for it
        command = [sys.executable, "-P", "-m", "volatool.batch.worker"]
        command += [str(end.fileno()), str(pool.threads), str(_log_level())]
        try:
            with _without_interrupts():
                self.process = subprocess.Popen(
                    command,
                    env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
                    pass_fds=[end.fileno()],
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                )
        except OSError as error:
            raise VolatoolError(f"workers can't be started ({error})", "E_WORKER") from error
        finally:
            end.close()  # the worker's own copy is the last one: its death ends the pipe
        self.unit: Unit | None = None
        self.is_ready = False
        self._send(pool.work)

    def give(self, unit: Unit) -> None:
        """Send a unit to work on."""
        self.unit = unit
        self._send(unit)

    def _send(self, message: Any) -> None:
        with contextlib.suppress(OSError):  # it died just now: the pipe's end tells
            self.pipe.send(message)

    def end(self) -> str:
        """Return how a worker that is gone ended."""
        self.pipe.close()
        self.wait(_PATIENCE_S)
        self.process.kill()  # if it still is alive
        code = self.process.wait()
        if code >= 0:
            return f"ended with status {code}"
        with contextlib.suppress(ValueError):
            return f"was killed ({signal.Signals(-code).name})"
        return f"was killed (signal {-code})"

    def wait(self, seconds: float) -> None:
        """Wait for the end, but not for long."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.process.wait(seconds)


class _Run:
    """One run of a pool: its workers and what they have to do."""

    def __init__(self, pool: Pool, units: Iterator[Unit], watcher: Watcher) -> None:
        self.pool, self.units, self.watcher = pool, units, watcher
        self.workers: dict[Connection, _Worker] = {}
        self.leaving: list[_Worker] = []
        self.n_false_starts = 0

    def results(self) -> Iterator[tuple[Unit, Result]]:
        """Yield results until there is no more to do."""
        unit = next(self.units, None)
        while unit is not None:  # no more workers than units
            self._start(unit)
            unit = next(self.units, None) if len(self.workers) < self.pool.jobs else None
        while self.workers:
            for pipe in wait(list(self.workers)):
                assert isinstance(pipe, Connection)
                worker = self.workers[pipe]
                try:
                    message = pipe.recv()
                except (EOFError, OSError):
                    yield from self._lost(worker)
                    continue
                yield from self._take(worker, message)

    def _start(self, unit: Unit) -> None:
        worker = _Worker(self.pool)
        self.workers[worker.pipe] = worker
        self._give(worker, unit)

    def _give(self, worker: _Worker, unit: Unit) -> None:
        worker.give(unit)
        self.watcher.started(unit)

    def _take(self, worker: _Worker, message: Any) -> Iterator[tuple[Unit, Result]]:
        """Act on what a worker says."""
        unit = worker.unit
        assert unit is not None
        if isinstance(message, Ready):
            self.n_false_starts, worker.is_ready = 0, True
        elif isinstance(message, Advanced):
            self.watcher.advanced(unit, message.done, message.total)
        elif isinstance(message, Logged):
            logging.getLogger(message.record.name).handle(message.record)
        else:
            following = next(self.units, None)
            if following is None:
                self._dismiss(worker)
            else:  # before the result is dealt with, so that the worker need not wait
                self._give(worker, following)
            yield unit, message

    def _dismiss(self, worker: _Worker) -> None:
        """Let a worker without work go, in its own time."""
        del self.workers[worker.pipe]
        self.leaving.append(worker)
        worker.unit = None
        worker.pipe.close()

    def _lost(self, worker: _Worker) -> Iterator[tuple[Unit, Result]]:
        """Try the unit of a worker that is gone once more, in a new one, or give it up."""
        del self.workers[worker.pipe]
        unit, how = worker.unit, worker.end()
        assert unit is not None
        _sweep(unit)
        if not worker.is_ready:  # it has not come to the unit: that is not the unit's fault
            self.n_false_starts += 1
            if self.n_false_starts >= _STARTS:
                raise VolatoolError(
                    f"workers can't be started: the last one {how} before its first tile",
                    "E_WORKER",
                )
            self._start(unit)
            return
        following: Unit | None
        if unit.attempt < ATTEMPTS:
            logger.warning("%s: its worker %s; it is tried once more", unit.path, how)
            following = unit.again()
        else:
            following = next(self.units, None)
        if following is not None:
            self._start(following)
        if unit.attempt >= ATTEMPTS:
            yield unit, lost(unit, how)

    def stop(self) -> None:
        """End the workers that are left; when this returns none is alive."""
        for worker in self.workers.values():
            worker.process.terminate()  # it cleans up behind itself
        deadline = time.monotonic() + _PATIENCE_S
        workers = [*self.workers.values(), *self.leaving]
        try:
            for worker in workers:
                worker.wait(max(0.0, deadline - time.monotonic()))
        finally:
            for worker in workers:
                worker.process.kill()
                worker.end()
                if worker.unit is not None:
                    _sweep(worker.unit)


def _sweep(unit: Unit) -> None:
    """Remove what a worker that is gone had begun to write."""
    folder = unit.path.parent if unit.outdir is None else unit.outdir
    if unit.kind != "stats":
        with contextlib.suppress(VolatoolError):
            sweep(folder)


@contextlib.contextmanager
def _without_interrupts() -> Iterator[None]:
    """Start a process that Ctrl-C does not reach; one that comes meanwhile waits."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _log_level() -> int:
    """Return the least level that a handler of volatool's log takes."""
    handlers = logging.getLogger("volatool").handlers
    # 0 would not be the least level but the root logger's
    return max(1, min((handler.level for handler in handlers), default=logging.WARNING))
