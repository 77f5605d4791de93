"""Voxel centres as LAS 1.4 or LAZ, the metadata of their blocks as the attributes of points."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from volatool.errors import CodedWarning
from volatool.export.cells import CellChunk, Places, cell_chunks, channels_by_name
from volatool.export.model import ExportOptions, Target
from volatool.export.notes import no_crs, unknown_channels
from volatool.vola.volume import Volume

_LIMITS = {"intensity": (0, 65535), "class": (0, 255), "returns": (1, 15)}
_NAMES = {"intensity": "intensity", "class": "classification", "returns": "number_of_returns"}
_COLOURS = ("red", "green", "blue")


def export(volume: Volume, target: Target, options: ExportOptions) -> list[CodedWarning]:
    """
    Write one point a voxel.

    Parameters
    ----------
    volume : Volume
        What is written.
    target : Target
        One file, ``.las`` or ``.laz``.
    options : ExportOptions
        Nothing of it.

    Returns
    -------
    warnings : list of CodedWarning
        ``W_NO_CRS``, ``W_CHANNELS``.

    Notes
    -----
    Stored integers count half voxels from the cube's corner, so that centres are exact: a volume
    of the same cube made of these points has the same voxels. z is in the vertical unit. Intensity,
    class, number of returns and colours are those of the block; the channel of heights is left
    out, z is the centre's. Every point is a first return; times are 0.
    """
    del options
    from volatool.points.crs import las_wkt
    from volatool.points.las_writer import LasWriter

    places, channels = Places.of(volume), channels_by_name(volume)
    wkt = las_wkt(volume.crs)
    # a single place has a step of 0, which a LAS file can't have
    scale = tuple(step / 2 or 0.001 for step in places.step)
    has_colours = all(name in channels for name in _COLOURS)
    with target.stream() as stream:
        writer = LasWriter(
            stream,
            scale,  # type: ignore[arg-type]
            places.origin,
            has_colours=has_colours,
            is_compressed=target.suffix.endswith(".laz"),
            wkt=wkt,
        )
        for chunk in cell_chunks(volume):
            stored = chunk.cells.astype(np.int64) * 2 + int(places.first * 2)
            if not places.step[0]:
                stored[:] = 0
            writer.write(stored, **_attributes(chunk, channels, has_colours))
        writer.finish()
    return no_crs(volume, wkt) + unknown_channels(volume)


def _attributes(
    chunk: CellChunk, channels: Mapping[str, Mapping[str, Any]], has_colours: bool
) -> dict[str, Any]:
    """Return the attributes of a piece, rounded and kept to what their fields hold."""
    attributes: dict[str, Any] = {}
    for name, (low, high) in _LIMITS.items():
        if name in channels:
            values = np.rint(chunk.channel(channels[name]))
            attributes[_NAMES[name]] = np.clip(values, low, high)
    for name in _COLOURS if has_colours else ():
        attributes[name] = np.clip(np.rint(chunk.channel(channels[name])), 0, 65535)
    return attributes
