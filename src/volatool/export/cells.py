"""A volume's voxels in pieces: their cells, places and metadata, for writers of any size."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from volatool.model import F64, I32, U64
from volatool.vola.volume import Volume

CHUNK = 1 << 18
"""Voxels of a piece, about."""


@dataclass(frozen=True, slots=True)
class Places:
    """
    Where the voxels of a volume are, as `Volume.centers` has it, without making all of them.

    Parameters
    ----------
    origin : tuple of 3 float
        Corner of the cube, in units of the CRS (z in the vertical unit).
    step : tuple of 3 float
        From one voxel to the next, same units; 0 for a single place.
    first : float
        Place of voxel 0 in steps: 0.5, or 0 for points that the original toolkit rounded to.
    """

    origin: tuple[float, float, float]
    step: tuple[float, float, float]
    first: float

    @classmethod
    def of(cls, volume: Volume) -> Places:
        """Return the places of a volume's deepest level."""
        is_rounded = volume.info.quantizer != "floor"
        ratio = volume.crs.z_ratio
        x, y, z, side = volume.cube.exact
        step = side / (4**volume.depth - int(is_rounded))
        return cls(
            (float(x), float(y), float(z / ratio)),
            (float(step), float(step), float(step / ratio)),
            0.0 if is_rounded else 0.5,
        )

    def centers(self, cells: I32) -> F64:
        """
        Return the best estimate of the place of each voxel.

        Parameters
        ----------
        cells : (n, 3) array of int32
            x, y, z.

        Returns
        -------
        centers : (n, 3) array of float64
            In units of the CRS, z in the vertical unit.
        """
        centers: F64 = (cells + self.first) * np.array(self.step) + np.array(self.origin)
        return centers


@dataclass(frozen=True, slots=True)
class CellChunk:
    """
    Consecutive voxels of a volume, in VOLA order.

    Parameters
    ----------
    cells : (n, 3) array of int32
        x, y, z from the cube's corner.
    words : (n,) array of uint64 or None
        The metadata word of each one's block.
    """

    cells: I32
    words: U64 | None

    def __len__(self) -> int:
        return len(self.cells)

    def channel(self, channel: Mapping[str, Any]) -> F64:
        """
        Return a metadata channel, decoded.

        Parameters
        ----------
        channel : mapping
            One of `VolumeInfo.channels`.

        Returns
        -------
        values : (n,) array of float64
        """
        assert self.words is not None
        data = (self.words >> np.uint64(8 * int(channel["byte"]))) & np.uint64(255)
        values: F64 = data.astype(np.float64) * float(channel["scale"]) + float(channel["offset"])
        return values


def channels_by_name(volume: Volume) -> dict[str, Mapping[str, Any]]:
    """Return the channels whose meaning is known, without the one that is always 1."""
    if not volume.has_metadata:
        return {}
    return {
        str(channel["name"]): channel
        for channel in volume.info.channels
        if channel["name"] != "present"
    }


def cell_chunks(volume: Volume, size: int = CHUNK) -> Iterator[CellChunk]:
    """
    Yield the voxels of the deepest level in pieces.

    Parameters
    ----------
    volume : Volume
        The volume.
    size : int
        Voxels of a piece, at most; at least 64.

    Yields
    ------
    chunk : CellChunk
        In VOLA order; memory is that of the blocks and one piece.
    """
    from volatool.kernels.words import child_cells

    words = volume.levels[-1]
    metadata = volume.metadata_levels[-1] if volume.metadata_levels is not None else None
    blocks = volume.voxels(volume.depth - 1) if volume.depth > 1 else np.zeros((1, 3), np.int32)
    step = max(size // 64, 1)
    for start in range(0, len(words), step):
        piece = slice(start, start + step)
        n_each = np.bitwise_count(words[piece])
        cells = child_cells(words[piece], blocks[piece], int(n_each.sum(dtype=np.int64)))
        repeated = None if metadata is None else np.repeat(metadata[piece], n_each)
        if len(cells):
            yield CellChunk(cells, repeated)
