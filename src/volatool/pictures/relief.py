"""The DEM as a map: heights in colours, shaded, with what is void or filled in marked."""

from __future__ import annotations

import math
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from volatool.model import Bool, CrsInfo
from volatool.pictures.marks import (
    INK,
    PAPER,
    QUIET,
    VOID,
    font,
    height_text,
    round_length,
    scale_bar,
    soft_mask,
    span,
    text_right,
    tint,
    to_image,
    unit_name,
)

_NAMES = {
    "dtm": "Ground (DTM)",
    "dsm": "Surface (DSM)",
    "min": "Lowest points",
    "max": "Highest points",
    "mean": "Mean of the points",
    "idw": "Ground (inverse distances)",
    "tin": "Ground (triangles)",
}


class _Grid(Protocol):
    @property
    def cell(self) -> Any: ...


class DemPicture(Protocol):
    """What of a DEM is drawn; `volatool.dem.surfaces.Dem` has it."""

    @property
    def z(self) -> NDArray[np.float32]:
        """Heights, row 0 in the north, NaN where there is none."""

    @property
    def flag(self) -> NDArray[np.uint8]:
        """0 void, 1 measured, 2 filled."""

    @property
    def grid(self) -> _Grid:
        """Where its cells are; only their edge is used."""

    @property
    def surface(self) -> str:
        """``"dtm"``, ``"dsm"``, ``"min"``, ..."""


class Relief:
    """
    The DEM drawn north up, as large as fits.

    Parameters
    ----------
    dem : DemPicture
        What is drawn.
    crs : CrsInfo
        Its units.
    width, tallest : int
        Largest picture, pixels.
    """

    def __init__(self, dem: DemPicture, crs: CrsInfo, width: int, tallest: int) -> None:
        self.dem, self.crs = dem, crs
        rows, columns = dem.z.shape
        scale = min(width / columns, tallest / rows)
        # blocks of whole cells first: bounded work and memory for large grids
        step = max(1, math.floor(1 / scale))
        self.z, self.flag = _blocks(dem.z, step), np.asarray(dem.flag[::step, ::step])
        self.cell = float(dem.grid.cell) * step
        self.has = np.isfinite(self.z)
        self.low, self.high = span(self.z[self.has])
        self.image = self._draw((max(1, round(columns * scale)), max(1, round(rows * scale))))

    def _draw(self, size: tuple[int, int]) -> Image.Image:
        """Return the picture."""
        has = self.has
        part = np.where(has, (self.z - self.low) / (self.high - self.low), 0.0)
        light = _light(self.z * np.float32(self.crs.z_ratio), self.cell)
        paper = np.array(VOID, np.float32)
        colour = tint(part) * (0.42 + 0.66 * light)[..., None]
        colour = np.where(has[..., None], colour, paper)
        pixels = np.asarray(to_image(colour).resize(size, Image.Resampling.BICUBIC), np.float32)
        # what was filled in between the points is paler, under fine lines; not single cells,
        # which would be specks
        filled = soft_mask(_opened(has & (self.flag == 2)), size)
        row, column = np.ogrid[: size[1], : size[0]]
        pale = filled[..., None] * np.where((row + column) % 6 < 1, 0.3, 0.13)[..., None]
        pixels = pixels + (255 - pixels) * pale
        void = soft_mask(~has, size)[..., None]
        return to_image(pixels * (1 - void) + paper * void)

    def legend(self, page: Image.Image, at: tuple[int, int], pane: int) -> None:
        """Say what the DEM is: heights and their colours, cell, scale, filled and void parts."""
        pen = ImageDraw.Draw(page)
        x, y = at
        unit, unit_z = (unit_name(u) for u in (self.crs.unit_xy, self.crs.unit_z))
        cell = float(self.dem.grid.cell)
        rows, columns = self.dem.z.shape
        name = _NAMES.get(self.dem.surface, self.dem.surface)
        text = f"{name}, {columns:,} x {rows:,} cells of {cell:.4g} {unit}"
        pen.text((x, y), text.rstrip(), INK, font(18))
        length = round_length(0.25 * columns * cell)
        pixels = length / (columns * cell) * self.image.width
        scale_bar(pen, (x, y + 58), pixels, f"{length:g} {unit}".strip())
        right = x + pane - 170
        ramp = np.tile(np.linspace(0, 1, 170, dtype=np.float32), (12, 1))
        page.paste(to_image(tint(ramp)), (right, y + 4))
        low, high = (height_text(value, self.low, self.high) for value in (self.low, self.high))
        pen.text((right, y + 19), low, QUIET, font(14))
        text_right(pen, x + pane, y + 19, f"{high} {unit_z}".strip(), QUIET, 14)
        parts = [
            (_opened(self.has & (self.flag == 2)), "filled between points", True),
            (~self.has, "no data", False),
        ]
        place = x + pane
        for mask, text, lined in parts:
            if not mask.any():
                continue
            place -= int(pen.textlength(text, font(14)))
            pen.text((place, y + 47), text, QUIET, font(14))
            box = (place - 24, y + 49, place - 8, y + 61)
            pen.rectangle(box, (226, 218, 184) if lined else VOID, QUIET)
            if lined:
                for start in range(4, 16, 4):
                    pen.line((box[0] + start, box[3] - 1, box[0] + start + 9, box[1] + 1), PAPER)
            place -= 40


