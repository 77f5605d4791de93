"""Take voxels away from a volume: empty blocks go, level by level up to the root."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from volatool.model import I64, U64, Bool
from volatool.vola.info import VolumeInfo
from volatool.vola.volume import Volume

Box = tuple[float, float, float, float, float, float]
Levels = tuple[U64, ...]

PRESENT = np.uint64(1 << 56)
"""Metadata word of an empty root: byte 7 is always 1, so that no word is zero."""


def prune(
    levels: Sequence[U64], deepest: U64, metadata: Sequence[U64] | None
) -> tuple[Levels, Levels | None]:
    """
    Replace the deepest words by ones with fewer bits and drop what becomes empty.

    Parameters
    ----------
    levels : sequence of (n,) arrays of uint64
        Occupancy words of all levels, the root first.
    deepest : (n,) array of uint64
        New words for the blocks of the last level; bits may only be missing.
    metadata : sequence of (n,) arrays of uint64, or None
        Words for the blocks of `levels`.

    Returns
    -------
    levels, metadata : tuples of (n,) arrays of uint64
        A deepest block keeps its metadata word even when it lost voxels. A block above that lost
        a whole block below it gets the mean of those left, each of which counts alike (class: the
        most frequent); the others keep theirs. The root stays, empty if need be.
    """
    from volatool.kernels.algebra import keep_bits
    from volatool.kernels.words import mean_words

    words = deepest
    own = None if metadata is None else metadata[-1]
    is_changed = np.zeros(len(words), np.bool_)  # blocks whose metadata word is not the old one
    kept: list[U64] = []
    kept_metadata: list[U64] = []
    for level in range(len(levels), 1, -1):
        alive: Bool = words != 0
        above = levels[level - 2]
        kept.append(words[alive])
        words = keep_bits(above, alive)
        if own is None or metadata is None:
            continue
        kept_metadata.append(own[alive])
        n_children = np.bitwise_count(above)
        starts = _starts(n_children)
        has_changed = np.zeros(len(above), np.bool_)
        owners = n_children > 0
        if len(is_changed):
            has_changed[owners] = np.logical_or.reduceat(is_changed | ~alive, starts[owners])
        own, is_changed = metadata[level - 2], has_changed & (words != 0)
        if is_changed.any():
            n_left = np.bitwise_count(words)
            # the words left of the changed blocks, group after group
            chosen = kept_metadata[-1][np.repeat(is_changed, n_left)]
            means = mean_words(chosen, _starts(n_left[is_changed]))
            own = own.copy()
            own[is_changed] = means
    kept.append(words)
    if own is None:
        return tuple(reversed(kept)), None
    if not words[0]:
        own = np.array([PRESENT])
    kept_metadata.append(own)
    return tuple(reversed(kept)), tuple(reversed(kept_metadata))


def _starts(counts: NDArray[np.uint8]) -> I64:
    starts = np.zeros(len(counts), np.int64)
    np.cumsum(counts[:-1], out=starts[1:])
    return starts


def pruned(volume: Volume, deepest: U64, info: VolumeInfo | None = None) -> Volume:
    """
    Return a volume without some of its voxels.

    Parameters
    ----------
    volume : Volume
        What they are taken from.
    deepest : (n,) array of uint64
        What is left of the words of its last level.
    info : VolumeInfo, optional
        Description; that of `volume` by default, with its box cut to the cells left, and without
        a number of points unless nothing was taken away.
    """
    if info is None and np.array_equal(deepest, volume.levels[-1]):
        return volume
    levels, metadata = prune(volume.levels, deepest, volume.metadata_levels)
    result = Volume(levels, metadata, volume.cube, info or volume.info)
    if info is not None:
        return result
    box = cells_box(result)
    return replace(result, info=replace(volume.info, box=box, n_points=None))


SLABS = np.array(
    [
        [0x1111111111111111 << digit for digit in range(4)],
        [0x000F000F000F000F << 4 * digit for digit in range(4)],
        [0xFFFF << 16 * digit for digit in range(4)],
    ],
    np.uint64,
)
"""Bits of a word by axis and digit on it."""


def cells_range(volume: Volume) -> tuple[list[int], list[int]]:
    """
    Return the smallest and the largest cell index on each axis, from few of the blocks.

    Parameters
    ----------
    volume : Volume
        With a voxel.

    Returns
    -------
    first, last : list of 3 int
        x, y, z.
    """
    if not all(words.all() for words in volume.levels):  # stored blocks without a voxel
        cells = volume.voxels()
        return cells.min(axis=0).tolist(), cells.max(axis=0).tolist()
    ranks = [np.cumsum(np.bitwise_count(words), dtype=np.int64) for words in volume.levels]
    return (
        [_extreme(volume, ranks, axis, range(4)) for axis in range(3)],
        [_extreme(volume, ranks, axis, range(3, -1, -1)) for axis in range(3)],
    )


def _extreme(volume: Volume, ranks: Sequence[I64], axis: int, digits: range) -> int:
    """Outermost cell index of an axis: only blocks of the outermost slab are followed down."""
    blocks = np.zeros(1, np.int64)
    index = 0
    for words, rank in zip(volume.levels, ranks, strict=True):
        here = words[blocks]
        digit = next(d for d in digits if (here & SLABS[axis, d]).any())
        index = 4 * index + digit
        before = rank[blocks] - np.bitwise_count(here)
        children = []
        for bit in range(64):
            flag = np.uint64(1 << bit)
            if flag & SLABS[axis, digit]:
                has = (here & flag) != 0
                children.append(before[has] + np.bitwise_count(here[has] & (flag - np.uint64(1))))
        blocks = np.concatenate(children)
    return index


def cells_box(volume: Volume) -> Box | None:
    """
    Return a box that holds all points of a volume: of its voxels, and of what is known.

    Parameters
    ----------
    volume : Volume
        Its `info.box`, if there is one, must hold the points.

    Returns
    -------
    box : tuple of 6 float or None
        Minimum x, y, z, then maximum, in units of the CRS (z in the vertical unit); None without
        voxels.
    """
    if not len(volume):
        return None
    size = 4**volume.depth
    corner, side = volume.cube.exact[:3], volume.cube.exact[3]
    first, last = cells_range(volume)
    ratios = (1, 1, volume.crs.z_ratio)
    if volume.info.quantizer == "floor":
        ends = [(low, high + 1, size) for low, high in zip(first, last, strict=True)]
    else:  # the toolkit rounded to the nearest of `size` places: half a step either way
        ends = [
            (max(2 * low - 1, 0), min(2 * high + 1, 2 * (size - 1)), 2 * (size - 1))
            for low, high in zip(first, last, strict=True)
        ]
    lows = [
        float((corner[axis] + side * low / n) / ratios[axis])
        for axis, (low, _, n) in enumerate(ends)
    ]
    highs = [
        float((corner[axis] + side * high / n) / ratios[axis])
        for axis, (_, high, n) in enumerate(ends)
    ]
    known = volume.info.box
    if known is not None:
        lows = list(map(max, lows, known[:3]))
        highs = list(map(min, highs, known[3:]))
        if any(low > high for low, high in zip(lows, highs, strict=True)):
            return None  # what was known was not true
    x0, y0, z0 = lows
    x1, y1, z1 = highs
    return x0, y0, z0, x1, y1, z1
