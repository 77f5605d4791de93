"""Real tiles with a ground class, hold-outs of their points, and the TIN to beat.

Pure functions for `dem_loo.py`, other benchmarks and tests; nothing here knows how a DEM is made.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]

KINDS = ("random", "5 m", "10 m", "20 m")
"""Hold-outs: every tenth point at random, or all points in square gaps of so many metres."""

PART = 0.1
"""Part of the points, or of the area, that is held out."""

MAX_POINTS = 100_000
"""Denser tiles are cut to a square about their middle that holds about so many ground points."""

MAX_SIDE_M = 600.0
"""Larger tiles are cut to a square of this side."""

_FOOT = Fraction("0.3048")
_TILES = (
    ("topo", "golden/inputs/lidR-Topography.laz", Fraction(1)),
    ("ntm46", "tiles/4_6_crop.las", Fraction(1200, 3937)),
    ("autzen", "tiles/autzen_trim.las", _FOOT),
    ("ahn1", "tiles/ahn3_cropped_1.laz", Fraction(1)),
    ("ahn2", "tiles/ahn3_cropped_2.laz", Fraction(1)),
    ("locks", "tiles/laserchicken-AHN3.laz", Fraction(1)),
    ("ign_dense", "tiles/las_with_several_extra_byte_bloc.laz", Fraction(1)),
    ("ign_thin", "tiles/test_semis_2023_0292_6833_LA93_IGN69.laz", Fraction(1)),
    ("osbs", "tiles/pyfor-osbs-test.laz", Fraction(1)),
    *(
        (f"samp{k}", f"tiles/isprs/samp{k}-utm.laz", Fraction(1))
        for k in (11, 12, 21, 22, 23, 24, 61)
    ),
)


@dataclass(frozen=True)
class Tile:
    """A tile of the shared folder: short name, file, metres per unit of x, y and z."""

    name: str
    path: Path
    unit: Fraction


@dataclass(frozen=True)
class Ground:
    """
    Ground-class points of a tile.

    Parameters
    ----------
    rows : (n, 3) array of int32
        Stored x, y, z in file order.
    scale, offset : tuple of 3 float
        Of the stored integers, in units of the CRS.
    xyz : (n, 3) array of float64
        The same points in metres.
    unit : Fraction
        Metres per unit.
    """

    rows: NDArray[np.int32]
    scale: tuple[float, float, float]
    offset: tuple[float, float, float]
    xyz: F64
    unit: Fraction


def tiles(shared: Path) -> list[Tile]:
    """
    Return the tiles whose ground class holds real heights, those that are there.

    lidR-Megaplot is not among them: its heights are above ground, and all of its ground is at 0.
    """
    listed = (Tile(name, Path(shared) / path, unit) for name, path, unit in _TILES)
    return [tile for tile in listed if tile.path.exists()]


def load(tile: Tile, max_points: int = MAX_POINTS, max_side_m: float = MAX_SIDE_M) -> Ground:
    """Return a tile's points of class 2 (so no noise, no water), cut to a square if large."""
    import laspy

    las = laspy.read(tile.path)
    ground = np.asarray(las.classification) == 2
    if "withheld" in las.point_format.dimension_names:
        ground &= ~np.asarray(las.withheld).astype(bool)
    rows = np.stack([np.asarray(las[axis])[ground] for axis in "XYZ"], axis=1).astype(np.int32)
    scale, offset = tuple(las.header.scales.tolist()), tuple(las.header.offsets.tolist())
    xyz = (rows * np.array(scale) + offset) * float(tile.unit)
    low, high = xyz[:, :2].min(axis=0), xyz[:, :2].max(axis=0)
    off = np.abs(xyz[:, :2] - (low + high) / 2).max(axis=1)  # half the side of the square
    half = max_side_m / 2
    if len(off) > max_points:
        half = min(half, float(np.partition(off, max_points)[max_points]))
    keep = off <= half
    return Ground(np.ascontiguousarray(rows[keep]), scale, offset, xyz[keep], tile.unit)


def holdout_mask(xy: F64, kind: str, seed: int) -> NDArray[np.bool_]:
    """
    Return which points are held out.

    Parameters
    ----------
    xy : (n, 2) array of float64
        Places in metres.
    kind : str
        One of `KINDS`: ``"random"`` or the side of a gap, ``"10 m"``.
    seed : int
        Of the choice.

    Returns
    -------
    out : (n,) array of bool
        About a tenth. Gaps stand on a square grid of random offset and cover a tenth of the plane.
    """
    rng = np.random.default_rng(seed)
    if kind == "random":
        return np.asarray(rng.random(len(xy)) < PART)
    side = float(kind.removesuffix(" m"))
    pitch = side / math.sqrt(PART)
    phase = (xy - xy.min(axis=0) + rng.uniform(0, pitch, 2)) % pitch
    return np.asarray((phase < side).all(axis=1))


def tin(train: F64, places: F64) -> F64:
    """
    Return heights on the triangles of points, of the nearest point outside their hull.

    Parameters
    ----------
    train : (n, 3) array of float64
        Points.
    places : (m, 2) array of float64
        Where heights are wanted.
    """
    from scipy.interpolate import LinearNDInterpolator
    from scipy.spatial import cKDTree

    middle = train.mean(axis=0)
    xy, at = train[:, :2] - middle[:2], places - middle[:2]
    z = LinearNDInterpolator(xy, train[:, 2])(at)
    outside = np.isnan(z)
    z[outside] = train[cKDTree(xy).query(at[outside])[1], 2]
    return np.asarray(z)
