"""Point records taken apart: one pass over the bytes for all that is wanted of them."""

from __future__ import annotations

import numpy as np

from volatool.kernels._jit import kernel

BLOCK = 1024
"""Records that stay in the cache while their fields are taken one after the other."""


@kernel
def split(records, x, y, z, parts, small, places, large):
    """
    Take coordinates and attributes out of point records.

    Parameters
    ----------
    records : (n, record_bytes) array of uint8, C-contiguous
        As LAS has them: little-endian, x, y, z in front.
    x, y, z : (n,) arrays of int32
        Filled.
    parts : (k, 3) array of int64
        Of each attribute within a byte: the byte's place in a record, how many bits are below it,
        and the mask of its bits then.
    small : (k, n) array of uint8
        Filled.
    places : (m,) array of int64
        Of each attribute of two bytes: its place in a record.
    large : (m, n) array of uint16
        Filled.
    """
    n = records.shape[0]
    for start in range(0, n, BLOCK):
        stop = min(start + BLOCK, n)
        for i in range(start, stop):
            x[i] = _int32(records, i, np.int64(0))
            y[i] = _int32(records, i, np.int64(4))
            z[i] = _int32(records, i, np.int64(8))
        for k in range(parts.shape[0]):
            at, shift, mask = parts[k, 0], np.uint8(parts[k, 1]), np.uint8(parts[k, 2])
            narrow = small[k]
            for i in range(start, stop):
                narrow[i] = (records[i, at] >> shift) & mask
        for k in range(places.size):
            at = places[k]
            wide = large[k]
            for i in range(start, stop):
                high = np.uint16(records[i, at + 1]) << np.uint16(8)
                wide[i] = np.uint16(records[i, at]) | high


@kernel
def _int32(records, i, at):
    """Return four bytes of a record as a number; one load in machine code."""
    value = np.uint32(records[i, at])
    value |= np.uint32(records[i, at + 1]) << np.uint32(8)
    value |= np.uint32(records[i, at + 2]) << np.uint32(16)
    value |= np.uint32(records[i, at + 3]) << np.uint32(24)
    return np.int32(value)
