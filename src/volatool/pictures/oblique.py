"""The voxels as little cubes, seen from above at a slant."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from volatool.pictures.marks import (
    INK,
    QUIET,
    font,
    north_arrow,
    round_length,
    scale_bar,
    span,
    tint,
    to_image,
    unit_name,
)
from volatool.vola.volume import Volume

_MAX_CELLS = 1_800_000
"""Voxels drawn at most; a coarser level is drawn when the deepest has more."""
_MIN_PIXELS = 0.45
"""Smallest edge of a cell on the picture; finer levels show nothing more."""
_FINE = 2
"""Voxels are drawn this much larger, then reduced, for smooth edges."""
_AZIMUTH, _TILT = 28.0, math.radians(38.0)
"""Direction of view east of north (give or take quarter turns), and downwards."""


class Oblique:
    """
    The voxels seen from above at a slant, from the corner towards which the ground falls.

    Parameters
    ----------
    volume : Volume
        What is drawn.
    width, tallest : int
        Largest picture, pixels.
    azimuth : float, optional
        Direction of view instead, radians east of north, as another picture's `azimuth` says it.
    """

    def __init__(
        self, volume: Volume, width: int, tallest: int, azimuth: float | None = None
    ) -> None:
        self.volume = volume
        self._wanted = azimuth
        levels = range(volume.depth, 0, -1)
        level = next((k for k in levels if volume.n_cells(k) <= _MAX_CELLS), 1)
        self._project(level)
        while level > 1 and self._fit(width, tallest) < _MIN_PIXELS * _FINE:
            level -= 1
            self._project(level)
        self.level, self.scale = level, self._fit(width, tallest)
        self.colours, self.note = self._colours()
        self.image, self.mask = self._draw()

    def _project(self, level: int) -> None:
        """Work out where the cells of a level lie on the picture, in cells."""
        cells = self.volume.voxels(level).astype(np.float32)
        self.kept = np.ones(len(cells), bool)
        if len(cells):  # a few stray voxels far away would make all others tiny
            low, high = np.percentile(cells[:, 2], (0.05, 99.95))
            far = max(4.0, 0.5 * (high - low))
            self.kept = (cells[:, 2] >= low - far) & (cells[:, 2] <= high + far)
            cells = cells[self.kept]
        self.cells = cells
        x, y, z = cells.T
        # of the four corners, look from the one in front of which the ground falls towards us
        middle = z - z.mean() if len(z) else z
        rise = (float(x @ middle), float(y @ middle))
        views = [math.radians(_AZIMUTH + quarter) for quarter in (0, 90, 180, 270)]
        self.azimuth = max(views, key=lambda a: math.sin(a) * rise[0] + math.cos(a) * rise[1])
        if self._wanted is not None:
            self.azimuth = self._wanted
        cos, sin = math.cos(self.azimuth), math.sin(self.azimuth)
        away = sin * x + cos * y
        self.across = cos * x - sin * y
        self.up = math.sin(_TILT) * away + math.cos(_TILT) * z
        self.near = math.sin(_TILT) * z - math.cos(_TILT) * away

    def _fit(self, width: int, tallest: int) -> float:
        """Return pixels per cell, on the enlarged picture, that make everything fit."""
        if not len(self.cells):
            return float(_FINE)
        wide, tall = (float(np.ptp(a)) + 3 for a in (self.across, self.up))
        return _FINE * min((width - 4) / wide, (tallest - 4) / tall, 60.0)

    def _colours(self) -> tuple[NDArray[np.float32], str]:
        """Return a colour per cell, and how it was chosen."""
        volume, level = self.volume, self.level
        names = {str(channel.get("name")) for channel in volume.info.channels}
        height = self.cells[:, 2] if len(self.cells) else np.zeros(0, np.float32)
        if {"red", "green", "blue"} <= names and volume.has_metadata:
            # a word stands for a block: the words one level deeper are the cells' own
            words = (
                volume.metadata_words(level + 1) if level < volume.depth else volume.metadata(level)
            )
            shifts = np.array([0, 8, 16], np.uint64)
            rgb = ((words[self.kept, None] >> shifts) & np.uint64(255)).astype(np.float32)
            if rgb.size and rgb.max() > 0:
                top = max(float(np.percentile(rgb, 99.5)), 60.0)
                return np.clip(rgb * (242.0 / top), 0, 255), "colours of the points"
        low, high = span(height)
        return tint((height - low) / (high - low)), "coloured by height"

    def _stamp(self) -> list[tuple[int, int, int]]:
        """Return the pixels (row, column) that a cube covers, and the face seen there."""
        edge = max(self.scale, 1.0) + 0.8
        cos, sin = math.cos(math.radians(_AZIMUTH)), math.sin(math.radians(_AZIMUTH))
        slant, tall = math.sin(_TILT), math.cos(_TILT)
        reach = math.ceil(edge)
        stamp = []
        for row in range(-reach, reach + 1):
            for column in range(-reach, reach + 1):
                right, up = column / edge, -row / edge
                # the top face: a point of the plane z = 1/2 under this pixel
                away = (up - tall / 2) / slant
                x, y = cos * right + sin * away, -sin * right + cos * away
                if abs(x) <= 0.5 and abs(y) <= 0.5:
                    stamp.append((row, column, 0))
                    continue
                # the sides that are seen: y = -1/2, and x = -1/2 as the view is turned
                x = (right + sin * -0.5) / cos
                z = (up - slant * (sin * x + cos * -0.5)) / tall
                if abs(x) <= 0.5 and abs(z) <= 0.5:
                    stamp.append((row, column, 1))
                    continue
                y = (cos * -0.5 - right) / sin
                z = (up - slant * (sin * -0.5 + cos * y)) / tall
                if abs(y) <= 0.5 and abs(z) <= 0.5:
                    stamp.append((row, column, 2))
        return stamp or [(0, 0, 0)]

    def _draw(self) -> tuple[Image.Image, Image.Image]:
        """Return the picture and its mask: near cells hide far ones."""
        if not len(self.cells):
            return Image.new("RGB", (8, 8)), Image.new("L", (8, 8))
        scale, pad = self.scale, int(self.scale) + 4
        order = np.argsort(self.near, kind="stable")  # far to near
        column = np.rint((self.across - self.across.min()) * scale).astype(np.int64) + pad
        row = np.rint((self.up.max() - self.up) * scale).astype(np.int64) + pad
        width, height = int(column.max()) + pad + 1, int(row.max()) + pad + 1
        place = (row * width + column)[order]
        # cubes of one grid cover each other in the order of `near`: the highest number wins
        number = np.arange(len(order), dtype=np.int32) * 4
        top = np.full(width * height, -1, np.int32)
        for down, right, side in self._stamp():
            np.maximum.at(top, place + (down * width + right), number + np.int32(side))
        seen = top >= 0
        front, face = order[np.maximum(top, 0) >> 2], np.maximum(top, 0) & 3
        depth = np.full(width * height, np.nan, np.float32)
        depth[seen] = self.near[front[seen]]
        shade = np.array([1.0, 0.66, 0.8], np.float32)[face]
        shade = shade * _edges(depth.reshape(height, width), scale).ravel()
        pixels = np.zeros((width * height, 3), np.float32)
        pixels[seen] = self.colours[front[seen]] * shade[seen, None]
        # a pixel of the smaller picture is the mean of its covered parts
        wide, tall = -(-width // _FINE), -(-height // _FINE)
        cover = np.zeros((tall * _FINE, wide * _FINE, 4), np.float32)
        cover[:height, :width, :3] = pixels.reshape(height, width, 3)
        cover[:height, :width, 3] = seen.reshape(height, width)
        small = cover.reshape(tall, _FINE, wide, _FINE, 4).sum(axis=(1, 3))
        weight = small[..., 3]
        mask = Image.fromarray(np.rint(weight * (255 / _FINE**2)).astype(np.uint8))
        return to_image(small[..., :3] / np.maximum(weight, 1)[..., None]), mask

    def legend(self, pen: ImageDraw.ImageDraw, at: tuple[int, int], width: int) -> None:
        """Say what the voxels are, and draw a scale bar and an arrow to the north."""
        x, y = at
        volume = self.volume
        unit = unit_name(volume.crs.unit_xy)
        count = volume.n_cells(self.level)
        line = f"{count:,} voxels of {volume.cell(self.level):.3g} {unit}".rstrip()
        pen.text((x, y), line, INK, font(18))
        which = f"level {self.level} of {volume.depth}, {self.note}"
        if len(self.cells) < count:
            which += f"; {count - len(self.cells):,} far above or below left out"
        pen.text((x, y + 26), which, QUIET, font(15))
        cell = volume.cell(self.level)
        if cell > 0 and len(self.cells):
            length = round_length(0.22 * width / (self.scale / _FINE) * cell)
            pixels = length / cell * self.scale / _FINE
            scale_bar(
                pen, (x, y + 58), pixels, " ".join(f"{length:g} {unit} across the view".split())
            )
        north = (-math.sin(self.azimuth), -math.cos(self.azimuth) * math.sin(_TILT))
        tip = (22 * north[0], 22 * north[1])
        north_arrow(pen, (x + width - 30, y + 34), tip)


def _edges(depth: NDArray[np.float32], scale: float) -> NDArray[np.float32]:
    """Return a factor below 1 where nearer things stand beside (eye-dome lighting)."""
    total = np.zeros_like(depth)
    lifted = np.where(np.isnan(depth), np.float32(-1e6), depth)
    for reach, weight in ((max(1, round(scale * 0.6)), 0.6), (max(2, round(scale * 1.6)), 0.4)):
        for down, right in ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, -1), (1, -1), (-1, 1)):
            beside = np.roll(lifted, (down * reach, right * reach), (0, 1))
            ahead = np.clip(beside - lifted - 1.2, 0, 6)
            total += np.float32(weight / 8) * ahead
    factor: NDArray[np.float32] = np.exp(np.float32(-0.34) * total)
    return factor


def sky(width: int, height: int) -> Image.Image:
    """Return the ground that the voxels are drawn on: dark enough for white roofs to show."""
    rows = np.linspace(0, 1, height, dtype=np.float32)[:, None, None]
    pixels = np.array([206, 215, 224]) * (1 - rows) + np.array([236, 239, 242]) * rows
    return to_image(np.tile(pixels, (1, width, 1)))
