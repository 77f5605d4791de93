"""What changed between two volumes."""

from __future__ import annotations

import making_volumes as making
import naive_algebra as twin
import naive_formats as naive
import naive_space
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import volatool as vt
from volatool.changes import significant_volume
from volatool.cube import Cube
from volatool.errors import InputError, OptionError
from volatool.kernels import near
from volatool.model import CrsInfo
from volatool.vola.diff import diff
from volatool.vola.volume import VolumeInfo

CUBE = Cube((100.0, 200.0, 300.0), 32.0)
INFO = VolumeInfo()


def volume_of(voxels, depth=3, **options):
    return making.volume_of(voxels, depth, metadata=False, cube=CUBE,
                            info=options.pop("info", INFO), **options)  # fmt: skip


def dense_sets(depth):
    """Sets of voxels that meet often: in a corner of the cube, across its blocks' borders."""
    high = min(4**depth, 9) - 1
    return st.sets(st.tuples(*[st.integers(0, high)] * 3), max_size=60)


@settings(max_examples=30, deadline=None)
@given(st.data(), st.integers(1, 3), st.integers(0, 4), st.sampled_from(["column", "block"]))
def test_counts_and_places_are_those_of_the_twin(data, depth, noise, by):
    """Any depth, noise and places; neighbours across blocks, edges and corners."""
    one, other = data.draw(dense_sets(depth)), data.draw(dense_sets(depth))
    level = data.draw(st.integers(1, depth))
    a, b = volume_of(one, depth), volume_of(other, depth)
    found = diff(a, b, noise=noise, min_voxels=2, level=level, by=by)
    added, removed = other - one, one - other
    far_added = twin.far(added, one, noise) if noise else added
    far_removed = twin.far(removed, other, noise) if noise else removed
    assert (found.n_both, found.n_added, found.n_removed) == (
        len(one & other), len(added), len(removed)
    )  # fmt: skip
    assert found.n_significant_added == len(far_added)
    assert found.n_significant_removed == len(far_removed)
    changes = found.changes
    blocks = [tuple(row) for row in changes.blocks.tolist()]
    expected = [twin.places(voxels, depth, level, by)
                for voxels in (added, removed, far_added, far_removed)]  # fmt: skip
    assert set(blocks) == set(expected[0]) | set(expected[1])
    assert blocks == sorted(blocks, key=lambda place: naive.path(place, level - 1))
    columns = (changes.added, changes.removed, changes.significant_added,
               changes.significant_removed)  # fmt: skip
    for column, counts in zip(columns, expected, strict=True):
        assert column.tolist() == [counts.get(block, 0) for block in blocks]
    significant = changes.significant_added + changes.significant_removed >= 2
    assert changes.is_significant.tolist() == significant.tolist()
    for block, first, last in zip(blocks, changes.first, changes.last, strict=True):
        layers = [v[2] for v in added | removed if block in twin.places([v], depth, level, by)]
        assert (first, last) == (min(layers), max(layers))


@pytest.mark.parametrize("noise", [1, 2, 4])
@pytest.mark.parametrize("step", naive_space.DIRECTIONS)
def test_noise_reaches_across_the_middle_of_the_cube(step, noise):
    """So many voxels away in each of 26 directions it is noise-like, one more it is not."""
    for depth in (2, 3):
        middle = 4**depth // 2
        here = tuple(middle if d < 0 else middle - 1 for d in step)
        for away in (noise, noise + 1):
            there = tuple(k + away * d for k, d in zip(here, step, strict=True))
            found = diff(volume_of({here}, depth), volume_of({there}, depth), noise=noise)
            assert (found.n_added, found.n_removed) == (1, 1)
            far = (found.n_significant_added, found.n_significant_removed)
            assert far == ((1, 1) if away > noise else (0, 0))


@given(st.integers(0, 2**64 - 1), *[st.integers(-1, 1)] * 3, st.integers(0, 4))
def test_spread_is_the_near_cells_of_another_block(word, x, y, z, reach):
    cells = [(i & 3, i >> 2 & 3, i >> 4) for i in range(64)]
    expected = 0
    for i, here in enumerate(cells):
        for j, there in enumerate(cells):
            away = [t + 4 * s - h for t, s, h in zip(there, (x, y, z), here, strict=True)]
            if word >> j & 1 and max(map(abs, away)) <= reach:
                expected |= 1 << i
    assert int(near.spread(np.uint64(word), x, y, z, reach)) == expected


