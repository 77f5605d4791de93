"""A picture of a tile for people: the shaded DEM beside an oblique view of the voxels."""

from __future__ import annotations

import io

from PIL import Image, ImageDraw

from volatool.pictures.marks import INK, PAPER, QUIET, crs_name, font, text_right
from volatool.pictures.oblique import Oblique, sky
from volatool.pictures.relief import DemPicture, Relief
from volatool.vola.volume import Volume

_MARGIN, _HEAD, _FOOT = 24, 62, 92


def render(dem: DemPicture | None, volume: Volume, *, width: int = 1600) -> bytes:
    """
    Draw a tile.

    Parameters
    ----------
    dem : Dem or None
        Surface; without one the voxels have the whole width.
    volume : Volume
        Its voxels; coloured by the colours in its metadata, else by height.
    width : int
        Pixels; at least 400.

    Returns
    -------
    png : bytes
        The same for the same input and version of Pillow.
    """
    width = max(width, 400)
    if dem is None:
        pane, wide = 0, width - 2 * _MARGIN
    else:
        pane = int((width - 3 * _MARGIN) * 0.46)
        wide = width - 3 * _MARGIN - pane
    tallest = int(wide * (0.9 if dem is not None else 0.7))
    view = Oblique(volume, wide, tallest)
    left = None if dem is None else Relief(dem, volume.crs, pane, tallest)
    height = max(view.image.height, 0 if left is None else left.image.height, int(0.45 * wide))
    page = Image.new("RGB", (width, _HEAD + height + _FOOT), PAPER)
    pen = ImageDraw.Draw(page)
    title = volume.info.source_name or "volume"
    pen.text((_MARGIN, 18), title, INK, font(26))
    text_right(pen, width - _MARGIN, 24, crs_name(volume.crs), QUIET, 16)

    x, y = _MARGIN, _HEAD + height + 12
    if left is not None:
        image = left.image
        page.paste(image, (x + (pane - image.width) // 2, _HEAD + (height - image.height) // 2))
        left.legend(page, (x, y), pane)
        x += pane + _MARGIN
    page.paste(sky(wide, height), (x, _HEAD))
    at = (x + (wide - view.image.width) // 2, _HEAD + (height - view.image.height) // 2)
    page.paste(view.image, at, view.mask)
    view.legend(pen, (x, y), wide)
    out = io.BytesIO()
    page.save(out, "PNG", optimize=False)
    return out.getvalue()
