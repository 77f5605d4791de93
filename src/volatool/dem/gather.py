"""Points for a surface, taken from the stream as it passes: ground, first returns, or all.

Without a ground class, ground is what the ground filter keeps of all points.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from volatool.emap.ground import GroundFilter
from volatool.errors import CodedWarning, InputError, OptionError
from volatool.model import CrsInfo, PointChunk, as_fraction
from volatool.scratch import Scratch, Spool

SURFACES = ("auto", "dtm", "dsm", "min", "max", "mean", "idw", "tin")
BARE = ("auto", "dtm", "idw", "tin")
"""Surfaces of the ground."""

GROUND = 2
ROW = np.dtype((np.int32, (3,)))
"""A point in a spool: stored x, y, z."""

SHARE = 0.25
"""Part of the memory budget that may be in use before points go to a file."""


@dataclass(frozen=True, slots=True)
class SurfacePoints:
    """
    The points of a file that a surface is made from.

    Parameters
    ----------
    name : str
        One of `SURFACES`, but never ``"auto"``.
    ground_source : str
        ``"class 2"``, ``"ground filter"``, ``"first returns"``, ``"lowest point per cell"``,
        ``"highest point per cell"``, ``"mean of the points per cell"``.
    spool : Spool
        Rows of int32 x, y, z in file order.
    scale, offset : tuple of 3 float
        Of the stored integers.
    extent : tuple of 4 int or None
        Smallest and largest stored x, y (x0, y0, x1, y1) of *all* points that were added, used
        for the surface or not: the DEM covers them. None without any.
    z_range : tuple of 2 int
        Smallest and largest stored z of the spool; 0, 0 when it is empty.
    warnings : tuple of CodedWarning
        ``W_NO_GROUND_CLASS``.
    beyond : Spool or None
        Points beyond the tile's edge, behind the others.
    """

    name: str
    ground_source: str
    spool: Spool
    scale: tuple[float, float, float]
    offset: tuple[float, float, float]
    extent: tuple[int, int, int, int] | None
    z_range: tuple[int, int] = (0, 0)
    warnings: tuple[CodedWarning, ...] = ()
    beyond: Spool | None = None

    def __len__(self) -> int:
        return len(self.spool) + (0 if self.beyond is None else len(self.beyond))

    @property
    def box(self) -> tuple[Fraction, Fraction, Fraction, Fraction] | None:
        """Exact left, bottom, right, top of all points that were added."""
        if self.extent is None:
            return None
        sides = [
            stored * as_fraction(self.scale[k % 2]) + as_fraction(self.offset[k % 2])
            for k, stored in enumerate(self.extent)
        ]
        return (sides[0], sides[1], sides[2], sides[3])

    def pieces(self) -> Iterable[NDArray[np.int32]]:
        """Yield (n, 3) arrays of int32 x, y, z in file order."""
        for spool in (self.spool, self.beyond):
            for rows in () if spool is None else spool.pieces():
                # rows read back from a file are read-only, which would be another kernel signature
                yield rows if rows.flags.writeable else rows.copy()

    def close(self) -> None:
        """Drop the points."""
        self.spool.close()
        if self.beyond is not None:
            self.beyond.close()


@dataclass(slots=True)
class Beyond:
    """
    Points of other files around a tile, as the tile would have stored them.

    Parameters
    ----------
    spool : Spool
        Rows of int32 x, y, z.
    extent : tuple of 4 int or None
        Smallest and largest stored x, y of all that were added.
    z_range : tuple of 2 int or None
        Smallest and largest stored z of the spool.
    """

    spool: Spool
    extent: tuple[int, int, int, int] | None = None
    z_range: tuple[int, int] | None = None


class SurfaceGatherer:
    """
    Pick the points of a surface from a stream of chunks.

    Parameters
    ----------
    surface : str
        ``auto``, ``dtm``, ``idw``, ``tin`` (ground-class points when there are any, else those that
        the ground filter keeps), ``dsm`` (first returns), ``min``, ``max``, ``mean`` (all).
    scratch : Scratch
        Where points wait.
    dimensions : iterable of str
        Attributes that the file's point format has.
    """

    def __init__(self, surface: str, scratch: Scratch, dimensions: Iterable[str]) -> None:
        if surface not in SURFACES:
            raise OptionError(f"--surface must be one of {', '.join(SURFACES)}, got {surface!r}")
        self.surface = surface
        self.scratch = scratch
        self.dimensions = frozenset(dimensions)
        self.spool = Spool(scratch, ROW, SHARE)
        self._has_ground = False
        self._scaling: tuple[Any, Any] | None = None
        self._extent: tuple[int, int, int, int] | None = None
        self._z_range: tuple[int, int] | None = None

    @property
    def attributes(self) -> frozenset[str]:
        """Attributes that the chunks must bring, of those the file has."""
        return self.dimensions & self.wanted

    @property
    def wanted(self) -> frozenset[str]:
        """Attributes that choose the points, whether the file has them or not."""
        names = {**dict.fromkeys(BARE, "classification"), "dsm": "return_number"}
        return frozenset({names[self.surface]} if self.surface in names else ())

    @property
    def is_bare(self) -> bool:
        """The surface is the ground."""
        return self.surface in BARE

    @property
    def has_ground(self) -> bool:
        """A point of the ground class has come."""
        return self._has_ground

    def add(self, chunk: PointChunk) -> None:
        """
        Take what the surface needs of a chunk.

        Parameters
        ----------
        chunk : PointChunk
            Selected points in file order; all chunks of one file.
        """
        if not len(chunk):
            return
        self._scaling = (chunk.scale, chunk.offset)
        self._extent = _hull(self._extent, _extent(chunk.x, chunk.y))
        self._keep(chunk, self._mask(chunk))

    def add_beyond(self, chunk: PointChunk, beyond: Beyond) -> int:
        """
        Take what the surface needs of another file's points, after all of the tile's own.

        Ground is of the kind that the tile's is: class 2, or all points for the filter.

        Parameters
        ----------
        chunk : PointChunk
            Selected points of a neighbour.
        beyond : Beyond
            Added to, in the tile's scale and offset: rounded where the neighbour's are finer.

        Returns
        -------
        n_ground : int
            Points of the ground class among them.
        """
        if not len(chunk) or self._scaling is None:
            return 0
        classes = chunk.attributes.get("classification") if self.is_bare else None
        ground = None if classes is None else classes == GROUND
        mask = None
        if self._has_ground:
            mask = np.zeros(len(chunk), np.bool_) if ground is None else ground
        elif self.surface == "dsm":
            mask = self._mask(chunk)
        kept = chunk if mask is None else chunk.take(mask)
        rows = _restored(kept, *self._scaling)
        if len(rows):
            beyond.extent = _hull(beyond.extent, _extent(rows[:, 0], rows[:, 1]))
            low, high = int(rows[:, 2].min()), int(rows[:, 2].max())
            old = beyond.z_range or (low, high)
            beyond.z_range = (min(old[0], low), max(old[1], high))
            beyond.spool.append(rows)
        return 0 if ground is None else int(np.count_nonzero(ground))

    @property
    def box(self) -> tuple[Fraction, Fraction, Fraction, Fraction] | None:
        """Exact left, bottom, right, top of all points that were added."""
        return self._points(None).box

    def spacing(self, crs: CrsInfo) -> float:
        """Return the mean spacing of the points kept so far, in the horizontal unit."""
        from volatool.dem.cell import mean_spacing

        return mean_spacing(self._points(None), crs.metres_per_unit_xy)

    def close(self) -> None:
        """Drop the points that wait."""
        self.spool.close()

    def _mask(self, chunk: PointChunk) -> NDArray[np.bool_] | None:
        """Points that the surface is made from; None for all of them."""
        if self.surface in BARE:
            classes = chunk.attributes.get("classification")
            ground = None if classes is None else classes == GROUND
            if not self._has_ground and ground is not None and ground.any():
                # what was kept so far was for the case that no ground class ever comes
                self.spool.close()
                self.spool = Spool(self.scratch, ROW, SHARE)
                self._z_range = None
                self._has_ground = True
            if not self._has_ground:
                return None
            return np.zeros(len(chunk), bool) if ground is None else ground
        if self.surface == "dsm":
            returns = chunk.attributes.get("return_number")
            # 0 is what formats and writers without returns leave there: take those too
            return None if returns is None else returns <= 1
        return None

    def _keep(self, chunk: PointChunk, mask: NDArray[np.bool_] | None) -> None:
        n = len(chunk) if mask is None else int(np.count_nonzero(mask))
        if not n:
            return
        rows = np.empty((n, 3), np.int32)
        for axis, stored in enumerate((chunk.x, chunk.y, chunk.z)):
            rows[:, axis] = stored if mask is None or n == len(chunk) else stored[mask]
        low, high = int(rows[:, 2].min()), int(rows[:, 2].max())
        old = self._z_range or (low, high)
        self._z_range = (min(old[0], low), max(old[1], high))
        self.spool.append(rows)

    def result(
        self, crs: CrsInfo | None = None, beyond: Beyond | None = None, threads: int = 1
    ) -> SurfacePoints:
        """
        Return the points, with the honest name of the surface they make.

        Parameters
        ----------
        crs : CrsInfo, optional
            Units, for the ground filter; metres by default.
        beyond : Beyond, optional
            Points of neighbours. The tile's own points are kept then, for another try: `close`.
        threads : int
            Never changes the result.

        Raises
        ------
        InputError
            ``E_NO_GROUND``: no point has the ground class and the ground filter keeps none.
        """
        points = self._points(beyond)
        if self.is_bare and not self._has_ground and len(points):
            try:
                return _bare_earth(points, crs or CrsInfo(), self.scratch, threads)
            finally:
                if beyond is None:
                    points.close()
        return points

    def _points(self, beyond: Beyond | None) -> SurfacePoints:
        sources = {
            "dsm": "first returns",
            "min": "lowest point per cell",
            "max": "highest point per cell",
            "mean": "mean of the points per cell",
        }
        name = "dtm" if self.surface == "auto" else self.surface
        scale, offset = self._scaling or ((1.0, 1.0, 1.0), (0.0, 0.0, 0.0))
        extent, z_range = self._extent, self._z_range
        if beyond is not None and beyond.extent is not None and beyond.z_range is not None:
            extent = _hull(extent, beyond.extent)
            low, high = z_range or beyond.z_range
            z_range = (min(low, beyond.z_range[0]), max(high, beyond.z_range[1]))
        return SurfacePoints(
            name,
            sources.get(name, "class 2"),
            self.spool,
            scale,
            offset,
            extent,
            z_range or (0, 0),
            beyond=None if beyond is None else beyond.spool,
        )


def _extent(x: NDArray[np.int32], y: NDArray[np.int32]) -> tuple[int, int, int, int]:
    return (int(x.min()), int(y.min()), int(x.max()), int(y.max()))


def _hull(
    one: tuple[int, int, int, int] | None, other: tuple[int, int, int, int]
) -> tuple[int, int, int, int]:
    old = one or other
    return (
        min(old[0], other[0]),
        min(old[1], other[1]),
        max(old[2], other[2]),
        max(old[3], other[3]),
    )


def _restored(
    chunk: PointChunk,
    scale: tuple[float, float, float],
    offset: tuple[float, float, float],
) -> NDArray[np.int32]:
    """Return the rows of a chunk as another scale and offset store them, rounded half up."""
    rows = np.empty((len(chunk), 3), np.int32)
    for axis, stored in enumerate((chunk.x, chunk.y, chunk.z)):
        factor = as_fraction(chunk.scale[axis]) / as_fraction(scale[axis])
        shift = as_fraction(chunk.offset[axis]) - as_fraction(offset[axis])
        shift /= as_fraction(scale[axis])
        if factor == 1 and shift == 0:
            rows[:, axis] = stored
            continue
        if factor == 1 and shift.denominator == 1:
            moved = stored.astype(np.int64) + int(shift)
        else:
            moved = np.floor(stored * float(factor) + float(shift) + 0.5).astype(np.int64)
        if len(moved) and max(-int(moved.min()), int(moved.max())) >= 2**31:
            raise InputError(
                "a neighbour's points are too far off to be stored with the tile's scale and offset"
            )
        rows[:, axis] = moved
    return rows


def _bare_earth(
    points: SurfacePoints, crs: CrsInfo, scratch: Scratch, threads: int = 1
) -> SurfacePoints:
    """Return the points that the ground filter keeps."""
    ground = GroundFilter(
        points, crs.metres_per_unit_xy, crs.metres_per_unit_z, scratch, threads=threads
    )
    spool = Spool(scratch, ROW, SHARE)
    z_range: tuple[int, int] | None = None
    for rows in points.pieces():
        kept = np.compress(ground.keeps(rows), rows, axis=0)  # five times as fast as rows[...]
        if len(kept):
            low, high = int(kept[:, 2].min()), int(kept[:, 2].max())
            old = z_range or (low, high)
            z_range = (min(old[0], low), max(old[1], high))
            spool.append(kept)
    ground.free()
    n_points = len(points)
    if z_range is None:
        raise InputError(
            "no point has the ground class (2) and the ground filter keeps none; "
            "use --surface min for the lowest point per cell",
            "E_NO_GROUND",
        )
    message = (
        f"no point has the ground class (2): the DEM is made from the {len(spool)} of {n_points} "
        "points that the ground filter kept"
    )
    if ground.cell_m > 1:
        message += f"; its finest cells are {ground.cell_m:g} m, as the points are sparse"
    return replace(
        points,
        ground_source="ground filter",
        spool=spool,
        beyond=None,
        z_range=z_range,
        warnings=(CodedWarning("W_NO_GROUND_CLASS", message),),
    )
