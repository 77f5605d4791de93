"""Points in another CRS while streaming: the same interface as the file they come from."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from types import TracebackType
from typing import Any, Self

import numpy as np
import pyproj
from numpy.typing import NDArray
from pyproj.exceptions import CRSError as ForeignCRSError
from pyproj.exceptions import ProjError

from volatool.cube import Cube
from volatool.errors import CodedWarning, CRSError, FormatError
from volatool.model import F64, I32, Bounds, CrsInfo, PointChunk
from volatool.points.crs import crs_from_user, describe, split
from volatool.points.crs_keys import compound
from volatool.points.crs_places import utm_for
from volatool.points.header import LasHeader
from volatool.points.reader import CHUNK_POINTS
from volatool.points.source import Source

OFFSET_STEP = 1_000_000.0
"""Offsets are multiples of 1000 km, so that tiles of one region share theirs."""

SCALES = (0.001, 0.01, 0.1, 1.0, 10.0)
"""Candidates, finest first: what fits 32 bits is taken."""

DEGREE_SCALE = 1e-7

_INT32 = 2**31 - 1


class Reprojected:
    """
    A source of points in another CRS.

    The coordinates are quantised anew (1 mm, or a decimal multiple that fits the extent). Heights
    stay as they are stored unless the target names a vertical CRS. One pass over the file finds the
    box in the new CRS, which is exact in `header`.

    Parameters
    ----------
    source : Source
        Closed with this one.
    to : str
        ``"EPSG:x"``, ``"EPSG:x+y"``, WKT, or ``"utm"`` for the zone of the middle of the points.

    Attributes
    ----------
    name, path, format, warnings, n_points, is_partial
        Of the source.
    header : LasHeader
        With scale, offset and box in the new CRS.
    own_grid : None
        A grid is none in another CRS.
    crs : CrsInfo
        The new CRS; it keeps the vertical part of the source when `to` has none.

    Raises
    ------
    CRSError
        ``E_CRS``: the source has no CRS, the target is unknown, or the heights can't be brought to
        the target's vertical CRS.
    FormatError
        ``E_BAD_COORDINATE``: a point has no place in the target.
    """

    own_grid: tuple[Cube, int] | None = None
    n_unread = 0

    def __init__(self, source: Source, to: str) -> None:
        self._source = source
        self.name, self.path, self.format = source.name, source.path, source.format
        if source.crs.wkt2 is None:
            raise CRSError(f"{self.name}: has no CRS to reproject from; give it by --crs")
        if to.strip().lower() == "utm":
            to = self._utm()
        self._transformer, self._moves_z, self.crs = _way(source.crs, to, self.name)
        box = self._float_box()
        self._scale, self._offset = _quantization(box, source.header, self.crs, self._moves_z)
        self.header: LasHeader = self._new_header(box)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    @property
    def warnings(self) -> list[CodedWarning]:
        """Warnings of the source."""
        return self._source.warnings

    @property
    def n_points(self) -> int:
        """Points that can be read."""
        return self._source.n_points

    @property
    def is_partial(self) -> bool:
        """Points were lost (salvage only)."""
        return self._source.is_partial

    def read_all(self) -> None:
        """Nothing is left out."""

    def close(self) -> None:
        """Close the source."""
        self._source.close()

    def chunks(
        self, attributes: Iterable[str] = (), chunk_points: int = CHUNK_POINTS
    ) -> Iterator[PointChunk]:
        """Stream the points in file order, as `PointSource.chunks` does."""
        for chunk in self._source.chunks(attributes, chunk_points):
            x, y, z = self._moved(chunk)
            stored_z = self._stored(z, 2) if self._moves_z else chunk.z
            yield PointChunk(
                chunk.start,
                self._stored(x, 0),
                self._stored(y, 1),
                stored_z,
                self._scale,
                self._offset,
                chunk.attributes,
            )

    def _stored(self, values: F64, axis: int) -> I32:
        stored: I32 = np.rint((values - self._offset[axis]) / self._scale[axis]).astype(np.int32)
        return stored

    def _moved(self, chunk: PointChunk) -> tuple[F64, F64, F64]:
        """Return the coordinates of a chunk in the new CRS, z only if it changes."""
        x, y, z = (
            stored * scale + offset
            for stored, scale, offset in zip(
                (chunk.x, chunk.y, chunk.z), chunk.scale, chunk.offset, strict=True
            )
        )
        if self._moves_z:
            new_x, new_y, new_z = self._transformed(x, y, z)
        else:
            new_x, new_y = self._transformed(x, y)
            new_z = z.astype(np.float64, copy=False)
        bad = ~(np.isfinite(new_x) & np.isfinite(new_y) & np.isfinite(new_z))
        if bad.any():
            at = int(np.argmax(bad))
            raise FormatError(
                f"{self.name}: point {chunk.start + at} ({x[at]}, {y[at]}, {z[at]}) has no "
                f"place in {self.crs.horizontal}",
                "E_BAD_COORDINATE",
            )
        return new_x, new_y, new_z

    def _transformed(self, *columns: NDArray[Any]) -> tuple[F64, ...]:
        n = len(columns[0])
        if n == 1:
            # pyproj takes a single point for scalars, which numpy before 2.4 warns of
            columns = tuple(np.repeat(column, 2) for column in columns)
        transform: Callable[..., tuple[F64, ...]] = self._transformer.transform
        moved = transform(*columns)
        return tuple(column[:n] for column in moved)

    def _float_box(self) -> list[float]:
        """Return minimum x, y, z and maximum of all points in the new CRS."""
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        for chunk in self._source.chunks():
            moved = self._moved(chunk)
            low = np.minimum(low, [values.min() for values in moved])
            high = np.maximum(high, [values.max() for values in moved])
        return [*low.tolist(), *high.tolist()]

    def _utm(self) -> str:
        """Return the UTM zone of the middle of the real box, for the header's may be wrong."""
        low, high = np.full(2, np.inf), np.full(2, -np.inf)
        for chunk in self._source.chunks():
            low = np.minimum(low, [chunk.x.min(), chunk.y.min()])
            high = np.maximum(high, [chunk.x.max(), chunk.y.max()])
        if not np.isfinite(low).all():  # no points
            low, high = np.zeros(2), np.zeros(2)
        scale, offset = self._source.header.scale[:2], self._source.header.offset[:2]
        left, bottom = low * scale + offset
        right, top = high * scale + offset
        code = utm_for(self._source.crs, Bounds(left, bottom, right, top))
        if code is None:
            raise CRSError(
                f"{self.name}: no UTM zone for x {left} to {right}, y {bottom} to {top} in "
                f"{self._source.crs.horizontal}; are these coordinates in it?"
            )
        return code

    def _new_header(self, box: list[float]) -> LasHeader:
        """Return the source's header with scale, offset and box of the new CRS."""
        old = self._source.header
        if not math.isfinite(box[0]):  # no points
            return replace(old, scale=self._scale, offset=self._offset)
        exact = []
        for i, value in enumerate(box):
            axis = i % 3
            if axis == 2 and not self._moves_z:
                exact.append(value)
                continue
            stored = int(self._stored(np.array([value]), axis)[0])
            exact.append(stored * self._scale[axis] + self._offset[axis])
        x0, y0, z0, x1, y1, z1 = exact
        return replace(old, scale=self._scale, offset=self._offset, box=(x0, y0, z0, x1, y1, z1))


