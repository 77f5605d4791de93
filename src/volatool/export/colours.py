"""Colours of voxels: their own, or those of heights, intensities and classes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from volatool.errors import OptionError
from volatool.export.cells import channels_by_name
from volatool.vola.volume import Volume

RGB = ("red", "green", "blue")

_OTHER = (150, 120, 170)
_CLASSES = {
    0: (178, 178, 178),
    1: (190, 190, 190),
    2: (166, 124, 82),  # ground
    3: (178, 214, 120),  # low vegetation
    4: (112, 180, 80),
    5: (46, 125, 50),  # high vegetation
    6: (214, 92, 76),  # building
    7: (255, 0, 255),  # noise
    9: (66, 133, 214),  # water
    10: (110, 90, 80),  # rail
    11: (96, 96, 104),  # road
    14: (240, 190, 40),  # wire
    15: (230, 150, 30),
    17: (140, 140, 150),  # bridge
    18: (255, 0, 255),
}
"""Colours of ASPRS classes; of the others `_OTHER`."""

Colours = NDArray[np.uint8]


def colours_of(volume: Volume, choice: str | None) -> Colours | None:
    """
    Return the colour of each voxel.

    Parameters
    ----------
    volume : Volume
        The volume.
    choice : str or None
        ``"rgb"``: the colours of the points; of metadata whose meaning is not told the first three
        bytes, which the original toolkit shows. ``"height"``: from low to high,
        ``"intensity"``: from black to white, ``"class"``: one for each class. ``"auto"`` or None:
        rgb where it is known, or else none. ``"none"``.

    Returns
    -------
    colours : (n, 3) array of uint8 or None
        Red, green, blue (sRGB) in the order of `Volume.voxels`; None for no colours.

    Raises
    ------
    OptionError
        ``E_NO_METADATA``: the volume has not what was asked for.
    """
    known = channels_by_name(volume)
    has_rgb = all(name in known for name in RGB)
    if choice in (None, "auto"):
        choice = "rgb" if has_rgb else "none"
    if choice == "none":
        return None
    if choice == "height":
        return _heights(volume)
    if choice == "rgb" and volume.has_metadata and not volume.info.channels:
        return _bytes(volume, (0, 1, 2))
    needed = RGB if choice == "rgb" else (str(choice),)
    if not all(name in known for name in needed):
        told = ", ".join(known) or "nothing that is known"
        raise OptionError(
            f"--colour {choice}: the volume does not have it, its metadata are {told}; "
            "give --colour height",
            "E_NO_METADATA",
        )
    data = _bytes(volume, tuple(int(known[name]["byte"]) for name in needed))
    if choice == "class":
        return _class_table()[data[:, 0]]
    return data if choice == "rgb" else np.repeat(data, 3, axis=1)


def _bytes(volume: Volume, which: tuple[int, ...]) -> Colours:
    """Return bytes of each voxel's metadata word."""
    words = volume.metadata()
    columns = [(words >> np.uint64(8 * byte)) & np.uint64(255) for byte in which]
    return np.column_stack(columns).astype(np.uint8)


def _class_table() -> Colours:
    table = np.full((256, 3), _OTHER, np.uint8)
    for code, colour in _CLASSES.items():
        table[code] = colour
    return table


def _heights(volume: Volume) -> Colours:
    """Return colours by layer, spread between the lowest and the highest one with a voxel."""
    from volatool.pictures.marks import span, tint

    layers = volume.voxels()[:, 2]
    low, high = span(layers)
    values, which = np.unique(layers, return_inverse=True)
    colours = tint((values - low) / (high - low))
    return np.rint(colours).astype(np.uint8)[which]


def linear(colours: Colours) -> Colours:
    """
    Return the linear colours of sRGB ones, as glTF has vertex colours.

    Parameters
    ----------
    colours : (n, 3) array of uint8
        sRGB.

    Returns
    -------
    colours : (n, 3) array of uint8
        Rounded: dark ones lose steps.
    """
    part = np.arange(256) / 255
    curve = np.where(part <= 0.04045, part / 12.92, ((part + 0.055) / 1.055) ** 2.4)
    table: Colours = np.rint(curve * 255).astype(np.uint8)
    return table[colours]


def labels_of(colours: Colours | None) -> NDArray[np.int64] | None:
    """Return a number for each colour: equal ones have the same."""
    if colours is None:
        return None
    wide = colours.astype(np.int64)
    return (wide[:, 0] << 16) | (wide[:, 1] << 8) | wide[:, 2]
