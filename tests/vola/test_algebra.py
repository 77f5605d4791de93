"""Algebra of volumes: crop, and sets of voxels."""

from __future__ import annotations

import math
from fractions import Fraction

import making_volumes as making
import naive_algebra as twin
import naive_formats as naive
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from volatool.cube import Cube
from volatool.errors import OptionError
from volatool.model import Bounds
from volatool.vola.algebra import crop
from volatool.vola.prune import cells_box, prune
from volatool.vola.volume import Volume, VolumeInfo

CUBE = Cube((10.0, 20.0, 30.0), 1.6)  # cells of 0.1 at depth 2
INFO = VolumeInfo(channels=making.INFO.channels)
VOXELS = st.sets(st.tuples(*[st.integers(0, 15)] * 3), max_size=40)


def volume_of(voxels, depth=2, **options):
    return making.volume_of(voxels, depth, cube=CUBE, info=INFO, **options)


def assert_words(volume, expected):
    assert twin.block_words(volume) == expected


@settings(max_examples=60, deadline=None)
@given(VOXELS, st.randoms())
def test_pruning_leaves_the_voxels_and_means_of_what_is_left(voxels, random):
    """Words of whole blocks stay; those above a block that went are means of the children left."""
    volume = volume_of(voxels, 3)
    left = {voxel for voxel in voxels if random.random() < 0.7}
    place = {naive.path(tuple(map(int, cell)), 2): i for i, cell in enumerate(volume.voxels(2))}
    deepest = np.zeros(len(volume.levels[-1]), np.uint64)
    for voxel in left:
        path = naive.path(voxel, 3)
        deepest[place[path[:2]]] |= np.uint64(1 << path[2])
    levels, metadata = prune(volume.levels, deepest, volume.metadata_levels)
    result = Volume(levels, metadata, volume.cube, volume.info)
    assert twin.voxel_set(result) == left
    assert [list(words) for words in result.levels] == naive.sparse_levels(left, 3)
    assert_words(result, twin.pruned_words(volume, left))


BOUND = st.integers(-3, 19)


@settings(max_examples=60, deadline=None)
@given(VOXELS, *[BOUND] * 6, st.booleans())
def test_crop_keeps_the_cells_that_meet_the_closed_box(voxels, x0, y0, z0, dx, dy, dz, half):
    """Half-open cells, the last one closed, decimal coordinates on faces exactly."""
    volume = volume_of(voxels)
    shift = 0.05 if half else 0.0
    lows = [round(c + v / 10 + shift, 2) for c, v in zip(CUBE.origin, (x0, y0, z0), strict=True)]
    highs = [round(low + abs(d) / 10, 2) for low, d in zip(lows, (dx, dy, dz), strict=True)]
    part = crop(volume, Bounds(*lows[:2], *highs[:2]), z=(lows[2], highs[2]))

    def meets(voxel):
        for cell, corner, low, high in zip(voxel, CUBE.origin, lows, highs, strict=True):
            start = Fraction(repr(corner)) + Fraction(cell, 10)
            stop = start + Fraction(1, 10)
            low, high = Fraction(repr(low)), Fraction(repr(high))
            above = stop >= low if cell == 15 else stop > low
            if not (above and start <= high):
                return False
        return True

    left = {voxel for voxel in voxels if meets(voxel)}
    assert twin.voxel_set(part) == left
    assert part.cube == volume.cube
    assert part.depth == volume.depth
    if left == voxels:
        assert making.same(part, volume)
    else:
        assert_words(part, twin.pruned_words(volume, left))


def test_crop_knows_vertical_units_infinite_sides_and_the_box_that_is_left():
    """z is in the vertical unit; the box is that of the cells left, within the known one."""
    volume = making.random_volume(3, 300)
    z = volume.centers()[:, 2]
    assert volume.crs.z_ratio != 1
    middle = float(np.quantile(z, 0.2))
    part = crop(volume, z=(-math.inf, middle))
    assert len(part) == (z <= middle).sum()
    assert part.info.n_points is None
    assert part.info.channels == volume.info.channels
    x0, y0, z0, x1, y1, z1 = part.info.box
    known = volume.info.box
    assert z0 == known[2]
    assert middle < z1 < known[5]
    kept = part.voxels()
    assert x0 == volume.cube.origin[0] + kept[:, 0].min() * volume.cell()
    assert y1 == min(known[4], volume.cube.origin[1] + (kept[:, 1].max() + 1) * volume.cell())
    assert x0 < x1
    assert y0 < y1
    assert crop(volume) is volume
    assert volume.info.n_points == 1000
    empty = crop(volume, z=(math.inf, math.inf))
    assert len(empty) == 0
    assert empty.info.box is None
    assert empty.levels[0].tolist() == [0]
    assert empty.metadata_words(1).tolist() == [1 << 56]


def test_crop_of_a_toolkit_volume_goes_by_the_places_it_rounded_to():
    """A voxel stays if the box holds points that are rounded to its place."""
    volume = making.volume_of(
        [(0, 0, 0), (7, 0, 0), (15, 0, 0)],
        2,
        cube=Cube((0.0, 0.0, 0.0), 15.0),
        info=VolumeInfo(quantizer="unknown"),
    )
    for left, right, expected in ((6.6, 7.4, [7]), (7.6, 8, []), (0.4, 6.4, [0]), (14.6, 20, [15])):
        part = crop(volume, Bounds(left, -1, right, 1))
        assert sorted(part.voxels()[:, 0].tolist()) == expected
    assert cells_box(volume) == (0.0, 0.0, 0.0, 15.0, 0.5, 0.5)


def test_crop_of_a_single_place_and_bad_heights():
    volume = making.volume_of([(0, 0, 0)], 2, cube=Cube((5.0, 5.0, 5.0), 0.0), info=VolumeInfo())
    assert len(crop(volume, Bounds(5, 5, 5, 5))) == 1
    assert len(crop(volume, Bounds(5.1, 5, 6, 5))) == len(crop(volume, z=(0, 4))) == 0
    for z in ((2, 1), (math.nan, 1)):
        with pytest.raises(OptionError, match="z must be lowest, highest"):
            crop(volume, z=z)