def _way(source: CrsInfo, to: str, name: str) -> tuple[pyproj.Transformer, bool, CrsInfo]:
    """Return the transformation, whether it changes heights, and the CRS that results."""
    assert source.wkt2 is not None
    target = crs_from_user(to, "to-crs")
    assert target.wkt2 is not None
    try:
        old, new = pyproj.CRS.from_wkt(source.wkt2), pyproj.CRS.from_wkt(target.wkt2)
        old_flat, old_vertical = split(old)
        new_flat, new_vertical = split(new)
        if new_vertical is None and len(new.axis_info) == 2:
            if old_flat.is_geocentric:
                raise CRSError(f"{name}: geocentric coordinates can't be reprojected to {to}")
            way = pyproj.Transformer.from_crs(old_flat, new_flat, always_xy=True)
            whole = new_flat if old_vertical is None else compound(new_flat, old_vertical)
            return way, False, _with_unit_z(describe(whole, "to-crs"), source)
        if old_vertical is None and len(old.axis_info) == 2:
            raise CRSError(
                f"{name}: heights can't be brought to {target.vertical}: the file's own vertical "
                "CRS is unknown; give it by --crs EPSG:x+y, or leave out the vertical part of the "
                "target"
            )
        way = pyproj.Transformer.from_crs(
            old, new, always_xy=True, allow_ballpark=False, only_best=True
        )
    except (ForeignCRSError, ProjError) as error:
        told = str(error).splitlines()[0]
        raise CRSError(
            f"{name}: no transformation from {source.horizontal} + {source.vertical} to {to} "
            f"(a grid of PROJ may be missing): {told}"
        ) from error
    return way, True, target


def _with_unit_z(crs: CrsInfo, source: CrsInfo) -> CrsInfo:
    """Return the CRS with the unit that heights keep; unrecorded, it was the horizontal one."""
    if crs.unit_z is not None:
        return crs
    unit, metres = source.unit_z, source.metres_per_unit_z
    if unit is None and not source.is_geographic:
        unit, metres = source.unit_xy, source.metres_per_unit_xy
    return replace(crs, unit_z=unit, metres_per_unit_z=metres)


def _quantization(
    box: list[float], header: LasHeader, crs: CrsInfo, moves_z: bool
) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Return scale and offset with which the box fits 32 bits."""
    pairs = []
    for axis in range(3):
        low, high = box[axis], box[axis + 3]
        if axis == 2 and not moves_z:
            pairs.append((header.scale[2], header.offset[2]))
        elif axis < 2 and crs.is_geographic:
            pairs.append((DEGREE_SCALE, 0.0))
        elif not math.isfinite(low):
            pairs.append((SCALES[0], 0.0))
        else:
            pairs.append(_scale_for(low, high))
    (sx, ox), (sy, oy), (sz, oz) = pairs
    return (sx, sy, sz), (ox, oy, oz)


def _scale_for(low: float, high: float) -> tuple[float, float]:
    """Return the finest scale, and an offset, with which an interval fits 32 bits."""
    offset = round((low + high) / 2 / OFFSET_STEP) * OFFSET_STEP + 0.0
    reach = max(abs(low - offset), abs(high - offset))
    for scale in SCALES:
        if reach / scale < _INT32:
            return scale, offset
    raise FormatError(
        f"coordinates from {low} to {high} are too far apart to be stored", "E_BAD_COORDINATE"
    )
