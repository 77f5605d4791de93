"""Algebra of volumes: crop, and sets of voxels."""

from __future__ import annotations

import io
import math
from dataclasses import replace
from fractions import Fraction

import making_volumes as making
import naive_algebra as twin
import naive_formats as naive
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from volatool.cube import Cube
from volatool.encodings import Encoding, write_volume
from volatool.errors import CRSError, InputError, OptionError
from volatool.formats.registry import open_volume
from volatool.model import Bounds, CrsInfo
from volatool.vola.algebra import combine, crop, unite
from volatool.vola.diff import diff
from volatool.vola.prune import cells_box, cells_range, prune
from volatool.vola.volume import Volume, VolumeInfo

CUBE = Cube((10.0, 20.0, 30.0), 1.6)  # cells of 0.1 at depth 2
INFO = VolumeInfo()  # bytes of unknown meaning: all are kept
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


@settings(max_examples=40, deadline=None)
@given(st.sets(st.tuples(*[st.integers(0, 63)] * 3), min_size=1, max_size=30))
def test_the_range_of_cells_is_found_from_few_blocks(voxels):
    """First and last index of each axis, also where empty blocks are stored."""
    volume = volume_of(voxels, 3)
    columns = list(zip(*voxels, strict=True))
    expected = (list(map(min, columns)), list(map(max, columns)))
    assert cells_range(volume) == expected
    if not volume.levels[0][0] & np.uint64(1):
        root = volume.levels[0] | np.uint64(1)
        levels = (root, np.insert(volume.levels[1], 0, np.uint64(0)), volume.levels[2])
        assert cells_range(Volume(levels, None, CUBE, INFO)) == expected


def test_crop_of_a_single_place_and_bad_heights():
    volume = making.volume_of([(0, 0, 0)], 2, cube=Cube((5.0, 5.0, 5.0), 0.0), info=VolumeInfo())
    assert len(crop(volume, Bounds(5, 5, 5, 5))) == 1
    assert len(crop(volume, Bounds(5.1, 5, 6, 5))) == len(crop(volume, z=(0, 4))) == 0
    for z in ((2, 1), (math.nan, 1)):
        with pytest.raises(OptionError, match="z must be lowest, highest"):
            crop(volume, z=z)


OPS = {
    "or": lambda a, b: a | b,
    "and": lambda a, b: a & b,
    "xor": lambda a, b: a ^ b,
    "sub": lambda a, b: a - b,
}


@settings(max_examples=80, deadline=None)
@given(VOXELS, VOXELS, st.sampled_from(sorted(OPS)), st.integers(1, 2))
def test_operations_are_those_of_sets(one, other, op, less):
    """At depth 3 or, where one is less deep, at the smaller depth; words, voxels and blocks."""
    a, b = volume_of(one, 3), volume_of(other, 3, seed=1)
    if less == 2:
        b = b.truncated(2)
    result = combine(a, b, op)
    one, other = twin.voxel_set(a.truncated(b.depth)), twin.voxel_set(b)
    expected = OPS[op](one, other)
    assert [list(words) for words in result.levels] == naive.sparse_levels(expected, b.depth)
    assert result.cube == a.cube
    assert twin.voxel_set(OPS[op](a, b)) == expected
    assert_words(result, twin.combined_words(a.truncated(b.depth), b, op, expected))


@settings(max_examples=60, deadline=None)
@given(VOXELS, VOXELS, VOXELS)
def test_laws(one, other, third):
    """Commutative, associative, distributive, De Morgan within the cube, and what - undoes."""
    cube = volume_of({(x, y, z) for x in range(16) for y in range(16) for z in range(16)})
    a, b, c = (volume_of(voxels, seed=i) for i, voxels in enumerate((one, other, third)))

    def equal(left, right):
        return making.same(left, right, metadata=False)

    assert equal(a | b, b | a)
    assert equal(a & b, b & a)
    assert equal(a ^ b, b ^ a)
    assert equal((a | b) | c, a | (b | c))
    assert equal((a & b) & c, a & (b & c))
    assert equal((a ^ b) ^ c, a ^ (b ^ c))
    assert equal(a & (b | c), (a & b) | (a & c))
    assert equal(cube - (a | b), (cube - a) & (cube - b))
    assert equal(cube - (a & b), (cube - a) | (cube - b))
    assert equal((a - b) | (a & b), a)
    assert equal(a ^ b, (a - b) | (b - a))
    assert equal(a ^ b, (a | b) - (a & b))
    assert len(a - a) == len(a ^ a) == 0
    if one:  # the mean of two equal words is that word
        assert making.same(a | a, a)
        assert making.same(a & a, a)


