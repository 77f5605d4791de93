"""Points in, volume out: chunks in any order, in bounded memory, every count exact."""

from __future__ import annotations

import math
from collections.abc import Generator, Iterable, Iterator
from contextlib import closing
from fractions import Fraction
from types import TracebackType
from typing import TYPE_CHECKING

import numpy as np

from volatool.ahead import ahead
from volatool.cube import MAX_DEPTH, OUTSIDE, Cube, Quantizer
from volatool.errors import OptionError, ResourceError
from volatool.model import I64, U64, CrsInfo, PointChunk
from volatool.scratch import Scratch
from volatool.vola.built import Box, Built
from volatool.vola.metadata import check_channels
from volatool.vola.runs import KeyRuns
from volatool.vola.sums import MetadataSums

if TYPE_CHECKING:
    from volatool.vola.volume import Volume

_SHARE = 0.7
"""Part of the memory budget that runs may fill; the rest is for the levels' words and others."""

_PIECE = 1 << 18
"""Points worked on at a time; a chunk of the usual size is one piece."""

Scaling = tuple[tuple[float, float, float], tuple[float, float, float]]
"""Scale and offset of stored integers."""


class VolaBuilder:
    """
    Collect points and build the volume's levels from them.

    Parameters
    ----------
    cube : Cube
        The extent, z in the horizontal unit.
    max_depth : int
        Level down to which the points are told apart, 1 to 10.
    channels : iterable of str
        Metadata channels, of `volatool.channels.CHANNELS`; none by default.
    n_points_hint : int, optional
        Upper bound of the number of points. With it, depths that can't reach `min_occupancy` any
        more are given up on the way, which keeps the memory down; without it every depth is kept.
    min_occupancy : float
        Least occupancy of a level that will be asked for, if it isn't 1 or 2.
    scratch : Scratch, optional
        Memory budget; unlimited by default.
    z_ratio : Fraction
        Horizontal units per vertical unit.
    keep_depth : int, optional
        Keep the words and sums of just the levels down to this one, whatever their occupancy.
    crs : CrsInfo, optional
        For the volume's description.

    Notes
    -----
    A depth D > 2 is only chosen if its voxels are at least ``64 min_occupancy`` times those of the
    level above, and there are no more voxels than points N: D is out of the question as soon as
    level D - 1 has more than ``N / (64 min_occupancy)`` voxels. The words of such levels are
    counted and dropped, and the sums of the metadata made coarser while points come in.

    The result depends on the set of points alone, not on their order or the chunks.
    """

    def __init__(
        self,
        cube: Cube,
        max_depth: int = 8,
        *,
        channels: Iterable[str] = (),
        n_points_hint: int | None = None,
        min_occupancy: float = 0.15,
        scratch: Scratch | None = None,
        z_ratio: Fraction = Fraction(1),
        keep_depth: int | None = None,
        crs: CrsInfo | None = None,
    ) -> None:
        if not 1 <= max_depth <= MAX_DEPTH:
            raise ResourceError(f"max_depth must be 1 to {MAX_DEPTH}, got {max_depth}", "E_SIZE")
        if keep_depth is not None and not 1 <= keep_depth <= max_depth:
            raise OptionError(f"keep_depth must be 1 to {max_depth}, got {keep_depth}")
        self.cube = cube
        self.max_depth = max_depth
        self.channels = check_channels(channels)
        self.n_points = 0
        self.crs = crs or CrsInfo()
        self._hint = n_points_hint
        self._keep_depth = keep_depth
        self._min_occupancy = min_occupancy
        self._z_ratio = z_ratio
        self._scratch = scratch or Scratch()
        self._quantizer: Quantizer | None = None
        self._boxes: dict[Scaling, I64] = {}
        may_rule_out = keep_depth is None and n_points_hint is not None
        self._keys = KeyRuns(self._scratch, _SHARE)
        self._sums = MetadataSums(
            self.channels,
            keep_depth or max_depth,
            self._scratch,
            _SHARE,
            self._quantizer_for,
            self._limit(n_points_hint or 0) if may_rule_out else math.inf,
            n_points_hint or 0,
        )
        self._built: Built | None = None
        self._is_closed = False

    def __enter__(self) -> VolaBuilder:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def add(self, chunk: PointChunk) -> int:
        """
        Add points.

        Parameters
        ----------
        chunk : PointChunk
            With the attributes that the channels need.

        Returns
        -------
        n_outside : int
            Points that are not in the closed cube; they are not added.

        Raises
        ------
        OptionError
            An attribute that a channel needs is missing, the volume is built already, or this is no
            chunk.
        """
        if not isinstance(chunk, PointChunk):
            raise OptionError(
                f"a builder takes the chunks of vt.stream, not {type(chunk).__name__}; an array "
                "can be saved as .npy and read by vt.import_points"
            )
        if self._built is not None:
            raise OptionError("the volume is built already; make a new VolaBuilder")
        self._sums.check(chunk)
        return sum(self._add_piece(piece) for piece in _pieces(chunk))

    def _add_piece(self, points: PointChunk) -> int:
        from volatool.kernels import collect

        quantizer = self._quantizer_for(points)
        box = self._boxes.setdefault((points.scale, points.offset), _nowhere())
        n_dropped = 0
        if not self._sums.can_add(points):  # heights outside may be of no use to it
            inside = quantizer.keys(points.x, points.y, points.z) != OUTSIDE
            n_dropped = len(points) - int(np.count_nonzero(inside))
            points = points.take(inside)
        keys = self._keys.room(len(points))
        tally = np.zeros(4, np.int64)
        if self.channels:
            self._sums.add(points, quantizer, keys, tally, box)
        else:
            x, y, z = (np.ascontiguousarray(a, np.int32) for a in (points.x, points.y, points.z))
            collect.collect_keys(x, y, z, *quantizer.plan, self.max_depth, keys, tally, box)
        self._keys.filled(int(tally[collect.KEYS]))
        if self._sums.is_review_due:
            self._sums.review(self._keys.stream(), self.max_depth)
        n_outside = int(tally[collect.OUT])
        self.n_points += len(points) - n_outside
        return n_outside + n_dropped

    def _quantizer_for(self, chunk: PointChunk) -> Quantizer:
        last = self._quantizer
        if last is None or (last.scale, last.offset) != (chunk.scale, chunk.offset):
            last = Quantizer(self.cube, chunk.scale, chunk.offset, self.max_depth, self._z_ratio)
            self._quantizer = last
        return last

    def _box(self) -> Box | None:
        """Return the box of the points added, in units of the file."""
        if not self.n_points:
            return None
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        for (scale, offset), box in self._boxes.items():
            if box[0] <= box[3]:
                ends = box.reshape(2, 3) * np.array(scale) + np.array(offset)
                low = np.minimum(low, ends.min(axis=0))  # a scale may be negative
                high = np.maximum(high, ends.max(axis=0))
        x0, y0, z0, x1, y1, z1 = (float(value) for value in (*low, *high))
        return (x0, y0, z0, x1, y1, z1)

    def _limit(self, n_points: int) -> float:
        """Most blocks that the last level of a depth worth keeping can have."""
        if self._min_occupancy <= 0:
            return float("inf")
        # a hair more, so that rounding can't rule out what an occupancy of just the limit allows
        return n_points / (64 * self._min_occupancy) * (1 + 1e-9)

    def build(self) -> Built:
        """
        Count and fold all levels, in one pass over the sorted cells.

        Returns
        -------
        built : Built
            The counts of levels 1 to `max_depth`, and the volumes that can be had. No more points
            can be added.
        """
        if self._built is None:
            is_limited = self._keep_depth is None and self._hint is not None
            with closing(self._drained_keys()) as keys:
                self._built = Built(
                    keys,
                    self._sums,
                    cube=self.cube,
                    crs=self.crs,
                    n_points=self.n_points,
                    box=self._box(),
                    max_depth=self.max_depth,
                    keep=self._keep_depth or self.max_depth,
                    limit=self._limit(max(self.n_points, self._hint or 0))
                    if is_limited
                    else float("inf"),
                    scratch=self._scratch,
                )
            self._sums.close()
        return self._built

    def _drained_keys(self) -> Generator[U64]:
        with ahead(self._keys.stream()) as pieces:  # merged in a thread while they are folded
            yield from pieces
        self._keys.close()  # before the metadata is folded: not both at once

    def finish(self, depth: int | str = "auto", min_occupancy: float | None = None) -> Volume:
        """
        Build, choose the depth and return the volume; the builder is closed.

        Parameters
        ----------
        depth : int or "auto"
            Number of levels; ``"auto"`` takes the deepest one with enough occupancy.
        min_occupancy : float, optional
            For ``"auto"``; as given to the builder by default.

        Returns
        -------
        volume : Volume

        Raises
        ------
        OptionError
            The builder is closed, as it is after a call of this, or there is no such depth.
        """
        from volatool.occupancy.depth import choose_depth

        if self._is_closed:
            raise OptionError("the builder is closed; make a new VolaBuilder")
        if depth != "auto" and (isinstance(depth, str) or not 1 <= depth <= self.max_depth):
            raise OptionError(f"depth must be 'auto' or 1 to {self.max_depth}, got {depth!r}")
        built = self.build()
        try:
            if depth == "auto":
                threshold = self._min_occupancy if min_occupancy is None else min_occupancy
                depth = choose_depth(
                    built.counts, built.n_points, cube=self.cube, threshold=threshold
                ).depth
            return built.volume(int(depth))
        finally:
            self.close()

    def close(self) -> None:
        """Drop all working data; volumes that were made stay."""
        self._is_closed = True
        self._keys.close()
        self._sums.close()
        if self._built is not None:
            self._built.close()


def _nowhere() -> I64:
    """Return the box of no points, to be widened."""
    far = np.iinfo(np.int64)
    return np.repeat(np.array([far.max, far.min]), 3)


def _pieces(chunk: PointChunk) -> Iterator[PointChunk]:
    for start in range(0, len(chunk), _PIECE):
        part = slice(start, start + _PIECE)
        yield PointChunk(
            chunk.start + start,
            chunk.x[part],
            chunk.y[part],
            chunk.z[part],
            chunk.scale,
            chunk.offset,
            {name: values[part] for name, values in chunk.attributes.items()},
        )
