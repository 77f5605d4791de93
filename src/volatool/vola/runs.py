"""Sorted runs of keys or rows of sums: merged as they grow, spilled to files when over budget.

Runs of keys form a stack in which each is more than twice as long as the next one, so a key takes
part in few merges. When memory runs out the whole stack goes to one sorted file; sixteen files of
a size become one. What comes out at the end is one sorted stream, whatever happened before.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator
from typing import Any, BinaryIO, TypeAlias

import numpy as np
from numpy.typing import NDArray

from volatool.model import I64, U64
from volatool.scratch import Scratch

Rows: TypeAlias = NDArray[Any]

PIECE_BYTES = 1 << 19
"""Size of the pieces in which runs are read, merged and written."""

_FAN_IN = 16

_MOST_LOOSE = 1 << 22
"""Keys that are sorted together."""

_LOOSE_PART = 4
"""They take at most this part of the budget, one fourth."""


class Runs:
    """
    A growing sorted collection of rows without repeated keys; the base of the two kinds below.

    Parameters
    ----------
    scratch : Scratch
        Budget and temporary files.
    share : float
        Part of the whole budget that may be in use when runs are kept in RAM.
    """

    dtype: Any = np.uint64
    row_shape: tuple[int, ...] = ()

    def __init__(self, scratch: Scratch, share: float = 0.7) -> None:
        self._scratch = scratch
        self._share = share
        self._tiers: list[list[_FileRun]] = []
        self._digits = 0  # by how many the keys of files may have to be shortened; see SumRuns

    # what the two kinds differ in

    def _keys(self, rows: Rows) -> Rows:
        return rows

    def _merge(self, left: Rows, right: Rows) -> Rows:
        raise NotImplementedError

    def spill(self, *runs: Rows) -> None:
        """
        Write runs to one file.

        Parameters
        ----------
        *runs : arrays of the kind's rows
            Each sorted, no key twice in it.
        """
        self._add_file(0, self._written(self._merged([self._slices(run) for run in runs])))

    def _add_file(self, tier: int, run: _FileRun) -> None:
        if tier == len(self._tiers):
            self._tiers.append([])
        self._tiers[tier].append(run)
        if len(self._tiers[tier]) == _FAN_IN:
            together = self._written(self._merged([self._read(r) for r in self._tiers[tier]]))
            for old in self._tiers[tier]:
                old.file.close()
            self._tiers[tier] = []
            self._add_file(tier + 1, together)

    def _written(self, pieces: Iterator[Rows]) -> _FileRun:
        run = _FileRun(self._scratch.file(), self._digits)
        with self._scratch.writing(run.file):
            for piece in pieces:
                run.file.write(np.ascontiguousarray(piece).view(np.uint8).data)
                run.n_rows += len(piece)
                self._scratch.spilled_bytes += piece.nbytes
            run.file.flush()
        return run

    def _piece_rows(self) -> int:
        row_bytes = np.dtype(self.dtype).itemsize * math.prod(self.row_shape)
        return int(PIECE_BYTES // row_bytes)

    def _slices(self, rows: Rows) -> Iterator[Rows]:
        step = self._piece_rows()
        for start in range(0, len(rows), step):
            yield rows[start : start + step]

    def _read(self, run: _FileRun) -> Iterator[Rows]:
        pieces = self._read_raw(run)
        digits = self._digits - run.digits
        return pieces if digits == 0 else self._folded(pieces, digits)

    def _read_raw(self, run: _FileRun) -> Iterator[Rows]:
        step = self._piece_rows()
        row_bytes = np.dtype(self.dtype).itemsize * int(np.prod(self.row_shape))
        for start in range(0, run.n_rows, step):
            # into an array of our own: one over read-only bytes would be another type to numba
            rows = np.empty((min(step, run.n_rows - start), *self.row_shape), self.dtype)
            run.file.seek(start * row_bytes)
            run.file.readinto(rows.view(np.uint8).data)  # type: ignore[attr-defined]
            yield rows

    def _folded(self, pieces: Iterator[Rows], digits: int) -> Iterator[Rows]:
        raise NotImplementedError

    def _merged(self, streams: list[Iterator[Rows]]) -> Generator[Rows]:
        """Merge sorted streams: each time the rows up to the least of the last keys in sight."""
        heads: list[Rows] = []
        alive: list[Iterator[Rows]] = []
        for stream in streams:
            first = next(stream, None)
            if first is not None:
                heads.append(first)
                alive.append(stream)
        while heads:
            bound = min(self._keys(head)[-1] for head in heads)
            taken = []
            for i, head in enumerate(heads):
                stop = int(np.searchsorted(self._keys(head), bound, side="right"))
                if stop:
                    taken.append(head[:stop])
                heads[i] = head[stop:]
            while len(taken) > 1:  # as a tree, so that a row takes part in few merges
                taken = [
                    self._merge(*taken[k : k + 2]) if k + 1 < len(taken) else taken[k]
                    for k in range(0, len(taken), 2)
                ]
            yield taken[0]
            for i in range(len(heads) - 1, -1, -1):
                if not len(heads[i]):
                    following = next(alive[i], None)
                    if following is None:
                        del heads[i], alive[i]
                    else:
                        heads[i] = following

    def stream(self, *runs: Rows) -> Generator[Rows]:
        """
        Yield all rows in order, in pieces.

        Parameters
        ----------
        *runs : arrays of the kind's rows
            Sorted runs in RAM, beside those in files.

        Yields
        ------
        rows : array of the kind's rows
            Sorted; no key twice in all pieces together. Not to be changed.
        """
        files = [self._read(run) for tier in self._tiers for run in tier]
        return self._merged(files + [self._slices(run) for run in runs])

    def close(self) -> None:
        """Drop the files."""
        for tier in self._tiers:
            for run in tier:
                run.file.close()
        self._tiers = []


class _FileRun:
    """A sorted run in a file of its own."""

    def __init__(self, file: BinaryIO, digits: int) -> None:
        self.file = file
        self.n_rows = 0
        self.digits = digits


def _held_bytes(rows: Rows) -> int:
    """Return the size of the array that the rows keep alive."""
    base = rows.base
    return int(base.nbytes) if isinstance(base, np.ndarray) else int(rows.nbytes)


class KeyRuns(Runs):
    """
    Sorted path keys, uint64; a key that is there twice counts once.

    Parameters
    ----------
    scratch, share :
        As for `Runs`.

    Notes
    -----
    New keys wait unsorted in one buffer of up to some four million, which is sorted at once:
    cheaper than sorting and merging short runs.
    """

    def __init__(self, scratch: Scratch, share: float = 0.7) -> None:
        super().__init__(scratch, share)
        self._stack: list[Rows] = []
        self._loose: U64 = np.empty(0, np.uint64)
        self._n_loose = 0
        self._counted_bytes = 0  # of the buffer, in the budget
        self._usual = 0
        budget = scratch.budget_bytes
        self._most = _MOST_LOOSE
        if budget is not None:
            self._most = min(self._most, int(budget * share) // (8 * _LOOSE_PART))

    def _merge(self, left: Rows, right: Rows) -> Rows:
        from volatool.kernels import levels

        merged: U64 = levels.merge_keys(left, right)
        return merged

    def room(self, n: int) -> U64:
        """
        Return where keys can be written; `filled` takes them over.

        Parameters
        ----------
        n : int
            How many there may be.

        Returns
        -------
        room : (m,) array of uint64
            `n` or more.
        """
        if self._n_loose + n > len(self._loose):
            self._widen(n)
        return self._loose[self._n_loose :]

    def _widen(self, n: int) -> None:
        """Make the buffer larger, or if the budget has no more, empty it."""
        size = min(max(self._n_loose + n, 2 * len(self._loose), self._usual), self._most + n)
        is_counted = self._scratch.take(8 * size, self._share)
        if not is_counted:
            self._join()
            if n <= len(self._loose):
                return
            self._drop_buffer()
            size = n
            is_counted = self._scratch.take(8 * size, self._share)
        loose = np.empty(size, np.uint64)
        loose[: self._n_loose] = self._loose[: self._n_loose]
        self._drop_buffer()
        self._loose, self._usual = loose, size
        self._counted_bytes = loose.nbytes if is_counted else 0

    def _drop_buffer(self) -> None:
        self._scratch.give(self._counted_bytes)
        self._loose, self._counted_bytes = np.empty(0, np.uint64), 0

    def filled(self, n: int) -> None:
        """Take over the first `n` keys that were written to `room`, in any order."""
        self._n_loose += n
        if self._n_loose >= self._most:
            self._join()

    def push(self, keys: U64) -> None:
        """Add keys in any order, repeated or not."""
        self.room(len(keys))[: len(keys)] = keys
        self.filled(len(keys))

    def _join(self) -> None:
        """Make one run of the keys that wait."""
        from volatool.kernels import levels

        keys = self._loose[: self._n_loose]
        keys.sort()
        keys = keys[: int(levels.drop_repeats(keys))]
        self._n_loose = 0
        if len(keys) > len(self._loose) * 7 // 8:
            self._drop_buffer()  # it is the run's from now on
            self._add_run(keys)
        elif self._scratch.take(keys.nbytes, self._share):
            self._scratch.give(keys.nbytes)
            self._add_run(keys.copy())
        else:
            self._spill_all(keys)

    def _add_run(self, keys: Rows) -> None:
        if not len(keys):
            return
        if not self._scratch.take(_held_bytes(keys), self._share):
            self._spill_all(keys)
            return
        self._stack.append(keys)
        while len(self._stack) > 1 and len(self._stack[-2]) <= 2 * len(self._stack[-1]):
            if not self._merge_last_two():
                break

    def _merge_last_two(self) -> bool:
        left, right = self._stack[-2:]
        expected = left.nbytes + right.nbytes
        if not self._scratch.take(expected, self._share):
            return False
        merged = self._merge(left, right)
        if merged.nbytes < expected * 7 // 8:
            merged = merged.copy()  # a view would hold the whole array that it was cut from
        self._stack[-2:] = [merged]
        self._scratch.give(expected - _held_bytes(merged))
        self._scratch.give(_held_bytes(left) + _held_bytes(right))
        return True

    def _spill_all(self, keys: Rows) -> None:
        """Write the stack and one more run to one file."""
        self.spill(*self._stack, keys)
        self._clear_stack()

    def _clear_stack(self) -> None:
        for run in self._stack:
            self._scratch.give(_held_bytes(run))
        self._stack = []

    def stream(self, *runs: Rows) -> Generator[Rows]:
        """
        Yield all keys in order, in pieces.

        Yields
        ------
        rows : (n,) array of uint64
            Sorted; no key twice in all pieces together. Not to be changed.
        """
        self._join()
        self._drop_buffer()
        return super().stream(*self._stack, *runs)

    def close(self) -> None:
        """Drop everything and give the memory back."""
        self._n_loose = 0
        self._drop_buffer()
        self._clear_stack()
        super().close()


class SumRuns(Runs):
    """Rows of sums (n, 8) int64 by block and class; rows with the same key are added."""

    dtype = np.int64
    row_shape = (8,)

    def _keys(self, rows: Rows) -> Rows:
        return rows[:, 0]

    def _merge(self, left: Rows, right: Rows) -> Rows:
        from volatool.kernels import reduce

        merged: I64 = reduce.merge_rows(left, right)
        return merged

    def coarsen(self, digits: int) -> None:
        """Make the blocks `digits` levels coarser; those in files are when they are read."""
        self._digits += digits

    def _folded(self, pieces: Iterator[Rows], digits: int) -> Iterator[Rows]:
        from volatool.kernels import reduce

        held = np.empty((0, 8), np.int64)
        for piece in pieces:
            rows = reduce.fold_rows(np.concatenate([held, piece]), 0)
            blocks = rows[:, 0] >> (8 + 6 * digits)
            cut = int(np.searchsorted(blocks, blocks[-1]))  # the last block may go on
            held = rows[cut:]
            if cut:
                yield reduce.fold_rows(rows[:cut], digits)
        if len(held):
            yield reduce.fold_rows(held, digits)
