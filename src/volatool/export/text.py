"""
Voxel centres as text: ``.xyz`` of ``x y z`` or ``x y z r g b``, ``.csv`` with a header row.

====== =========================================================================================
xyz    blanks between; colours as the bytes 0 to 255 of the block's metadata, where they are known
csv    ``x,y,z``, then a column for each metadata channel by its name, decoded; channels whose
       meaning is not known are ``byte0`` to ``byte7``, as they are
====== =========================================================================================

Numbers have as many decimals as keep a centre within a thousandth of a cell, all the same, so that
the voxels come back from the text. z is in the vertical unit.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from volatool.errors import CodedWarning
from volatool.export.cells import CellChunk, Places, cell_chunks, channels_by_name
from volatool.export.model import ExportOptions, Target
from volatool.export.notes import no_crs, unknown_channels
from volatool.vola.volume import Volume

_COLOURS = ("red", "green", "blue")
Column: TypeAlias = Callable[[CellChunk], NDArray[np.bytes_]]


def export(volume: Volume, target: Target, options: ExportOptions) -> list[CodedWarning]:
    """
    Write one line a voxel, in VOLA order.

    Parameters
    ----------
    volume : Volume
        What is written.
    target : Target
        One file, ``.xyz`` or ``.csv``.
    options : ExportOptions
        Nothing of it.

    Returns
    -------
    warnings : list of CodedWarning
        ``W_NO_CRS`` always: text has no place for one. ``W_CHANNELS`` (xyz).
    """
    del options
    is_csv = target.suffix == ".csv"
    columns = _columns(volume, is_csv)
    head = ",".join(name for name, _ in columns) + "\n" if is_csv else ""
    with target.stream() as stream:
        stream.write(head.encode())
        for chunk in cell_chunks(volume):
            texts = [column(chunk) for _, column in columns]
            stream.write(_lines(texts, b"," if is_csv else b" "))
    warnings = [] if is_csv else unknown_channels(volume)
    if volume.crs.horizontal is None:
        return no_crs(volume, None) + warnings
    name = "+".join(part for part in (volume.crs.horizontal, volume.crs.vertical) if part)
    return [
        CodedWarning("W_NO_CRS", f"text carries no CRS; the coordinates are in {name}"),
        *warnings,
    ]


def _columns(volume: Volume, is_csv: bool) -> list[tuple[str, Column]]:
    """Return name and content of each column."""
    places, channels = Places.of(volume), channels_by_name(volume)
    columns: list[tuple[str, Column]] = [
        (name, _coordinate(places, axis)) for axis, name in enumerate("xyz")
    ]
    if not is_csv:
        if all(name in channels for name in _COLOURS):
            columns += [(name, _byte(int(channels[name]["byte"]))) for name in _COLOURS]
    elif volume.has_metadata and not volume.info.channels:
        columns += [(f"byte{byte}", _byte(byte)) for byte in range(8)]
    else:
        columns += [(name, _channel(channel)) for name, channel in channels.items()]
    return columns


def _coordinate(places: Places, axis: int) -> Column:
    """Return the column of an axis: each cell's text is made once a piece."""
    step, origin = places.step[axis], places.origin[axis]
    # the original toolkit's points may lie on the very border of a half-open cell
    decimals = None if places.first == 0 else decimals_for(step)

    def column(chunk: CellChunk) -> NDArray[np.bytes_]:
        cells, which = np.unique(chunk.cells[:, axis], return_inverse=True)
        values = ((cells + places.first) * step + origin).tolist()
        texts = [repr(value) if decimals is None else f"{value:.{decimals}f}" for value in values]
        return np.array(texts, np.bytes_)[which]

    return column


def decimals_for(step: float) -> int:
    """
    Return the decimals that keep a number within a thousandth of a step.

    Examples
    --------
    >>> decimals_for(0.5), decimals_for(30.0), decimals_for(0.0)
    (3, 2, 3)
    """
    if not step:
        return 3
    return min(max(math.ceil(-math.log10(step / 500)), 0), 17)


def _byte(byte: int) -> Column:
    return _table(byte, [str(value) for value in range(256)])


def _channel(channel: Mapping[str, Any]) -> Column:
    scale, offset = float(channel["scale"]), float(channel["offset"])
    texts = [f"{value * scale + offset:.10g}" for value in range(256)]
    return _table(int(channel["byte"]), texts)


def _table(byte: int, texts: Sequence[str]) -> Column:
    """Return the column of a metadata byte, whose 256 values are told."""
    table = np.array(texts, np.bytes_)

    def column(chunk: CellChunk) -> NDArray[np.bytes_]:
        assert chunk.words is not None
        return table[((chunk.words >> np.uint64(8 * byte)) & np.uint64(255)).astype(np.intp)]

    return column


def _lines(texts: Sequence[NDArray[np.bytes_]], separator: bytes) -> bytes:
    """Join columns to lines."""
    line = texts[0]
    for text in texts[1:]:
        line = np.strings.add(np.strings.add(line, separator), text)
    return b"\n".join(line.tolist()) + b"\n"
