"""OctoMap binary trees for import: the occupied leaves as voxels; free and unknown are left out.

A comment of our own export gives back cube, depth and CRS. In other trees the cube is at the
lowest occupied voxel.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from volatool.errors import FormatError
from volatool.formats.octomap import MAX_CELLS, parse_bt
from volatool.formats.origin import find_origin
from volatool.imports.grid import BYTES_A_CELL, cell_points, voxel_points
from volatool.imports.model import ImportedPoints
from volatool.model import I32, as_fraction
from volatool.options import ConvertOptions


def read(path: Path, options: ConvertOptions) -> ImportedPoints:
    """
    Open a tree.

    Parameters
    ----------
    path : pathlib.Path
        The file; its leaves are held, and its voxels while they are listed.
    options : ConvertOptions
        ``memory``.

    Raises
    ------
    FormatError, TruncatedError, ResourceError
        As for `volatool.formats.octomap.parse_bt`; more voxels than ``memory`` allows.
    """
    tree = parse_bt(path.read_bytes())
    limit = min(MAX_CELLS, options.memory // BYTES_A_CELL)
    origin = find_origin(tree.comments)
    leaves = tree.occupied
    if origin is not None:
        corner = np.array(origin.corner, np.int64)
        if len(leaves):
            low = leaves[:, :3] - corner
            if low.min() < 0 or (low + leaves[:, 3:]).max() > 4**origin.depth:
                raise FormatError("voxels lie outside the cube that its comment names")

        def voxels() -> Iterator[I32]:
            yield (tree.cells(limit) - corner).astype(np.int32)

        return voxel_points("bt", voxels, origin.cube, origin.depth, origin.info.crs)
    low, high = np.zeros(3, np.int64), np.ones(3, np.int64)
    if len(leaves):
        low = leaves[:, :3].min(axis=0).astype(np.int64)
        high = (leaves[:, :3] + leaves[:, 3:]).max(axis=0).astype(np.int64)
    cell = as_fraction(tree.resolution)

    def cells() -> Iterator[I32]:
        yield (tree.cells(limit) - low).astype(np.int32)

    return cell_points(
        "bt", cells, (high - low).tolist(), [int(value) * cell for value in low], cell
    )
