"""Work done beside the main thread: one thread that writes while the next thing is computed."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from types import TracebackType
from typing import TypeVar

T = TypeVar("T")

IsStopped = Callable[[], bool]
"""Says whether what is being done is no longer wanted."""


class StoppedError(Exception):
    """Raised in the thread when its work is no longer wanted; never seen outside."""


class Beside:
    """
    A thread for work that the main one need not wait for.

    Notes
    -----
    It pays for what releases the GIL: zlib, files, kernels. Used as a context manager: leaving it
    waits for the thread, and when it is left by an error stops it at its next piece, so that
    nobody writes to files that are being removed.
    """

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(1, "volatool-beside")
        self._stopped = threading.Event()

    def __enter__(self) -> Beside:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if kind is not None:
            self._stopped.set()
        self._pool.shutdown(wait=True, cancel_futures=True)

    def start(self, work: Callable[[IsStopped], T]) -> Callable[[], T]:
        """
        Start some work.

        Parameters
        ----------
        work : callable
            Called in the thread with what says whether to stop.

        Returns
        -------
        result : callable
            Waits for the work and returns what it returned, or raises what it raised.
        """
        return self._pool.submit(work, self._stopped.is_set).result
