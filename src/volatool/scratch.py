"""Working memory under a ceiling: in RAM while it fits, in unlinked temporary files beyond.

Results never depend on where an array lives; only the resident size of the process does.
"""

from __future__ import annotations

import contextlib
import mmap
import os
import tempfile
import threading
from collections.abc import Iterable, Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import DTypeLike, NDArray

from volatool.errors import ResourceError


class Scratch:
    """
    A budget of working memory and the temporary files that take what is over it.

    Parameters
    ----------
    budget_bytes : int, optional
        How much the arrays of all users of this object may hold in RAM; None for no limit.
    directory : pathlib.Path, optional
        Where temporary files go; the system's folder for them by default. The files have no name
        from their creation on (where the system can), so a killed process leaves none behind.
    """

    def __init__(self, budget_bytes: int | None = None, directory: Path | None = None) -> None:
        self.budget_bytes = budget_bytes
        self.directory = directory
        self.used_bytes = 0
        self.spilled_bytes = 0
        self._maps: dict[int, mmap.mmap] = {}
        self._lock = threading.Lock()  # the reader's thread and the builders' share one budget

    def __enter__(self) -> Scratch:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._maps.clear()

    @property
    def has_files(self) -> bool:
        """Some array of `zeros` lives in a file now."""
        return bool(self._maps)

    @property
    def left_bytes(self) -> int:
        """What is left of the budget; without one nothing has to be in files."""
        if self.budget_bytes is None:
            return 0
        return max(0, self.budget_bytes - self.used_bytes)

    def take(self, n_bytes: int, share: float = 1.0) -> bool:
        """
        Take memory from the budget if it is there.

        Parameters
        ----------
        n_bytes : int
            How much.
        share : float
            The part of the whole budget that may be in use afterwards.

        Returns
        -------
        granted : bool
            False: use a file. True: give it back with `give`.
        """
        with self._lock:
            used = self.used_bytes + n_bytes
            if self.budget_bytes is not None and used > self.budget_bytes * share:
                return False
            self.used_bytes = used
            return True

    def give(self, n_bytes: int) -> None:
        """Give memory back to the budget."""
        with self._lock:
            self.used_bytes -= n_bytes

    def file(self) -> BinaryIO:
        """
        Return an empty temporary file, read and write, gone when it is closed.

        Raises
        ------
        ResourceError
            ``E_MEMORY``: no temporary file can be made.
        """
        try:
            return tempfile.TemporaryFile(dir=self.directory)
        except OSError as error:
            raise _no_space(self.directory, error) from error

    @contextlib.contextmanager
    def writing(self, file: BinaryIO) -> Iterator[None]:
        """
        Turn what goes wrong while a file of `file` is written or flushed into an error of ours.

        Raises
        ------
        ResourceError
            ``E_MEMORY``: it takes no more; it is closed.
        """
        try:
            yield
        except OSError as error:
            drop(file)
            raise _no_space(self.directory, error) from error

    def zeros(self, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
        """
        Return an array of zeros, in RAM if the budget has it, else backed by a file.

        Parameters
        ----------
        shape : tuple of int
            Shape.
        dtype : dtype
            Data type.

        Returns
        -------
        array : ndarray
            A plain array either way; `relax` drops a file's pages from RAM, `free` gives it back.
        """
        dtype = np.dtype(dtype)
        n_bytes = int(np.prod(shape, dtype=np.int64)) * dtype.itemsize
        if n_bytes == 0 or self.take(n_bytes):
            return np.zeros(shape, dtype)
        with self.file() as file:
            try:
                # reserve the blocks now: a full disk is an error here and a SIGBUS later
                os.posix_fallocate(file.fileno(), 0, n_bytes)
            except OSError as error:
                raise _no_space(self.directory, error) from error
            mapped = mmap.mmap(file.fileno(), n_bytes)
        self.spilled_bytes += n_bytes
        array: NDArray[Any] = np.frombuffer(mapped, dtype).reshape(shape)
        self._maps[array.ctypes.data] = mapped
        return array

    def is_filed(self, array: NDArray[Any]) -> bool:
        """Tell whether an array that `zeros` returned is in a file."""
        return array.ctypes.data in self._maps

    def relax(self, array: NDArray[Any], start: int = 0, stop: int | None = None) -> None:
        """
        Let rows of a file-backed array leave RAM until they are used again.

        Parameters
        ----------
        array : ndarray
            As `zeros` returned it; nothing happens to an array in RAM.
        start, stop : int
            Rows; all by default. As many above them are dropped too: those that were read again
            with these as their neighbours, with what the system mapped around them.
        """
        mapped = self._maps.get(array.ctypes.data)
        if mapped is None:
            return
        stop = len(array) if stop is None else stop
        row = array.strides[0]
        page = mmap.PAGESIZE
        first = max(0, 2 * start - stop) * row // page * page
        last = stop * row if stop == len(array) else stop * row // page * page
        if last > first:
            mapped.madvise(mmap.MADV_DONTNEED, first, last - first)

    def free(self, *arrays: NDArray[Any]) -> None:
        """Give back what `zeros` returned; the arrays must not be used any more."""
        for array in arrays:
            if self._maps.pop(array.ctypes.data, None) is None:
                self.give(array.nbytes)


def drop(file: BinaryIO) -> None:
    """Close a temporary file whose content nobody wants: closing writes what is left, in vain."""
    with contextlib.suppress(OSError):
        file.close()


def _no_space(directory: Path | None, error: OSError) -> ResourceError:
    return no_space(directory or tempfile.gettempdir(), error.strerror or str(error))


def no_space(where: Path | str, why: str) -> ResourceError:
    """Return the error for a temporary folder that takes no more."""
    return ResourceError(
        f"no room for temporary data in {where} ({why}); "
        "set TMPDIR to a larger folder or raise --memory"
    )


_BLOCK_ROWS = 1 << 18
"""Rows of a spool that are kept, and read, together."""


class Spool:
    """
    Rows appended in order and read back in the same order, spilled to a file when over budget.

    Parameters
    ----------
    scratch : Scratch
        The budget.
    dtype : dtype
        Of one row; may be structured.
    share : float
        Part of the whole budget that may be in use when rows are kept in RAM.
    """

    def __init__(self, scratch: Scratch, dtype: DTypeLike, share: float = 1.0) -> None:
        self.scratch = scratch
        self.dtype = np.dtype(dtype)
        self.share = share
        self.n_rows = 0
        # of `_BLOCK_ROWS` each, but for the first, which grows to that: pieces need no copying
        self._blocks: list[NDArray[Any]] = []
        self._file: BinaryIO | None = None

    def __len__(self) -> int:
        return self.n_rows

    def append(self, rows: NDArray[Any]) -> None:
        """
        Append rows.

        Parameters
        ----------
        rows : (n,) array of the spool's dtype
            Copied.
        """
        if not len(rows):
            return
        if self._file is None and not self._widen(len(rows)):
            self._file = self.scratch.file()
            for kept in self._kept():
                self._write(kept)
            self._drop_blocks()
        if self._file is None:
            self._fill(rows)
        else:
            self._write(rows)
        self.n_rows += len(rows)

    def _widen(self, n: int) -> bool:
        """Make room for so many rows more; False if the budget has none."""
        total = self.n_rows + n
        held = sum(map(len, self._blocks))
        if total <= held:
            return True
        if total <= _BLOCK_ROWS:
            sizes = [min(max(total, 2 * held), _BLOCK_ROWS)]
        else:
            sizes = [_BLOCK_ROWS] * -(-total // _BLOCK_ROWS)
        if not self.scratch.take((sum(sizes) - held) * self.dtype.itemsize, self.share):
            return False
        is_first_short = len(self._blocks) == 1 and held < sizes[0]
        first = self._blocks.pop() if is_first_short else None
        for size in sizes[len(self._blocks) :]:
            self._blocks.append(np.empty(size, self.dtype))
        if first is not None:
            self._blocks[0][: self.n_rows] = first[: self.n_rows]
        return True

    def _fill(self, rows: NDArray[Any]) -> None:
        done = 0
        while done < len(rows):
            number, start = divmod(self.n_rows + done, _BLOCK_ROWS)
            part = rows[done : done + _BLOCK_ROWS - start]
            self._blocks[number][start : start + len(part)] = part
            done += len(part)

    def _kept(self) -> Iterator[NDArray[Any]]:
        for number, block in enumerate(self._blocks):
            yield block[: self.n_rows - number * _BLOCK_ROWS]

    def _write(self, rows: NDArray[Any]) -> None:
        assert self._file is not None
        with self.scratch.writing(self._file):
            self._file.write(np.ascontiguousarray(rows).view(np.uint8).data)
        self.scratch.spilled_bytes += rows.nbytes

    def _drop_blocks(self) -> None:
        for block in self._blocks:
            self.scratch.give(block.nbytes)
        self._blocks = []

    def pieces(self, max_rows: int = _BLOCK_ROWS) -> Iterator[NDArray[Any]]:
        """
        Yield the rows in order, in pieces that do not depend on how they were appended.

        Parameters
        ----------
        max_rows : int
            Rows of every piece but the last, which may have fewer.

        Yields
        ------
        rows : (n,) array of the spool's dtype
            Not to be changed.
        """
        if self._file is None:
            yield from _recut(self._kept(), max_rows)
            return
        with self.scratch.writing(self._file):
            self._file.flush()
        for start in range(0, self.n_rows, max_rows):
            n_rows = min(max_rows, self.n_rows - start)
            self._file.seek(start * self.dtype.itemsize)
            yield np.frombuffer(self._file.read(n_rows * self.dtype.itemsize), self.dtype)

    def close(self) -> None:
        """Drop the rows and give the memory back."""
        self._drop_blocks()
        if self._file is not None:
            drop(self._file)
            self._file = None
        self.n_rows = 0


def _recut(arrays: Iterable[NDArray[Any]], max_rows: int) -> Iterator[NDArray[Any]]:
    """Yield the rows of arrays, in pieces of `max_rows` (the last may be shorter)."""
    waiting: list[NDArray[Any]] = []
    n_waiting = 0
    for array in arrays:
        start = 0
        while start < len(array):
            part = array[start : start + max_rows - n_waiting]
            start += len(part)
            n_waiting += len(part)
            waiting.append(part)
            if n_waiting == max_rows:
                yield waiting[0] if len(waiting) == 1 else np.concatenate(waiting)
                waiting, n_waiting = [], 0
    if waiting:
        yield waiting[0] if len(waiting) == 1 else np.concatenate(waiting)