def test_an_empty_result_is_written_read_and_counted():
    """The root word is 0, its metadata byte 7 is 1; every format and the tables take it."""
    a = volume_of({(1, 2, 3), (15, 0, 0)})
    empty = a - a
    assert [len(words) for words in empty.levels] == [1, 0]
    assert empty.levels[0].tolist() == [0]
    assert empty.metadata_words(1).tolist() == [1 << 56]
    assert empty.volume() == 0
    assert empty.info.box is None
    for kind in ("sparse", "dense"):
        for codec in ("none", "gzip"):
            stream = io.BytesIO()
            write_volume(stream, empty, Encoding(kind, 2, codec))
            back = open_volume(stream.getvalue())
            assert making.same(back, empty, metadata=kind == "sparse")
    assert making.same(empty | a, a)
    assert len(empty & a) == len(crop(empty, Bounds(0, 0, 11, 21))) == 0
    assert len(empty.voxels()) == len(empty.centers()) == 0


def channel(name, byte, scale, offset, unit="", reduction="mean"):
    return {"byte": byte, "name": name, "scale": scale, "offset": offset, "unit": unit,
            "reduction": reduction}  # fmt: skip


def word(**bytes_):
    places = {"red": 0, "height": 3, "intensity": 5, "class": 6}
    return np.uint64(sum(value << 8 * places[name] for name, value in bytes_.items()) | 1 << 56)


def one_voxel(channels, metadata, voxels=((0, 0, 0),), **info):
    levels = making.volume_of(voxels, 1, cube=CUBE).levels
    return Volume(levels, (np.array([metadata]),), CUBE, VolumeInfo(channels=channels, **info))


def test_metadata_is_brought_to_a_common_scaling():
    """Heights and intensities of both span the result's range; colours keep their bytes."""
    a = one_voxel(
        (channel("red", 0, 256.0, 0.0), channel("height", 3, 0.1, 100.0, "m"),
         channel("class", 6, 1.0, 0.0, reduction="mode"), channel("present", 7, 1.0, 0.0)),
        word(red=100, height=200, **{"class": 6}),
    )  # fmt: skip
    b = one_voxel(
        (channel("red", 0, 1.0, 0.0), channel("height", 3, 0.2, 110.0, "m"),
         channel("intensity", 5, 1.0, 0.0),
         channel("class", 6, 1.0, 0.0, reduction="mode"), channel("present", 7, 1.0, 0.0)),
        word(red=50, height=50, intensity=9, **{"class": 2}),
        ((3, 3, 3),),
    )  # fmt: skip
    both = a | b
    assert [c["name"] for c in both.info.channels] == ["red", "height", "class", "present"]
    red, height = both.info.channels[:2]
    assert red["scale"] == 256.0
    assert height["offset"] == 100.0
    assert height["scale"] == pytest.approx((161 - 100) / 255)
    byte = (int(both.metadata_words(1)[0]) >> 24) & 255
    # 100 + 20 and 110 + 10 are the same height
    assert byte * height["scale"] + height["offset"] == pytest.approx(120, abs=height["scale"])
    assert int(both.metadata_words(1)[0]) & 255 == 75
    assert int(both.metadata_words(1)[0]) >> 48 & 255 == 2
    assert int(both.metadata_words(1)[0]) >> 40 & 255 == 0
    assert making.same(a & a, a)
    assert (a - b).info.channels == a.info.channels
    assert (a - b).metadata_words(1).tolist() == a.metadata_words(1).tolist()


def test_without_common_channels_there_is_no_metadata_and_unknown_bytes_stay():
    a = one_voxel((channel("height", 3, 0.1, 0.0, "m"),), word(height=10))
    b = one_voxel((channel("height", 3, 0.1, 0.0, "ft"),), word(height=20))
    plain = Volume(a.levels, None, CUBE, VolumeInfo())
    assert not (a | b).has_metadata
    assert (a | b).info.channels == ()
    for union in (a | plain, plain | a, plain ^ a, unite([plain, a, b])):
        assert not union.has_metadata
        assert union.info.channels == ()
    assert (a & plain).has_metadata
    assert not (plain - a).has_metadata
    raw = [one_voxel((), word(red=n, **{"class": 9 - n}), quantizer="unknown") for n in (2, 5)]
    union = raw[0] | raw[1]
    assert union.metadata_words(1).tolist() == [word(red=4, **{"class": 4})]
    assert union.info.quantizer == "unknown"


@settings(max_examples=40, deadline=None)
@given(st.lists(VOXELS, min_size=1, max_size=5), st.randoms())
def test_a_union_of_many_weighs_them_alike_in_any_order(sets, random):
    """Voxels of all; words are the means over the volumes that have the block."""
    volumes = [volume_of(voxels, seed=i) for i, voxels in enumerate(sets)]
    union = unite(volumes)
    assert twin.voxel_set(union) == set().union(*sets)
    assert_words(union, twin.united_words(volumes))
    random.shuffle(volumes)
    assert making.same(unite(volumes), union)
    if len(volumes) == 2:
        assert making.same(volumes[0] | volumes[1], union)


