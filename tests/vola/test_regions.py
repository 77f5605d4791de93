"""Boxes and columns against every voxel looked at."""

from __future__ import annotations

import making_volumes as making
import naive_queries as naive
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from volatool.cube import Cube
from volatool.errors import OptionError
from volatool.model import CrsInfo
from volatool.vola import regions
from volatool.vola.frame import Frame
from volatool.vola.volume import VolumeInfo

PLAIN = VolumeInfo(crs=CrsInfo())
voxel_sets = st.sets(st.tuples(*[st.integers(0, 15)] * 3), max_size=40)
half = st.integers(-4, 36).map(lambda k: k / 2)


def in_cells(voxels, depth=2):
    """Volume whose cells are the units of its coordinates."""
    return making.volume_of(voxels, depth, cube=Cube((0.0,) * 3, 4.0**depth), info=PLAIN)


@settings(max_examples=100, deadline=None)
@given(voxel_sets, st.tuples(*[half] * 3), st.tuples(*[half] * 3))
def test_a_box_holds_the_voxels_that_its_points_fall_into(voxels, a, b):
    low, high = np.minimum(a, b), np.maximum(a, b)
    found = in_cells(voxels).box(low, high)
    inside = [v for v in voxels if naive.meets_box(v, low, high, 16)]
    assert (found.voxels, bool(found)) == (len(inside), bool(inside))
    assert found.blocks == len({tuple(c // 4 for c in v) for v in inside})
    axes = [
        sum(naive.meets_box((k,), (x,), (y,), 16) for k in range(16))
        for x, y in zip(low, high, strict=True)
    ]
    assert found.cells == np.prod(axes)
    assert found.fill == (len(inside) / found.cells if found.cells else 0)
    if inside:
        assert found.low.tolist() == np.min(inside, axis=0).tolist()
        assert found.high.tolist() == (np.max(inside, axis=0) + 1).tolist()
    else:
        assert found.low is found.high is None


def test_boxes_without_limits_and_boxes_that_are_none():
    volume = making.random_volume(3, 200)
    whole = volume.box([-np.inf] * 3, [np.inf] * 3)
    assert (whole.voxels, whole.blocks) == (len(volume), volume.n_blocks())
    assert whole.cells == 64**3
    centers = volume.centers()
    assert (whole.low < centers.min(0)).all()
    assert (whole.high > centers.max(0)).all()
    assert whole.high - whole.low == pytest.approx(
        np.ptp(centers, axis=0) + volume.cell() / np.array([1, 1, float(volume.crs.z_ratio)])
    )
    for low, high in (([1, 0, 0], [0, 1, 1]), ([np.nan, 0, 0], [1, 1, 1]), ([0, 0], [1, 1])):
        with pytest.raises(OptionError):
            volume.box(low, high)


def test_only_blocks_that_meet_the_box_are_visited(monkeypatch):
    volume = making.random_volume(5, 3000)
    seen = []
    from volatool.kernels import regions as kernels

    real = kernels.masked_words

    def spy(directory, rows, *rest):
        seen.append(len(rows))
        return real(directory, rows, *rest)

    monkeypatch.setattr(kernels, "masked_words", spy)
    center = volume.centers()[0]
    assert volume.box(center - 1e-4, center + 1e-4).voxels == 1
    assert seen == [1] * 5


@settings(max_examples=100, deadline=None)
@given(st.sets(st.tuples(st.integers(0, 2), st.integers(0, 2), st.integers(0, 63)), max_size=60))
def test_columns_are_runs_from_top_to_bottom(voxels):
    volume = in_cells(voxels, 3)
    places = [(x, y) for x in range(-1, 4) for y in range(4)]
    columns = volume.columns(np.array(places) + 0.5)
    for (x, y), column in zip(places, columns, strict=True):
        assert list(column) == [(low, high + 1) for low, high in naive.runs(voxels, x, y)]
        assert column.is_outside == (x < 0)
        assert len(column) == len(naive.runs(voxels, x, y))


def test_a_column_is_in_the_vertical_unit():
    volume = making.random_volume(3, 2000)
    x, y, z = volume.centers()[7]
    column = volume.column(x, y)
    assert any(low < z < high for low, high in column)
    same = np.abs(volume.centers()[:, :2] - [x, y]).max(axis=1) < volume.cell() / 4
    heights = column.high - column.low
    ratio = float(volume.crs.z_ratio)
    assert heights.sum() == pytest.approx(same.sum() * volume.cell() / ratio)
    assert (np.diff(column.high) < 0).all()


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e300])
def test_columns_that_are_nowhere(bad):
    volume = making.random_volume(2, 50)
    column = volume.column(bad, volume.centers()[0, 1])
    assert (len(column), column.is_outside) == (0, True)
    assert volume.columns(np.empty((0, 2))) == []


def test_toolkit_cells_lie_around_their_points():
    info = VolumeInfo(crs=CrsInfo(), quantizer="unknown")
    volume = making.volume_of([(2, 0, 1), (2, 0, 2)], 1, cube=Cube((0.0,) * 3, 3.0), info=info)
    assert list(volume.column(2, 0)) == [(0.5, 2.5)]
    found = volume.box([1.6, 0, 2.4], [1.7, 0.1, 2.4])
    assert (found.voxels, found.low.tolist(), found.high.tolist()) == (
        1, [1.5, -0.5, 1.5], [2.5, 0.5, 2.5],
    )  # fmt: skip


def test_a_cube_that_is_one_place():
    volume = making.volume_of([(0, 0, 0)], 2, cube=Cube((5.0, 5.0, 5.0), 0.0), info=PLAIN)
    assert list(volume.column(5, 5)) == [(5.0, 5.0)]
    assert volume.box([0] * 3, [9] * 3).voxels == 1
    assert volume.box([0] * 3, [4] * 3).voxels == 0


def test_a_polygon_chooses_the_voxels_whose_centre_it_holds():
    """A star, a hole and two parts; blocks all inside, all outside and cut through."""
    import shapely

    star = shapely.Polygon([(2, 2), (60, 8), (30, 30), (58, 60), (20, 40), (4, 61.5)])
    shape = star.difference(shapely.Point(25, 25).buffer(6)).union(shapely.box(50, 20, 60, 30.5))
    volume = making.random_volume(3, 20000, cube=Cube((0.0,) * 3, 64.0), info=PLAIN)
    first, last = Frame.of(volume).range_of([0, 0, 10], [64, 64, 50.5], centres=True)
    found = regions.select(volume, first, last, shape)
    centers = volume.centers()
    inside = shapely.intersects_xy(shape, centers[:, 0], centers[:, 1])
    inside &= (centers[:, 2] >= 10) & (centers[:, 2] < 50.5)
    assert found.n_voxels == inside.sum() > 100
    words = np.zeros(volume.n_blocks(), np.uint64)
    words[found.index] = found.words
    bits = (words[:, None] >> np.arange(64, dtype=np.uint64)) & np.uint64(1)
    is_set = (volume.levels[-1][:, None] >> np.arange(64, dtype=np.uint64)) & np.uint64(1)
    assert bits[is_set.astype(bool)].astype(bool).tolist() == inside.tolist()
    assert not len(regions.select(volume, first, last, shapely.Polygon()).words)
    assert not len(regions.select(volume, first, last, shapely.box(100, 100, 200, 200)).words)
