"""Voxels in the order and the masks of OpenVDB's trees: nodes of 32, 16 and 8 a side."""

from __future__ import annotations

import numpy as np

from volatool.kernels._jit import kernel

LEAF_BITS, LOWER_BITS, UPPER_BITS = 9, 12, 15
"""Bits of a place in a node: x, then y, then z, the last one fastest."""


@kernel
def tree_keys(cells):
    """
    Numbers by which voxels sort as OpenVDB stores them.

    Parameters
    ----------
    cells : (n, 3) array of int32
        x, y, z, 0 to ``2**20 - 1``.

    Returns
    -------
    keys : (n,) array of uint64
        Place of the upper node, 24 bits, then places in the upper node, the lower node, the leaf.
    """
    keys = np.empty(len(cells), np.uint64)
    for i in range(len(cells)):
        key = np.uint64(0)
        for high, low in ((20, 12), (12, 7), (7, 3), (3, 0)):
            for axis in range(3):
                part = (cells[i, axis] >> low) & ((1 << (high - low)) - 1)
                key = (key << np.uint64(high - low)) | np.uint64(part)
        keys[i] = key
    return keys


@kernel
def masks(places, parents, n_words, n_parents):
    """
    Bit masks of nodes.

    Parameters
    ----------
    places : (n,) array of int64
        Bit of each child in its parent.
    parents : (n,) array of int64
        Which parent.
    n_words, n_parents : int
        Words of a mask; masks.

    Returns
    -------
    masks : (n_parents, n_words) array of uint64
    """
    found = np.zeros((n_parents, n_words), np.uint64)
    for i in range(places.size):
        found[parents[i], places[i] >> 6] |= np.uint64(1) << np.uint64(places[i] & 63)
    return found


@kernel
def leaf_buffers(leaf_masks, counts, head, value):
    """
    Leaves as OpenVDB stores them after its tree: the mask, a byte, the active values.

    Parameters
    ----------
    leaf_masks : (n, 64) array of uint8
        The masks as bytes.
    counts : (n,) array of int64
        Bits set in each.
    head : int
        The byte.
    value : (4,) array of uint8
        The value of every voxel.

    Returns
    -------
    data : (65 n + 4 sum(counts),) array of uint8
    """
    n_bytes = np.int64(0)
    for i in range(counts.size):
        n_bytes += 65 + 4 * counts[i]
    data = np.empty(n_bytes, np.uint8)
    at = np.int64(0)
    for i in range(counts.size):
        data[at : at + 64] = leaf_masks[i]
        data[at + 64] = head
        at += 65
        for _ in range(counts[i]):
            for k in range(4):
                data[at + k] = value[k]
            at += 4
    return data
