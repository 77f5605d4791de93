"""Snapped cubes: corners on multiples of the side, so that cubes of all files are one grid."""

from __future__ import annotations

import math
from collections.abc import Iterator
from fractions import Fraction

import numpy as np

from volatool.cube import Cube
from volatool.model import I64, PointChunk, as_fraction

CubeIndex = tuple[int, int, int]
"""Number of a snapped cube along x, y, z: its corner in sides."""


def snapped_cube(index: CubeIndex, side: Fraction) -> Cube:
    """Return a snapped cube by its number."""
    return Cube.from_exact([number * side for number in index], side, is_snapped=True)


def by_cube(
    chunk: PointChunk, side: Fraction, z_ratio: Fraction
) -> Iterator[tuple[CubeIndex, PointChunk]]:
    """
    Yield the points of a chunk by snapped cube; half-open, so each point is in one.

    Parameters
    ----------
    chunk : PointChunk
        Points of each cube stay in their order.
    side : Fraction
        Of the cubes, in the horizontal unit.
    z_ratio : Fraction
        Horizontal units per vertical unit.

    Raises
    ------
    OverflowError
        A number of a cube doesn't fit 62 bits.
    """
    columns = [cube_numbers(chunk, axis, side, z_ratio) for axis in range(3)]
    order = np.lexsort(columns)  # stable
    chunk = chunk.take(order)
    numbers = np.column_stack(columns)[order]
    starts = np.flatnonzero(np.any(np.diff(numbers, axis=0, prepend=numbers[:1] - 1), axis=1))
    for start, stop in zip(starts, [*starts[1:], len(chunk)], strict=True):
        x, y, z = (int(value) for value in numbers[start])
        yield (x, y, z), chunk.take(slice(start, stop))


def cube_numbers(chunk: PointChunk, axis: int, side: Fraction, z_ratio: Fraction) -> I64:
    """
    Return the number of the snapped cube of each point on one axis, exactly.

    Parameters
    ----------
    chunk, side, z_ratio
        As for `by_cube`.
    axis : int
        0, 1 or 2.
    """
    ratio = z_ratio if axis == 2 else Fraction(1)
    slope = as_fraction(chunk.scale[axis]) * ratio / side
    shift = as_fraction(chunk.offset[axis]) * ratio / side
    length = math.lcm(slope.denominator, shift.denominator)
    stored = (chunk.x, chunk.y, chunk.z)[axis]
    factor, start = int(slope * length), int(shift * length)
    if abs(factor) < 2**30 and max(abs(start), length) < 2**61:
        return (stored.astype(np.int64) * factor + start) // length
    numbers = (stored.astype(object) * factor + start) // length
    if len(numbers) and max(map(abs, (numbers.min(), numbers.max()))) >= 2**62:
        raise OverflowError("a snapped cube's number doesn't fit 62 bits")
    return np.asarray(numbers, np.int64)
