"""The part of a volume that is exported: a level, a rectangle, a range of heights."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from volatool.cube import Cube
from volatool.export.model import ExportOptions
from volatool.model import U64, Bool, Bounds
from volatool.vola.volume import Volume


def select(volume: Volume, options: ExportOptions) -> Volume:
    """
    Return what is to be exported.

    Parameters
    ----------
    volume : Volume
        All of it.
    options : ExportOptions
        ``level``, ``bounds`` and ``z``.

    Returns
    -------
    volume : Volume
        At the level, in the same cube; the arrays are shared where nothing is left out.

    Raises
    ------
    OptionError
        There is no such level.
    """
    if options.level is not None and options.level != volume.depth:
        depth = options.level
        volume = half_open(volume).truncated(depth) if depth >= 1 else volume.truncated(depth)
    if options.bounds is not None or options.z is not None:
        volume = crop(volume, options.bounds, z=options.z)
    return volume


def half_open(volume: Volume) -> Volume:
    """
    Return a volume of rounded points as one of half-open cells around them.

    Parameters
    ----------
    volume : Volume
        Of any quantizer.

    Returns
    -------
    volume : Volume
        The same words. The original toolkit rounds to S = 4**depth points a side, side / (S - 1)
        apart: the middles of the cells of a cube of S / (S - 1) times the side, half a step lower.
        Only such a cube can be divided more coarsely.
    """
    if volume.info.quantizer == "floor":
        return volume
    *origin, side = volume.cube.exact
    n_cells = 4**volume.depth
    step = side / (n_cells - 1)
    cube = Cube.from_exact([corner - step / 2 for corner in origin], step * n_cells)
    return Volume(
        volume.levels, volume.metadata_levels, cube, replace(volume.info, quantizer="floor")
    )


def crop(
    volume: Volume, bounds: Bounds | None = None, *, z: tuple[float, float] | None = None
) -> Volume:
    """Return the cells whose box meets a closed box; stands in for `volatool.vola.algebra.crop`."""
    from volatool.kernels.words import child_keys

    cells, edge = volume.voxels(), volume.cell()
    limits = [(-np.inf, np.inf)] * 3
    if bounds is not None:
        limits[:2] = [(bounds.left, bounds.right), (bounds.bottom, bounds.top)]
    if z is not None:
        ratio = float(volume.crs.z_ratio)
        limits[2] = (z[0] * ratio, z[1] * ratio)
    keep: Bool = np.ones(len(cells), np.bool_)
    for axis, (low, high) in enumerate(limits):
        corner = volume.cube.origin[axis] + cells[:, axis] * edge
        keep &= (corner <= high) & (corner + edge >= low)
    levels: list[U64] = []
    metadata: list[U64] = []
    for level in range(volume.depth, 0, -1):
        words = volume.levels[level - 1]
        bits = child_keys(words, np.zeros(len(words), np.uint64), len(keep))
        starts = np.cumsum(np.bitwise_count(words), dtype=np.int64) - np.bitwise_count(words)
        flags = np.where(keep, np.uint64(1) << bits, np.uint64(0))
        words = np.bitwise_or.reduceat(flags, starts) if len(flags) else words
        keep = words != 0
        if level == 1:
            keep[:] = True
        levels.insert(0, words[keep])
        if volume.has_metadata:
            metadata.insert(0, volume.metadata_words(level)[keep])
    return Volume(
        tuple(levels), tuple(metadata) if volume.has_metadata else None, volume.cube, volume.info
    )
