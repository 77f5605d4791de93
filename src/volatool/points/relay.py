"""For writers in other languages, which lose the exception that was raised in a call back."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, BinaryIO

from volatool.errors import OutputError


class Relay:
    """
    A binary file that remembers why a write failed: lazrs only tells "Failed to call write".

    Parameters
    ----------
    file : binary file
        All is passed on to it.
    """

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._error: OSError | None = None

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)

    def write(self, data: Any) -> int:
        """Write bytes."""
        try:
            return self._file.write(data)
        except OSError as error:
            self._error = error
            raise

    def cause(self, error: Exception, what: str) -> OSError:
        """
        Return what is to be raised for a writer's error.

        Parameters
        ----------
        error : Exception
            As the writer told it.
        what : str
            What could not be done, if no write failed.
        """
        return self._error or OutputError(f"{what} ({error})")


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Let Ctrl-C wait for the end of a call that would take it for a failed write."""
    if threading.current_thread() is not threading.main_thread():
        yield  # signals are the main thread's
        return
    missed: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, _: missed.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.SIG_DFL if before is None else before)
        if missed:
            signal.raise_signal(signal.SIGINT)
