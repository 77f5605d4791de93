"""Volumes of neighbouring cubes in one."""

from __future__ import annotations

from fractions import Fraction

import making_volumes as making
import naive_algebra as twin
import naive_formats as naive
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from volatool.cube import Cube
from volatool.errors import CRSError, InputError, OptionError, ResourceError
from volatool.model import CrsInfo
from volatool.vola.algebra import unite
from volatool.vola.tiles import common_grid, lift
from volatool.vola.volume import VolumeInfo

SIDE = Fraction(10)
INFO = VolumeInfo(box=None)


def tile(index, voxels, depth=2, *, side=SIDE, corner=(0, 0, 0), **options):
    exact = [Fraction(c) + number * side for c, number in zip(corner, index, strict=True)]
    cube = Cube.from_exact(exact, Fraction(side), is_snapped=not any(corner))
    return making.volume_of(voxels, depth, cube=cube, info=options.pop("info", INFO), **options)


VOXELS = st.sets(st.tuples(*[st.integers(0, 15)] * 3), max_size=8)
INDEX = st.tuples(*[st.integers(-6, 6)] * 3)


@settings(max_examples=60, deadline=None)
@given(st.dictionaries(INDEX, VOXELS, min_size=1, max_size=5), st.booleans())
def test_tiles_of_a_lattice_go_into_one_cube_as_they_are(tiles, is_snapped):
    """Every voxel at its place, every block its metadata, the smallest cube that will do."""
    corner = (0, 0, 0) if is_snapped else (1, 2, Fraction(1, 3))
    volumes = [tile(index, voxels, seed=i, corner=corner)
               for i, (index, voxels) in enumerate(tiles.items())]  # fmt: skip
    union = unite(common_grid(volumes).volumes)
    size = union.depth - 2
    assert union.cube.exact[3] == SIDE * 4**size
    low = [min(index[axis] for index in tiles) for axis in range(3)]
    high = [max(index[axis] for index in tiles) for axis in range(3)]
    span = max(h - lo + 1 for h, lo in zip(high, low, strict=True))
    assert 4**size >= span
    assert size == 0 or 4 ** (size - 1) < span
    start = [(value - c) / SIDE for value, c in zip(union.cube.exact, corner, strict=False)]
    expected = {
        tuple(int(16 * (number - s)) + v for number, s, v in zip(index, start, voxel, strict=True))
        for index, voxels in tiles.items()
        for voxel in voxels
    }
    assert twin.voxel_set(union) == expected
    edge = SIDE * 4**size
    if union.cube.is_snapped and size:
        assert all(value % edge == 0 for value in union.cube.exact[:3])
    words = twin.block_words(union)
    for (index, voxels), volume in zip(tiles.items(), volumes, strict=True):
        if voxels:
            cell = tuple(int(n - s) for n, s in zip(index, start, strict=True))
            for block, word in twin.block_words(volume).items():
                assert words[naive.path(cell, size) + block] == word


def test_a_tile_of_one_cube_stays_and_empty_tiles_set_nothing():
    one = tile((3, 4, 5), {(1, 1, 1)})
    (same,) = common_grid([one]).volumes
    assert making.same(same, one)
    empty = lift(tile((0, 0, 0), set()), Cube((0.0, 0.0, 0.0), 40.0), 1, (0, 0, 0))
    assert [len(words) for words in empty.levels] == [1, 0, 0]
    assert len(empty) == 0
    assert len(empty.metadata_levels[0]) == 1


def test_the_smaller_depth_is_used_and_told():
    grid = common_grid([tile((0, 0, 0), {(0, 0, 0)}, 3), tile((1, 0, 0), {(0, 0, 0)}, 2)])
    assert {volume.depth for volume in grid.volumes} == {3}
    (warning,) = grid.warnings
    assert (warning.code, warning.count) == ("W_DEPTH", 1)
    same = common_grid([tile((0, 0, 0), {(0, 0, 0)}, 3), tile((0, 0, 0), {(0, 0, 0)}, 2)])
    assert {volume.depth for volume in same.volumes} == {2}
    assert [w.code for w in same.warnings] == ["W_DEPTH"]


