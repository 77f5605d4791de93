"""The part of a volume that is exported: a level, a rectangle, a range of heights."""

from __future__ import annotations

from dataclasses import replace

from volatool.cube import Cube
from volatool.export.model import ExportOptions
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
        from volatool.vola.algebra import crop

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
