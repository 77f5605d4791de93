"""Tables 2 to 7 of the VOLA paper on tiles at hand: one read each, nothing written."""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from volatool import resources
from volatool.cube import MAX_DEPTH
from volatool.errors import CodedWarning
from volatool.formats import gz
from volatool.formats.registry import open_volume
from volatool.model import LevelCounts, Progress, no_progress
from volatool.naming import VOLUME_SUFFIXES
from volatool.occupancy.levels import CELLS
from volatool.opening import open_source
from volatool.options import ConvertOptions
from volatool.outputs import OutputSet
from volatool.papers.vola_density import DensityGatherer, DensityMap, cell_for
from volatool.scan import Scan, TileScanner
from volatool.scratch import Scratch
from volatool.tile import input_document
from volatool.vola.strips import level_strips
from volatool.vola.volume import Volume
from volatool.volume_stats import volume_input
from volatool.volumes import make_volumes

if TYPE_CHECKING:
    from volatool.cube import Cube
    from volatool.dem.gather import SurfaceGatherer
    from volatool.points.source import Source
    from volatool.vola.builder import VolaBuilder

_STRIP_VOXELS = 20_000_000
"""Levels with more voxels are not sorted into strips."""


@dataclass(frozen=True, slots=True)
class Tile:
    """
    What one read of a tile gives.

    Parameters
    ----------
    path : pathlib.Path
        The input.
    source : dict
        ``input`` of a report.
    volume : Volume
        With its metadata, as deep as asked for; else `own`.
    own : Volume
        As deep as the rule has it for this tile alone.
    counts : list of LevelCounts
        Of levels 1 to beyond the volume's depth, if points were counted there.
    density : DensityMap or None
        None for a VOLA file.
    laz_bytes : int or None
        Size as LAZ: of the input itself, or of an input that is not compressed by compressing it.
    laz_kind : str
        ``"input"``, ``"input, COPC"``, ``"compressed here"`` or ``"none"``.
    warnings : tuple of CodedWarning
        What came up.
    """

    path: Path
    source: dict[str, Any]
    volume: Volume
    own: Volume
    counts: list[LevelCounts]
    density: DensityMap | None
    laz_bytes: int | None
    laz_kind: str
    warnings: tuple[CodedWarning, ...]

    @property
    def density_m2(self) -> float | None:
        """Points a square metre of covered area; None if the unit or the points aren't known."""
        density = self.source["density"]["all_per_area_occupied"]
        metres = self.volume.crs.metres_per_unit_xy
        return None if density is None or metres is None else float(density / metres**2)

    @property
    def n_points(self) -> int | None:
        """Points that made the voxels, if that is known."""
        number = self.source["points_used"]
        return None if number is None else int(number)


def read_tile(
    path: Path, options: ConvertOptions, progress: Progress = no_progress
) -> Tile | CodedWarning:
    """
    Read a tile.

    Parameters
    ----------
    path : pathlib.Path
        LAS, LAZ, COPC or a VOLA file.
    options : ConvertOptions
        CRS, and the depth if it is not to be chosen.
    progress : callable, optional
        Told (points done, points of the file).

    Returns
    -------
    tile : Tile or CodedWarning
        A warning when no point is left to use.
    """
    if path.name.lower().endswith(VOLUME_SUFFIXES):
        tile = _volume_tile(path, options)
        return tile if len(tile.volume) else _empty(path)
    with open_source(path, options) as source, _scratch(options) as scratch:
        box = source.header.box
        density = DensityGatherer(cell_for(max(box[3] - box[0], box[4] - box[1])))
        scan = _scan(source, options, scratch, density, progress)
        if not scan.builders:
            return _empty(path)
        counts = next(iter(scan.builders.values())).build().counts
        part = make_volumes(
            scan.builders, source, options, OutputSet(overwrite=False), None, _corners(source, scan)
        )
        laz_bytes, kind = _laz(source, options)
        return Tile(
            path=path,
            source=input_document(path, source, scan),
            volume=part.volume,
            own=part.volume,
            counts=counts[: len(part.levels)],
            density=density.result(),
            laz_bytes=laz_bytes,
            laz_kind=kind,
            warnings=(*source.warnings, *scan.warnings, *part.warnings),
        )


def _empty(path: Path) -> CodedWarning:
    return CodedWarning("W_EMPTY", f"{path.name}: has no point to use; it is left out")


def _volume_tile(path: Path, options: ConvertOptions) -> Tile:
    volume = open_volume(path)
    if options.depth is not None and options.depth < volume.depth:
        volume = volume.truncated(options.depth)
    return Tile(
        path=path,
        source=volume_input(path, volume, volume.crs),
        volume=volume,
        own=volume,
        counts=volume.counts(),
        density=None,
        laz_bytes=None,
        laz_kind="none",
        warnings=volume.info.warnings,
    )


@contextmanager
def _scratch(options: ConvertOptions) -> Iterator[Scratch]:
    with Scratch(resources.working_budget(options.memory)) as scratch:
        yield scratch


