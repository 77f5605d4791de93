"""
Pictures of a volume from above, north up, placed for GIS by a world file.

A pixel is a cell, empty cells are transparent; cells have the colours of their block's metadata if
they are known. Without colours layers are ink, and the view from the top shows heights.

=================== ===========================================================================
``--slices all``    ``STEM.z0012.png``: one layer of cells; 12 is its z from the cube's corner
``--slices top``    ``STEM.top.png``: the topmost cell of each column
beside each         ``.pgw``, the world file, and ``.png.aux.xml`` with the CRS and, of a layer, the
                    heights of its floor and ceiling (``z_low``, ``z_high``, vertical unit)
=================== ===========================================================================

All layers have the extent of the voxels; layers without a voxel are not written.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any
from xml.sax.saxutils import escape, quoteattr

import numpy as np
from numpy.typing import NDArray

from volatool.errors import CodedWarning, ResourceError
from volatool.export.cells import CellChunk, cell_chunks, channels_by_name
from volatool.export.model import ExportOptions, Target
from volatool.export.notes import no_crs
from volatool.export.placing import with_extent
from volatool.model import I32, I64, U64, Bounds
from volatool.units import format_size
from volatool.vola.volume import Volume
from volatool.vola.window import half_open

LIMIT_BYTES = 1 << 30
"""Of all pictures before compression, 4 bytes a pixel, unless ``--limit`` says otherwise."""

MOST_LAYERS, MOST_AT_ONCE = 4096, 256
"""Layers that are written; layers at the level that is chosen when none is asked for."""

_LONGEST_SIDE = 32768
_COLOURS = ("red", "green", "blue")


@dataclass(frozen=True, slots=True)
class Frame:
    """
    The part of the grid that pictures show.

    Parameters
    ----------
    volume : Volume
        With half-open cells.
    low, high : tuple of 3 int
        Lowest and highest cell of the voxels: x, y, z.
    layers : (n,) array of int64
        z of the layers that hold a voxel, ascending.
    """

    volume: Volume
    low: tuple[int, int, int]
    high: tuple[int, int, int]
    layers: I64

    @classmethod
    def of(cls, volume: Volume) -> Frame:
        """Return the extent of a volume's voxels."""
        low, high = np.full(3, 4**volume.depth), np.full(3, -1)
        seen = np.zeros(4**volume.depth, np.bool_)
        for chunk in cell_chunks(volume):
            low = np.minimum(low, chunk.cells.min(axis=0))
            high = np.maximum(high, chunk.cells.max(axis=0))
            seen[chunk.cells[:, 2]] = True
        x0, y0, z0 = map(int, low)
        x1, y1, z1 = map(int, high)
        return cls(volume, (x0, y0, z0), (x1, y1, z1), np.flatnonzero(seen))

    @property
    def width(self) -> int:
        """Pixels from west to east."""
        return self.high[0] - self.low[0] + 1

    @property
    def height(self) -> int:
        """Pixels from north to south."""
        return self.high[1] - self.low[1] + 1

    def size_bytes(self, n_pictures: int) -> int:
        """Bytes of so many pictures before compression."""
        return 4 * self.width * self.height * n_pictures

    def is_sane(self, n_pictures: int, limit: int) -> bool:
        """Tell whether that is no more than a user can want."""
        return (
            n_pictures <= MOST_LAYERS
            and max(self.width, self.height) <= _LONGEST_SIDE
            and self.size_bytes(n_pictures) <= limit
        )

    def bounds(self) -> Bounds:
        """Return the extent in units of the CRS."""
        x, y, _ = self.volume.cube.origin
        cell = self.volume.cell()
        return Bounds(
            x + self.low[0] * cell,
            y + self.low[1] * cell,
            x + (self.high[0] + 1) * cell,
            y + (self.high[1] + 1) * cell,
        )

    def heights(self, layer: int) -> tuple[float, float]:
        """Return floor and ceiling of a layer in the vertical unit."""
        z, cell = self.volume.cube.origin[2], self.volume.cell()
        ratio = float(self.volume.crs.z_ratio)
        return (z + layer * cell) / ratio, (z + (layer + 1) * cell) / ratio

    def pixels(self, cells: I32) -> tuple[I64, I64]:
        """Return row and column of cells."""
        xyz = cells.astype(np.int64)
        return self.high[1] - xyz[:, 1], xyz[:, 0] - self.low[0]


def export(volume: Volume, target: Target, options: ExportOptions) -> list[CodedWarning]:
    """
    Write pictures with their world files.

    Parameters
    ----------
    volume : Volume
        What is shown.
    target : Target
        Several files.
    options : ExportOptions
        ``slices``, ``limit``; without ``level`` the deepest one with at most 256 layers (of the
        view from the top: the deepest) whose pictures stay under the limit.

    Returns
    -------
    warnings : list of CodedWarning
        ``W_NO_CRS``; ``W_LEVEL``: a coarser level was taken.

    Raises
    ------
    OptionError
        ``E_CUBE``: all voxels are in one place.
    ResourceError
        ``E_SIZE``: the level asked for makes too many or too large pictures.
    """
    from volatool.points.crs import known_wkt

    with_extent(volume, "a picture")
    is_top = options.slices == "top"
    frame, warnings = _frame(half_open(volume), is_top, options)
    wkt = known_wkt(frame.volume.crs)
    if is_top:
        _write(target, frame, _top(frame), ".top", wkt, None)
    else:
        digits = len(str(4**frame.volume.depth - 1))
        for layer, picture in _layers(frame):
            _write(target, frame, picture, f".z{layer:0{digits}d}", wkt, frame.heights(layer))
    return warnings + no_crs(volume, wkt)


