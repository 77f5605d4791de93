"""Imported files as the original toolkit converts them; see `volatool.vola.toolkit`."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from volatool.errors import InputError
from volatool.imports.model import ImportedPoints
from volatool.model import F64, I64, U64
from volatool.vola.toolkit import Box, ToolkitBuilder, ToolkitVolume


def build(
    points: ImportedPoints,
    depth: int,
    *,
    with_metadata: bool = True,
    swap_yz: bool = False,
    epsg: int | None = None,
    lat: float = 0.0,
    lon: float = 0.0,
) -> ToolkitVolume:
    """
    Return what the toolkit would write for a file.

    Parameters
    ----------
    points : ImportedPoints
        The file.
    depth : int
        Number of levels.
    with_metadata : bool
        Give each block its metadata word, if the toolkit takes any from this format.
    swap_yz : bool
        As the toolkit's ``-z``: it swaps the points and not their box, and so does this.
    epsg, lat, lon
        For the header.

    Returns
    -------
    volume : ToolkitVolume
        To be written by `volatool.formats.toolkit`.

    Raises
    ------
    InputError
        ``E_TOOLKIT``: there is no such conversion, no point, or the toolkit stops at a value.
    """
    taken = points.toolkit
    if taken is None:
        raise InputError(
            f"the toolkit reads no {points.format} files, or not in a way that can be repeated; "
            "leave out --compat toolkit",
            "E_TOOLKIT",
        )
    has_words = with_metadata and taken.n_channels > 0
    box = taken.box if taken.box is not None else _box(taken.batches(False))
    builder = ToolkitBuilder(depth, box, with_metadata=has_words, epsg=epsg, lat=lat, lon=lon)
    for xyz, words in taken.batches(has_words):
        builder.add_points(xyz[:, [0, 2, 1]] if swap_yz else xyz, words)
    return builder.finish()


def _box(batches: Iterator[tuple[F64, U64 | None]]) -> Box:
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for xyz, _ in batches:
        if len(xyz):
            low, high = np.minimum(low, xyz.min(axis=0)), np.maximum(high, xyz.max(axis=0))
    if not np.isfinite([low, high]).all():
        raise InputError(
            "there are no points, or some that are not finite, for which the toolkit writes no "
            "file",
            "E_TOOLKIT",
        )
    x0, y0, z0 = low.tolist()
    x1, y1, z1 = high.tolist()
    return x0, y0, z0, x1, y1, z1


def words_of(channels: I64) -> U64:
    """
    Return the metadata words of channels, as the toolkit adds them.

    Parameters
    ----------
    channels : (n, k) array of int64
        At most 8 columns. The toolkit adds ``value << 8 k`` as signed numbers: a negative one
        fills all channels above it.
    """
    shifted = channels << (8 * np.arange(channels.shape[1], dtype=np.int64))
    words: U64 = shifted.sum(axis=1).view(np.uint64)
    return words
