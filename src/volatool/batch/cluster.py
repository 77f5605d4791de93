"""Units worked on by a Dask cluster; the one module that imports distributed (extra ``dask``)."""

from __future__ import annotations

import contextlib
import functools
import logging
import os
import queue
import threading
import time
import uuid
from collections.abc import Generator, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from volatool._version import __version__
from volatool.batch.executor import Watcher
from volatool.batch.work import Result, Unit, lost, perform
from volatool.batch.worker import prepare
from volatool.errors import OptionError, VolatoolError

try:
    import dask
    import distributed
except ImportError as error:  # pragma: no cover (seen by a test in a process of its own)
    raise OptionError(
        "--scheduler needs the extra 'dask': pip install 'volatool[dask]'", "E_NO_EXTRA"
    ) from error

RESOURCE = "tile"
"""Dask resource that a worker may declare (``--resources tile=1``): tiles it works on at a time."""

_CONNECT_S = 20.0
_LEAST_AHEAD = 32
"""Units handed to the scheduler before any is done: it has to see work to start workers for it."""

_NEWS_S = 0.5
_WAIT_S = 1.0

logger = logging.getLogger(__name__)

_one_at_a_time = threading.Lock()


class _Stopped(BaseException):  # so that nothing on the way takes it for a failed tile
    """The run was stopped while a worker was at work."""


class Cluster:
    """
    Works on a Dask cluster; an `Executor`.

    Parameters
    ----------
    address : str
        Of a scheduler, such as ``tcp://host:8786``; ``"local"`` starts one with workers on this
        machine, for the time of the run.
    jobs : int
        Workers of a local cluster.
    threads : int
        Cores of each worker of a local cluster.

    Notes
    -----
    A worker takes one unit at a time whatever its number of threads, since the memory ceiling is
    the process's; the threads are the unit's. Where workers declare the resource `RESOURCE` the
    scheduler knows of this. Inputs and outputs are on a file system that all share: a worker works
    in the folder that the parent works in, if it has it.

    A unit whose worker is lost is tried again by the scheduler itself, as often as its
    ``allowed-failures`` say.
    """

    in_order = False

    def __init__(self, address: str, jobs: int = 1, threads: int = 1) -> None:
        self.address = address
        self.jobs, self.threads = jobs, threads

    def results(
        self, units: Iterable[Unit], watcher: Watcher
    ) -> Generator[tuple[Unit, Result], None, None]:
        """Work on units; see `Executor.results`."""
        with contextlib.ExitStack() as stack:
            client = stack.enter_context(self._client(stack))
            run = _Run(client, iter(units), watcher)
            try:
                yield from run.results()
            finally:
                run.stop(at_once=self.address == "local")

    def _client(self, stack: contextlib.ExitStack) -> distributed.Client:
        """Connect to the scheduler, and see that its workers are like this process."""
        # the tiles say what is wrong with them; the scheduler's own lines would say it again
        logging.getLogger("distributed").setLevel(logging.CRITICAL)
        where: Any = self.address
        if self.address == "local":
            stack.enter_context(
                dask.config.set({"distributed.scheduler.allowed-failures": 1})  # tried twice
            )
            where = stack.enter_context(
                distributed.LocalCluster(
                    n_workers=self.jobs,
                    threads_per_worker=self.threads,
                    memory_limit=None,  # volatool keeps its own ceiling
                    resources={RESOURCE: 1},
                    dashboard_address=None,
                    # its metrics are served all the same: not on 8787, another run may be there
                    scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},
                )
            )
        try:
            client = distributed.Client(where, timeout=_CONNECT_S, set_as_default=False)
        except (OSError, ValueError, TimeoutError) as error:
            raise VolatoolError(
                f"--scheduler {self.address}: no Dask scheduler answers ({error})", "E_CLUSTER"
            ) from error
        try:
            _check_workers(client, self.address)
        except BaseException:
            client.close()
            raise
        return client


def _check_workers(client: distributed.Client, address: str) -> None:
    """Refuse workers without this version of volatool: their outputs would be others."""
    # by a builtin: a function of ours could not even be unpickled without volatool
    code = "__import__('volatool').__version__"
    found = client.run(eval, code, on_error="return")
    for worker, version in found.items():
        if version != __version__:
            told = "none" if isinstance(version, BaseException) else version
            raise VolatoolError(
                f"--scheduler {address}: worker {worker} has volatool {told}, this is "
                f"{__version__}; install the same on all",
                "E_CLUSTER",
            )
    if not found:
        logger.warning("--scheduler %s: has no workers yet; waiting for them", address)