def _frame(
    volume: Volume, is_top: bool, options: ExportOptions
) -> tuple[Frame, list[CodedWarning]]:
    """Return the extent at the level that is shown."""
    limit = options.limit or LIMIT_BYTES
    depth = volume.depth
    while True:
        frame = Frame.of(volume.truncated(depth))
        n_pictures = 1 if is_top else len(frame.layers)
        if options.level is not None:
            break
        if frame.is_sane(n_pictures, limit) and n_pictures <= MOST_AT_ONCE:
            break
        if depth == 1:
            break
        depth -= 1
    if not frame.is_sane(n_pictures, limit):
        raise ResourceError(
            f"level {depth} makes {n_pictures} pictures of {frame.width} x {frame.height} pixels, "
            f"{format_size(frame.size_bytes(n_pictures))}; at most {MOST_LAYERS} pictures of "
            f"{_LONGEST_SIDE} pixels a side and {format_size(limit)} are written; give a coarser "
            "--level, --bounds, --z or a larger --limit",
            "E_SIZE",
        )
    if depth == volume.depth:
        return frame, []
    told = f"level {depth} of {volume.depth} is shown, {n_pictures} layers; --level shows another"
    return frame, [CodedWarning("W_LEVEL", told)]


def _layers(frame: Frame) -> Iterator[tuple[int, NDArray[np.uint8]]]:
    """Yield z and picture of each layer that holds a voxel."""
    volume = frame.volume
    chunks = list(cell_chunks(volume))
    cells = np.concatenate([chunk.cells for chunk in chunks])
    words = np.concatenate([chunk.words for chunk in chunks]) if volume.has_metadata else None
    order = np.argsort(cells[:, 2], kind="stable")
    ends = np.searchsorted(cells[order, 2], np.append(frame.layers, frame.layers[-1] + 1))
    for number, layer in enumerate(frame.layers.tolist()):
        part = order[ends[number] : ends[number + 1]]
        rows, columns = frame.pixels(cells[part])
        picture = np.zeros((frame.height, frame.width, 4), np.uint8)
        picture[rows, columns, :3] = _colours(volume, None if words is None else words[part])
        picture[rows, columns, 3] = 255
        yield layer, picture


def _top(frame: Frame) -> NDArray[np.uint8]:
    """Return the view from the top."""
    volume = frame.volume
    layer = np.full((frame.height, frame.width), -1, np.int64)
    colours = np.zeros((frame.height, frame.width, 3), np.uint8)
    for chunk in cell_chunks(volume):
        rows, columns = frame.pixels(chunk.cells)
        np.maximum.at(layer, (rows, columns), chunk.cells[:, 2])
        is_top = layer[rows, columns] == chunk.cells[:, 2]
        words = None if chunk.words is None else chunk.words[is_top]
        colours[rows[is_top], columns[is_top]] = _colours(volume, words)
    is_seen = layer >= 0
    if not _has_colours(volume):
        from volatool.pictures.marks import span, tint

        low, high = span(layer[is_seen])
        colours = np.rint(tint((layer - low) / (high - low))).astype(np.uint8)
    alpha = np.where(is_seen, 255, 0).astype(np.uint8)
    picture = np.dstack([colours, alpha])
    picture[~is_seen] = 0
    return picture


def _has_colours(volume: Volume) -> bool:
    return set(_COLOURS) <= set(channels_by_name(volume))


def _colours(volume: Volume, words: U64 | None) -> NDArray[np.uint8]:
    """Return red, green, blue of voxels, (n, 3) or (3,): the bytes of their metadata, else ink."""
    if words is None or not _has_colours(volume):
        from volatool.pictures.marks import INK

        return np.array(INK, np.uint8)
    chunk = CellChunk(np.empty((len(words), 3), np.int32), words)
    channels = channels_by_name(volume)
    raw: list[Any] = [{**channels[name], "scale": 1.0, "offset": 0.0} for name in _COLOURS]
    return np.column_stack([chunk.channel(channel).astype(np.uint8) for channel in raw])


def _write(
    target: Target,
    frame: Frame,
    picture: NDArray[np.uint8],
    ending: str,
    wkt: str | None,
    heights: tuple[float, float] | None,
) -> None:
    """Write a picture and what places it."""
    from PIL import Image

    with target.stream(f"{ending}.png") as stream:
        Image.fromarray(picture).save(stream, "PNG", optimize=False)
    bounds, cell = frame.bounds(), frame.volume.cell()
    # one number a line: x and y of a step to the right and down, middle of the upper left pixel
    world = (cell, 0.0, 0.0, -cell, bounds.left + cell / 2, bounds.top - cell / 2)
    with target.stream(f"{ending}.pgw") as stream:
        stream.write("".join(f"{value!r}\n" for value in world).encode())
    with target.stream(f"{ending}.png.aux.xml") as stream:
        stream.write(_sidecar(wkt, heights).encode())


def _sidecar(wkt: str | None, heights: tuple[float, float] | None) -> str:
    """Return what GDAL reads beside a picture."""
    lines = ["<PAMDataset>"]
    if wkt is not None:
        lines.append(f"  <SRS>{escape(wkt)}</SRS>")
    if heights is not None:
        lines.append("  <Metadata>")
        for key, value in zip(("z_low", "z_high"), heights, strict=True):
            lines.append(f"    <MDI key={quoteattr(key)}>{value!r}</MDI>")
        lines.append("  </Metadata>")
    return "\n".join([*lines, "</PAMDataset>"]) + "\n"
