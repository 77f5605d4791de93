"""Volumes for the tests of exports: of a real grid, with all channels of metadata."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np
from making_volumes import INFO, random_volume

from volatool.points.crs import crs_from_user

FEET = crs_from_user("EPSG:2994+6360")
"""International feet, heights in US survey feet."""

_SCALES = {
    "red": 256.0,
    "green": 256.0,
    "blue": 256.0,
    "height": 0.02,
    "returns": 6 / 255,
    "intensity": 8.25,
    "class": 1.0,
    "present": 1.0,
}
CHANNELS = tuple(
    {
        "byte": byte,
        "name": name,
        "scale": scale,
        "offset": {"returns": 1.0, "height": 400.0}.get(name, 0.0),
        "unit": "",
        "reduction": "mean",
    }
    for byte, (name, scale) in enumerate(_SCALES.items())
)
FULL = replace(INFO, crs=FEET, epsg=2994, channels=CHANNELS)


def full_volume(depth=3, n=200, **options):
    """Return random voxels with all channels, in feet."""
    return random_volume(depth, n, **{"info": FULL, **options})


def toolkit_volume(**options):
    """Return a volume as a file of the original toolkit makes it: no channels, no WKT."""
    from volatool.model import CrsInfo

    crs = CrsInfo(horizontal="EPSG:28992", epsg=28992, source="vola")
    info = replace(INFO, crs=crs, channels=(), quantizer="unknown", epsg=28992, box=None)
    return random_volume(**{"info": info, **options})


def quantized(xyz, volume):
    """
    Return the cells of points in a volume's cube, exactly: ``floor(S (p - origin) / side)``.

    Rational arithmetic on the numbers as they print, by the definition alone.
    """
    *origin, side = volume.cube.exact
    ratio = volume.crs.z_ratio
    size = 4**volume.depth
    cells = []
    for row in xyz:
        place = [Fraction(repr(float(value))) for value in row]
        place[2] *= ratio
        cells.append(
            tuple(
                min(size - 1, (value - corner) * size // side)
                for value, corner in zip(place, origin, strict=True)
            )
        )
    return np.array(cells, np.int64)
