"""A volume from path keys: the way in for whatever has cells rather than points."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from volatool.cube import MAX_DEPTH, Cube
from volatool.errors import OptionError, ResourceError
from volatool.model import U64
from volatool.vola.fold import words_of_levels
from volatool.vola.info import VolumeInfo
from volatool.vola.prune import PRESENT
from volatool.vola.strips import group_starts
from volatool.vola.volume import Volume

_CONSTANT_BYTE = np.uint64(255 << 56)


def from_keys(
    keys: ArrayLike,
    depth: int,
    cube: Cube,
    info: VolumeInfo,
    metadata_words: ArrayLike | None = None,
) -> Volume:
    """
    Return the volume of the voxels that path keys name.

    Parameters
    ----------
    keys : (n,) array of uint64
        Path keys of voxels at `depth` (six bits a level, root first), in any order; repeats are
        one voxel.
    depth : int
        Number of levels, 1 to 10.
    cube : Cube
        The extent.
    info : VolumeInfo
        Description; its channels say what the metadata bytes are, and are dropped when there are
        no words.
    metadata_words : (n,) array of uint64, optional
        A word for each key. Each block of each level gets the mean of the words of all keys in
        it, repeats included (`kernels.words.mean_words`: halves up, class the most frequent), and
        byte 7 = 1.

    Returns
    -------
    volume : Volume
        Without any key the root word is 0 and there are no deeper blocks.

    Raises
    ------
    OptionError
        Keys that are no cells of `depth`, or not as many words as keys.
    ResourceError
        ``E_SIZE``: path keys end at level 10.
    """
    if not 1 <= depth <= MAX_DEPTH:
        raise ResourceError(f"depth must be 1 to {MAX_DEPTH}, got {depth}", "E_SIZE")
    cells = np.array(keys, np.uint64).reshape(-1)  # a copy: it is sorted in place
    if len(cells) and int(cells.max()) >= 64**depth:
        raise OptionError(f"{int(cells.max())} is no path key of depth {depth}: below {64**depth}")
    if metadata_words is None:
        cells.sort()
        return Volume(_levels(cells, depth), None, cube, replace(info, channels=()))
    words = np.asarray(metadata_words, np.uint64).reshape(-1)
    if len(words) != len(cells):
        raise OptionError(f"{len(cells)} keys need as many metadata words, got {len(words)}")
    order = np.argsort(cells, kind="stable")
    cells = cells[order]
    metadata = _metadata(cells, words[order], depth)
    return Volume(_levels(cells, depth), metadata, cube, info)


def _levels(keys: U64, depth: int) -> tuple[U64, ...]:
    """Fold sorted keys, repeats among them; `keys` is changed."""
    from volatool.kernels import levels as kernels

    return words_of_levels(keys[: int(kernels.drop_repeats(keys))], depth)


def _metadata(keys: U64, words: U64, depth: int) -> tuple[U64, ...]:
    """Mean words of the blocks of every level of sorted keys."""
    from volatool.kernels.words import mean_words

    levels = []
    for level in range(1, depth + 1):
        starts = group_starts(keys >> np.uint64(6 * (depth - level + 1)))
        levels.append((mean_words(words, starts) & ~_CONSTANT_BYTE) | PRESENT)
    if not len(keys):
        levels[0] = np.array([PRESENT])
    return tuple(levels)
