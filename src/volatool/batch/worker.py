"""What a worker process of the pool does: units from a pipe, results and news back into it."""

from __future__ import annotations

import contextlib
import logging
import logging.handlers
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from dataclasses import dataclass
from multiprocessing.connection import Connection
from types import FrameType
from typing import Any, NoReturn

from volatool.batch.work import Unit, Work, perform
from volatool.outputs import discard_all

_PAUSE_S = 0.1
"""Between two pieces of news about one unit."""


@dataclass(frozen=True, slots=True)
class Ready:
    """The worker has started."""


@dataclass(frozen=True, slots=True)
class Advanced:
    """So many points of the unit are done."""

    done: int
    total: int


@dataclass(frozen=True, slots=True)
class Logged:
    """A record for the log."""

    record: logging.LogRecord


def run_worker(pipe: Connection, threads: int, log_level: int) -> None:
    """
    Work on units until the pipe ends.

    Parameters
    ----------
    pipe : Connection
        Gives the function that does the work, then `Unit`s; takes `Ready`, then `Advanced`,
        `Logged` and a `Result` for each unit.
    threads : int
        Cores that the worker may use.
    log_level : int
        The least level that the parent logs.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C goes to all: the parent decides
    signal.signal(signal.SIGTERM, _stop)
    # read when the libraries first start threads, which is later
    os.environ.setdefault("RAYON_NUM_THREADS", str(threads))
    os.environ.setdefault("OPENBLAS_NUM_THREADS", str(threads))
    work: Work = pipe.recv()
    units: queue.SimpleQueue[Unit] = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(pipe, units), daemon=True).start()
    sender = _Sender(pipe)
    _forward_log(sender, log_level)
    if work is perform:
        prepare()
    sender.send(Ready())
    while True:
        unit = units.get()
        sender.send(work(unit, _Progress(sender)))


def _stop(number: int, frame: FrameType | None) -> None:
    """Leave by an exception, so that half-written outputs are removed on the way."""
    raise SystemExit(128 + number)


def _listen(pipe: Connection, units: queue.SimpleQueue[Unit]) -> None:
    """Take units from the pipe; leave at its end: the parent is gone, or has no more work."""
    with contextlib.suppress(EOFError, OSError):
        while True:
            units.put(pipe.recv())
    _leave()


def _leave() -> NoReturn:
    """
    End at once.

    What is half-written is removed first: a thread that waits for the disk (``fsync``) keeps the
    process alive until it is done, and the run that follows would take the files for a live one's.
    """
    discard_all()
    os._exit(0)


class _Sender:
    """The worker's side of the pipe; threads may share it."""

    def __init__(self, pipe: Connection) -> None:
        self._pipe = pipe
        self._lock = threading.RLock()  # the signal's handler may come while it is held

    def send(self, message: Any) -> None:
        """Send one message; leave if there is nobody to take it."""
        try:
            with self._lock:
                self._pipe.send(message)
        except OSError:
            _leave()


class _Progress:
    """Sends a unit's progress now and then, and its end."""

    def __init__(self, sender: _Sender) -> None:
        self._sender = sender
        self._next = 0.0

    def __call__(self, done: int, total: int) -> None:
        now = time.monotonic()
        if now >= self._next or done >= total:
            self._next = now + _PAUSE_S
            self._sender.send(Advanced(done, total))


class _LogSender(logging.handlers.QueueHandler):
    """Sends records to the parent, whose handlers write them."""

    def enqueue(self, record: logging.LogRecord) -> None:
        self.queue.send(Logged(record))  # type: ignore[attr-defined]


def _forward_log(sender: _Sender, level: int) -> None:
    logging.captureWarnings(True)  # of NumPy and others, as in the parent
    logger = logging.getLogger("volatool")
    logger.setLevel(level)
    logger.addHandler(_LogSender(sender))  # type: ignore[arg-type]


def prepare() -> None:
    """Have the kernels compiled, if the cache has none, in one worker, while the others wait."""
    from volatool.kernels import _jit

    folder = _jit.writable_cache_dir()
    if folder is None:
        return
    with (folder / ".warming").open("w") as file:
        with contextlib.suppress(ImportError, OSError):  # without locks each compiles for itself
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX)
        if next(folder.rglob("*.nbc"), None) is None:
            # in a process of its own: the compiler's memory is not the tiles'
            code = "from volatool.warming import warm_kernels; warm_kernels()"
            subprocess.run(
                [sys.executable, "-c", code],
                check=False,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )


if __name__ == "__main__":
    from volatool.batch import worker  # what is sent is of this module, not of the main one

    descriptor, n_threads, least_level = map(int, sys.argv[1:])
    worker.run_worker(Connection(descriptor), n_threads, least_level)
