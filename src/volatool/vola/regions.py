"""Parts of a volume: boxes, columns, and the blocks that meet a region."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from volatool.errors import OptionError
from volatool.model import F64, I64, U64, Bool
from volatool.vola.frame import Frame
from volatool.vola.rows import rows_of

if TYPE_CHECKING:
    from volatool.vola.volume import Volume

_LAYERS = np.uint64(0x0001_0001_0001_0001)


@dataclass(frozen=True, slots=True)
class Selection:
    """
    The voxels of a region, block by block, in VOLA order.

    Parameters
    ----------
    index : (n,) array of int64
        Which blocks of the deepest level: rows of its words and metadata words.
    blocks : (n, 3) array of int64
        Their x, y, z, in blocks.
    words : (n,) array of uint64
        Their voxels that are in the region; none is zero.
    """

    index: I64
    blocks: I64
    words: U64

    @property
    def n_voxels(self) -> int:
        """Voxels in the region."""
        return int(np.bitwise_count(self.words).sum(dtype=np.int64))


@dataclass(frozen=True, slots=True)
class BoxCount:
    """
    What is in a box.

    Parameters
    ----------
    voxels : int
        Voxels that a point of the closed box falls into.
    blocks : int
        Blocks that they are in.
    cells : int
        Cells of the volume's grid that a point of the box falls into, set or not; 0 means that
        the box is outside the cube.
    low, high : (3,) array of float64, or None
        Corners of the smallest box of whole voxels that holds them, in units of the CRS (z in the
        vertical unit).
    """

    voxels: int
    blocks: int
    cells: int
    low: F64 | None
    high: F64 | None

    def __bool__(self) -> bool:
        return self.voxels > 0

    @property
    def fill(self) -> float:
        """Share of the cells that are set."""
        return self.voxels / self.cells if self.cells else 0.0


@dataclass(frozen=True, slots=True)
class Column:
    """
    The occupied runs over a place, top to bottom.

    Parameters
    ----------
    low, high : (n,) arrays of float64
        Lower and upper end of each run of voxels, in the vertical unit.
    is_outside : bool
        The place is outside the cube, or not finite.
    """

    low: F64
    high: F64
    is_outside: bool = False

    def __len__(self) -> int:
        return len(self.low)

    def __iter__(self) -> Iterator[tuple[float, float]]:
        return iter(zip(self.low.tolist(), self.high.tolist(), strict=True))


def checked_box(low: ArrayLike, high: ArrayLike) -> tuple[F64, F64]:
    """
    Return the corners of a box.

    Raises
    ------
    OptionError
        Not three numbers each, one is NaN, or a low one is above the high one.
    """
    corners = np.array([low, high], np.float64)
    if corners.shape != (2, 3) or not (corners[0] <= corners[1]).all():  # false for NaN
        raise OptionError(
            f"a box needs X0 <= X1, Y0 <= Y1 and Z0 <= Z1, got {corners[0].tolist()} and "
            f"{corners[1].tolist()}"
        )
    return corners[0], corners[1]


def count_box(volume: Volume, low: ArrayLike, high: ArrayLike) -> BoxCount:
    """
    Count what is in a box.

    Parameters
    ----------
    volume : Volume
        The voxels.
    low, high : (3,) arrays of float
        Corners in units of the CRS, z in the vertical unit; infinity is no limit.

    Returns
    -------
    count : BoxCount
        True if there is any voxel.

    Raises
    ------
    OptionError
        See `checked_box`.

    Notes
    -----
    Only blocks that meet the box are visited, level by level.
    """
    from volatool.kernels import regions

    frame = Frame.of(volume)
    first, last = frame.range_of(*checked_box(low, high), centres=False)
    cells = int(np.prod(np.maximum(last - first + 1, 0).astype(object)))
    chosen = select(volume, first, last)
    if not len(chosen.words):
        return BoxCount(0, 0, cells, None, None)
    regions.tight_range(chosen.blocks, chosen.words, first, last)
    corners = frame.coordinates(np.stack([first, last + 1]))
    return BoxCount(chosen.n_voxels, len(chosen.words), cells, corners[0], corners[1])


def columns(volume: Volume, xy: ArrayLike) -> list[Column]:
    """
    Return the occupied runs over places.

    Parameters
    ----------
    volume : Volume
        The voxels.
    xy : (n, 2) array of float
        In units of the CRS.

    Returns
    -------
    columns : list of n Column
        Voxels on top of each other are one run.
    """
    from volatool.kernels import regions

    places = rows_of(xy, 2, what="places")
    frame = Frame.of(volume)
    level_of_floor = np.full((len(places), 1), frame.corner[2] / frame.z_ratio)
    cells = np.ascontiguousarray(volume.cell_indices(np.hstack([places, level_of_floor]))[:, :2])
    starts = np.empty(len(cells) + 1, np.int64)
    rows, depth = volume.directory.rows, volume.depth
    runs = np.empty((4 * len(cells), 2), np.int64)
    n_runs = regions.column_runs(rows, depth, cells, starts, runs)
    if n_runs > len(runs):
        runs = np.empty((n_runs, 2), np.int64)
        regions.column_runs(rows, depth, cells, starts, runs)
    planes = np.zeros((2, n_runs, 3))
    planes[:, :, 2] = runs[:n_runs].T
    planes[1] += 1
    low, high = frame.coordinates(planes)[:, :, 2]
    return [
        Column(low[start:stop], high[start:stop], bool(cell[0] < 0))
        for start, stop, cell in zip(starts[:-1], starts[1:], cells, strict=True)
    ]


def select(volume: Volume, first: I64, last: I64, polygon: Any | None = None) -> Selection:
    """
    Return the voxels of a region.

    Parameters
    ----------
    volume : Volume
        The voxels.
    first, last : (3,) arrays of int64
        Range of cells, both inclusive, within the grid; nothing where ``first > last``.
    polygon : shapely geometry, optional
        Only voxels whose centre lies in it or on its outline, in units of the CRS.

    Returns
    -------
    selection : Selection
        Blocks that don't meet the region, and all below them, are not visited.

    Raises
    ------
    OptionError
        The polygon is no geometry.
    """
    from volatool.kernels import regions

    directory = volume.directory
    rows = np.zeros(int((first <= last).all()), np.int64)
    blocks = np.zeros((len(rows), 3), np.int64)
    area = None if polygon is None else _Area(polygon, Frame.of(volume), volume.depth)
    is_whole = np.zeros(len(rows), np.bool_)
    for level in range(1, volume.depth + 1):
        shift = 2 * (volume.depth - level)
        words = np.empty(len(rows), np.uint64)
        n = regions.masked_words(directory.rows, rows, blocks, first >> shift, last >> shift, words)
        if level == volume.depth:
            break
        below_rows, below = np.empty(n, np.int64), np.empty((n, 3), np.int64)
        regions.children(directory.rows, rows, blocks, words, below_rows, below)
        rows, blocks = below_rows, below
        if area is not None:
            is_whole = np.repeat(is_whole, np.bitwise_count(words))
            is_kept = area.split(blocks, level, is_whole)
            rows, blocks, is_whole = rows[is_kept], blocks[is_kept], is_whole[is_kept]
    if area is not None and len(rows):
        words[~is_whole] &= area.masks(blocks[~is_whole])
    chosen = words != 0
    index = rows[chosen] - directory.starts[volume.depth - 1]
    return Selection(index, blocks[chosen], words[chosen])


class _Area:
    """A polygon against the centres of voxels, column by column."""

    def __init__(self, polygon: Any, frame: Frame, depth: int) -> None:
        import shapely

        if not isinstance(polygon, shapely.Geometry):
            raise OptionError(
                f"a polygon is a shapely geometry, not {type(polygon).__name__}; "
                "volatool.vola.polygons.read_polygons reads WKT and files"
            )
        if not shapely.is_valid(polygon):  # of one that cuts itself GEOS may fail, or say anything
            polygon = shapely.make_valid(polygon)
        self.polygon, self.frame, self.depth = polygon, frame, depth
        shapely.prepare(polygon)

    def split(self, blocks: I64, level: int, is_whole: Bool) -> Bool:
        """Return which blocks meet the polygon; mark in `is_whole` those that are all in it."""
        import shapely

        is_kept = is_whole.copy()
        open_blocks = np.flatnonzero(~is_whole)
        columns, which = _unique(blocks[open_blocks, :2])
        span = 4 ** (self.depth - level)
        corners = np.zeros((2, len(columns), 3))
        corners[0, :, :2] = columns * span + 0.5
        corners[1, :, :2] = (columns + 1) * span - 0.5
        low, high = self.frame.coordinates(corners)
        boxes = shapely.box(low[:, 0], low[:, 1], high[:, 0], high[:, 1])
        meets = shapely.intersects(self.polygon, boxes)
        is_whole[open_blocks] = (meets & shapely.covers(self.polygon, boxes))[which]
        is_kept[open_blocks] = meets[which]
        return is_kept

    def masks(self, blocks: I64) -> U64:
        """Return which cells of blocks have their centre in the polygon."""
        import shapely

        columns, which = _unique(blocks[:, :2])
        bits = np.arange(16)
        places = np.zeros((len(columns), 16, 3))
        places[:, :, 0] = 4 * columns[:, :1] + (bits & 3) + 0.5
        places[:, :, 1] = 4 * columns[:, 1:] + (bits >> 2) + 0.5
        xyz = self.frame.coordinates(places)
        is_in = shapely.intersects_xy(self.polygon, xyz[:, :, 0], xyz[:, :, 1])
        layer = (is_in.astype(np.uint64) << bits.astype(np.uint64)).sum(axis=1, dtype=np.uint64)
        masks: U64 = (layer * _LAYERS)[which]
        return masks


def _unique(columns: I64) -> tuple[I64, I64]:
    """Return the different (x, y), and which of them each is."""
    keys, which = np.unique(columns[:, 0] << 32 | columns[:, 1], return_inverse=True)
    return np.stack([keys >> 32, keys & 0xFFFFFFFF], axis=1), which.reshape(-1)
