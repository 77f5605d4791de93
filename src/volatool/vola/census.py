"""Counts and statistics of the voxels in a box or polygon: by class, height, metadata."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from volatool.errors import OptionError
from volatool.model import F64, I64, U64, Bounds
from volatool.vola.algebra import voxel_size
from volatool.vola.frame import Frame
from volatool.vola.regions import Selection, checked_box, select

if TYPE_CHECKING:
    from volatool.vola.volume import Volume

_NOT_MEASURED = ("class", "present")


@dataclass(frozen=True, slots=True)
class Band:
    """
    The voxels between two heights.

    Parameters
    ----------
    low, high : float
        In the vertical unit; the centre of a voxel is at least `low` and below `high`.
    voxels : int
        How many.
    classes : dict of int to int
        Voxels of each class code; empty if the volume has no class channel.
    """

    low: float
    high: float
    voxels: int
    classes: dict[int, int]


@dataclass(frozen=True, slots=True)
class ChannelSummary:
    """
    Statistics of one metadata channel, each voxel with the value of its block.

    Parameters
    ----------
    n : int
        Voxels.
    mean, minimum, maximum : float
        In the unit of the channel.
    unit : str
        Its name, ``""`` without.
    """

    n: int
    mean: float
    minimum: float
    maximum: float
    unit: str


@dataclass(frozen=True, slots=True)
class Census:
    """
    What is in a region.

    Parameters
    ----------
    voxels, blocks : int
        Voxels whose centre is in the region, and blocks that they are in.
    volume : float
        Of these voxels, in cubic horizontal units.
    unit : str or None
        Name of the horizontal unit.
    low, high : (3,) array of float64, or None
        Corners of the smallest box of whole voxels that holds them, in units of the CRS (z in the
        vertical unit).
    classes : dict of int to int
        Voxels of each class code, ascending; empty if the volume has no class channel.
    bands : tuple of Band
        As asked for.
    channels : dict of str to ChannelSummary
        The other channels; empty without voxels.
    """

    voxels: int
    blocks: int
    volume: float
    unit: str | None
    low: F64 | None
    high: F64 | None
    classes: dict[int, int]
    bands: tuple[Band, ...]
    channels: dict[str, ChannelSummary]

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON object; heights without limit are null."""
        tight = None
        if self.low is not None and self.high is not None:
            tight = [*self.low.tolist(), *self.high.tolist()]
        return {
            "voxels": self.voxels,
            "blocks": self.blocks,
            "volume": self.volume,
            "unit": self.unit,
            "tight": tight,
            "classes": _text_keys(self.classes),
            "bands": [
                {
                    "low": band.low,
                    "high": band.high,
                    "voxels": band.voxels,
                    "classes": _text_keys(band.classes),
                }
                for band in self.bands
            ],
            "channels": {
                name: {
                    "n": one.n,
                    "mean": one.mean,
                    "min": one.minimum,
                    "max": one.maximum,
                    "unit": one.unit,
                }
                for name, one in self.channels.items()
            },
        }


def census(
    volume: Volume,
    box: Bounds | Sequence[float] | None = None,
    *,
    z: tuple[float, float] | None = None,
    polygon: Any | None = None,
    bands: Sequence[float] = (),
) -> Census:
    """
    Count the voxels of a region by class and height, and sum up their metadata.

    Parameters
    ----------
    volume : Volume
        The voxels.
    box : Bounds or sequence of 4 or 6 float, optional
        ``x0, y0, x1, y1`` or ``x0, y0, z0, x1, y1, z1`` in units of the CRS, z in the vertical
        unit; infinity is no limit. Voxels count whose centre lies in the half-open box: boxes
        side by side share none.
    z : tuple of 2 float, optional
        Lower and upper height, beside or in place of those of the box.
    polygon : shapely Polygon or MultiPolygon, optional
        In the volume's CRS. Voxels count whose centre lies in it or on its outline.
    bands : sequence of float, optional
        Heights in ascending order: n + 1 of them make n bands. Infinity is no limit.

    Returns
    -------
    census : Census
        Voxels weigh equally. Metadata is one word a block of 4 x 4 x 4 voxels: each of a block's
        voxels counts with the block's class and value, whatever points it held itself.

    Raises
    ------
    OptionError
        A box with a low corner above the high one, bands that do not ascend, a NaN.

    Notes
    -----
    Only blocks that meet the region are visited.
    """
    from volatool.kernels import regions

    edges = _edges(bands)
    frame = Frame.of(volume)
    first, last = frame.range_of(*_corners(box, z), centres=True)
    chosen = select(volume, first, last, polygon)
    low = high = None
    if len(chosen.words):
        regions.tight_range(chosen.blocks, chosen.words, first, last)
        low, high = frame.coordinates(np.stack([first, last + 1]))
    n_voxels = chosen.n_voxels
    codes = _channel_bytes(volume, chosen.index, "class")
    layers = _layers(chosen)
    return Census(
        voxels=n_voxels,
        blocks=len(chosen.words),
        volume=n_voxels * float(voxel_size(volume)),
        unit=volume.crs.unit_xy,
        low=low,
        high=high,
        classes=_by_class(codes, layers.sum(axis=1)),
        bands=_bands(frame, chosen, codes, layers, edges),
        channels=_channels(volume, chosen),
    )


