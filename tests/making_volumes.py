"""Volumes for the tests of the formats."""

from __future__ import annotations

import io
from fractions import Fraction

import naive_formats as naive
import numpy as np

from volatool.cube import Cube
from volatool.formats import dense, sparse
from volatool.model import CrsInfo
from volatool.vola.volume import Volume, VolumeInfo

CRS = CrsInfo(
    wkt2='COMPOUNDCRS["ä"]',
    horizontal="EPSG:2994",
    vertical="EPSG:6360",
    epsg=2994,
    unit_xy="foot",
    unit_z="US survey foot",
    metres_per_unit_xy=Fraction(3048, 10000),
    metres_per_unit_z=Fraction(1200, 3937),
    source="wkt",
)
INFO = VolumeInfo(
    crs=CRS,
    box=(637000.01, 4850000.5, 400.0, 637010.0, 4850009.25, 405.125),
    n_points=1000,
    channels=(
        {
            "byte": 3,
            "name": "height",
            "scale": 0.02,
            "offset": 400.0,
            "unit": "m",
            "reduction": "mean",
        },
    ),
    source_name="tile.laz",
    source_bytes=12345,
    lat=44.0,
    lon=-123.0,
    epsg=2994,
)
CUBE = Cube((637000.01, 4850000.5, 400.0), 10.01)


def volume_of(voxels, depth, *, metadata=True, cube=CUBE, info=INFO, seed=0) -> Volume:
    """Return a volume of voxels with random metadata words, byte 7 is 1."""
    rng = np.random.default_rng(seed)
    levels = tuple(np.array(words, np.uint64) for words in naive.sparse_levels(voxels, depth))
    words = tuple(
        rng.integers(0, 2**56, len(level), np.uint64) | np.uint64(1 << 56) for level in levels
    )
    return Volume(levels, words if metadata else None, cube, info)


def random_volume(depth=3, n=200, **options) -> Volume:
    """Return a volume of random voxels."""
    rng = np.random.default_rng(n)
    voxels = {tuple(map(int, row)) for row in rng.integers(0, 4**depth, (n, 3))}
    return volume_of(voxels, depth, **options)


def written(volume: Volume, mode: int = 0) -> bytes:
    """Return a volume as a sparse (0) or dense (1) file with its trailer."""
    stream = io.BytesIO()
    (dense if mode else sparse).write(stream, volume)
    return stream.getvalue()


def same(a: Volume, b: Volume, *, metadata: bool = True) -> bool:
    """Tell whether two volumes hold the same."""
    arrays = [(a.levels, b.levels)]
    if metadata:
        assert a.has_metadata == b.has_metadata
        arrays.append((a.metadata_levels or (), b.metadata_levels or ()))
    return (
        all(
            len(left) == len(right) and all(map(np.array_equal, left, right))
            for left, right in arrays
        )
        and a.cube == b.cube
        and a.cube.exact == b.cube.exact
    )
