"""A remote file read by ranges: cached by blocks, read ahead of where it will be wanted next."""

from __future__ import annotations

import bisect
import io
import logging
import os
import tempfile
from collections import OrderedDict
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, BinaryIO, cast

from volatool.errors import InputError
from volatool.remote import store
from volatool.remote.path import WEB, RemotePath
from volatool.remote.staging import refuse_full

BLOCK = 1 << 14
"""Ranges start and end at multiples of this: a header is one request."""

PART = 1 << 22
"""Longest range of one request."""

REQUESTS = 4
"""Requests under way at a time: what is asked for ahead of time is this many parts."""

KEPT_BYTES = 2 * REQUESTS * PART
"""Bytes kept in memory, those asked for ahead of time included."""

_FIRST_AHEAD = 1 << 17

logger = logging.getLogger(__name__)


class NoRangesError(InputError):
    """The server gives whole files only."""


class RangeFile(io.RawIOBase):
    """
    A file of which parts are asked for when they are read, or shortly before.

    Reading on and on is seen, and more and more is asked for in advance, so that the throughput is
    that of the line whatever its latency. `expect` says what will be read when that has gaps.

    Parameters
    ----------
    path : RemotePath
        What is read.
    size : int
        Bytes of the file.
    fetch : callable
        (start, stop) to those bytes; called from several threads. May raise `NoRangesError`.

    Attributes
    ----------
    n_requests, n_bytes : int
        What was asked for so far.
    """

    def __init__(self, path: RemotePath, size: int, fetch: Callable[[int, int], bytes]) -> None:
        super().__init__()
        self.path, self.name, self.size = path, str(path), size
        self.n_requests = self.n_bytes = 0
        self._fetch = fetch
        self._position = 0
        self._last = -1  # where the read before ended
        self._ahead = 0
        self._plan: list[tuple[int, int]] | None = None
        self._runs: OrderedDict[int, _Run] = OrderedDict()
        self._of_block: dict[int, _Run] = {}
        self._pool = ThreadPoolExecutor(REQUESTS, "volatool-ranges")
        self._whole: BinaryIO | None = None

    def readable(self) -> bool:
        """Return True."""
        return True

    def seekable(self) -> bool:
        """Return True."""
        return True

    def tell(self) -> int:
        """Return the position."""
        return self._position

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Move; all three ways."""
        base = {os.SEEK_SET: 0, os.SEEK_CUR: self._position, os.SEEK_END: self.size}[whence]
        self._position = max(0, base + offset)
        return self._position

    def read(self, size: int | None = -1) -> bytes:
        """Return the next bytes, fewer only at the end of the file."""
        if self.closed:
            raise ValueError("the file is closed")
        start = self._position
        stop = self.size if size is None or size < 0 else min(self.size, start + size)
        if start >= stop:
            return b""
        data = self._bytes(start, stop)
        self._position = self._last = stop
        return data

    def readinto(self, buffer: Any) -> int:
        """Fill a buffer with the next bytes; return how many."""
        view = memoryview(buffer).cast("B")
        data = self.read(len(view))
        view[: len(data)] = data
        return len(data)

    def expect(self, ranges: Sequence[tuple[int, int]]) -> None:
        """
        Say what will be read: only that is asked for in advance.

        Parameters
        ----------
        ranges : sequence of (int, int)
            Start and stop, in ascending order.
        """
        self._plan = []
        for start, stop in ranges:
            if self._plan and start <= self._plan[-1][1] + BLOCK:
                self._plan[-1] = (self._plan[-1][0], stop)
            else:
                self._plan.append((start, stop))
        self._ahead = REQUESTS * PART

    def fetch_whole(self, size: int | None) -> None:
        """Read from a temporary copy from now on; the size is checked if it is known."""
        self._whole = _downloaded(self.path, size)
        self.size = self._whole.seek(0, os.SEEK_END)
        self.n_requests += 1
        self.n_bytes += self.size

    def close(self) -> None:
        """Forget what was read; requests under way are not waited for."""
        self._pool.shutdown(wait=False, cancel_futures=True)
        self._runs.clear()
        self._of_block.clear()
        if self._whole is not None:
            self._whole.close()
        if not self.closed and self.n_requests:
            logger.info("%s: %d requests, %d bytes", self.path, self.n_requests, self.n_bytes)
        super().close()

    def _bytes(self, start: int, stop: int) -> bytes:
        if self._whole is None:
            try:
                is_new = self._ask(start, stop)
                self._ask_ahead(start, stop, is_new)
                return self._joined(start, stop)
            except NoRangesError:
                self.fetch_whole(self.size)
        assert self._whole is not None
        self._whole.seek(start)
        return self._whole.read(stop - start)

    def _ask(self, start: int, stop: int) -> bool:
        """Ask for what is not here of a range; return whether anything was not."""
        is_new = False
        block, end = start // BLOCK, -(-stop // BLOCK)
        while block < end:
            first = block
            while block < end and block not in self._of_block and block - first < PART // BLOCK:
                block += 1
            if block > first:
                is_new = True
                self._send(first, block)
            else:
                self._runs.move_to_end(self._of_block[block].first)
                block += 1
        return is_new

    def _send(self, first: int, end: int) -> None:
        start, stop = first * BLOCK, min(end * BLOCK, self.size)
        run = _Run(first, end, self._pool.submit(self._load, start, stop))
        self._runs[first] = run
        self._of_block.update(dict.fromkeys(range(first, end), run))
        self.n_requests += 1
        self.n_bytes += stop - start

    def _load(self, start: int, stop: int) -> bytes:
        def question() -> bytes:
            data = self._fetch(start, stop)
            if len(data) != stop - start:
                text = f"{len(data)} bytes came instead of {stop - start}; did the file change?"
                raise InputError(f"{self.path}: {text}", "E_NETWORK")
            return data

        return store.asked(question, self.path)

    def _ask_ahead(self, start: int, stop: int, is_new: bool) -> None:
        """Ask for what comes next, unless half of it is on its way already."""
        if self._plan is None:
            if start != self._last:
                self._ahead = 0
                return
            if self._ahead == 0 and not is_new:
                return
        if all(self._has(*piece) for piece in self._next(stop, self._ahead // 2)) and not is_new:
            return
        self._ahead = min(REQUESTS * PART, max(_FIRST_AHEAD, 2 * self._ahead))
        for piece in self._next(stop, self._ahead):
            self._ask(*piece)

    def _next(self, start: int, n_bytes: int) -> Iterator[tuple[int, int]]:
        """Yield the ranges that are expected to be read from a place on."""
        plan = [(start, self.size)] if self._plan is None else self._plan
        for low, high in plan[max(0, bisect.bisect_right(plan, (start, self.size)) - 1) :]:
            if n_bytes <= 0:
                return
            low = max(low, start)
            high = min(high, low + n_bytes)
            if high > low:
                yield low, high
                n_bytes -= high - low

    def _has(self, start: int, stop: int) -> bool:
        blocks = range(start // BLOCK, -(-stop // BLOCK))
        return all(block in self._of_block for block in blocks)

    def _joined(self, start: int, stop: int) -> bytes:
        pieces = bytearray()
        while start < stop:
            run = self._of_block[start // BLOCK]
            offset = run.first * BLOCK
            piece = run.data.result()[start - offset : stop - offset]
            pieces += piece
            start += len(piece)
        self._forget()
        return bytes(pieces)

    def _forget(self) -> None:
        """Let go of what was touched longest ago."""
        kept = sum(run.end - run.first for run in self._runs.values()) * BLOCK
        while kept > KEPT_BYTES:
            _, run = self._runs.popitem(last=False)
            kept -= (run.end - run.first) * BLOCK
            for block in range(run.first, run.end):
                del self._of_block[block]


class _Run:
    """Blocks that one request asks for, from `first` to before `end`."""

    __slots__ = ("data", "end", "first")

    def __init__(self, first: int, end: int, data: Future[bytes]) -> None:
        self.first, self.end, self.data = first, end, data


def open_url(path: RemotePath) -> BinaryIO:
    """
    Open a remote file for reading.

    Parameters
    ----------
    path : RemotePath
        The file.

    Returns
    -------
    stream : binary file
        A `RangeFile`.

    Raises
    ------
    OptionError, InputNotFoundError, InputError, ResourceError
        ``E_NO_EXTRA``; ``E_NOT_FOUND``; ``E_ACCESS``; ``E_NETWORK``; ``E_SIZE``: no room for the
        temporary copy.
    """
    files, name = store.filesystem(path)
    found = store.details(path)
    file = RangeFile(path, found.size or 0, _fetcher(files, name, path, found.size))
    if found.size is None or not found.ranges:
        file.fetch_whole(found.size)
    return cast(BinaryIO, file)


def _fetcher(
    files: Any, name: str, path: RemotePath, size: int | None
) -> Callable[[int, int], bytes]:
    """Return what gets a range of a file."""
    if path.protocol not in WEB or not size:
        return lambda start, stop: cast(bytes, files.cat_file(name, start=start, end=stop))
    file = files.open(name, "rb", size=size, cache_type="none")

    def fetch(start: int, stop: int) -> bytes:
        # unlike cat_file, it does not take in a whole file for a part of it
        try:
            return cast(bytes, file._fetch_range(start, stop))
        except ValueError as error:
            raise NoRangesError(f"{path}: no byte ranges") from error

    return fetch


def _downloaded(path: RemotePath, size: int | None) -> BinaryIO:
    """Return a temporary copy of a file whose server gives whole files only."""
    refuse_full(path, size or 0)
    logger.warning(
        "%s: the server gives no byte ranges; all of it is downloaded to a temporary file", path
    )
    files, name = store.filesystem(path)
    copy = cast(BinaryIO, tempfile.TemporaryFile())  # noqa: SIM115  closed with the RangeFile

    def question() -> None:
        copy.seek(0)
        copy.truncate()
        files.get_file(name, copy)
        if size is not None and copy.tell() != size:
            text = f"{copy.tell()} bytes came instead of {size}"
            raise InputError(f"{path}: {text}", "E_NETWORK")

    try:
        store.asked(question, path)
    except BaseException:
        copy.close()
        raise
    return copy