def _text_keys(classes: dict[int, int]) -> dict[str, int]:
    return {str(code): n for code, n in classes.items()}


def _edges(bands: Sequence[float]) -> F64:
    edges = np.array([float(edge) for edge in bands])
    if len(edges) == 1 or not (np.diff(edges) > 0).all():  # false for NaN
        raise OptionError(f"bands need two heights or more, ascending; got {edges.tolist()}")
    return edges


def _corners(
    box: Bounds | Sequence[float] | None, z: tuple[float, float] | None
) -> tuple[F64, F64]:
    """Return low and high corner of what a box and a range of heights have in common."""
    numbers = [-np.inf] * 3 + [np.inf] * 3
    if isinstance(box, Bounds):
        box = (box.left, box.bottom, box.right, box.top)
    if box is not None:
        given = [float(number) for number in box]
        if len(given) == 4:
            given = [*given[:2], -np.inf, *given[2:], np.inf]
        if len(given) != 6:
            raise OptionError(f"a box has 4 or 6 numbers, got {len(given)}")
        numbers = given
    low, high = checked_box(numbers[:3], numbers[3:])
    if z is not None:
        if not z[0] <= z[1]:
            raise OptionError(f"heights must be LOW <= HIGH, got {z[0]:g} and {z[1]:g}")
        low[2], high[2] = max(low[2], z[0]), min(high[2], z[1])
    return low, high


def _channel_bytes(volume: Volume, index: I64, name: str) -> U64 | None:
    """Return the byte of a channel in blocks; None if the volume has no such channel."""
    for channel in volume.info.channels:
        if channel["name"] == name and volume.has_metadata:
            words = volume.metadata_words()[index]
            found: U64 = (words >> np.uint64(8 * int(channel["byte"]))) & np.uint64(255)
            return found
    return None


def _layers(chosen: Selection) -> I64:
    """Return how many voxels each block has in each of its 4 layers, (n, 4)."""
    shifts = np.array([0, 16, 32, 48], np.uint64)
    words = (chosen.words[:, None] >> shifts) & np.uint64(0xFFFF)
    counts: I64 = np.bitwise_count(words).astype(np.int64)
    return counts


def _by_class(codes: U64 | None, voxels: I64) -> dict[int, int]:
    if codes is None:
        return {}
    counts = np.zeros(256, np.int64)
    np.add.at(counts, codes.astype(np.int64), voxels)
    return {int(code): int(counts[code]) for code in np.flatnonzero(counts)}


def _bands(
    frame: Frame, chosen: Selection, codes: U64 | None, layers: I64, edges: F64
) -> tuple[Band, ...]:
    if not len(edges):
        return ()
    middles = np.zeros((*layers.shape, 3))
    middles[:, :, 2] = 4 * chosen.blocks[:, 2:] + np.arange(4) + 0.5
    heights = frame.coordinates(middles)[:, :, 2]
    which = np.searchsorted(edges, heights, side="right") - 1
    found = []
    for k, (low, high) in enumerate(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True)):
        voxels = np.where(which == k, layers, 0).sum(axis=1)
        found.append(Band(low, high, int(voxels.sum()), _by_class(codes, voxels)))
    return tuple(found)


def _channels(volume: Volume, chosen: Selection) -> dict[str, ChannelSummary]:
    weights = np.bitwise_count(chosen.words).astype(np.int64)
    n = int(weights.sum())
    found: dict[str, ChannelSummary] = {}
    for channel in volume.info.channels if n else ():
        name = str(channel["name"])
        data = _channel_bytes(volume, chosen.index, name)
        if name in _NOT_MEASURED or data is None:
            continue
        scale, offset = float(channel["scale"]), float(channel["offset"])
        total = int((data.astype(np.int64) * weights).sum())
        ends = sorted(int(end) * scale + offset for end in (data.min(), data.max()))
        found[name] = ChannelSummary(
            n, total / n * scale + offset, ends[0], ends[1], str(channel.get("unit") or "")
        )
    return found
