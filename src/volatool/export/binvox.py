"""Volumes as binvox grids."""

from __future__ import annotations

import numpy as np

from volatool.errors import CodedWarning, ResourceError
from volatool.export.model import ExportOptions, Target
from volatool.export.placing import not_kept, shifted, with_extent
from volatool.formats.binvox import MAX_SIDE, encode_binvox
from volatool.model import I32
from volatool.vola.volume import Volume
from volatool.vola.window import half_open


def export(volume: Volume, target: Target, options: ExportOptions) -> list[CodedWarning]:
    """
    Write a ``.binvox``: the whole cube, or a cubic window of it.

    Parameters
    ----------
    volume : Volume
        What is written.
    target : Target
        One file.
    options : ExportOptions
        ``bounds``, ``z``: the window is the smallest one that holds the voxels, as it is when the
        cube has more than `MAX_SIDE` cells a side. ``local``: the corner of the cube is 0.
        ``limit``: bytes.

    Returns
    -------
    warnings : list of CodedWarning
        ``W_SHIFTED``, or ``W_NO_CRS`` and ``W_Z_UNIT``.

    Raises
    ------
    ResourceError
        ``E_SIZE``: more than `MAX_SIDE` cells a side, or more bytes than the limit.

    Notes
    -----
    The window is cubic because readers don't agree on the scale of other grids.
    """
    volume = half_open(volume)
    cube = with_extent(volume, "binvox")
    cells = volume.voxels()
    is_part = options.bounds is not None or options.z is not None
    low, side = _window(cells, 4**volume.depth, is_part)
    _refuse(side, 2 * side**3 // 255, options.limit)
    cells -= low
    cell = cube.exact[3] / 4**volume.depth
    corner = [int(low[axis]) * cell for axis in range(3)]
    if not options.local:
        corner = [corner[axis] + cube.exact[axis] for axis in range(3)]
    data = encode_binvox(cells, side, [float(value) for value in corner], float(cell * side))
    _refuse(side, len(data), options.limit)
    with target.stream() as stream:
        stream.write(data)
    return [shifted(volume, (0, 0, 0))] if options.local else not_kept(volume, "binvox")


def _window(cells: I32, n_cells: int, is_part: bool) -> tuple[I32, int]:
    """Return the first cell and the cells a side of what is written."""
    if n_cells <= MAX_SIDE and not is_part:
        return np.zeros(3, np.int32), n_cells
    low, high = cells.min(axis=0), cells.max(axis=0)
    side = int((high - low).max()) + 1
    return np.minimum(low, n_cells - side), side  # inside the cube


def _refuse(side: int, n_bytes: int, limit: int | None) -> None:
    if side > MAX_SIDE:
        raise ResourceError(
            f"the voxels lie in a window of {side} cells a side, binvox has at most {MAX_SIDE}; "
            "give a coarser --level, or --bounds and --z",
            "E_SIZE",
        )
    if limit is not None and n_bytes > limit:
        raise ResourceError(
            f"the grid takes {n_bytes} bytes or more, --limit is {limit}; give a coarser --level, "
            "or --bounds and --z",
            "E_SIZE",
        )
