"""The volume in memory: levels of 64-bit words, their metadata, and where the cells are.

Levels count from 1 (the root block, 4 x 4 x 4 cells) to the depth, whose cells are the voxels.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from volatool.cube import MAX_DEPTH, Cube
from volatool.errors import FormatError, OptionError, ResourceError
from volatool.model import F64, I32, I64, U64, Bool, Bounds, CrsInfo, LevelCounts
from volatool.vola.info import VolumeInfo
from volatool.vola.rows import rows_of
from volatool.vola.words import count_level, frozen, popcount

if TYPE_CHECKING:
    from volatool.vola.census import Census
    from volatool.vola.components import Components
    from volatool.vola.directory import Directory
    from volatool.vola.neighbours import NeighbourError
    from volatool.vola.path import Path
    from volatool.vola.rays import Hits, Sights
    from volatool.vola.regions import BoxCount, Column
    from volatool.vola.window import Window

__all__ = ["MAX_LEVELS", "Volume", "VolumeInfo", "count_level"]

MAX_LEVELS = 15
"""Deepest volume that can be held: cell indices are int32. Path keys end at `MAX_DEPTH`."""

_SLAB = 1 << 14
_ULPS = 4 * float(np.finfo(np.float64).eps)


@dataclass(frozen=True, eq=False, repr=False)
class Volume:
    """
    An immutable set of voxels in a cube, in VOLA order, with a metadata word per block.

    Parameters
    ----------
    levels : tuple of (n,) arrays of uint64
        Occupancy words, the root level first; the j-th set bit of one level owns the j-th word of
        the next. The last level's bits are the voxels.
    metadata : tuple of (n,) arrays of uint64, or None
        One word per occupancy word, byte c (bits 8c..8c+7) is channel c.
    cube : Cube
        The extent.
    info : VolumeInfo
        CRS, box, channels and origin.

    Raises
    ------
    FormatError
        ``E_CORRUPT``: the number of words of a level is not the number of bits set above it.
    """

    levels: tuple[U64, ...]
    metadata_levels: tuple[U64, ...] | None
    cube: Cube
    info: VolumeInfo = field(default_factory=VolumeInfo)

    def __post_init__(self) -> None:
        if not 1 <= len(self.levels) <= MAX_LEVELS:
            raise ResourceError(
                f"a volume has 1 to {MAX_LEVELS} levels, got {len(self.levels)}", "E_SIZE"
            )
        object.__setattr__(self, "levels", tuple(map(frozen, self.levels)))
        if self.metadata_levels is not None:
            object.__setattr__(self, "metadata_levels", tuple(map(frozen, self.metadata_levels)))
            if [len(words) for words in self.metadata_levels] != [len(w) for w in self.levels]:
                raise FormatError("a volume needs one metadata word for each occupancy word")
        expected = 1
        for level, words in enumerate(self.levels, 1):
            if len(words) != expected:
                raise FormatError(
                    f"level {level} has {len(words)} blocks, the level above it says {expected}"
                )
            expected = popcount(words)

    def __repr__(self) -> str:
        crs = self.crs.horizontal or "no CRS"
        return (
            f"<Volume depth {self.depth}, {len(self)} voxels of {self.cell():g}, "
            f"cube {self.cube.side:g} at {self.cube.origin}, {crs}"
            f"{', metadata' if self.has_metadata else ''}>"
        )

    def __len__(self) -> int:
        return self.n_voxels

    @property
    def depth(self) -> int:
        """Number of levels."""
        return len(self.levels)

    @cached_property
    def n_voxels(self) -> int:
        """Cells set at the deepest level."""
        return popcount(self.levels[-1])

    @property
    def has_metadata(self) -> bool:
        """Whether there is a metadata word for each block."""
        return self.metadata_levels is not None

    @property
    def crs(self) -> CrsInfo:
        """Coordinate reference system."""
        return self.info.crs

    @property
    def bounds(self) -> Bounds:
        """Horizontal rectangle of the points if known, else of the cube."""
        if self.info.box is not None:
            x0, y0, _, x1, y1, _ = self.info.box
            return Bounds(x0, y0, x1, y1)
        x, y, _ = self.cube.origin
        return Bounds(x, y, x + self.cube.side, y + self.cube.side)

    def _level(self, level: int | None) -> int:
        if level is None:
            return self.depth
        if not 1 <= level <= self.depth:
            raise OptionError(
                f"level {level} is not in this volume: it has levels 1 to {self.depth}"
            )
        return level

    def cell(self, level: int | None = None) -> float:
        """Return the edge of a cell at a level, the deepest by default."""
        return self.cube.cell(self._level(level))

    def n_blocks(self, level: int | None = None) -> int:
        """Return the number of stored blocks (words) of a level, the deepest by default."""
        return len(self.levels[self._level(level) - 1])

    def n_cells(self, level: int | None = None) -> int:
        """Return the number of cells set at a level, the deepest by default."""
        level = self._level(level)
        return self.n_voxels if level == self.depth else len(self.levels[level])

    def truncated(self, depth: int) -> Volume:
        """Return the same volume to a smaller depth; the arrays are shared."""
        depth = self._level(depth)
        metadata = None if self.metadata_levels is None else self.metadata_levels[:depth]
        return Volume(self.levels[:depth], metadata, self.cube, self.info)

    def keys(self, level: int | None = None) -> U64:
        """
        Return the path keys of the cells set at a level.

        Parameters
        ----------
        level : int, optional
            1 to `depth`; the deepest by default.

        Returns
        -------
        keys : (n,) array of uint64
            Ascending: VOLA order. Six bits a level, root first.
        """
        level = self._level(level)
        if level > MAX_DEPTH:
            raise ResourceError(f"path keys end at level {MAX_DEPTH}, not {level}", "E_SIZE")
        from volatool.kernels import words

        keys = np.zeros(1, np.uint64)
        for i in range(level):
            keys = words.child_keys(self.levels[i], keys, self.n_cells(i + 1))
        return keys

    def block_keys(self, level: int | None = None) -> U64:
        """Return the path keys of the stored blocks of a level, in the order of its words."""
        level = self._level(level)
        return self.keys(level - 1) if level > 1 else np.zeros(1, np.uint64)

    def window(
        self,
        bounds: Bounds | Sequence[float] | None = None,
        level: int | None = None,
        *,
        z: tuple[float, float] | None = None,
    ) -> Window:
        """
        Return a box of cells, for ``.to_numpy()``.

        Parameters
        ----------
        bounds : Bounds or four float, optional
            Closed rectangle, in units of the CRS; the whole cube by default.
        level : int, optional
            1 to `depth`; the deepest by default.
        z : tuple of 2 float, optional
            Lowest and highest, in the vertical unit.

        Returns
        -------
        window : Window
            ``.to_numpy()`` is a bool array with axes x, y, z; ``.origin``, ``.cell``, ``.level``.
        """
        from volatool.vola.window import window_of

        return window_of(self, bounds, level, z=z)

    def voxels(self, level: int | None = None) -> I32:
        """
        Return the indices of the cells set at a level.

        Parameters
        ----------
        level : int, optional
            1 to `depth`; the deepest by default.

        Returns
        -------
        voxels : (n, 3) array of int32
            x, y, z from the cube's corner, 0 to ``4**level - 1``, in VOLA order.
        """
        from volatool.kernels import words

        cells = np.zeros((1, 3), np.int32)
        for i in range(self._level(level)):
            cells = words.child_cells(self.levels[i], cells, self.n_cells(i + 1))
        return cells

    def _is_rounded(self) -> bool:
        return self.info.quantizer != "floor"

    def centers(self, level: int | None = None) -> F64:
        """
        Return the best estimate of the place of each cell set at a level.

        Parameters
        ----------
        level : int, optional
            1 to `depth`; the deepest by default.

        Returns
        -------
        centers : (n, 3) array of float64
            In units of the CRS (z in the vertical unit), in VOLA order. Middles of the cells; for
            volumes of the original toolkit the points that it rounded to.
        """
        level = self._level(level)
        cells = self.voxels(level).astype(np.float64)
        if self._is_rounded():
            span = 4 ** (self.depth - level)
            cells = cells * span + (span - 1) / 2
            step = self.cube.side / (4**self.depth - 1)
        else:
            cells += 0.5
            step = self.cube.cell(level)
        centers: F64 = cells * step + np.asarray(self.cube.origin)
        centers[:, 2] /= float(self.crs.z_ratio)
        return centers

    def cell_indices(self, xyz: ArrayLike, level: int | None = None) -> I64:
        """
        Return the cell that each point falls into, set or not.

        Parameters
        ----------
        xyz : (n, 3) array of float
            In units of the CRS (z in the vertical unit).
        level : int, optional
            1 to `depth`; the deepest by default.

        Returns
        -------
        cells : (n, 3) array of int64
            x, y, z; -1 for points outside the closed cube or not finite.

        Notes
        -----
        A point within rounding error of a face (4 units in the last place of the coordinate)
        counts as on it, and so belongs to the cell above.
        """
        level = self._level(level)
        points = rows_of(xyz)
        cells = np.empty(points.shape, np.int64)
        for start in range(0, len(points), _SLAB):  # temporary arrays stay in the cache
            piece = slice(start, start + _SLAB)
            for axis in range(3):
                cells[piece, axis] = self._axis_cells(points[piece, axis], axis, level)
            cells[piece][(cells[piece] < 0).any(axis=1)] = -1
        return cells

    def _axis_cells(self, places: F64, axis: int, level: int) -> I64:
        """Cell of each coordinate of one axis, -1 outside."""
        if axis == 2 and self.crs.z_ratio != 1:
            places = places * float(self.crs.z_ratio)
        corner, side, size = self.cube.origin[axis], self.cube.side, 4**level
        error = _ULPS * np.maximum(np.abs(places), abs(corner))
        away = places - corner
        # false for NaN; the error of an infinite place is infinite, so it would be inside
        inside = np.isfinite(places) & (away >= -error) & (away <= side + error)
        away = np.where(inside, away, 0.0)
        if not side:
            cells = np.zeros(len(away), np.int64)
        elif self._is_rounded():
            nodes = 4**self.depth - 1
            extent = (corner + self._rounded_side) - corner  # the toolkit's, to the last bit
            cells = np.rint(nodes * np.clip(away / extent, 0.0, 1.0)).astype(np.int64)
            cells >>= 2 * (self.depth - level)
        else:
            np.add(away, error, out=away, where=inside)
            cells = np.minimum(np.maximum(away, 0.0) * (size / side), size - 1).astype(np.int64)
        cells[~inside] = -1
        return cells

    @cached_property
    def _rounded_side(self) -> float:
        """Side as the toolkit has it: a difference of floats, where the cube's is of decimals."""
        if self.info.box is None:
            return self.cube.side
        box = self.info.box
        side = max(high - low for low, high in zip(box[:3], box[3:], strict=True))
        return side if math.isclose(side, self.cube.side, rel_tol=1e-9) else self.cube.side

    def contains(self, xyz: ArrayLike) -> Bool:
        """
        Tell which points fall into a voxel.

        Parameters
        ----------
        xyz : (n, 3) array of float
            In units of the CRS (z in the vertical unit).

        Returns
        -------
        contained : (n,) array of bool
            False outside the cube and for coordinates that are not finite.
        """
        if self._is_rounded() or not self.cube.side:
            return self.contains_cells(self.cell_indices(xyz))
        from volatool.vola.query import contains

        return contains(self, xyz)

    def contains_cells(self, cells: ArrayLike, level: int | None = None) -> Bool:
        """
        Tell which cells are set.

        Parameters
        ----------
        cells : (n, 3) array of int
            x, y, z; outside the grid is not set.
        level : int, optional
            1 to `depth`; the deepest by default.

        Returns
        -------
        contained : (n,) array of bool
        """
        found: Bool = self.find(cells, level) >= 0
        return found

    def find(self, cells: ArrayLike, level: int | None = None) -> I64:
        """
        Return the place of cells in VOLA order.

        Parameters
        ----------
        cells : (n, 3) array of int
            x, y, z; outside the grid is not set.
        level : int, optional
            1 to `depth`; the deepest by default.

        Returns
        -------
        index : (n,) array of int64
            Row of the cell in `voxels` (and of its block in the next level), -1 if it is not set.
        """
        level = self._level(level)
        indices: I64 = np.ascontiguousarray(rows_of(cells, 3, np.int64, what="cells"))
        return self.directory.find(indices, level)

    def ray(
        self, origin: ArrayLike, direction: ArrayLike, max_distance: ArrayLike | None = None
    ) -> Hits:
        """Return the first voxel that each ray meets: `volatool.vola.rays.cast`."""
        from volatool.vola.rays import cast

        return cast(self, origin, direction, max_distance)

    def sight(self, a: ArrayLike, b: ArrayLike, *, ignore_ends: bool = False) -> Sights:
        """Tell whether points see each other: `volatool.vola.rays.sight`."""
        from volatool.vola.rays import sight

        return sight(self, a, b, ignore_ends=ignore_ends)

    def box(self, low: ArrayLike, high: ArrayLike) -> BoxCount:
        """Count what is in a box: `volatool.vola.regions.count_box`."""
        from volatool.vola.regions import count_box

        return count_box(self, low, high)

    def column(self, x: float, y: float) -> Column:
        """Return the occupied runs over a place, top to bottom; see `columns`."""
        return self.columns([[x, y]])[0]

    def columns(self, xy: ArrayLike) -> list[Column]:
        """Return the occupied runs over places: `volatool.vola.regions.columns`."""
        from volatool.vola.regions import columns

        return columns(self, xy)

    def census(
        self,
        box: Bounds | Sequence[float] | None = None,
        *,
        z: tuple[float, float] | None = None,
        polygon: Any | None = None,
        bands: Sequence[float] = (),
    ) -> Census:
        """Count a region by class, height and metadata: `volatool.vola.census.census`."""
        from volatool.vola.census import census

        return census(self, box, z=z, polygon=polygon, bands=bands)

    def neighbours(
        self,
        xyz: ArrayLike,
        *,
        connectivity: int = 26,
        radius: float | None = None,
        exact: bool = True,
    ) -> I64:
        """Count the voxels around points' cells: `volatool.vola.neighbours.count`."""
        from volatool.vola.neighbours import count

        return count(self, xyz, connectivity=connectivity, radius=radius, exact=exact)

    def neighbour_error(self, connectivity: int = 26) -> NeighbourError:
        """Measure what inside blocks is missed: `volatool.vola.neighbours.error_by_block`."""
        from volatool.vola.neighbours import error_by_block

        return error_by_block(self, connectivity)

    @cached_property
    def directory(self) -> Directory:
        """Rank directory, made when it is first needed."""
        from volatool.vola.directory import Directory

        return Directory.of(self.levels)

    def metadata_words(self, level: int | None = None) -> U64:
        """
        Return the metadata words of the blocks of a level.

        Parameters
        ----------
        level : int, optional
            1 to `depth`; the deepest by default.

        Returns
        -------
        words : (n,) array of uint64
            In the order of the level's occupancy words.

        Raises
        ------
        OptionError
            ``E_NO_METADATA``: the volume has none.
        """
        if self.metadata_levels is None:
            raise OptionError("this volume has no metadata", "E_NO_METADATA")
        return self.metadata_levels[self._level(level) - 1]

    def metadata(self, level: int | None = None) -> U64:
        """
        Return the metadata word of each cell set at a level: that of its block.

        Parameters
        ----------
        level : int, optional
            1 to `depth`; the deepest by default.

        Returns
        -------
        words : (n,) array of uint64
            In the order of `voxels`. ``words.view(np.uint8).reshape(-1, 8)`` is its bytes on a
            little-endian machine.
        """
        level = self._level(level)
        per_block = self.metadata_words(level)
        repeated: U64 = np.repeat(per_block, np.bitwise_count(self.levels[level - 1]))
        return repeated

    def channel(self, name: str, level: int | None = None) -> F64:
        """
        Return one metadata channel, decoded, for each cell set at a level.

        Parameters
        ----------
        name : str
            As `info.channels` has it: ``"red"``, ``"height"``, ``"class"``, ...
        level : int, optional
            1 to `depth`; the deepest by default.

        Returns
        -------
        values : (n,) array of float64
            ``byte * scale + offset``, in the channel's unit.
        """
        for channel in self.info.channels:
            if channel["name"] == name:
                shift = np.uint64(8 * int(channel["byte"]))
                data = (self.metadata(level) >> shift) & np.uint64(255)
                values: F64 = data.astype(np.float64) * float(channel["scale"])
                values += float(channel["offset"])
                return values
        names = ", ".join(str(channel["name"]) for channel in self.info.channels) or "none"
        raise OptionError(f"no metadata channel {name!r}; known: {names}", "E_NO_METADATA")

    def components(self, connectivity: int = 26, level: int | None = None) -> Components:
        """
        Find the connected components of a level's set cells, the largest first.

        Parameters
        ----------
        connectivity : int
            26: over faces, edges and corners. 6: over faces only.
        level : int, optional
            1 to `depth`; the deepest by default.

        Returns
        -------
        components : Components
            ``len()`` is their number; ``sizes``, ``boxes``, ``bounds``, and ``labels`` in the
            order of `voxels`.
        """
        from volatool.vola.components import components

        return components(self, connectivity, level)

    def clearance(self, xyz: ArrayLike, level: int | None = None, *, to: str = "box") -> F64:
        """
        Return the distance from each point to the nearest occupied cell.

        Parameters
        ----------
        xyz : (n, 3) array of float
            In units of the CRS (z in the vertical unit), inside the cube or not.
        level : int, optional
            1 to `depth`; the deepest by default.
        to : {"box", "centre"}
            To the cell's box, 0 inside; or to its middle.

        Returns
        -------
        distances : (n,) array of float64
            In the horizontal unit of the CRS; infinity when the volume is empty.
        """
        from volatool.vola.clearance import clearance

        return clearance(self, xyz, level, to=to)

    def path(
        self, a: ArrayLike, b: ArrayLike, clearance: float = 0.0, **options: Any
    ) -> Path | None:
        """
        Find a short way between two places through free space.

        Parameters
        ----------
        a, b : (3,) array of float
            The ends, in units of the CRS (z in the vertical unit).
        clearance : float
            Distance that the whole line keeps from occupied voxels' boxes, in the horizontal unit.
        **options
            ``z``, ``level``, ``factor``, ``smooth``, ``max_cells``, as
            `volatool.vola.path.find_path` has them.

        Returns
        -------
        path : Path or None
            ``points``, ``length``, ``clearance``, ...; None when there is no way.

        Raises
        ------
        PathEndError
            ``E_PATH_END``: an end is outside the cube, in a voxel, or nearer to one than
            `clearance`.
        ResourceError
            ``E_SIZE``: undecided within ``max_cells``.
        """
        from volatool.vola.path import find_path

        return find_path(self, a, b, clearance, **options)

    def counts(self) -> list[LevelCounts]:
        """Return the exact counts of each level, the root first."""
        return [count_level(words) for words in self.levels]

    def volume(self) -> float:
        """
        Return the volume of the voxels.

        Returns
        -------
        volume : float
            In the cubed horizontal unit of the CRS, heights brought to it.
        """
        from volatool.vola.algebra import voxel_size

        return len(self) * float(voxel_size(self))

    def volume_m3(self) -> float | None:
        """Return the volume of the voxels in cubic metres, None if the unit is not known."""
        metres = self.crs.metres_per_unit_xy
        return None if metres is None else self.volume() * float(metres**3)

    def __or__(self, other: Volume) -> Volume:
        """Return the union; see `volatool.vola.algebra.combine`."""
        return self._combined(other, "or")

    def __and__(self, other: Volume) -> Volume:
        """Return the intersection."""
        return self._combined(other, "and")

    def __xor__(self, other: Volume) -> Volume:
        """Return the voxels that one of both has."""
        return self._combined(other, "xor")

    def __sub__(self, other: Volume) -> Volume:
        """Return the voxels that the other does not have."""
        return self._combined(other, "sub")

    def crop(
        self,
        bounds: Bounds | Sequence[float] | None = None,
        *,
        z: tuple[float, float] | None = None,
    ) -> Volume:
        """Return the part in a box, on the same grid: `volatool.vola.algebra.crop`."""
        from volatool.vola.algebra import crop

        return crop(self, bounds, z=z)

    def downsample(self, depth: int | None = None) -> Volume:
        """Return the volume of fewer levels, one less by default: exact, as `truncated`."""
        return self.truncated(self.depth - 1 if depth is None else depth)

    def regrid(self, cube: Cube, depth: int) -> Volume:
        """Return the volume on another grid: `volatool.vola.regrid.regrid`."""
        from volatool.vola.regrid import regrid

        return regrid(self, cube, depth)

    def _combined(self, other: Volume, op: str) -> Volume:
        if not isinstance(other, Volume):
            return NotImplemented
        from volatool.vola.algebra import combine

        return combine(self, other, op)
