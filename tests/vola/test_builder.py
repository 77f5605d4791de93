"""The builder's volumes against plain Python, whatever the order, the chunks and the memory."""

from __future__ import annotations

import hashlib
import itertools
from fractions import Fraction

import naive_vola as naive
import numpy as np
import pytest

from volatool.channels import CHANNELS
from volatool.cube import Cube
from volatool.errors import OptionError, ResourceError
from volatool.model import CrsInfo, PointChunk
from volatool.scratch import Scratch
from volatool.vola.builder import VolaBuilder
from volatool.vola.volume import VolumeInfo

SCALE, OFFSET = (0.01, 0.01, 0.01), (500.0, -20.0, 3.5)


def some_points(n=1200, seed=1, spread=1500, colour=2**16):
    """Points on a bumpy surface with every attribute, clustered enough to share voxels."""
    rng = np.random.default_rng(seed)
    x, y = rng.integers(0, spread, (2, n))
    z = (60 * np.sin(x / 200) * np.cos(y / 300) + rng.integers(0, 20, n)).astype(np.int64) + 100
    attributes = {
        "classification": rng.choice([1, 2, 2, 5, 6, 9, 200], n).astype(np.uint8),
        "number_of_returns": rng.integers(0, 8, n).astype(np.uint8),
        "intensity": rng.integers(0, 3000, n).astype(np.uint16),
        "red": rng.integers(0, colour, n).astype(np.uint16),
        "green": rng.integers(0, colour, n).astype(np.uint16),
        "blue": rng.integers(0, colour, n).astype(np.uint16),
    }
    columns = [np.ascontiguousarray(c, np.int32) for c in (x, y, z)]
    return PointChunk(0, *columns, SCALE, OFFSET, attributes)


def cube_of(points, z_ratio=Fraction(1)):
    ratios = (1, 1, z_ratio)
    ends = []
    for pick in (min, max):
        for axis, column in enumerate((points.x, points.y, points.z)):
            value = int(pick(column)) * naive.decimal(points.scale[axis])
            ends.append((value + naive.decimal(points.offset[axis])) * ratios[axis])
    return Cube.around(ends)


def pieces_of(points, n):
    for start in range(0, len(points), n):
        mask = np.zeros(len(points), bool)
        mask[start : start + n] = True
        yield points.take(mask)


_made: list[VolaBuilder] = []


@pytest.fixture(autouse=True)
def _close_builders():
    """Temporary files of builders are closed, not left to the garbage collector."""
    yield
    while _made:
        _made.pop().close()


def make(*args, **options):
    _made.append(VolaBuilder(*args, **options))
    return _made[-1]


def build(points, *, chunk=1000, depth=4, cube=None, **options):
    builder = make(cube or cube_of(points), options.pop("max_depth", depth), **options)
    for piece in pieces_of(points, chunk):
        assert builder.add(piece) == 0
    built = builder.build()
    return builder, built, built.volume(depth)


def digest(volume):
    arrays = (*volume.levels, *(volume.metadata_levels or ()))
    return hashlib.sha256(b"|".join(array.tobytes() for array in arrays)).hexdigest()


def check_against_naive(points, built, volume, channels, z_ratio=Fraction(1)):
    """Compare words, counts and metadata of every level with plain Python."""
    xyz = np.column_stack([points.x, points.y, points.z]).tolist()
    depth = volume.depth
    keys = naive.path_keys(xyz, points.scale, points.offset, volume.cube.exact, depth, z_ratio)
    expected = naive.level_words(set(keys), depth)
    assert [words.tolist() for words in volume.levels] == expected
    for level, words in enumerate(expected, 1):
        counts = built.counts[level - 1]
        assert counts.blocks == len(words)
        assert counts.voxels == sum(word.bit_count() for word in words)
        assert counts.contiguous_pairs == sum(map(naive.pairs, words))
    if channels:
        words = naive.metadata_words(keys, depth, points.z.tolist(), points.attributes, channels)
        assert [level.tolist() for level in volume.metadata_levels] == words


