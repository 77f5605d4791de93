"""What a builder has built: exact counts of all levels, and the volumes that can be had."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from volatool.cube import Cube
from volatool.errors import OptionError
from volatool.model import U64, CrsInfo, LevelCounts
from volatool.scratch import Scratch, Spool
from volatool.vola.fold import fold_levels
from volatool.vola.sums import MetadataSums

if TYPE_CHECKING:
    from volatool.vola.volume import Volume, VolumeInfo

Box = tuple[float, float, float, float, float, float]

_SHARE = 0.9
_PRESENT = np.uint64(1 << 56)


class Built:
    """
    Exact counts of all levels and the words of those that were kept.

    Parameters
    ----------
    keys : iterator of (n,) arrays of uint64
        All distinct voxels at `max_depth`, sorted.
    sums : MetadataSums
        Of the same points.
    cube : Cube
        The extent.
    crs : CrsInfo
        For the description.
    n_points : int
        Points that the keys were made from.
    box : tuple of 6 float or None
        Tight box of the points, minimum x, y, z, then maximum, in units of the file.
    max_depth : int
        Level of the keys.
    keep : int
        Deepest level whose words are kept ...
    limit : float
        ... if it and those above it (but for levels 1 and 2) have no more blocks than this.
    scratch : Scratch
        Memory budget.

    Attributes
    ----------
    counts : list of LevelCounts
        Of levels 1 to `max_depth`.
    deepest : int
        Deepest depth that `volume` can return.
    channels : tuple of dict
        Metadata bytes in use, as the trailer describes them.
    """

    def __init__(
        self,
        keys: Iterator[U64],
        sums: MetadataSums,
        *,
        cube: Cube,
        crs: CrsInfo,
        n_points: int,
        box: Box | None,
        max_depth: int,
        keep: int,
        limit: float,
        scratch: Scratch,
    ) -> None:
        self.cube = cube
        self.crs = crs
        self.n_points = n_points
        self.box = box
        self.max_depth = max_depth
        self.deepest = min(keep, sums.level) if sums.channels else keep
        self.channels: tuple[dict[str, Any], ...] = ()
        self._words = [Spool(scratch, np.uint64, _SHARE) for _ in range(self.deepest)]
        self._metadata: list[Spool] | None = None

        def keep_words(level: int, words: U64) -> None:
            if level > self.deepest:
                return
            self._words[level - 1].append(words)
            if level > 2 and len(self._words[level - 1]) > limit:
                self._drop_from(level)

        try:
            self.counts: list[LevelCounts] = fold_levels(keys, max_depth, keep_words)
            if sums.channels:
                self._fold_metadata(sums, scratch)
        except BaseException:  # Ctrl-C too: the spools' files must not stay open
            self.close()
            raise

    def _drop_from(self, level: int) -> None:
        for spool in self._words[level - 1 :]:
            spool.close()
        del self._words[level - 1 :]
        self.deepest = level - 1

    def _fold_metadata(self, sums: MetadataSums, scratch: Scratch) -> None:
        sums.coarsen_to(self.deepest)
        spools = [Spool(scratch, np.uint64, _SHARE) for _ in range(self.deepest)]
        self._metadata = spools
        scaling = sums.scaling(self.crs.unit_z)
        sums.fold(scaling, lambda level, words: spools[level - 1].append(words))
        if not self.n_points:
            spools[0].append(np.array([_PRESENT]))
        self.channels = scaling.channels

    def info(self) -> VolumeInfo:
        """Return the description of the volumes as far as it is known here."""
        from volatool.vola.volume import VolumeInfo

        return self._completed(VolumeInfo(crs=self.crs, epsg=self.crs.epsg))

    def _completed(self, info: VolumeInfo) -> VolumeInfo:
        return replace(
            info,
            box=self.box,
            n_points=self.n_points,
            channels=self.channels,
            quantizer="floor",
        )

    def volume(self, depth: int, info: VolumeInfo | None = None) -> Volume:
        """
        Return the volume of a depth.

        Parameters
        ----------
        depth : int
            Number of levels.
        info : VolumeInfo, optional
            CRS, source, latitude and longitude; box, points, channels and quantizer are set here.

        Returns
        -------
        volume : Volume
            Its arrays are its own: it stays when this object is closed.

        Raises
        ------
        OptionError
            The words of this depth were not kept.
        """
        from volatool.vola.volume import Volume

        if not 1 <= depth <= self.deepest:
            raise OptionError(
                f"depth {depth} was not kept, levels 1 to {self.deepest} were: build with "
                f"keep_depth={depth} (or deeper) to have it whatever its occupancy"
            )
        levels = tuple(_joined(spool) for spool in self._words[:depth])
        metadata = None
        if self._metadata is not None:
            metadata = tuple(_joined(spool) for spool in self._metadata[:depth])
        complete = self.info() if info is None else self._completed(info)
        return Volume(levels, metadata, self.cube, complete)

    def close(self) -> None:
        """Drop the words and give the memory back."""
        for spool in (*self._words, *(self._metadata or ())):
            spool.close()
        self._words, self._metadata, self.deepest = [], None, 0


def _joined(spool: Spool) -> U64:
    words = np.empty(len(spool), np.uint64)
    start = 0
    for piece in spool.pieces():
        words[start : start + len(piece)] = piece
        start += len(piece)
    return words
