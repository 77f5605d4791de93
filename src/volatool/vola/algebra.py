"""Volumes from volumes: cut out a box, unite, intersect, subtract."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np

from volatool.errors import OptionError
from volatool.model import Bounds, as_fraction
from volatool.vola.prune import pruned
from volatool.vola.volume import Volume


def crop(
    volume: Volume, bounds: Bounds | None = None, *, z: tuple[float, float] | None = None
) -> Volume:
    """
    Return the part of a volume in a box, on the same grid.

    Parameters
    ----------
    volume : Volume
        What is cut.
    bounds : Bounds, optional
        Closed rectangle, in units of the CRS; may be infinite.
    z : tuple of 2 float, optional
        Lowest and highest, both included, in the vertical unit; may be infinite.

    Returns
    -------
    part : Volume
        The voxels whose cell meets the closed box. Cells are half-open (the last one of the cube
        is closed), so one that only ends at the box is not among them; of volumes of the original
        toolkit a cell is what it rounded to one place. Worked out on exact rationals. Metadata as
        `vola.prune.prune` has it. `info.n_points` is None and `info.box` the part's when voxels
        were lost.

    Raises
    ------
    OptionError
        The lowest z is above the highest, or one is not a number.
    """
    z = (-math.inf, math.inf) if z is None else z
    if not z[0] <= z[1]:
        raise OptionError(f"z must be lowest, highest; got {z[0]:g}, {z[1]:g}")
    box = Bounds(-math.inf, -math.inf, math.inf, math.inf) if bounds is None else bounds
    sides = ((box.left, box.right), (box.bottom, box.top), z)
    ranges = [_cells_between(volume, axis, *ends) for axis, ends in enumerate(sides)]
    if all(low <= 0 and high >= 4**volume.depth - 1 for low, high in ranges):
        return volume
    from volatool.kernels.algebra import box_bits

    first, last = np.array(ranges, np.int64).T.copy()
    depth = volume.depth
    blocks = volume.voxels(depth - 1) if depth > 1 else np.zeros((1, 3), np.int32)
    return pruned(volume, box_bits(volume.levels[-1], blocks, first, last))


def _cells_between(volume: Volume, axis: int, low: float, high: float) -> tuple[int, int]:
    """First and last cell of an axis that meet a closed interval; first > last if none does."""
    size = 4**volume.depth
    side = volume.cube.exact[3]
    ratio = volume.crs.z_ratio if axis == 2 else Fraction(1)

    def place(value: float) -> Fraction | None:
        """Place in the cube from 0 to 1; None if infinite."""
        if math.isinf(value):
            return None
        away = as_fraction(value) * ratio - volume.cube.exact[axis]
        return away / side if side else away

    start, stop = place(low), place(high)
    if (start is not None and start > (1 if side else 0)) or (stop is not None and stop < 0):
        return 0, -1
    if low == math.inf or high == -math.inf:
        return 0, -1
    if volume.info.quantizer == "floor":
        first = 0 if start is None else math.floor(start * size)
        last = size - 1 if stop is None else math.floor(stop * size)
    else:
        steps, half = size - 1, Fraction(1, 2)
        first = 0 if start is None else math.ceil(start * steps - half)
        last = size - 1 if stop is None else math.floor(stop * steps + half)
    if not side:  # one place, cell 0
        return 0, 0
    return max(min(first, size - 1), 0), min(last, size - 1)
