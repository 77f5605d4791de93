"""Sums of the points' attributes per block: what the metadata words are made from."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from volatool.cube import Quantizer
from volatool.errors import OptionError
from volatool.model import I32, I64, U64, PointChunk
from volatool.scratch import Scratch
from volatool.vola.fold import Sink, fold_sums
from volatool.vola.held import HeldPoints
from volatool.vola.metadata import ATTRIBUTES, Ranges, Scaling, attributes_for, check_channels
from volatool.vola.runs import SumRuns

_LEAST_ROWS = 1 << 14
"""Rows of the smallest table."""

_SORT_BYTES = 16
"""What putting a row in order takes beside it: its key and its place."""

_HELD_SHARE = 0.25
"""Part of the memory budget that may be in use when points are held back in RAM."""

_DTYPES = {
    "classification": np.uint8,
    "red": np.uint16,
    "green": np.uint16,
    "blue": np.uint16,
    "number_of_returns": np.uint8,
    "intensity": np.uint16,
}


class MetadataSums:
    """
    Exact sums per block of one level and class; the levels above follow from them.

    Parameters
    ----------
    channels : iterable of str
        Metadata channels; with none nothing is kept.
    level : int
        The level (1 is the root block) whose blocks are told apart at first.
    scratch : Scratch
        Memory budget.
    share : float
        Part of the whole budget that may be in use when sums are kept in RAM.
    quantizer_for : callable
        Gives the quantizer of points.
    limit : float
        A level below 2 with more blocks than this is given up: the sums become coarser.
    n_expected : int
        How many points there will be, at most.

    Notes
    -----
    The sums are in a hash table as long as the budget has room for it; then its rows become a
    sorted run and a new table begins. Points that follow each other in a file mostly are in one
    block or in few, so that most of them find their row in the processor's cache. The first points
    are held back until it is plain which levels have too many blocks (`review`): a row takes more
    memory than a point, and a level with nearly a block a point more time than all the others.
    """

    def __init__(
        self,
        channels: Iterable[str],
        level: int,
        scratch: Scratch,
        share: float,
        quantizer_for: Callable[[PointChunk], Quantizer],
        limit: float = math.inf,
        n_expected: int = 0,
    ) -> None:
        self.channels = check_channels(channels)
        self.level = level
        self._scratch = scratch
        self._share = share
        self._limit = limit
        self._next_count = limit  # rows from which on blocks may be over the limit
        self._runs = SumRuns(scratch, share)
        self._rows: I64 = np.empty((0, *SumRuns.row_shape), np.int64)
        self._slots: I32 = np.empty(0, np.int32)
        self._n_rows = 0
        self._counted_bytes = 0  # of the table, in the budget
        far = np.iinfo(np.int64)
        self._quantizer_for = quantizer_for
        self._n_expected = n_expected
        self._held = HeldPoints(scratch, _HELD_SHARE, attributes_for(self.channels))
        # points to hold back before the first look
        self._patience = 2 * limit if self.channels and math.isfinite(limit) else 0.0
        self._ranges: I64 = np.array([far.max, far.min, 0, 0])
        self._heights: tuple[float, float] | None = None  # scale and offset of the sums of z
        self._nothing: dict[str, NDArray[Any]] = {}

    def check(self, chunk: PointChunk) -> None:
        """
        Refuse a chunk that lacks an attribute.

        Raises
        ------
        OptionError
            Which one is missing, and for which channel.
        """
        for channel in self.channels:
            for name in ATTRIBUTES[channel]:
                if name not in chunk.attributes:
                    raise OptionError(
                        f"metadata channel {channel!r} needs the points' {name}, which they don't "
                        "have; leave the channel out"
                    )

    def add(
        self, points: PointChunk, quantizer: Quantizer, keys: U64, tally: I64, box: I64
    ) -> None:
        """
        Add points and write their path keys.

        Parameters
        ----------
        points : PointChunk
            All inside the cube, unless `can_add`.
        quantizer : Quantizer
            Of these points.
        keys, tally, box
            As for `volatool.kernels.collect.collect_sums`.
        """
        from volatool.kernels import collect

        x, y, z = (np.ascontiguousarray(a, np.int32) for a in (points.x, points.y, points.z))
        if self._patience:
            collect.collect_keys(x, y, z, *quantizer.plan, quantizer.depth, keys, tally, box)
            self._held.add(points)
            return
        heights = self._stored_heights(points, z)
        code, red, green, blue, returns, intensity = (self._column(points, n) for n in _DTYPES)
        if not len(self._rows):
            self._widen()
        while True:
            tally[collect.ROWS] = self._n_rows
            collect.collect_sums(
                x,
                y,
                z,
                *quantizer.plan,
                quantizer.depth,
                keys,
                tally,
                box,
                quantizer.depth - self.level + 1,
                code,
                red,
                green,
                blue,
                heights,
                returns,
                intensity,
                self._slots,
                self._rows,
                self._ranges,
            )
            self._n_rows = int(tally[collect.ROWS])
            if tally[collect.NEXT] == len(x):
                return
            self._make_room()

    @property
    def is_review_due(self) -> bool:
        """So many points are held back that it may be plain which levels have too many blocks."""
        return 0 < self._patience <= len(self._held)

    def review(self, keys: Iterable[U64], depth: int) -> None:
        """
        Give up the levels with too many blocks; add the points held back if more won't tell more.

        Parameters
        ----------
        keys : iterable of (n,) arrays of uint64
            Path keys of all points so far, sorted, none twice.
        depth : int
            Their level.
        """
        voxels = _prefix_counts(keys, depth)
        level = self.level
        while level > 2 and voxels[level - 1] > self._limit:  # of the level above: its blocks
            level -= 1
        self.coarsen_to(level)
        n, blocks = len(self._held), float(voxels[level - 1])
        if level > 2 and blocks * self._n_expected > self._limit * n and n < self._n_expected:
            # at this rate there will be too many: better to wait than to sum them all up
            self._patience = max(n + 1.0, 1.05 * n * self._limit / blocks)
            return
        # every further block is a row more at least
        self._next_count = self._limit
        self._settle()

    def _settle(self) -> None:
        """Add the points that were held back."""
        self._patience = 0.0
        for points in self._held.taken():
            keys = np.empty(len(points), np.uint64)  # and what is told here is known already
            quantizer = self._quantizer_for(points)
            self.add(points, quantizer, keys, np.zeros(4, np.int64), np.zeros(6, np.int64))

    def _make_room(self) -> None:
        """Have a free row: by coarser blocks, a larger table or an empty one."""
        if self._n_rows > self._next_count:
            self._rule_out(np.sort((self._rows[: self._n_rows, 0] >> 8).view(np.uint64)))
        if self._n_rows > len(self._rows) // 2:
            self._widen()

    def _widen(self) -> None:
        """Double the table, or if the budget has no more, empty it."""
        from volatool.kernels import collect

        capacity = max(2 * len(self._rows), _LEAST_ROWS)
        rows = np.empty((capacity, *self._rows.shape[1:]), np.int64)
        slots = np.empty(2 * capacity, np.int32)
        n_bytes = rows.nbytes + slots.nbytes + _SORT_BYTES * capacity // 2
        is_counted = self._scratch.take(n_bytes, self._share)
        if not is_counted and len(self._rows):
            self._empty()
            return
        rows[: self._n_rows] = self._rows[: self._n_rows]
        self._scratch.give(self._counted_bytes)
        self._rows, self._slots = rows, slots
        self._counted_bytes = n_bytes if is_counted else 0
        collect.regroup(self._rows, self._n_rows, 0, self._slots)

    def _empty(self) -> None:
        """Make a sorted run of the table."""
        from volatool.kernels import collect

        self._runs.spill(self._sorted())
        self._slots[:] = collect.EMPTY
        self._n_rows = 0

    def _sorted(self) -> I64:
        """Return the rows in use, put in order; the slots are of no use then."""
        from volatool.kernels import collect

        rows = self._rows[: self._n_rows]
        collect.permute_rows(rows, np.argsort(rows[:, 0].copy()))
        return rows

    def _rule_out(self, blocks: U64) -> None:
        """Give up the levels that have too many blocks: of these, sorted, of the level at hand."""
        from volatool.kernels import levels

        voxels = levels.prefix_counts(blocks, self.level - 1)
        level = self.level
        while level > 2 and voxels[level - 1] > self._limit:  # of the level above: its blocks
            level -= 1
        self.coarsen_to(level)
        # every further block is a row more at least
        self._next_count = self._n_rows + self._limit - voxels[level - 1]

    @property
    def ranges(self) -> Ranges:
        """Extremes of the attributes added so far."""
        low, high, colour, intensity = (int(value) for value in self._ranges)
        return Ranges(low, high, colour, intensity) if low <= high else Ranges()

    def _column(self, chunk: PointChunk, name: str) -> NDArray[Any]:
        """Return an attribute, or zeros when no channel is made from it."""
        dtype = _DTYPES[name]
        if any(name in ATTRIBUTES[channel] for channel in self.channels):
            return np.ascontiguousarray(chunk.attributes[name], dtype)
        zeros = self._nothing.get(name)
        if zeros is None or len(zeros) < len(chunk):
            zeros = self._nothing[name] = np.zeros(len(chunk), dtype)
        return zeros[: len(chunk)]

    def can_add(self, chunk: PointChunk) -> bool:
        """Whether heights count in the steps of the first chunk, so that none is converted."""
        here = (chunk.scale[2], chunk.offset[2])
        return here == (self._heights or here) or "height" not in self.channels

    def _stored_heights(self, chunk: PointChunk, z: I32) -> I32:
        """Return stored heights in the scale and offset of the first chunk."""
        here = (chunk.scale[2], chunk.offset[2])
        self._heights = self._heights or here
        if self.can_add(chunk):
            return z
        scale, offset = self._heights
        heights = np.rint((z * here[0] + (here[1] - offset)) / scale)
        if np.abs(heights).max() >= 2**31:
            raise OptionError(
                "points with very different height offsets can't share a metadata channel; "
                "leave out 'height'"
            )
        stored: I32 = heights.astype(np.int32)
        return stored

    def coarsen_to(self, level: int) -> None:
        """Tell only the blocks of a coarser level apart from now on."""
        from volatool.kernels import collect

        if level < self.level:
            digits = self.level - level
            self._runs.coarsen(digits)
            self._n_rows = int(collect.regroup(self._rows, self._n_rows, digits, self._slots))
            self.level = level

    def scaling(self, z_unit: str | None) -> Scaling:
        """Return how the sums become bytes, for the points added so far."""
        self._settle()
        scale, offset = self._heights or (1.0, 0.0)
        return Scaling.of(self.channels, self.ranges, scale, offset, z_unit)

    def fold(self, scaling: Scaling, sink: Sink) -> None:
        """Hand the metadata words of levels 1 to `level` to a sink, piece by piece."""
        self._settle()
        fold_sums(self._runs.stream(self._sorted()), self.level, scaling, sink)

    def close(self) -> None:
        """Drop everything."""
        self._held.close()
        self._scratch.give(self._counted_bytes)
        self._rows, self._slots = self._rows[:0].copy(), self._slots[:0].copy()
        self._n_rows = self._counted_bytes = 0
        self._runs.close()


def _prefix_counts(pieces: Iterable[U64], depth: int) -> I64:
    """Return how many cells of levels 0 to `depth` keys reach that come sorted in pieces."""
    from volatool.kernels import levels

    voxels = np.zeros(depth + 1, np.int64)
    last: np.uint64 | None = None
    for keys in pieces:
        voxels += levels.prefix_counts(keys, depth)
        if last is not None:  # cells that go on from the piece before
            shifts = 6 * np.arange(depth, -1, -1, dtype=np.uint64)
            voxels -= (last >> shifts) == (keys[0] >> shifts)
        last = keys[-1]
    return voxels