def _scan(
    source: Source,
    options: ConvertOptions,
    scratch: Scratch,
    density: DensityGatherer,
    progress: Progress,
) -> Scan:
    from volatool.vola.builder import VolaBuilder
    from volatool.vola.metadata import attributes_for, channels_of

    channels = tuple(
        channel for channel in channels_of(source.header.dimensions) if channel in options.meta
    )

    def builder(cube: Cube) -> VolaBuilder:
        return VolaBuilder(
            cube,
            max(options.max_depth, options.depth or 0),
            channels=channels,
            n_points_hint=source.n_points,
            scratch=scratch,
            z_ratio=source.crs.z_ratio,
            keep_depth=options.depth,
            crs=source.crs,
        )

    # the scanner hands the points that are used to whoever has `add`
    taker = cast("SurfaceGatherer", density)
    return TileScanner(source, options, builder, attributes_for(channels), taker, progress).run()


def _corners(source: Source, scan: Scan) -> list[float]:
    from volatool.tile import corners_of

    return corners_of(source, scan)


class _Size(io.RawIOBase):
    """A file that keeps nothing but its size."""

    def __init__(self) -> None:
        self.place = self.size = 0

    def writable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def tell(self) -> int:
        return self.place

    def seek(self, offset: int, whence: int = 0) -> int:
        self.place = (0, self.place, self.size)[whence] + offset
        return self.place

    def write(self, data: Any) -> int:
        self.place += len(data)
        self.size = max(self.size, self.place)
        return len(data)


def _laz(source: Source, options: ConvertOptions) -> tuple[int | None, str]:
    """Return the size as LAZ and where it is from."""
    from volatool.points.reader import PointSource
    from volatool.points.rewrite import Rewriter

    header = source.header
    if header.is_compressed:
        return header.size_bytes, "input, COPC" if header.is_copc else "input"
    if not isinstance(source, PointSource):  # reprojected: the file is behind it
        with open_source(Path(source.path), replace(options, to_crs=None)) as plain:
            return _laz(plain, options)
    size = _Size()
    writer = Rewriter(source, cast("Any", size))
    for _, records in source.records(options.chunk_points):
        writer.write(records)
    writer.finish()
    return size.size, "compressed here"


def sizes(volume: Volume) -> dict[str, int | None]:
    """
    Return the sizes of a volume's levels, without header and trailer, as the paper counts them.

    Parameters
    ----------
    volume : Volume
        With or without metadata.

    Returns
    -------
    sizes : dict
        Bytes: ``vola_1_bit``, ``vola_1_bit_gzip``, ``vola_2_bit``, ``vola_2_bit_gzip``; the last
        two None without metadata.
    """
    plain = b"".join(words.tobytes() for words in volume.levels)
    found: dict[str, int | None] = {
        "vola_1_bit": len(plain),
        "vola_1_bit_gzip": _gzipped(plain),
        "vola_2_bit": None,
        "vola_2_bit_gzip": None,
    }
    if volume.metadata_levels is not None:
        pairs = zip(volume.levels, volume.metadata_levels, strict=True)
        both = b"".join(words.tobytes() + more.tobytes() for words, more in pairs)
        found |= {"vola_2_bit": len(both), "vola_2_bit_gzip": _gzipped(both)}
    return found


def _gzipped(data: bytes) -> int:
    stream = io.BytesIO()
    with gz.writer(stream) as packed:
        packed.write(data)
    return len(stream.getvalue())


def broken_identity(volume: Volume) -> list[int]:
    """
    Return the levels whose blocks are not as many as the cells set in the level above.

    Parameters
    ----------
    volume : Volume
        Counted anew, by a table: not as the volume itself is checked.

    Returns
    -------
    levels : list of int
        Empty if the identity holds, as it must.
    """
    from volatool.kernels import lookup

    table = np.bitwise_count(np.arange(1 << 16, dtype=np.uint16))
    voxels = [int(lookup.count_by_table(words, table)) for words in volume.levels]
    blocks = [len(words) for words in volume.levels]
    expected = [1, *voxels[:-1]]
    return [level for level, (n, m) in enumerate(zip(blocks, expected, strict=True), 1) if n != m]


def strip_occupancy(volume: Volume, level: int) -> tuple[int, int] | None:
    """
    Return voxels and words of a level in the dense order: strips of 64 cells along x.

    Parameters
    ----------
    volume : Volume
        Any.
    level : int
        1 to its depth.

    Returns
    -------
    voxels, words : int
        Cells set, and the words of the dense level that are not zero; None for more voxels than
        are worth sorting, or levels whose cells 64 bits can't number.
    """
    if volume.n_cells(level) > _STRIP_VOXELS or level > MAX_DEPTH:
        return None
    bare = Volume(volume.levels[:level], None, volume.cube, volume.info)
    return volume.n_cells(level), len(level_strips(bare, level).words)


def tile_mean(tiles: Sequence[Tile], level: int) -> float:
    """Return the mean over tiles of a level's occupancy, every tile alike."""
    values = []
    for tile in tiles:
        if level <= len(tile.counts):
            count = tile.counts[level - 1]
            values.append(count.voxels / (CELLS * count.blocks))
    return float(np.mean(values))
