"""A surface of chance-free hills as voxels of any depth: what Table 1 is measured on."""

from __future__ import annotations

import numpy as np

from volatool.cube import Cube
from volatool.errors import OptionError
from volatool.model import F64, I32, U64
from volatool.vola.fold import words_of_levels
from volatool.vola.info import VolumeInfo
from volatool.vola.volume import Volume

DEEPEST = 8
"""Levels of the deepest volume."""

SIDE = 100.0
"""Metres a side: a tile of the paper's."""

_GOLDEN = 0.7548776662466927, 0.5698402909980532
"""Steps of the R2 sequence, which covers a square evenly without chance."""


def surface_places(n_points: int) -> F64:
    """
    Return points spread evenly over hills and roofs.

    Parameters
    ----------
    n_points : int
        Points.

    Returns
    -------
    places : (n_points, 3) array of float64
        x, y, z from 0 to 1, in parts of the cube's side.
    """
    number = np.arange(n_points, dtype=np.float64)
    x, y = (np.mod(0.5 + step * number, 1.0) for step in _GOLDEN)
    hills = 0.25 + 0.06 * np.sin(9.0 * x + 2.0 * y) + 0.05 * np.sin(13.0 * y - 4.0 * x)
    roofs = 0.12 * (np.sin(31.0 * x) > 0.6) * (np.sin(37.0 * y) > 0.5)
    return np.column_stack([x, y, hills + roofs])


def floor_cells(places: F64, depth: int) -> I32:
    """Return the cell of each place, 0 to ``4**depth - 1`` on each axis."""
    size = 4**depth
    cells: I32 = np.minimum((places * size).astype(np.int32), size - 1)
    return cells


def surface(n_points: int) -> Volume:
    """
    Return the points of `surface_places` as a volume of depth 8; less deep ones by `truncated`.

    Parameters
    ----------
    n_points : int
        At least 1.
    """
    if n_points < 1:
        raise OptionError(f"a surface needs at least one point, got {n_points}")
    return volume_of_cells(floor_cells(surface_places(n_points), DEEPEST), DEEPEST)


def volume_of_cells(cells: I32, depth: int) -> Volume:
    """
    Return cells as a volume in a cube of 100 m.

    Parameters
    ----------
    cells : (n, 3) array of int32
        x, y, z, in any order, repeats allowed.
    depth : int
        Level of the cells.
    """
    from volatool.kernels.quantize import cell_keys

    keys: U64 = np.unique(cell_keys(cells))
    words = words_of_levels(keys, depth)
    info = VolumeInfo(n_points=len(cells), source_name="surface")
    return Volume(words, None, Cube((0.0, 0.0, 0.0), SIDE), info)