@pytest.mark.parametrize("chunk", [1, 70, 10_000])
def test_every_word_and_count_is_that_of_plain_python(chunk):
    """All levels, all channels, whatever the chunks."""
    points = some_points(600 if chunk == 1 else 1200)
    _, built, volume = build(points, chunk=chunk, channels=CHANNELS)
    check_against_naive(points, built, volume, CHANNELS)
    for above, below in itertools.pairwise(built.counts):
        assert below.blocks == above.voxels


@pytest.mark.parametrize(
    "channels", [(), ("height",), ("class",), ("rgb", "intensity"), ("returns", "class")]
)
def test_only_the_channels_asked_for_are_there(channels):
    """Absent channels are 0; no channel, no metadata; they need only their own attributes."""
    points = some_points()
    _, built, volume = build(points, channels=channels)
    assert volume.has_metadata == bool(channels)
    check_against_naive(points, built, volume, channels)


@pytest.mark.parametrize("colour", [256, 257, 1])
def test_eight_bit_colours_in_sixteen_bits_are_not_divided(colour):
    """The largest colour of the points decides."""
    points = some_points(colour=colour)
    _, built, volume = build(points, channels=("rgb",))
    check_against_naive(points, built, volume, ("rgb",))
    assert volume.info.channels[0]["scale"] == (256 if colour == 257 else 1)


def test_heights_in_another_unit_are_scaled_for_the_cube_only():
    """Feet on the z axis: the cells are cubes in metres; the height channel keeps its range."""
    foot = Fraction(3048, 10000)
    points = some_points()
    cube = cube_of(points, foot)
    _, built, volume = build(points, cube=cube, channels=CHANNELS, z_ratio=foot)
    check_against_naive(points, built, volume, CHANNELS, foot)


def test_order_chunks_memory_and_depth_limits_do_not_change_a_byte():
    """Shuffled points, three chunk sizes, budgets from nothing to unlimited, deeper trees."""
    points = some_points(20_000)
    order = np.random.default_rng(5).permutation(len(points))
    shuffled = points.take(order)
    cube = cube_of(points)
    reference = digest(build(points, chunk=20_000, channels=CHANNELS)[2])
    found = set()
    for chunk, budget in ((300, None), (300, 0), (999, 200_000), (5000, 1_000_000)):
        scratch = Scratch(budget)
        builder, _, volume = build(
            shuffled, chunk=chunk, channels=CHANNELS, cube=cube, scratch=scratch, max_depth=7
        )
        found.add(digest(volume))
        assert bool(scratch.spilled_bytes) == (budget is not None)
        builder.close()
        assert scratch.used_bytes == 0
    assert found == {reference}


@pytest.mark.parametrize("is_by_place", [False, True])
@pytest.mark.parametrize("budget", [None, 0, 300_000])
def test_depths_that_can_not_be_chosen_are_given_up_and_the_others_stay(budget, is_by_place):
    """
    With an upper bound of the points the chosen volume is the same; deeper ones are refused.

    In a file that goes from one end to the other, blocks become too many only late.
    """
    points = some_points(30_000, spread=900)
    if is_by_place:
        points = points.take(np.argsort(points.x))
    plain = make(cube_of(points), 8, channels=CHANNELS)
    frugal = make(
        cube_of(points), 8, channels=CHANNELS, n_points_hint=40_000, scratch=Scratch(budget)
    )
    for piece in pieces_of(points, 2000):
        plain.add(piece)
        frugal.add(piece)
    a, b = plain.build(), frugal.build()
    assert [c.blocks for c in a.counts] == [c.blocks for c in b.counts]
    assert a.deepest == 8
    assert 2 < b.deepest < 8
    assert all(c.blocks <= 40_000 / 9.6 for c in b.counts[1 : b.deepest])
    assert b.counts[b.deepest].blocks > 40_000 / 9.6
    for depth in range(1, b.deepest + 1):
        assert digest(a.volume(depth)) == digest(b.volume(depth))
    with pytest.raises(OptionError, match=f"depth 8 was not kept, levels 1 to {b.deepest} were"):
        b.volume(8)
    assert digest(plain.finish()) == digest(frugal.finish())


