"""Volumes of neighbouring cubes in one cube that holds them all, exactly where that can be."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np

from volatool.cube import MAX_DEPTH, Cube
from volatool.errors import CodedWarning, InputError, OptionError, ResourceError
from volatool.model import U64
from volatool.vola.grid import (
    SLACK,
    check_crs,
    check_grid,
    describe_grid,
    is_rounded,
    same_cube,
)
from volatool.vola.prune import cells_range
from volatool.vola.regrid import as_cells, regridded
from volatool.vola.volume import Volume

Index = tuple[int, int, int]


@dataclass(frozen=True, slots=True)
class CommonGrid:
    """
    Volumes brought to one grid.

    Parameters
    ----------
    volumes : tuple of Volume
        In one cube, of one depth.
    n_lost : int
        Voxels that lie outside that cube.
    is_resampled : bool
        Whether cells of some of them are not those of the file.
    warnings : tuple of CodedWarning
        ``W_DEPTH``, ``W_OUTSIDE_CUBE``.
    """

    volumes: tuple[Volume, ...]
    n_lost: int = 0
    is_resampled: bool = False
    warnings: tuple[CodedWarning, ...] = ()


def common_grid(
    volumes: Sequence[Volume],
    *,
    cube: Cube | None = None,
    depth: int | None = None,
    resample: bool = False,
) -> CommonGrid:
    """
    Bring volumes to one grid.

    Parameters
    ----------
    volumes : sequence of Volume
        At least one, in the same reference system.
    cube, depth : Cube and int, optional
        The grid, both or none. By default that of the volumes if they have one cube. Cubes of one
        side whose corners are whole sides apart (``--snap``, ``--split``) go, cell by cell as they
        are, into the smallest cube of 4, 16, ... sides that holds them: with its corner on
        multiples of its own side if all of theirs are and that one is not larger, else with the
        smallest of their corners.
    resample : bool
        Volumes that don't fit so are brought to the grid cell by cell (`vola.regrid`). Without
        `cube` it continues the cells of the first volume as far as all voxels reach.

    Returns
    -------
    grid : CommonGrid
        Of the smallest of their depths where cells are kept.

    Raises
    ------
    InputError
        ``E_GRID``: they don't fit, and are not to be resampled.
    CRSError
        ``E_CRS``: in different reference systems.
    ResourceError
        ``E_SIZE``: deeper than 10 levels.
    """
    if not volumes:
        raise OptionError("there is no volume to bring to a grid")
    for other in volumes[1:]:
        check_crs(volumes[0], other)
    if cube is not None and depth is not None:
        return _on_given(volumes, cube, depth, resample)
    if all(same_cube(volumes[0], other) for other in volumes[1:]):
        if not resample:
            for other in volumes[1:]:
                check_grid(volumes[0], other)
        elif len({volume.depth for volume in volumes}) > 1:
            volumes = [as_cells(volume) for volume in volumes]
        return _of_one_depth(volumes)
    side = volumes[0].cube.exact[3]
    indices = _lattice(volumes, volumes[0].cube)
    if indices is not None:
        low, size, is_snapped = _enclosing(indices, volumes)
        corner = [volumes[0].cube.exact[axis] + low[axis] * side for axis in range(3)]
        outer = Cube.from_exact(corner, side * 4**size, is_snapped)
        moved = [_minus(index, low) for index in indices]
        even = _of_one_depth(volumes)
        lifted = tuple(
            lift(volume, outer, size, index)
            for volume, index in zip(even.volumes, moved, strict=True)
        )
        return replace(even, volumes=lifted)
    if not resample:
        first = volumes[0]
        other = next(v for v in volumes[1:] if _lattice([first, v], first.cube) is None)
        raise InputError(
            f"the volumes are not on one grid, nor in cubes of one side that lie whole sides "
            f"apart: {describe_grid(first)}, and {describe_grid(other)}; convert them with "
            "--cube-from, --split or --snap --cube, or resample (--resample)",
            "E_GRID",
        )
    outer, levels = _continued(volumes)
    return _on_given(volumes, outer, levels, resample=True)


def _of_one_depth(volumes: Sequence[Volume]) -> CommonGrid:
    depths = sorted({volume.depth for volume in volumes})
    warnings: tuple[CodedWarning, ...] = ()
    if len(depths) > 1:
        warnings = (
            CodedWarning(
                "W_DEPTH",
                f"the volumes have {depths[0]} to {depths[-1]} levels; {depths[0]} are used",
                sum(volume.depth > depths[0] for volume in volumes),
            ),
        )
    return CommonGrid(tuple(one.truncated(depths[0]) for one in volumes), warnings=warnings)


def _on_given(volumes: Sequence[Volume], cube: Cube, depth: int, resample: bool) -> CommonGrid:
    """Bring volumes to a given grid: as they are, lifted, or resampled."""
    placed: list[Volume] = []
    n_lost, is_resampled = 0, False
    for volume in volumes:
        fitted = _fitted(volume, cube, depth)
        if fitted is None and not resample:
            raise InputError(
                f"the volume is not on the grid that was asked for (side {cube.side:.12g} at "
                f"{', '.join(f'{value:.12g}' for value in cube.origin)}, {depth} levels) but on "
                f"{describe_grid(volume)}, {volume.depth} levels; resample (--resample)",
                "E_GRID",
            )
        if fitted is None:
            fitted, lost = regridded(volume, cube, depth)
            n_lost += lost
            is_resampled = True
        placed.append(fitted)
    warnings: tuple[CodedWarning, ...] = ()
    if n_lost:
        text = f"{n_lost} voxels lie outside the cube of the result and are left out"
        warnings = (CodedWarning("W_OUTSIDE_CUBE", text, n_lost),)
    return CommonGrid(tuple(placed), n_lost, is_resampled, warnings)


def _fitted(volume: Volume, cube: Cube, depth: int) -> Volume | None:
    """Return a volume in a cube and depth with its own cells, None if they are others."""
    if is_rounded(volume):
        return None
    side, outer = volume.cube.exact[3], cube.exact[3]
    if not side or not outer:
        return None
    size = round(math.log(outer / side, 4))
    if size < 0 or volume.depth + size < depth:
        return None
    index = _index(volume, cube, side)
    slack = SLACK * volume.cell()
    if index is None or abs(outer - side * 4**size) > slack:
        return None
    if not all(0 <= number < 4**size for number in index):
        return None
    return lift(volume.truncated(depth - size), cube, size, index) if depth > size else None


def _lattice(volumes: Sequence[Volume], cube: Cube) -> list[Index] | None:
    """How many sides each cube is from the first, on each axis; None if not whole ones."""
    side = cube.exact[3]
    indices = []
    for volume in volumes:
        slack = SLACK * volume.cell()
        if is_rounded(volume) or not side or abs(volume.cube.exact[3] - side) > slack:
            return None
        index = _index(volume, cube, side)
        if index is None:
            return None
        indices.append(index)
    return indices


def _index(volume: Volume, cube: Cube, side: Fraction) -> Index | None:
    found = []
    for own, other in zip(volume.cube.exact[:3], cube.exact[:3], strict=True):
        number = round((own - other) / side)
        if abs(own - other - number * side) > SLACK * volume.cell():
            return None
        found.append(number)
    return found[0], found[1], found[2]


def _minus(index: Index, low: Sequence[int]) -> Index:
    return index[0] - low[0], index[1] - low[1], index[2] - low[2]


def _enclosing(indices: Sequence[Index], volumes: Sequence[Volume]) -> tuple[list[int], int, bool]:
    """Corner and size (sides are 4**size) of the smallest cube around, and if it is snapped."""
    low = [min(index[axis] for index in indices) for axis in range(3)]
    high = [max(index[axis] for index in indices) for axis in range(3)]
    size = 0
    while 4**size < max(h - lo + 1 for h, lo in zip(high, low, strict=True)):
        size += 1
    side = volumes[0].cube.exact[3]
    numbers = [corner / side for corner in volumes[0].cube.exact[:3]]
    if all(number.denominator == 1 for number in numbers):
        edge = 4**size
        starts = [int(n) + lo for n, lo in zip(numbers, low, strict=True)]
        snapped = [start // edge * edge for start in starts]
        reach = [h - lo for h, lo in zip(high, low, strict=True)]
        if all(
            start + r < corner + edge
            for start, r, corner in zip(starts, reach, snapped, strict=True)
        ):
            shifted = [corner - int(n) for corner, n in zip(snapped, numbers, strict=True)]
            return shifted, size, True
    return low, size, False


def lift(volume: Volume, cube: Cube, size: int, index: Index) -> Volume:
    """
    Return a volume as one cell of a larger cube.

    Parameters
    ----------
    volume : Volume
        Of half-open cells.
    cube : Cube
        Its side is ``4**size`` times the volume's.
    size : int
        Levels that come on top.
    index : tuple of 3 int
        Which cell of level `size` of `cube` the volume is: x, y, z.

    Returns
    -------
    volume : Volume
        The same voxels, `size` levels deeper; each block above the old root has the metadata word
        of the root.

    Raises
    ------
    ResourceError
        ``E_SIZE``: deeper than 10 levels.
    """
    if volume.depth + size > MAX_DEPTH:
        raise ResourceError(
            f"a cube of side {cube.side:.12g} around the volumes needs {volume.depth + size} "
            f"levels for their cells, at most {MAX_DEPTH} are made; merge fewer of them, or less "
            "deep ones",
            "E_SIZE",
        )
    above: list[U64] = []
    for level in range(size):
        shift = 2 * (size - 1 - level)
        x, y, z = (number >> shift & 3 for number in index)
        above.append(np.array([1 << x + 4 * y + 16 * z], np.uint64))
    metadata = volume.metadata_levels
    if not len(volume):  # an empty cell is not set
        nothing = np.empty(0, np.uint64)
        levels = [np.zeros(1, np.uint64), *[nothing] * (volume.depth + size - 1)]
        words = None if metadata is None else (metadata[0], *[nothing] * (len(levels) - 1))
        return Volume(tuple(levels), words, cube, volume.info)
    if metadata is not None:
        metadata = (*[metadata[0]] * size, *metadata)
    return Volume((*above, *volume.levels), metadata, cube, volume.info)


def _continued(volumes: Sequence[Volume]) -> tuple[Cube, int]:
    """Return the cells of the first volume continued as far as all voxels reach."""
    first = volumes[0]
    side, corner = first.cube.exact[3], first.cube.exact[:3]
    if not side:
        raise InputError(
            "the first volume is a single place, whose cells can't be continued; name another "
            "one first, or give the grid by --cube-from",
            "E_GRID",
        )
    cell = side / 4**first.depth
    lows, highs = [], []
    for volume in volumes:
        if not len(volume):
            continue
        start, stop = cells_range(volume)
        step = volume.cube.exact[3] / (4**volume.depth - is_rounded(volume))
        origin = volume.cube.exact[:3]
        lows.append([origin[axis] + step * start[axis] for axis in range(3)])
        reach = [number + (not is_rounded(volume)) for number in stop]
        highs.append([origin[axis] + step * reach[axis] for axis in range(3)])
    if not lows:
        return first.cube, first.depth
    away_low = [min(row[axis] for row in lows) - corner[axis] for axis in range(3)]
    away_high = [max(row[axis] for row in highs) - corner[axis] for axis in range(3)]
    low = [math.floor(away / cell) for away in away_low]
    high = [math.ceil(away / cell) for away in away_high]
    depth = first.depth
    while 4**depth < max(h - lo for h, lo in zip(high, low, strict=True)):
        depth += 1
    if depth > MAX_DEPTH:
        raise ResourceError(
            f"cells of {float(cell):g} around all volumes need {depth} levels, at most {MAX_DEPTH} "
            "are made; give a coarser grid by --cube-from",
            "E_SIZE",
        )
    if all(lo >= 0 and h <= 4**first.depth for h, lo in zip(high, low, strict=True)):
        return first.cube, first.depth
    begin = [corner[axis] + low[axis] * cell for axis in range(3)]
    return Cube.from_exact(begin, cell * 4**depth), depth
