"""Reading ahead: a generator that runs in a thread of its own while its last items are used."""

from __future__ import annotations

import threading
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from queue import SimpleQueue
from typing import Any, TypeVar

T = TypeVar("T")


@contextmanager
def ahead(items: Generator[T, Any, Any], n_ahead: int = 2) -> Iterator[Iterator[T]]:
    """
    Make the items of a generator in another thread, in order, a few before they are asked for.

    Parameters
    ----------
    items : generator
        Run and closed in the thread. What it raises is raised to who asks for the next item.
    n_ahead : int
        Items that may wait.

    Yields
    ------
    items : iterator
        The same items.

    Notes
    -----
    When the ``with`` block is left, however that is, the generator has been closed and the thread
    has ended. The thread stops at the item it is at: nothing waits for those that nobody wants.

    lazrs keeps the interpreter lock while it decodes, so that a call that needs the lock waits for
    the end of a batch: what runs beside it should be few long calls that do without the lock.
    """
    reader = _Reader(items, n_ahead)
    reader.thread.start()
    try:
        yield reader.items()
    finally:
        reader.stop()


class _Reader:
    """The thread and what it shares with the one that it works for."""

    def __init__(self, items: Generator[Any, Any, Any], n_ahead: int) -> None:
        self._source = items
        self._ready: SimpleQueue[tuple[Any, BaseException | None, bool]] = SimpleQueue()
        self._room = threading.Semaphore(n_ahead)
        self._is_stopped = False
        self.thread = threading.Thread(target=self._work, name="volatool-reader")

    def _work(self) -> None:
        error: BaseException | None = None
        try:
            for item in self._source:
                self._ready.put((item, None, False))
                del item  # not kept while the next one is made
                self._room.acquire()
                if self._is_stopped:
                    break
        except BaseException as raised:  # Rust panics too: the one who asks is to see it
            error = raised
        try:
            self._source.close()
        except BaseException as raised:
            error = error or raised
        self._ready.put((None, error, True))

    def items(self) -> Iterator[Any]:
        """Yield the items as they come."""
        while True:
            item, error, is_end = self._ready.get()
            if error is not None:
                raise error
            if is_end:
                return
            self._room.release()
            yield item
            del item

    def stop(self) -> None:
        """End the thread; an error that nobody asked for is dropped."""
        self._is_stopped = True
        self._room.release()
        self.thread.join()
