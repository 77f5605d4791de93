"""Sorted path keys: duplicates, merging, and folding into the words of a level."""

from __future__ import annotations

import numpy as np

from volatool.kernels._jit import kernel
from volatool.kernels.contiguity import contiguous_pairs, popcount


@kernel
def drop_repeats(keys):
    """
    Move the distinct keys of a sorted array to its front.

    Parameters
    ----------
    keys : (n,) array of uint64, sorted
        Changed in place.

    Returns
    -------
    n_distinct : int64
        How many there are.
    """
    if keys.size == 0:
        return np.int64(0)
    kept = np.int64(1)
    previous = keys[0]
    for i in range(1, keys.size):
        key = keys[i]
        keys[kept] = key
        kept += np.int64(key != previous)  # no branch: half of them would be mispredicted
        previous = key
    return kept


@kernel
def merge_keys(left, right):
    """
    Union of two sorted arrays of distinct keys.

    Parameters
    ----------
    left, right : (n,), (m,) arrays of uint64, strictly increasing

    Returns
    -------
    merged : (k,) array of uint64
        Strictly increasing, the front of an array of n + m.
    """
    merged = np.empty(left.size + right.size, np.uint64)
    i = j = k = np.int64(0)
    while i < left.size and j < right.size:
        a, b = left[i], right[j]
        merged[k] = min(a, b)
        k += 1
        i += np.int64(a <= b)
        j += np.int64(b <= a)
    while i < left.size:
        merged[k] = left[i]
        i += 1
        k += 1
    while j < right.size:
        merged[k] = right[j]
        j += 1
        k += 1
    return merged[:k]


@kernel
def prefix_counts(keys, depth):
    """
    How many cells of every level the keys reach.

    Parameters
    ----------
    keys : (n,) array of uint64, sorted
        Path keys at level `depth`.
    depth : int
        Their level.

    Returns
    -------
    voxels : (depth + 1,) array of int64
        Occupied cells at level 0 (the whole cube) to `depth`.
    """
    voxels = np.zeros(depth + 1, np.int64)
    if keys.size == 0:
        return voxels
    voxels[0] = 1
    for i in range(1, keys.size):
        change = keys[i] ^ keys[i - 1]
        level = depth + 1
        while change != 0:
            change >>= np.uint64(6)
            level -= 1
        if level <= depth:
            voxels[level] += 1  # the first level at which the two paths differ
    for level in range(1, depth + 1):
        voxels[level] += voxels[level - 1]
    return voxels


@kernel
def fold_keys(keys, state, blocks, words):
    """
    Fold the cells of a level into its words: one 64-bit word for each block of 4 x 4 x 4.

    Parameters
    ----------
    keys : (n,) array of uint64, sorted
        Path keys of cells, the next piece of the level's sorted keys.
    state : (2,) array of uint64
        Path key and word of the block that the piece before ended in; word 0 at the start.
        Updated in place: the last block stays there, as the next piece may add to it.
    blocks, words : (n + 1,) arrays of uint64
        Filled with the path keys (one digit shorter) and words of the blocks that are complete;
        what is behind those is undefined.

    Returns
    -------
    n_blocks : int64
        How many were filled.
    """
    block, word = state[0], state[1]
    at = np.int64(-1)  # of the block begun last
    if word != np.uint64(0):
        at += 1
        blocks[at], words[at] = block, word
    for i in range(keys.size):
        parent = keys[i] >> np.uint64(6)
        bit = np.uint64(1) << (keys[i] & np.uint64(63))
        is_same = parent == block and at >= 0
        # no branch: where many blocks have few cells it would often be mispredicted
        word = bit | (word if is_same else np.uint64(0))
        at += np.int64(not is_same)
        block = parent
        blocks[at] = block
        words[at] = word
    state[0], state[1] = block, word
    return max(at, np.int64(0))


@kernel
def count_words(words, counts):
    """
    Count the words of a level by their set bits, and their contiguous pairs.

    Parameters
    ----------
    words : (n,) array of uint64
        Words of blocks.
    counts : (66,) array of int64
        Added to: elements 0 to 64 how many words have so many bits set, element 65 the
        face-sharing pairs.
    """
    for i in range(words.size):
        counts[popcount(words[i])] += 1
        counts[65] += contiguous_pairs(words[i])