def test_a_depth_to_keep_is_kept_whatever_its_occupancy():
    """Fixed depths and budgets: words to that depth, counts to the deepest."""
    points = some_points()
    builder, built, volume = build(
        points, depth=6, max_depth=8, keep_depth=6, n_points_hint=3000, channels=CHANNELS
    )
    assert (volume.depth, built.deepest, len(built.counts)) == (6, 6, 8)
    assert built.counts[5].voxels / built.counts[5].blocks < 0.15 * 64
    with pytest.raises(OptionError, match="keep_depth=7"):
        built.volume(7)
    builder.close()


def test_points_outside_are_counted_and_not_added():
    """Nothing is clipped: the rest is as if they had never been there."""
    points = some_points()
    inside = points.x < 700
    cube = cube_of(points.take(inside))
    box_keys = naive.path_keys(
        np.column_stack([points.x, points.y, points.z]).tolist(), SCALE, OFFSET, cube.exact, 4
    )
    outside = np.array([key == naive.OUTSIDE for key in box_keys])
    builder = make(cube, 4, channels=CHANNELS)
    assert builder.add(points) == outside.sum() > 0
    assert builder.add(points.take(outside)) == outside.sum()
    built = builder.build()
    assert built.n_points == (~outside).sum()
    kept = points.take(~outside)
    assert digest(built.volume(4)) == digest(build(kept, cube=cube, channels=CHANNELS)[2])


@pytest.mark.parametrize("kind", ["one point", "one place", "column", "flat"])
def test_degenerate_clouds_are_volumes(kind):
    """A side of 0 or extents of 0 are no trouble."""
    points = some_points(1 if kind == "one point" else 50)
    if kind != "one point":
        for name in ("x", "y") if kind == "column" else ("z",) if kind == "flat" else "xyz":
            getattr(points, name)[:] = 77
    _, built, volume = build(points, channels=CHANNELS)
    check_against_naive(points, built, volume, CHANNELS)
    assert volume.info.n_points == len(points)


def test_no_points_give_an_empty_root():
    """A valid volume without voxels."""
    builder = make(Cube((0.0, 0.0, 0.0), 1.0), 3, channels=("class",))
    built = builder.build()
    assert [c.blocks for c in built.counts] == [1, 0, 0]
    volume = built.volume(2)
    assert (len(volume), volume.info.box, volume.info.n_points) == (0, None, 0)
    assert volume.metadata_levels[0].tolist() == [1 << 56]


@pytest.mark.parametrize("max_depth", [1, 9, 10])
def test_all_depths_work(max_depth):
    """From one level to ten, metadata included."""
    points = some_points(400)
    _, built, volume = build(points, depth=max_depth, channels=CHANNELS)
    check_against_naive(points, built, volume, CHANNELS)


def test_the_volume_says_what_it_is_made_of():
    """Box, points and channels are filled in; what the caller knows is kept."""
    points = some_points()
    builder, built, _ = build(points, channels=("height",), crs=CrsInfo(unit_z="metre", epsg=28992))
    volume = built.volume(2, VolumeInfo(source_name="a.laz", lat=52.0))
    info = volume.info
    assert (info.source_name, info.lat, info.n_points) == ("a.laz", 52.0, 1200)
    assert info.quantizer == "floor"
    xyz = points.xyz()
    assert np.allclose(info.box, [*xyz.min(axis=0), *xyz.max(axis=0)], atol=1e-9)
    height = info.channels[0]
    assert (height["name"], height["unit"]) == ("height", "metre")
    assert height["offset"] == pytest.approx(xyz[:, 2].min())
    assert height["scale"] * 255 + height["offset"] == pytest.approx(xyz[:, 2].max())
    assert built.info().epsg == 28992
    builder.close()
    assert volume.levels[1].sum() > 0  # its arrays are its own
    with pytest.raises(OptionError, match="was not kept"):
        built.volume(2)


