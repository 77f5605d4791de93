"""A volume on another grid of voxels."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np

from volatool.cube import MAX_DEPTH, Cube
from volatool.errors import OptionError, ResourceError
from volatool.model import I32, I64
from volatool.vola.build import from_keys
from volatool.vola.grid import is_rounded
from volatool.vola.prune import cells_box
from volatool.vola.volume import Volume

MAX_CELLS = 1 << 27
"""Cells that the voxels of a source may be split into: 16 bytes each, and as many to sort them."""

_PIECE = 1 << 18


def as_cells(volume: Volume) -> Volume:
    """
    Return a volume of the original toolkit as one of half-open cells.

    Parameters
    ----------
    volume : Volume
        Its voxel k of S stands for the place ``k / (S - 1)`` of the side.

    Returns
    -------
    volume : Volume
        The same voxels: that place lies in cell k. Volumes of cells are returned as they are.
    """
    if not is_rounded(volume):
        return volume
    return replace(volume, info=replace(volume.info, quantizer="floor"))


def regrid(volume: Volume, cube: Cube, depth: int) -> Volume:
    """
    Return a volume on another grid.

    Parameters
    ----------
    volume : Volume
        The source.
    cube : Cube
        Of the target, in the CRS of the source.
    depth : int
        Of the target, 1 to 10.

    Returns
    -------
    volume : Volume
        As `regridded`.
    """
    return regridded(volume, cube, depth)[0]


def regridded(volume: Volume, cube: Cube, depth: int) -> tuple[Volume, int]:
    """
    Bring a volume to another grid, and count what lies outside.

    Parameters
    ----------
    volume, cube, depth
        As `regrid`.

    Returns
    -------
    volume : Volume
        When its cells are not smaller than the source's voxels: those that hold the middle of a
        voxel (half-open, the last one of the cube closed). When they are smaller: all whose inside
        meets that of a voxel, so that no occupied place is lost. Both worked out on exact
        rationals, and both exact where the grids are aligned: coarser cells are those of
        `Volume.truncated`, finer ones fill the voxels. A voxel of the original toolkit is the
        place that it rounded to. The metadata word of a block is the mean of those of the voxels
        that set its cells, byte 7 is 1.
    n_lost : int
        Voxels of the source that set no cell: they lie outside the cube.

    Raises
    ------
    ResourceError
        ``E_SIZE``: source or target deeper than 10 levels, or more than 2**27 cells.
    OptionError
        ``E_GRID``: the cube is a single place.
    """
    for levels in (depth, volume.depth):
        if not 1 <= levels <= MAX_DEPTH:
            raise ResourceError(f"a grid has 1 to {MAX_DEPTH} levels, got {levels}", "E_SIZE")
    axes = [_axis(volume, cube, depth, axis) for axis in range(3)]
    voxels = volume.voxels()
    metadata = volume.metadata() if volume.has_metadata else None
    n_each = _sizes(voxels, axes)
    total = int(n_each.sum())
    if total > MAX_CELLS:
        raise ResourceError(
            f"the voxels would be split into {total} cells, at most {MAX_CELLS} are made; give a "
            "smaller depth",
            "E_SIZE",
        )
    from volatool.kernels.quantize import cell_keys

    keys, words = np.empty(total, np.uint64), np.empty(0 if metadata is None else total, np.uint64)
    n_lost, place = int(np.count_nonzero(n_each == 0)), 0
    for piece in _pieces(n_each):  # the work arrays of a piece are small, the keys are not
        cells, rows = _cells(voxels[piece], axes, n_each[piece])
        keys[place : place + len(cells)] = cell_keys(cells)
        if metadata is not None:
            words[place : place + len(cells)] = metadata[piece][rows]
        place += len(cells)
    info = replace(
        volume.info,
        quantizer="floor",
        n_points=None if n_lost else volume.info.n_points,
        warnings=(),
    )
    result = from_keys(keys, depth, cube, info, None if metadata is None else words)
    if n_lost:
        result = replace(result, info=replace(result.info, box=cells_box(result)))
    return result, n_lost


@dataclass(frozen=True, slots=True)
class _Axis:
    """First and last target cell of each source cell of an axis; last < first outside."""

    first: I64
    last: I64


def _axis(volume: Volume, cube: Cube, depth: int, axis: int) -> _Axis:
    n_source, n_target = 4**volume.depth, 4**depth
    side, target_side = volume.cube.exact[3], cube.exact[3]
    shift = volume.cube.exact[axis] - cube.exact[axis]
    if not target_side:
        raise OptionError("a grid needs a cube with a side greater than 0", "E_GRID")
    scale = n_target / target_side
    numbers = range(n_source)
    if is_rounded(volume):
        step = side / (n_source - 1)
        return _points(numbers, step * scale, shift * scale, n_target)
    step = side / n_source
    if step * scale <= 1:
        return _points(numbers, step * scale, (shift + step / 2) * scale, n_target)
    return _boxes(numbers, step * scale, shift * scale, n_target)


def _points(numbers: Sequence[int], slope: Fraction, start: Fraction, n_cells: int) -> _Axis:
    """Cell of the place ``slope * number + start``."""
    place = _floor(numbers, slope, start)
    at_end = [] if not slope else _whole_number((n_cells - start) / slope, len(numbers))
    if not slope and start == n_cells:
        at_end = list(range(len(numbers)))
    place[at_end] = n_cells - 1  # the far face of the cube is closed
    outside = (place < 0) | (place >= n_cells)
    last = np.where(outside, -1, place)
    return _Axis(np.where(outside, 0, place), last)


def _whole_number(value: Fraction, limit: int) -> list[int]:
    return [int(value)] if value.denominator == 1 and 0 <= value < limit else []


def _boxes(numbers: Sequence[int], slope: Fraction, start: Fraction, n_cells: int) -> _Axis:
    """Cells whose inside meets that of the cell from ``slope * number + start`` on."""
    first = _floor(numbers, slope, start)
    # the last one begins before the end of the cell: ceil(end) - 1 = -floor(-end) - 1
    last = -_floor(numbers, -slope, -(start + slope)) - 1
    return _Axis(np.maximum(first, 0), np.minimum(last, n_cells - 1))


def _floor(numbers: Sequence[int], slope: Fraction, start: Fraction) -> I64:
    """``floor(slope * number + start)``, exactly, within int64."""
    denominator = math.lcm(slope.denominator, start.denominator)
    factor, shift = int(slope * denominator), int(start * denominator)
    largest = max(abs(factor) * len(numbers) + abs(shift), denominator)
    if largest < 2**62:
        return (np.arange(len(numbers), dtype=np.int64) * factor + shift) // denominator
    bound = 2**40
    return np.array(
        [min(max((k * factor + shift) // denominator, -bound), bound) for k in numbers], np.int64
    )


def _sizes(voxels: I32, axes: list[_Axis]) -> I64:
    """How many target cells each voxel sets."""
    sizes = np.ones(len(voxels), np.int64)
    for i, axis in enumerate(axes):
        spans = np.maximum(axis.last - axis.first + 1, 0)
        sizes *= spans[voxels[:, i]]
    return sizes


def _pieces(n_each: I64) -> Iterator[slice]:
    """Cut the voxels into runs of about as many cells each."""
    ends = np.cumsum(n_each)
    start = 0
    while start < len(n_each):
        before = ends[start - 1] if start else 0
        stop = int(np.searchsorted(ends, before + _PIECE, side="right"))
        stop = min(max(stop, start + 1), start + _PIECE)
        yield slice(start, stop)
        start = stop


def _cells(voxels: I32, axes: list[_Axis], n_each: I64) -> tuple[I32, I64]:
    """Target cells of voxels, and the voxel of each."""
    rows = np.repeat(np.arange(len(voxels)), n_each)
    number = np.arange(len(rows)) - np.repeat(np.cumsum(n_each) - n_each, n_each)
    cells = np.empty((len(rows), 3), np.int32)
    for i, axis in enumerate(axes):
        own = voxels[rows, i]
        first = axis.first[own]
        span = axis.last[own] - first + 1
        cells[:, i] = first + number % span
        number //= span
    return cells, rows
