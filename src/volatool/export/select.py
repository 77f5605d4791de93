"""The part of a volume that is exported: a level, a rectangle, a range of heights."""

from __future__ import annotations

from volatool.export.model import ExportOptions
from volatool.vola.volume import Volume
from volatool.vola.window import half_open


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
