"""A census against every voxel looked at."""

from __future__ import annotations

from dataclasses import replace

import making_volumes as making
import numpy as np
import pytest

from volatool.errors import OptionError
from volatool.model import Bounds

CHANNELS = (
    *making.INFO.channels,
    {"byte": 6, "name": "class", "scale": 1.0, "offset": 0.0, "unit": "", "reduction": "mode"},
    {"byte": 7, "name": "present", "scale": 1.0, "offset": 0.0, "unit": "", "reduction": ""},
)


@pytest.fixture(scope="module")
def volume():
    info = replace(making.INFO, channels=CHANNELS)
    return making.random_volume(3, 3000, info=info)


def check(volume, inside, census):
    assert census.voxels == inside.sum()
    assert census.volume == pytest.approx(inside.sum() * volume.cell() ** 3)
    codes = volume.channel("class")[inside].astype(int)
    assert census.classes == {c: (codes == c).sum() for c in sorted(set(codes.tolist()))}
    heights = volume.channel("height")[inside]
    if not inside.any():
        assert (census.channels, census.low, census.blocks) == ({}, None, 0)
        return
    assert list(census.channels) == ["height"]
    found = census.channels["height"]
    assert (found.n, found.unit) == (len(heights), "m")
    assert [found.mean, found.minimum, found.maximum] == pytest.approx(
        [heights.mean(), heights.min(), heights.max()]
    )
    assert census.blocks == len({tuple(v // 4) for v in volume.voxels()[inside]})
    half = volume.cell() / 2 / np.array([1, 1, float(volume.crs.z_ratio)])
    centers = volume.centers()[inside]
    assert census.low == pytest.approx(centers.min(0) - half)
    assert census.high == pytest.approx(centers.max(0) + half)


def test_voxels_of_the_toolkit_have_the_volume_of_their_own_step(volume):
    """Like `Volume.volume` and the components: S points are S - 1 steps apart."""
    rounded = replace(volume, info=replace(volume.info, quantizer="toolkit"))
    whole = rounded.census()
    assert whole.voxels == len(volume)
    assert whole.volume == pytest.approx(rounded.volume())
    assert whole.volume == pytest.approx(rounded.components().volumes.sum())
    assert whole.volume > volume.census().volume * 1.04


def test_polygons_that_cut_themselves_and_what_is_none(volume):
    import shapely

    low, high = volume.centers().min(0) - 0.01, volume.centers().max(0) + 0.01
    (x0, y0), (x1, y1) = low[:2], high[:2]
    bow = shapely.Polygon([(x0, y0), (x1, y1), (x1, y0), (x0, y1)])
    assert not bow.is_valid
    whole, half = volume.census().voxels, volume.census(polygon=bow).voxels
    x, y = ((volume.centers()[:, :2] - low[:2]) / (high[:2] - low[:2])).T
    assert half == ((x <= np.minimum(y, 1 - y)) | (x >= np.maximum(y, 1 - y))).sum() < whole
    with pytest.raises(OptionError, match="a polygon is a shapely geometry, not str"):
        volume.census(polygon=bow.wkt)


def test_a_census_of_everything_and_of_nothing(volume):
    check(volume, np.ones(len(volume), bool), volume.census())
    check(volume, np.zeros(len(volume), bool), volume.census([0, 0, 1, 1]))


@pytest.mark.parametrize("seed", range(4))
def test_voxels_count_by_their_centre_in_the_half_open_box(volume, seed):
    rng = np.random.default_rng(seed)
    centers = volume.centers()
    low, high = np.sort(rng.uniform(centers.min(0), centers.max(0), (2, 3)), axis=0)
    if seed == 0:  # exactly on centres
        low, high = np.sort(centers[[5, 500]], axis=0)
    inside = ((centers >= low) & (centers < high)).all(axis=1)
    flat = ((centers >= low) & (centers < high))[:, :2].all(axis=1)
    check(volume, inside, volume.census([*low, *high]))
    check(volume, flat, volume.census([*low[:2], *high[:2]]))
    check(volume, flat, volume.census(Bounds(*low[:2], *high[:2])))
    check(volume, inside, volume.census([*low[:2], *high[:2]], z=(low[2], high[2])))
    # side by side: none is counted twice, none lost
    middle = (low[0] + high[0]) / 2
    parts = [
        volume.census([*low, middle, *high[1:]]),
        volume.census([middle, *low[1:], *high]),
    ]
    assert sum(part.voxels for part in parts) == inside.sum()


def test_bands_of_height(volume):
    heights = volume.centers()[:, 2]
    edges = [-np.inf, *np.quantile(heights, [0.2, 0.7]), heights.max()]
    bands = volume.census(bands=edges).bands
    codes = volume.channel("class").astype(int)
    for band, low, high in zip(bands, edges[:-1], edges[1:], strict=True):
        inside = (heights >= low) & (heights < high)
        assert (band.low, band.high, band.voxels) == (low, high, inside.sum())
        assert band.classes == {c: (codes[inside] == c).sum() for c in sorted(set(codes[inside]))}
    assert sum(band.voxels for band in bands) < len(volume)  # the highest voxels are in none


def test_a_polygon_and_heights(volume):
    import shapely

    centers = volume.centers()
    triangle = shapely.Polygon(centers[[1, 1000, 2000], :2])
    z = (centers[:, 2].min(), np.median(centers[:, 2]))
    inside = shapely.intersects_xy(triangle, centers[:, 0], centers[:, 1])
    inside &= (centers[:, 2] >= z[0]) & (centers[:, 2] < z[1])
    assert inside.any()
    check(volume, inside, volume.census(z=z, polygon=triangle))


def test_without_metadata_there_are_counts_alone():
    census = making.random_volume(3, 100, metadata=False).census(bands=[0, 1e6])
    assert (census.classes, census.channels) == ({}, {})
    assert census.bands[0].voxels == census.voxels > 90
    document = census.to_dict()
    assert document["classes"] == {}
    assert len(document["tight"]) == 6


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"box": [1, 1, 0, 2]}, "X0 <= X1"),
        ({"box": [1, 2, 3]}, "4 or 6 numbers, got 3"),
        ({"box": [np.nan, 0, 1, 1]}, "X0 <= X1"),
        ({"bands": [1]}, "two heights"),
        ({"bands": [2, 1]}, "ascending"),
        ({"bands": [0, np.nan]}, "ascending"),
        ({"z": (2, 1)}, "LOW <= HIGH"),
        ({"z": (np.nan, 1)}, "LOW <= HIGH"),
    ],
)
def test_regions_that_are_none_are_refused(volume, options, message):
    with pytest.raises(OptionError, match=message):
        volume.census(**options)
