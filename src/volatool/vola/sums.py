"""Sums of the points' attributes per block: what the metadata words are made from."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from volatool.errors import OptionError
from volatool.model import I32, U64, PointChunk
from volatool.scratch import Scratch
from volatool.vola.fold import Sink, fold_sums
from volatool.vola.metadata import ATTRIBUTES, Ranges, Scaling, check_channels
from volatool.vola.runs import SumRuns

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
    """

    def __init__(self, channels: Iterable[str], level: int, scratch: Scratch, share: float) -> None:
        self.channels = check_channels(channels)
        self.level = level
        self.ranges = Ranges()
        self._runs = SumRuns(scratch, share)
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

    def add(self, points: PointChunk, keys: U64, depth: int, order: U64 | None, bits: int) -> None:
        """
        Add points.

        Parameters
        ----------
        points : PointChunk
            All inside the cube, at most ``2**bits``.
        keys : (n,) array of uint64
            Their path keys.
        depth : int
            Level of the keys.
        order : (n,) array of uint64, sorted, or None
            ``key << bits | number of the point``, where that fits 64 bits.
        bits : int
            How many the number of a point has.
        """
        from volatool.kernels import reduce

        z = self._stored_heights(points)
        columns = [self._column(points, name) for name in _DTYPES]
        code, red, green, blue, returns, intensity = columns
        self.ranges.add(z, dict(zip(_DTYPES, columns, strict=True)))
        digits = depth - self.level + 1  # of a key that are below its block
        if order is not None:
            parts = [(0, order, bits, bits + 6 * digits)]
        else:
            # the blocks are shorter than the keys, and the pieces are cut to the bits left
            free = min(64 - 6 * (self.level - 1), bits)
            blocks = keys >> np.uint64(6 * digits)
            parts = [
                (start, _numbered(blocks[start : start + (1 << free)], free), free, free)
                for start in range(0, len(keys), 1 << free)
            ]
        for start, ordered, index_bits, block_shift in parts:
            rows = reduce.sum_points(
                ordered,
                index_bits,
                block_shift,
                code[start:],
                red[start:],
                green[start:],
                blue[start:],
                z[start:],
                returns[start:],
                intensity[start:],
            )
            self._runs.push(rows.copy())

    def _column(self, chunk: PointChunk, name: str) -> NDArray[Any]:
        """Return an attribute, or zeros when no channel is made from it."""
        dtype = _DTYPES[name]
        if any(name in ATTRIBUTES[channel] for channel in self.channels):
            return np.ascontiguousarray(chunk.attributes[name], dtype)
        zeros = self._nothing.get(name)
        if zeros is None or len(zeros) < len(chunk):
            zeros = self._nothing[name] = np.zeros(len(chunk), dtype)
        return zeros[: len(chunk)]

    def _stored_heights(self, chunk: PointChunk) -> I32:
        """Return stored heights in the scale and offset of the first chunk."""
        here = (chunk.scale[2], chunk.offset[2])
        if self._heights is None:
            self._heights = here
        if here == self._heights or "height" not in self.channels:
            return np.ascontiguousarray(chunk.z, np.int32)
        scale, offset = self._heights
        z = np.rint((chunk.z * here[0] + (here[1] - offset)) / scale)
        if np.abs(z).max() >= 2**31:
            raise OptionError(
                "points with very different height offsets can't share a metadata channel; "
                "leave out 'height'"
            )
        stored: I32 = z.astype(np.int32)
        return stored

    def coarsen_to(self, level: int) -> None:
        """Tell only the blocks of a coarser level apart from now on."""
        if level < self.level:
            self._runs.coarsen(self.level - level)
            self.level = level

    def scaling(self, z_unit: str | None) -> Scaling:
        """Return how the sums become bytes, for the points added so far."""
        scale, offset = self._heights or (1.0, 0.0)
        return Scaling.of(self.channels, self.ranges, scale, offset, z_unit)

    def fold(self, scaling: Scaling, sink: Sink) -> None:
        """Hand the metadata words of levels 1 to `level` to a sink, piece by piece."""
        fold_sums(self._runs.stream(), self.level, scaling, sink)

    def close(self) -> None:
        """Drop everything."""
        self._runs.close()


def _numbered(blocks: U64, bits: int) -> U64:
    order = blocks << np.uint64(bits)
    order |= np.arange(len(order), dtype=np.uint64)
    order.sort()
    return order