def test_what_is_known_of_a_result():
    """Boxes unite, points add up, sources are named; a subset's box is that of its cells."""
    a = volume_of({(0, 0, 0), (9, 9, 9)})
    a = replace(a, info=replace(a.info, box=(10.0, 20.0, 30.0, 11.0, 21.0, 31.0), n_points=5,
                                source_name="a.laz", source_bytes=10))  # fmt: skip
    b = volume_of({(15, 15, 15), (9, 9, 9)})
    b = replace(b, info=replace(b.info, box=(10.9, 20.9, 30.9, 11.6, 21.6, 31.6), n_points=7,
                                source_name="b.laz", source_bytes=20, epsg=25832))  # fmt: skip
    union = (a | b).info
    assert union.box == (10.0, 20.0, 30.0, 11.6, 21.6, 31.6)
    assert (union.n_points, union.source_name, union.source_bytes) == (12, "a.laz | b.laz", 30)
    assert union.epsg == 25832
    both = (a & b).info
    assert both.box == (10.9, 20.9, 30.9, 11.0, 21.0, 31.0)
    assert (both.n_points, both.source_name, both.source_bytes) == (None, "a.laz & b.laz", None)
    assert (a - b).info.box == (10.0, 20.0, 30.0, 10.1, 20.1, 30.1)
    assert (a ^ b).info.source_name == "a.laz ^ b.laz"
    many = [replace(a, info=replace(a.info, source_name=f"{i}.laz")) for i in range(9)]
    assert unite(many).info.source_name == "0.laz and 8 others"
    assert (volume_of(set()) | a).info.box == a.info.box


def test_other_grids_are_refused_with_both_told():
    a = volume_of({(0, 0, 0)})
    moved = making.volume_of({(0, 0, 0)}, 2, cube=Cube((10.0, 20.0, 30.1), 1.6), info=INFO)
    for op in OPS:
        with pytest.raises(
            InputError, match=r"side 1.6 at 10, 20, 30, and .* 30.1; .*resample"
        ) as e:
            combine(a, moved, op)
        assert e.value.code == "E_GRID"
    rounded = replace(a, info=replace(a.info, quantizer="toolkit"))
    with pytest.raises(InputError, match="rounded"):
        a | rounded
    with pytest.raises(InputError, match="of 2 and 1 levels"):
        rounded | rounded.truncated(1)
    assert len(rounded | replace(a, info=replace(a.info, quantizer="unknown"))) == 1
    near, far = (
        replace(a, info=VolumeInfo(crs=CrsInfo(unit_xy=unit, metres_per_unit_xy=metres)))
        for unit, metres in (("metre", Fraction(1)), ("foot", Fraction(3048, 10000)))
    )
    with pytest.raises(CRSError, match="metre and in foot"):
        near | far
    assert len(a | far) == 1
    with pytest.raises(OptionError, match="no operation 'plus'"):
        combine(a, a, "plus")
    with pytest.raises(OptionError, match="at least one"):
        unite([])
    with pytest.raises(TypeError):
        a | {(0, 0, 0)}


def test_a_cube_in_floating_point_is_the_same_grid():
    """A file without its trailer has the cube of the header: a rounding error is no other grid."""
    exact = Cube.from_exact([Fraction(1, 3)] * 3, Fraction(5, 3))
    a = making.volume_of({(0, 0, 0)}, 2, cube=exact, info=INFO)
    b = making.volume_of({(1, 0, 0)}, 2, cube=Cube(exact.origin, exact.side), info=INFO)
    assert a.cube.exact != b.cube.exact
    assert (a | b).cube == a.cube


def test_volume_in_cubic_units():
    """Cube units, cubic metres where the unit is known; toolkit voxels by their own step."""
    a = making.random_volume(2, 100)
    cell = Fraction(repr(10.01)) / 16
    assert a.volume() == pytest.approx(float(len(a) * cell**3))
    assert a.volume_m3() == pytest.approx(a.volume() * 0.3048**3)
    rounded = making.volume_of({(0, 0, 0)}, 2, cube=Cube((0.0, 0.0, 0.0), 30.0),
                               info=VolumeInfo(quantizer="unknown"))  # fmt: skip
    assert rounded.volume() == 8.0
    assert rounded.volume_m3() is None


@settings(max_examples=40, deadline=None)
@given(VOXELS, VOXELS, st.sampled_from(sorted(OPS)))
def test_stored_blocks_without_a_voxel_do_no_harm(one, other, op):
    """Files without metadata may have them (W_EMPTY_BLOCKS); results have none."""
    a, b = volume_of(one, 3, metadata=False), volume_of(other, 3, metadata=False)
    if int(a.levels[0][0]) & 1 == 0:
        root = a.levels[0] | np.uint64(1)
        levels = (root, np.insert(a.levels[1], 0, np.uint64(0)), a.levels[2])
        a = Volume(levels, None, a.cube, a.info)
    for left, right in ((a, b), (b, a)):
        expected = OPS[op](twin.voxel_set(left), twin.voxel_set(right))
        result = combine(left, right, op)
        assert [list(words) for words in result.levels] == naive.sparse_levels(expected, 3)
    found = diff(a, b)
    assert (found.n_added, found.n_removed) == (len(other - one), len(one - other))
    bounds = Bounds(10.0, 20.0, 10.05, 30.0)
    assert twin.voxel_set(crop(a, bounds)) == {v for v in one if v[0] <= 2}
