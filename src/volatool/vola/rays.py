"""Rays and lines of sight through a volume."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from volatool.errors import OptionError
from volatool.model import F64, I64, Bool
from volatool.vola.frame import Frame
from volatool.vola.rows import rows_of

if TYPE_CHECKING:
    from volatool.vola.volume import Volume


@dataclass(frozen=True, slots=True)
class Hits:
    """
    The first voxel that each of n rays meets.

    Parameters
    ----------
    voxels : (n, 3) array of int64
        x, y, z from the cube's corner; -1 where nothing is met.
    index : (n,) array of int64
        Row of the voxel in `Volume.voxels`, -1 without.
    distance : (n,) array of float64
        From the origin, in the horizontal unit; 0 for a ray that starts in a voxel, infinite
        where nothing is met.
    points : (n, 3) array of float64
        Where the ray comes into the voxel, in units of the CRS (z in the vertical unit); NaN
        without.
    blocks : (n,) array of int64
        How many blocks were looked into.
    """

    voxels: I64
    index: I64
    distance: F64
    points: F64
    blocks: I64

    def __len__(self) -> int:
        return len(self.index)

    @property
    def is_hit(self) -> Bool:
        """Which rays meet a voxel, (n,) array of bool."""
        return self.index >= 0


@dataclass(frozen=True, slots=True)
class Sights:
    """
    Whether n pairs of points see each other.

    Parameters
    ----------
    is_clear : (n,) array of bool
        Nothing is between them. False also where a coordinate, or what is between, is not finite.
    blockers : Hits
        The first voxel in the way, seen from the first point.
    length : (n,) array of float64
        Between the points, in the horizontal unit.
    """

    is_clear: Bool
    blockers: Hits
    length: F64

    def __len__(self) -> int:
        return len(self.is_clear)


def cast(
    volume: Volume, origin: ArrayLike, direction: ArrayLike, max_distance: ArrayLike | None = None
) -> Hits:
    """
    Return the first voxel that each ray meets.

    Parameters
    ----------
    volume : Volume
        The voxels.
    origin, direction : (3,) or (n, 3) arrays of float
        In units of the CRS, z in the vertical unit; a direction's length does not matter. One
        origin with many directions, or the other way round, is repeated.
    max_distance : float or (n,) array of float, optional
        In the horizontal unit, inclusive; no limit by default.

    Returns
    -------
    hits : Hits
        A ray meets the voxels that one of its points falls into by the rule of
        `Volume.contains`: cells are half-open, a face, edge or corner belongs to the cell above it.
        What is not finite meets nothing.

    Raises
    ------
    OptionError
        A direction is zero, a distance negative or NaN, or the shapes don't fit.
    """
    origins, directions = _pairs(origin, direction)
    if (directions == 0).all(axis=1).any():
        raise OptionError("a ray needs a direction that is not zero")
    frame = Frame.of(volume)
    scaled, _ = _scaled(frame.directions(directions))
    lengths = np.linalg.norm(scaled, axis=1)
    limits = np.full(len(origins), np.inf)
    if max_distance is not None:
        given = np.asarray(max_distance, np.float64).reshape(-1)
        if not (given >= 0).all():
            raise OptionError("the distance that a ray is followed must be 0 or more")
        if len(given) not in (1, len(origins)):
            raise OptionError(f"{len(origins)} rays have {len(given)} largest distances")
        with np.errstate(all="ignore"):
            limits = given / (lengths * (frame.step or 1.0))
    skips = np.full((len(origins), 2, 3), -1, np.int64)
    return _cast(volume, frame, origins, scaled, limits, skips)


def sight(volume: Volume, a: ArrayLike, b: ArrayLike, *, ignore_ends: bool = False) -> Sights:
    """
    Tell whether points see each other: whether no voxel is between them.

    Parameters
    ----------
    volume : Volume
        The voxels. What is outside the cube is free.
    a, b : (3,) or (n, 3) arrays of float
        In units of the CRS, z in the vertical unit; one point against many is repeated.
    ignore_ends : bool
        The voxels that hold the two points are no obstacles: eyes and targets stand on surfaces.

    Returns
    -------
    sights : Sights
        By the same rule as `cast`; both ends belong to the line.

    Raises
    ------
    OptionError
        The shapes don't fit.
    """
    starts, ends = _pairs(a, b)
    frame = Frame.of(volume)
    with np.errstate(all="ignore"):
        between = frame.places(ends) - frame.places(starts)
        away = (ends - starts) * [1.0, 1.0, frame.z_ratio]
        # not the root of the sum of squares, which overflow
        length: F64 = np.hypot(np.hypot(away[:, 0], away[:, 1]), away[:, 2])
        scaled, exponent = _scaled(between)
        limits = np.ldexp(1.0, exponent)
    skips = np.full((len(starts), 2, 3), -1, np.int64)
    if ignore_ends:
        skips[:, 0] = volume.cell_indices(starts)
        skips[:, 1] = volume.cell_indices(ends)
    hits = _cast(volume, frame, starts, scaled, limits, skips)
    is_known = np.isfinite(length) & np.isfinite(between).all(axis=1)
    return Sights(is_known & ~hits.is_hit, hits, length)


def _pairs(a: ArrayLike, b: ArrayLike) -> tuple[F64, F64]:
    """Return two (n, 3) arrays."""
    try:
        left, right = np.broadcast_arrays(np.asarray(a, np.float64), np.asarray(b, np.float64))
        return rows_of(left), rows_of(right)
    except ValueError as error:
        raise OptionError(f"expected rows of x, y, z, as many or one: {error}") from error


def _scaled(directions: F64) -> tuple[F64, I64]:
    """Return directions with components below 1, by powers of two: ties stay ties."""
    with np.errstate(all="ignore"):
        largest = np.abs(directions).max(axis=1, initial=0.0)
        _, exponent = np.frexp(np.where(np.isfinite(largest), largest, 1.0))
        return np.ldexp(directions, -exponent[:, None]), exponent.astype(np.int64)


def _cast(
    volume: Volume, frame: Frame, origins: F64, directions: F64, limits: F64, skips: I64
) -> Hits:
    from volatool.kernels import ray

    n = len(origins)
    cells = np.empty((n, 3), np.int64)
    found, blocks = np.empty(n, np.int64), np.empty(n, np.int64)
    ts = np.empty(n)
    places = frame.places(origins)
    is_usable = np.logical_and.reduce(np.isfinite(np.hstack([places, directions])), axis=1)
    places = np.where(is_usable[:, None], places, -1.0)
    usable = np.where(is_usable[:, None], directions, 0.0)
    limits = np.ascontiguousarray(limits, np.float64)
    directory = volume.directory
    ray.cast(directory.rows, volume.depth, places, usable, limits, skips, cells, found, ts, blocks)
    is_hit = found >= 0
    with np.errstate(all="ignore"):
        along = np.where(is_hit, ts * frame.step, np.nan)[:, None] * directions
        distance = np.where(is_hit, ts * frame.step * np.linalg.norm(usable, axis=1), np.inf)
    along[:, 2] /= frame.z_ratio
    index = np.where(is_hit, found - directory.starts[-1], -1)
    return Hits(cells, index, distance, origins + along, blocks)