class _Run:
    """One run on a cluster: what the scheduler has been given, and what comes back."""

    def __init__(self, client: distributed.Client, units: Iterator[Unit], watcher: Watcher) -> None:
        self.client, self.units, self.watcher = client, units, watcher
        self.topic = f"volatool-{uuid.uuid4().hex}"
        self.news: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self.at_work: dict[distributed.Future[Any], Unit] = {}
        self.stopping = distributed.Event(self.topic, client=client)
        self.folder = str(Path.cwd())
        self.resources: dict[str, int] | None = None
        self.n_ahead = _LEAST_AHEAD
        self._looked = 0.0

    def results(self) -> Iterator[tuple[Unit, Result]]:
        """Yield results until there is no more to do."""
        by_index: dict[int, Unit] = {}
        started: set[int] = set()
        self.client.subscribe_topic(self.topic, self._hear)
        try:
            while self._fill(by_index):
                try:
                    message = self.news.get(timeout=_WAIT_S)
                except queue.Empty:
                    self._check_scheduler()
                    continue
                if isinstance(message, tuple):
                    index, done, total = message
                    unit = by_index.get(index)
                    if unit is not None:  # news may be late
                        if index not in started:
                            started.add(index)
                            self.watcher.started(unit)
                        self.watcher.advanced(unit, done, total)
                    continue
                unit = self.at_work.pop(message)
                by_index.pop(unit.index)
                if unit.index not in started:
                    self.watcher.started(unit)
                started.discard(unit.index)
                yield unit, self._result(unit, message)
        finally:
            with contextlib.suppress(Exception):  # the scheduler may be gone
                self.client.unsubscribe_topic(self.topic)

    def _hear(self, event: tuple[float, Any]) -> None:
        """Take news of a worker; called in the client's own thread."""
        self.news.put(tuple(event[1]))

    def _fill(self, by_index: dict[int, Unit]) -> bool:
        """Hand the scheduler as many units as keep the workers busy; False when all is done."""
        self._look()
        while len(self.at_work) < self.n_ahead:
            unit = next(self.units, None)
            if unit is None:
                break
            # the scheduler may have a unit begun anew whose lost worker had named its outputs;
            # that there were none before, or may be replaced, the parent has seen to
            future = self.client.submit(
                _perform,
                replace(unit, overwrite=True),
                self.folder,
                self.topic,
                key=f"{self.topic}-{unit.index}",
                resources=self.resources,
                pure=False,
            )
            self.at_work[future] = unit
            by_index[unit.index] = unit
            future.add_done_callback(self.news.put)
        return bool(self.at_work)

    def _look(self) -> None:
        """See now and then what the workers are: some come, some go."""
        now = time.monotonic()
        if now - self._looked < 5.0:
            return
        self._looked = now
        workers = self.client.scheduler_info(n_workers=-1)["workers"].values()
        declared = sum(int(worker["resources"].get(RESOURCE, 0)) for worker in workers)
        self.resources = {RESOURCE: 1} if declared else None
        slots = declared or sum(worker["nthreads"] for worker in workers)
        self.n_ahead = max(_LEAST_AHEAD, 2 * slots)

    def _check_scheduler(self) -> None:
        if self.client.status in ("closed", "closing"):
            raise _gone()

    def _result(self, unit: Unit, future: distributed.Future[Any]) -> Result:
        """Return what a future has become."""
        if future.status == "finished":
            result: Result = future.result()
            return result
        if future.status != "error":  # cancelled, lost: not by us
            raise _gone()
        error = future.exception()
        if isinstance(error, distributed.KilledWorker):
            return lost(unit, "was lost")
        return lost(unit, f"failed ({type(error).__name__}: {error})")

    def stop(self, at_once: bool) -> None:
        """
        See that no worker writes any more.

        Parameters
        ----------
        at_once : bool
            The workers are ended by the caller.
        """
        if not self.at_work:
            return
        with contextlib.suppress(Exception):  # the scheduler may be gone, and its workers with it
            self.stopping.set()
            if at_once:
                self.client.cancel(list(self.at_work))
            else:  # a thread can't be ended from outside: each unit sees the event and leaves
                distributed.wait(list(self.at_work))


def _gone() -> VolatoolError:
    return VolatoolError(
        "the Dask scheduler is gone; what is done is done: --resume goes on from a --manifest",
        "E_CLUSTER",
    )


# on the workers


def _perform(unit: Unit, folder: str, topic: str) -> Result:
    """Work on a unit in the folder that the parent works in."""
    worker = distributed.get_worker()
    with _one_at_a_time:
        news = _News(worker, unit.index, topic)
        with contextlib.suppress(OSError):  # then absolute names have to do
            os.chdir(folder)
        try:
            news.stop_if_asked()
            _prepare_once(worker.state.nthreads)
            return perform(unit, news)
        except _Stopped:
            return lost(unit, "was stopped")


@functools.cache
def _prepare_once(threads: int) -> None:
    os.environ.setdefault("RAYON_NUM_THREADS", str(threads))
    prepare()


class _News:
    """Progress of one unit, told now and then; where a unit learns that the run was stopped."""

    def __init__(self, worker: distributed.Worker, index: int, topic: str) -> None:
        self._worker, self._index, self._topic = worker, index, topic
        # made here, in the task's thread: progress is told in another, which has no worker
        self._stopping = distributed.Event(topic, client=distributed.get_client())
        self._next = 0.0

    def __call__(self, done: int, total: int) -> None:
        now = time.monotonic()
        if now >= self._next or done >= total:
            self._next = now + _NEWS_S
            self._worker.log_event(self._topic, (self._index, done, total))
            self.stop_if_asked()

    def stop_if_asked(self) -> None:
        """Leave the unit if the parent wants no more."""
        if self._stopping.is_set():
            raise _Stopped