@pytest.mark.parametrize(
    "other",
    [
        tile((0, 0, 0), {(0, 0, 0)}, corner=(1, 0, 0)),
        tile((1, 0, 0), {(0, 0, 0)}, side=Fraction(20)),
        tile((1, 0, 0), {(0, 0, 0)}, info=VolumeInfo(quantizer="toolkit")),
        tile((0, 0, 0), {(0, 0, 0)}, side=Fraction(0)),
    ],
)
def test_other_cubes_are_refused_or_resampled_around_the_first_ones_cells(other):
    first = tile((0, 0, 0), {(0, 0, 0), (15, 15, 15)})
    with pytest.raises(InputError, match=r"not on one grid.*--resample") as e:
        common_grid([first, other])
    assert e.value.code == "E_GRID"
    if not other.cube.side:
        return
    grid = common_grid([first, other], resample=True)
    assert grid.is_resampled
    assert grid.n_lost == 0
    one, two = grid.volumes
    assert one.cube == two.cube
    assert one.cell() == first.cell()
    shift = [int((f - o) / Fraction(10, 16)) for f, o in
             zip(first.cube.exact[:3], one.cube.exact[:3], strict=True)]  # fmt: skip
    assert twin.voxel_set(one) == {tuple(v + s for v, s in zip(voxel, shift, strict=True))
                                   for voxel in ((0, 0, 0), (15, 15, 15))}  # fmt: skip
    assert len(two) >= 1


def test_a_given_grid_takes_what_fits_and_resamples_the_rest_on_request():
    """Tiles inside as they are; what lies outside is counted."""
    reference = Cube((0.0, 0.0, 0.0), 40.0)
    tiles = [tile((0, 0, 0), {(0, 0, 0)}), tile((3, 0, 1), {(15, 0, 0)})]
    grid = common_grid(tiles, cube=reference, depth=3)
    assert not grid.is_resampled
    assert twin.voxel_set(unite(grid.volumes)) == {(0, 0, 0), (63, 0, 16)}
    coarse = common_grid(tiles, cube=reference, depth=2)
    assert twin.voxel_set(unite(coarse.volumes)) == {(0, 0, 0), (15, 0, 4)}
    outside = tile((4, 0, 0), {(0, 0, 0), (1, 0, 0)})
    for cube, depth, volume in ((reference, 4, tiles[0]), (reference, 3, outside),
                                (Cube((1.0, 0.0, 0.0), 40.0), 3, tiles[0])):  # fmt: skip
        with pytest.raises(InputError, match="not on the grid that was asked for"):
            common_grid([volume], cube=cube, depth=depth)
    grid = common_grid([outside, tiles[0]], cube=reference, depth=3, resample=True)
    assert grid.n_lost == 2
    assert [w.code for w in grid.warnings] == ["W_OUTSIDE_CUBE"]
    whole = common_grid([tile((0, 0, 0), {(0, 0, 0)}, side=Fraction(40), depth=3)],
                        cube=reference, depth=1)  # fmt: skip
    assert whole.volumes[0].depth == 1


def test_too_many_levels_and_other_reference_systems_are_refused():
    with pytest.raises(ResourceError, match="needs 11 levels") as e:
        common_grid([tile((0, 0, 0), {(0, 0, 0)}), tile((10**5, 0, 0), {(0, 0, 0)})])
    assert e.value.code == "E_SIZE"
    far = [tile((0, 0, 0), {(0, 0, 0)}), tile((10**5, 0, 0), {(0, 0, 0)}, side=Fraction(11))]
    with pytest.raises(ResourceError, match="need 11 levels"):
        common_grid(far, resample=True)
    metres, feet = (
        tile((0, 0, 0), {(0, 0, 0)}, info=VolumeInfo(crs=CrsInfo(
            unit_xy=unit, metres_per_unit_xy=size)))
        for unit, size in (("metre", Fraction(1)), ("foot", Fraction(3048, 10000)))
    )  # fmt: skip
    with pytest.raises(CRSError):
        common_grid([metres, feet])
    with pytest.raises(OptionError, match="no volume"):
        common_grid([])
    rounded = [tile((0, 0, 0), {(0, 0, 0)}, depth, info=VolumeInfo(quantizer="toolkit"))
               for depth in (2, 3)]  # fmt: skip
    with pytest.raises(InputError, match="2 and 3 levels"):
        common_grid(rounded)
    assert len({v.depth for v in common_grid(rounded, resample=True).volumes}) == 1
