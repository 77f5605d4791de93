"""Ctrl-C between two pieces of work instead of in the midst of one."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Iterator
from types import FrameType, TracebackType


class Interruptible:
    """
    A context in which SIGINT waits for the end of the work at hand.

    Used as a context manager in the main thread. A second SIGINT interrupts at once.

    Attributes
    ----------
    is_wanted : bool
        A SIGINT has come: stop at the next chance.
    """

    def __init__(self) -> None:
        self.is_wanted = False
        self._is_waiting = False

    def __enter__(self) -> Interruptible:
        self._before = signal.signal(signal.SIGINT, self._interrupt)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        signal.signal(signal.SIGINT, self._before)

    @contextlib.contextmanager
    def waiting(self) -> Iterator[None]:
        """Let SIGINT interrupt at once: nothing is lost by it here."""
        self._is_waiting = True
        try:
            if self.is_wanted:
                raise KeyboardInterrupt
            yield
        finally:
            self._is_waiting = False

    def _interrupt(self, number: int, frame: FrameType | None) -> None:
        if self._is_waiting or self.is_wanted:
            self.is_wanted = True
            raise KeyboardInterrupt
        self.is_wanted = True
