"""Kernels on several threads: they release the GIL, and each has its own part of the arrays.

Results never depend on the number of threads.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from types import TracebackType


class Crew:
    """
    Threads that share work, as a context manager.

    Parameters
    ----------
    threads : int
        How many; 1 works in the caller's own thread.

    Examples
    --------
    >>> with Crew(2) as crew:
    ...     crew.run(lambda first, last: print(last - first), [(0, 5), (5, 10)])
    5
    5
    """

    def __init__(self, threads: int = 1) -> None:
        self.threads = max(1, threads)
        self._pool = ThreadPoolExecutor(self.threads) if self.threads > 1 else None

    def __enter__(self) -> Crew:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Let the threads end."""
        if self._pool is not None:
            self._pool.shutdown()

    def run(self, work: Callable[[int, int], object], spans: Iterable[tuple[int, int]]) -> None:
        """
        Do a work for all spans and wait for it.

        Parameters
        ----------
        work : callable
            Given first and last + 1 of a span; must touch nothing of another's.
        spans : iterable of tuple of 2 int
            As `shares` makes them.
        """
        if self._pool is None:
            for first, last in spans:
                work(first, last)
            return
        for future in [self._pool.submit(work, first, last) for first, last in spans]:
            future.result()

    def shares(self, first: int, last: int) -> list[tuple[int, int]]:
        """
        Return spans of about equal length, one for each thread.

        Parameters
        ----------
        first, last : int
            What to share out; `last` is excluded.

        Examples
        --------
        >>> Crew(2).shares(3, 10)
        [(3, 6), (6, 10)]
        """
        edges = [first + (last - first) * k // self.threads for k in range(self.threads + 1)]
        return [(low, high) for low, high in pairwise(edges) if low < high]
