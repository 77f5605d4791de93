"""What is known about a volume beside its cells."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from volatool.errors import CodedWarning
from volatool.model import CrsInfo


@dataclass(frozen=True, slots=True)
class VolumeInfo:
    """
    What is known about a volume beside its cells.

    Parameters
    ----------
    crs : CrsInfo
        Coordinate reference system; an empty one if unknown.
    box : tuple of 6 float or None
        Tight box of the points: minimum x, y, z, then maximum, in units of the CRS (z in the
        vertical unit).
    n_points : int or None
        Points that made the volume.
    channels : tuple of mappings
        Metadata bytes in use: ``byte, name, scale, offset, unit, reduction``; the value is
        ``byte * scale + offset``.
    quantizer : str
        ``"floor"`` (half-open cells), ``"toolkit"`` (rounded to 4**depth points) or ``"unknown"``
        (a file without a trailer; places are worked out as for ``"toolkit"``).
    source_name : str or None
        Name of the point file, without its folder.
    source_bytes : int or None
        Its size.
    lat, lon : float or None
        Centre of the box, WGS 84 degrees.
    epsg : int or None
        Horizontal EPSG code of the header.
    generator : str or None
        The program that wrote the file.
    warnings : tuple of CodedWarning
        What was suspicious, and put right, when the volume was read.
    """

    crs: CrsInfo = field(default_factory=CrsInfo)
    box: tuple[float, float, float, float, float, float] | None = None
    n_points: int | None = None
    channels: tuple[Mapping[str, Any], ...] = ()
    quantizer: str = "floor"
    source_name: str | None = None
    source_bytes: int | None = None
    lat: float | None = None
    lon: float | None = None
    epsg: int | None = None
    generator: str | None = None
    warnings: tuple[CodedWarning, ...] = ()