@settings(max_examples=40, deadline=None)
@given(dense_sets(2), dense_sets(2), st.integers(0, 2))
def test_tops_of_columns(one, other, noise):
    """Raised and lowered beyond the noise, the net of all; columns of one volume only apart."""
    found = diff(volume_of(one, 2), volume_of(other, 2), noise=noise).surface()
    before, after = ({}, {})
    for tops, voxels in ((before, one), (after, other)):
        for x, y, z in voxels:
            tops[x, y] = max(tops.get((x, y), 0), z)
    moved = [after[column] - before[column] for column in before.keys() & after.keys()]
    assert found.n_both == len(moved)
    assert found.n_added == len(after.keys() - before.keys())
    assert found.n_removed == len(before.keys() - after.keys())
    assert found.raised == sum(step for step in moved if step > noise)
    assert found.lowered == sum(-step for step in moved if step < -noise)
    assert found.net == sum(moved)


def test_few_blocks_in_a_deep_volume():
    """Of 4**9 x 4**9 columns of blocks: the places are those that there are."""
    far = {(0, 0, 0), (4**10 - 1, 7, 4**10 - 1)}
    found = diff(volume_of(far, 10), volume_of({(0, 0, 0), (1, 0, 0)}, 10), by="block")
    assert found.changes.blocks.tolist() == [[0, 0, 0], [4**9 - 1, 1, 4**9 - 1]]
    surface = found.surface()
    assert (surface.n_both, surface.n_added, surface.n_removed) == (1, 1, 1)


def plane(z):
    return {(x, y, z(x, y)) for x in range(48) for y in range(48)}