def _blocks(z: NDArray[np.float32], step: int) -> NDArray[np.float32]:
    """Return means over step x step cells, NaN where all of them are."""
    if step == 1:
        return np.asarray(z, np.float32)
    rows, columns = z.shape
    edges = np.arange(0, columns, step)
    means = np.empty((-(-rows // step), len(edges)), np.float32)
    for row in range(len(means)):
        strip = z[row * step : (row + 1) * step]
        has = np.isfinite(strip)
        total = np.where(has, strip, 0).sum(axis=0, dtype=np.float64)
        count = np.add.reduceat(has.sum(axis=0), edges)
        total = np.add.reduceat(total, edges)
        means[row] = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    return means


def _opened(mask: Bool) -> Bool:
    """Return the parts of a mask that hold a square of 3 x 3 cells."""

    def spread(cells: Bool) -> Bool:
        wide = np.pad(cells, 1)
        wide = wide[:-2] | wide[1:-1] | wide[2:]
        spread: Bool = wide[:, :-2] | wide[:, 1:-1] | wide[:, 2:]
        return spread

    return spread(~spread(~mask)) & mask


def _light(z: NDArray[np.float32], cell: float) -> NDArray[np.float32]:
    """
    Return brightness 0 to 1 of a surface lit from the north-west, and a little from all sides.

    Notes
    -----
    Flat ground is drawn steeper, up to six times, so that kerbs and ditches show.
    """
    steps = []
    for axis in (0, 1):
        before, after = np.roll(z, 1, axis), np.roll(z, -1, axis)
        first, last = [slice(None)] * 2, [slice(None)] * 2
        first[axis], last[axis] = slice(0, 1), slice(-1, None)
        before[tuple(first)], after[tuple(last)] = np.nan, np.nan
        one_sided = np.isnan(before).astype(np.float32) + np.isnan(after)
        before, after = np.where(np.isnan(before), z, before), np.where(np.isnan(after), z, after)
        steps.append(np.nan_to_num((after - before) / np.maximum(2 - one_sided, 1) / cell))
    south, east = steps
    slope = np.hypot(south, east)
    steep = float(np.percentile(slope, 85)) if slope.size else 0.0
    exaggeration = min(max(0.55 / steep, 0.8), 6.0) if steep > 0 else 1.0
    south, east = south * exaggeration, east * exaggeration
    length = np.sqrt(1 + south * south + east * east)
    light = np.zeros_like(z)
    for azimuth, weight in ((315, 0.62), (270, 0.14), (0, 0.14), (225, 0.1)):
        sun_x, sun_y = math.sin(math.radians(azimuth)), math.cos(math.radians(azimuth))
        # the normal is (-dz/dx, -dz/dy, 1); rows run south, so dz/dy is -south
        facing = (0.707 * (south * sun_y - east * sun_x) + 0.707) / length
        light += np.float32(weight) * np.clip(facing, 0, 1).astype(np.float32)
    return np.clip(light, 0, 1)
