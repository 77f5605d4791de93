"""Repeatable chance: hashes of whole numbers instead of a random stream.

A value depends on its seed and keys alone, so a scene can be worked out in pieces of any size, in
any order, with the same result; numpy's own streams may change from version to version.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

_STEP = np.uint64(0x9E3779B97F4A7C15)
_MIX_1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX_2 = np.uint64(0x94D049BB133111EB)


def bits(seed: int, *keys: ArrayLike) -> NDArray[np.uint64]:
    """
    Hash whole numbers (SplitMix64's finaliser, chained).

    Parameters
    ----------
    seed : int
        Names the use; two uses of the same keys need two seeds.
    *keys : arrays of int
        Broadcast against each other.

    Returns
    -------
    hashes : array of uint64
    """
    # an array, not a scalar: numpy warns of scalars that overflow, which is what a hash is for
    state = np.array([(seed * int(_STEP) + 1) % 2**64], np.uint64)
    for key in keys:
        state = (state ^ np.asarray(key, np.int64).astype(np.uint64)) + _STEP
        state = (state ^ (state >> np.uint64(30))) * _MIX_1
        state = (state ^ (state >> np.uint64(27))) * _MIX_2
        state = state ^ (state >> np.uint64(31))
    return state


def uniform(seed: int, *keys: ArrayLike) -> NDArray[np.float64]:
    """Return numbers in [0, 1), 53 bits each; arguments as in `bits`."""
    return (bits(seed, *keys) >> np.uint64(11)).astype(np.float64) * 2.0**-53


def between(low: float, high: float, seed: int, *keys: ArrayLike) -> NDArray[np.float64]:
    """Return numbers in [low, high); other arguments as in `bits`."""
    return low + (high - low) * uniform(seed, *keys)


def normal(seed: int, *keys: ArrayLike) -> NDArray[np.float64]:
    """
    Return bell-shaped numbers with mean 0 and variance 1; arguments as in `bits`.

    Notes
    -----
    The sum of a hash's four 16-bit parts: never beyond 3.5, and free of library functions whose
    last digit differs between machines.
    """
    word = bits(seed, *keys)
    total = sum((word >> np.uint64(16 * part)) & np.uint64(0xFFFF) for part in range(4))
    return (np.asarray(total, np.float64) / 65535.0 - 2.0) * np.sqrt(3.0)


def smooth(
    seed: int, u: NDArray[np.float64], v: NDArray[np.float64], wavelength: float
) -> NDArray[np.float64]:
    """
    Return value noise: a smooth random surface in [-1, 1].

    Parameters
    ----------
    seed : int
        Which surface.
    u, v : arrays of float64
        Place.
    wavelength : float
        Distance between its knots, same unit.
    """
    x, y = u / wavelength, v / wavelength
    column, row = np.floor(x), np.floor(y)
    fx, fy = x - column, y - row
    fx = fx * fx * fx * (fx * (fx * 6 - 15) + 10)
    fy = fy * fy * fy * (fy * (fy * 6 - 15) + 10)
    i, j = column.astype(np.int64), row.astype(np.int64)
    south = uniform(seed, i, j) * (1 - fx) + uniform(seed, i + 1, j) * fx
    north = uniform(seed, i, j + 1) * (1 - fx) + uniform(seed, i + 1, j + 1) * fx
    return 2 * (south * (1 - fy) + north * fy) - 1