def test_a_plane_that_moves_by_one_voxel_is_noise():
    """In any direction, flat or sloping: every voxel changes, no place is significant."""
    ground = volume_of(plane(lambda x, y: 20))
    slope = volume_of(plane(lambda x, y: 5 + x // 2 + y // 3))
    moved = volume_of(
        {(x + 1, y + 1, z + 1) for x, y, z in plane(lambda x, y: 5 + x // 2 + y // 3)}
    )
    for a, b in ((ground, volume_of(plane(lambda x, y: 21))), (slope, moved)):
        found = diff(a, b)
        assert found.n_added > 1000
        assert found.n_significant_added == found.n_significant_removed == 0
        assert not found.changes.is_significant.any()
        assert significant_volume(found) == 0
        assert diff(a, b, noise=0).changes.is_significant.mean() > 0.9
    two = diff(ground, volume_of(plane(lambda x, y: 22)))
    assert two.n_significant_added == two.n_added == 48 * 48
    assert diff(ground, volume_of(plane(lambda x, y: 22)), noise=2).n_significant_added == 0


def test_a_new_house_gives_its_volume():
    """All of it, also the layer on the ground that is near old voxels; and gone the other way."""
    ground = plane(lambda x, y: 20)
    house = {(x, y, z) for x in range(12, 22) for y in range(17, 25) for z in range(21, 27)}
    a, b = volume_of(ground), volume_of(ground | house)
    found = diff(a, b)
    volume = 10 * 8 * 6 * 0.5**3
    assert found.at_significant_places() == (len(house), 0)
    assert significant_volume(found) == volume == (b - a).volume()
    assert found.n_significant_added == 10 * 8 * 5  # the lowest layer touches the ground
    surface = found.surface()
    assert (surface.raised, surface.net, surface.lowered) == (480, 480, 0)
    back = diff(b, a)
    assert back.at_significant_places() == (0, len(house))
    low, high = found.corners(found.changes.blocks, 3)[:, :2], found.changes.last
    assert low.min(axis=0).tolist() == [100 + 12 * 0.5, 200 + 16 * 0.5]
    assert set(high.tolist()) == {26}
    assert set(found.changes.first.tolist()) == {21}


def test_a_bird_is_not_significant():
    ground = plane(lambda x, y: 20)
    found = diff(volume_of(ground), volume_of(ground | {(10, 10, 40), (30, 30, 41), (31, 30, 41)}))
    assert found.n_significant_added == 3
    assert len(found.changes) == 2
    assert not found.changes.is_significant.any()
    assert diff(found.a, found.b, min_voxels=2).changes.is_significant.tolist() == [False, True]


def test_empty_volumes_and_equal_ones():
    a, empty = volume_of({(1, 2, 3), (60, 1, 1)}), volume_of(set())
    for one, other, added, removed in ((a, a, 0, 0), (empty, a, 2, 0), (a, empty, 0, 2),
                                       (empty, empty, 0, 0)):  # fmt: skip
        found = diff(one, other, min_voxels=1)
        assert (found.n_added, found.n_removed) == (added, removed)
        assert found.n_significant_added + found.n_significant_removed == added + removed
        assert len(found.changes) == added + removed


def test_heights_are_in_the_vertical_unit_and_toolkit_voxels_are_around_their_places():
    feet = CrsInfo(unit_xy="metre", metres_per_unit_xy=1, unit_z="two", metres_per_unit_z=2)
    found = diff(*(volume_of(voxels, info=VolumeInfo(crs=feet)) for voxels in ({(0, 0, 8)}, set())))
    assert found.faces(np.array([[0.0, 0.0, 8.0]])).tolist() == [[100.0, 200.0, (300 + 4) / 2]]
    info = VolumeInfo(quantizer="unknown")
    found = diff(volume_of({(0, 0, 63)}, info=info), volume_of(set(), info=info))
    step = 32 / 63
    assert found.faces(np.array([[0.0, 0.0, 64.0]]))[0].tolist() == pytest.approx(
        [100 - step / 2, 200 - step / 2, 332 + step / 2]
    )


def test_grids_and_options_are_checked():
    a = volume_of({(1, 2, 3)})
    other = making.volume_of({(1, 2, 3)}, 3, cube=Cube((0.0, 0.0, 0.0), 32.0), info=INFO)
    with pytest.raises(InputError, match="not on the same grid"):
        diff(a, other)
    assert diff(a, other, resample=True).is_resampled
    assert not diff(a, a.truncated(2), resample=True).is_resampled
    for options in ({"noise": 5}, {"noise": -1}, {"min_voxels": 0}, {"level": 4}, {"level": 0},
                    {"by": "row"}):  # fmt: skip
        with pytest.raises(OptionError, match="must be"):
            diff(a, a, **options)
    with pytest.raises(OptionError, match=r"diff compares volumes \(vt.open\), got str"):
        diff(a, "june.vol.gz")


def test_a_real_tile_against_scipy_and_numpy(shared, tmp_path):
    """Every second point of a street in Delft: sets of keys, and a dilation of the dense grid."""
    from scipy import ndimage

    tile = shared / "tiles" / "ahn3_cropped_2.laz"
    options = {"dem": False, "dense": "never", "depth": 4}
    whole = vt.convert(tile, tmp_path, **options).paths[0]
    halves = []
    for bounds in ((84990, 0, 85045, 10**6), (85020, 0, 86000, 10**6)):
        report = vt.convert(tile, tmp_path / str(bounds[0]), cube_from=whole, bounds=bounds,
                            thin=2, dem=False, dense="never")  # fmt: skip
        halves.append(vt.open(report.paths[0]))
    a, b = halves
    for result, operation in ((a | b, np.union1d), (a & b, np.intersect1d), (a ^ b, np.setxor1d),
                              (a - b, np.setdiff1d)):  # fmt: skip
        assert np.array_equal(result.keys(), operation(a.keys(), b.keys()))
        assert len(result) > 1000
    found = diff(a, b, noise=2)
    grids = []
    for volume in (a, b):
        grid = np.zeros((256,) * 3, np.bool_)
        grid[tuple(volume.voxels().T)] = True
        grids.append(grid)
    near = [ndimage.maximum_filter(grid.view(np.uint8), 5, mode="constant") > 0 for grid in grids]
    one, other = grids
    assert found.n_both == (one & other).sum()
    assert found.n_significant_added == (other & ~near[0]).sum() > 0
    assert found.n_significant_removed == (one & ~near[1]).sum() > 0