def test_finish_chooses_and_closes():
    """The depth rule, a fixed depth, and no adding afterwards."""
    points = some_points(20_000)
    builder = make(cube_of(points), 6)
    builder.add(points)
    volume = builder.finish(min_occupancy=0.3)
    assert volume.counts()[-1].voxels / volume.counts()[-1].blocks >= 0.3 * 64
    with pytest.raises(OptionError, match="built already"):
        builder.add(points)
    with pytest.raises(OptionError, match="the builder is closed"):
        builder.finish()
    with VolaBuilder(cube_of(points), 6) as other:
        with pytest.raises(OptionError, match=r"takes the chunks of vt\.stream, not ndarray"):
            other.add(points.xyz())
        other.add(points)
        for depth in (0, 7, "deep"):
            with pytest.raises(OptionError, match="depth must be 'auto' or 1 to 6"):
                other.finish(depth=depth)
        assert other.finish(depth=5).depth == 5


def test_chunks_with_another_scale_and_offset_fit_in():
    """Two files of one place: the same cells; heights count in the first one's steps."""
    points = some_points()
    cube = cube_of(points)
    finer = PointChunk(
        0,
        *((v * 10).astype(np.int32) for v in (points.x, points.y, points.z)),
        (0.001,) * 3,
        OFFSET,
        points.attributes,
    )
    builder = make(cube, 4, channels=CHANNELS)
    builder.add(points)
    builder.add(finer)
    twice = make(cube, 4, channels=CHANNELS)
    twice.add(points)
    twice.add(points)
    assert digest(builder.build().volume(4)) == digest(twice.build().volume(4))


def test_a_missing_attribute_is_said():
    """Which one, and what to do."""
    points = some_points()
    bare = PointChunk(0, points.x, points.y, points.z, SCALE, OFFSET)
    builder = make(cube_of(points), 4, channels=("rgb",))
    with pytest.raises(OptionError, match="'rgb' needs the points' red"):
        builder.add(bare)
    with pytest.raises(OptionError, match="no metadata channel is called 'colour'"):
        make(cube_of(points), 4, channels=("colour",))
    for depth in (0, 11):
        with pytest.raises(ResourceError, match="max_depth must be 1 to 10"):
            make(cube_of(points), depth)


def test_a_full_disk_is_an_error_of_ours(monkeypatch):
    """Spilling that fails says what to do."""
    points = some_points()
    scratch = Scratch(0)

    class Full:
        def write(self, data):
            raise OSError(28, "No space left on device")

        def close(self):
            pass

    monkeypatch.setattr(scratch, "file", Full)
    builder = make(cube_of(points), 4, scratch=scratch)
    with pytest.raises(ResourceError, match=r"No space left on device.*TMPDIR"):
        builder.add(points)


@pytest.mark.shared
@pytest.mark.parametrize("name", ["4_6_crop.las", "autzen_trim.las"])
def test_real_tiles_have_the_counts_of_plain_numpy(shared, name):
    """Floor rule and unique voxels, counted independently, equal every level exactly."""
    import laspy

    las = laspy.read(shared / "tiles" / name)
    scale, offset = tuple(map(float, las.header.scales)), tuple(map(float, las.header.offsets))
    columns = [np.ascontiguousarray(c, np.int32) for c in (las.X, las.Y, las.Z)]
    points = PointChunk(0, *columns, scale, offset)
    assert len(set(scale)) == 1
    low = [int(c.min()) for c in columns]
    side = max(int(c.max()) - m for c, m in zip(columns, low, strict=True))
    _, built, volume = build(points, chunk=30_000, depth=6)
    for level in range(1, 7):
        cells = 4**level
        index = [
            np.minimum((c.astype(np.int64) - m) * cells // side, cells - 1)
            for c, m in zip(columns, low, strict=True)
        ]
        distinct = len(np.unique(index[0] + cells * (index[1] + cells * index[2])))
        assert built.counts[level - 1].voxels == distinct
    assert volume.n_voxels == distinct
