"""Small things that pictures are made of: colours of heights, text, bars, arrows."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from volatool.model import Bool, CrsInfo

INK, QUIET, PAPER = (34, 38, 44), (112, 118, 126), (255, 255, 255)
VOID = (236, 237, 239)
_RAMP: NDArray[np.float32] = np.array(
    [
        [92, 134, 108],
        [146, 174, 120],
        [206, 206, 146],
        [222, 190, 132],
        [190, 144, 104],
        [166, 128, 112],
        [226, 216, 206],
    ],
    np.float32,
)
"""Colours from low to high ground, in equal steps."""
_UNITS = {"metre": "m", "meter": "m", "foot": "ft", "US survey foot": "ft US", "degree": "\u00b0"}


def span(values: NDArray[Any]) -> tuple[float, float]:
    """Return heights between which to spread colours: without the outermost hundredths."""
    if not values.size:
        return 0.0, 1.0
    low, high = (float(v) for v in np.percentile(values, (0.5, 99.5)))
    return (low, high) if high > low else (low - 0.5, low + 0.5)


def tint(part: NDArray[Any]) -> NDArray[np.float32]:
    """Return the colour of heights given as parts of the span."""
    knots = np.linspace(0, 1, len(_RAMP))
    colour = np.empty((*part.shape, 3), np.float32)
    for band in range(3):  # interp keeps to the end colours outside 0 to 1
        colour[..., band] = np.interp(part, knots, _RAMP[:, band])
    return colour


def to_image(pixels: NDArray[Any]) -> Image.Image:
    """Return an RGB image of (rows, columns, 3) numbers, rounded and limited to 0 .. 255."""
    return Image.fromarray(np.clip(pixels + 0.5, 0, 255).astype(np.uint8))


def soft_mask(mask: Bool, size: tuple[int, int]) -> NDArray[np.float32]:
    """Return a mask at another size, 0 to 1, with soft edges."""
    picture = Image.fromarray(mask.astype(np.uint8) * 255).resize(size, Image.Resampling.BILINEAR)
    return np.asarray(picture).astype(np.float32) / np.float32(255)


def font(size: int) -> Any:
    """Return Pillow's own font: the same on every machine."""
    return ImageFont.load_default(size)


def text_right(
    pen: ImageDraw.ImageDraw, x: int, y: int, text: str, ink: tuple[int, int, int], size: int
) -> None:
    """Write text that ends at x."""
    pen.text((x - pen.textlength(text, font(size)), y), text, ink, font(size))


def unit_name(name: str | None) -> str:
    """Return the short form of a unit, empty if it is unknown."""
    return _UNITS.get(name or "", name or "")


def crs_name(crs: CrsInfo) -> str:
    """Return the codes or names of a CRS in one line."""
    parts = [part for part in (crs.horizontal, crs.vertical) if part]
    return " + ".join(parts) if parts else "no coordinate system"


def height_text(value: float, low: float, high: float) -> str:
    """Return a height with as many decimals as the span from low to high deserves."""
    decimals = 0 if high - low >= 20 else 1 if high - low >= 2 else 2
    return f"{round(value, decimals) + 0.0:.{decimals}f}"


def round_length(length: float) -> float:
    """Return the largest 1, 2 or 5 x 10^n not above a length."""
    if not length > 0:
        return 1.0
    power = 10.0 ** math.floor(math.log10(length))
    return power * next(digit for digit in (5, 2, 1) if digit * power <= length * 1.0000001)


def scale_bar(pen: ImageDraw.ImageDraw, at: tuple[int, int], pixels: float, text: str) -> None:
    """Draw a scale bar of two halves with its length beside it."""
    x, y = at
    end = x + round(pixels)
    half = (x + end) // 2
    pen.rectangle((x, y, half, y + 5), INK, INK)
    pen.rectangle((half, y, end, y + 5), PAPER, INK)
    pen.text((end + 8, y - 6), text, QUIET, font(14))


def north_arrow(pen: ImageDraw.ImageDraw, at: tuple[int, int], tip: tuple[float, float]) -> None:
    """Draw an arrow around a middle to `tip` (from the middle), with an N beyond it."""
    (x, y), (dx, dy) = at, tip
    pen.line((x - dx, y - dy, x + dx, y + dy), INK, 2)
    length = math.hypot(dx, dy) or 1.0
    ux, uy = dx / length, dy / length
    head = [
        (x + dx, y + dy),
        (x + dx - 9 * ux + 4 * uy, y + dy - 9 * uy - 4 * ux),
        (x + dx - 9 * ux - 4 * uy, y + dy - 9 * uy + 4 * ux),
    ]
    pen.polygon(head, INK)
    pen.text((x + 1.3 * dx + 11 * ux - 5, y + 1.3 * dy + 11 * uy - 8), "N", INK, font(14))
