"""One pass over sorted keys or sums that makes the words of all levels.

Each level takes pieces of its own sorted cells, keeps the last block back (it may go on in the
next piece) and hands the complete ones up to the level above as that level's cells.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from volatool.model import I64, U64, LevelCounts
from volatool.vola.metadata import Scaling

Sink = Callable[[int, U64], None]
"""Called with (level from 1, next words of that level in order), to be copied if kept."""


def fold_levels(pieces: Iterator[U64], depth: int, sink: Sink) -> list[LevelCounts]:
    """
    Fold sorted voxels into the words of every level, and count them.

    Parameters
    ----------
    pieces : iterator of (n,) arrays of uint64
        Distinct path keys at level `depth`, sorted through all pieces.
    depth : int
        Number of levels.
    sink : callable
        Is given each level's words piece by piece.

    Returns
    -------
    counts : list of LevelCounts
        Of levels 1 to `depth`. Without any voxel level 1 has one empty block, the others none.
    """
    from volatool.kernels import levels as kernels

    states = np.zeros((depth + 1, 2), np.uint64)
    counts = np.zeros((depth + 1, 66), np.int64)
    blocks_seen = np.zeros(depth + 1, np.int64)
    # made once: new pages for each piece take longer than the folding
    rooms = [np.empty((2, 0), np.uint64)] * (depth + 1)

    def put(level: int, words: U64) -> None:
        kernels.count_words(words, counts[level])
        blocks_seen[level] += len(words)
        sink(level, words)

    def climb(cells: U64, is_last: bool) -> None:
        for level in range(depth, 0, -1):
            if rooms[level].shape[1] <= len(cells):
                rooms[level] = np.empty((2, len(cells) + 1), np.uint64)
            blocks, words = rooms[level]
            n_blocks = int(kernels.fold_keys(cells, states[level], blocks, words))
            if is_last and states[level, 1]:
                blocks[n_blocks], words[n_blocks] = states[level]
                n_blocks += 1
            if not n_blocks:
                return
            put(level, words[:n_blocks])
            cells = blocks[:n_blocks]

    for piece in pieces:
        climb(piece, is_last=False)
    climb(np.empty(0, np.uint64), is_last=True)
    if not blocks_seen[1]:
        put(1, np.zeros(1, np.uint64))
    return [
        LevelCounts(int(blocks_seen[level]), counts[level, :65].copy(), int(counts[level, 65]))
        for level in range(1, depth + 1)
    ]


def words_of_levels(keys: U64, depth: int) -> tuple[U64, ...]:
    """
    Return the words of every level of voxels that come in one piece.

    Parameters
    ----------
    keys : (n,) array of uint64
        Distinct path keys at level `depth`, sorted.
    depth : int
        Number of levels.
    """
    pieces: list[list[U64]] = [[np.empty(0, np.uint64)] for _ in range(depth)]
    fold_levels(iter([keys]), depth, lambda level, words: pieces[level - 1].append(words.copy()))
    return tuple(map(np.concatenate, pieces))


def fold_sums(pieces: Iterator[I64], level: int, scaling: Scaling, sink: Sink) -> None:
    """
    Make the metadata words of every level from sorted sums.

    Parameters
    ----------
    pieces : iterator of (n, 8) arrays of int64
        Rows of sums of the blocks of `level`, sorted through all pieces.
    level : int
        Their level, from 1 (the root block).
    scaling : Scaling
        From means to bytes.
    sink : callable
        Is given each level's words piece by piece.
    """
    from volatool.kernels import reduce as kernels

    held = [np.empty((0, 8), np.int64) for _ in range(level + 1)]

    def climb(rows: I64, at: int, is_last: bool) -> None:
        while at > 0:
            rows = kernels.fold_rows(np.concatenate([held[at], rows]), 0)
            if not len(rows):
                return
            blocks = rows[:, 0] >> 8
            cut = len(rows) if is_last else int(np.searchsorted(blocks, blocks[-1]))
            held[at] = rows[cut:].copy()
            if not cut:
                return
            rows = rows[:cut]
            sink(at, kernels.encode_rows(rows, scaling.table, scaling.has_class))
            rows = kernels.fold_rows(rows, 1)
            at -= 1

    for piece in pieces:
        climb(piece, level, is_last=False)
    climb(np.empty((0, 8), np.int64), level, is_last=True)
