"""The volume in memory."""

from __future__ import annotations

import itertools
from fractions import Fraction

import making_volumes as making
import naive_formats as naive
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from volatool.cube import Cube
from volatool.errors import FormatError, OptionError, ResourceError
from volatool.formats.registry import open_volume
from volatool.model import CrsInfo
from volatool.vola.volume import Volume, VolumeInfo

VOXELS = [(0, 0, 0), (1, 0, 0), (5, 2, 9), (15, 15, 15), (15, 15, 14)]


def test_voxels_and_keys_come_in_vola_order() -> None:
    """Ascending paths, root first, at every level."""
    volume = making.random_volume(3, 300)
    for level in (1, 2, 3):
        paths = {naive.path(tuple(row), 3)[:level] for row in volume.voxels().tolist()}
        cells = [naive.cell(digits) for digits in sorted(paths)]
        assert [tuple(row) for row in volume.voxels(level).tolist()] == cells
        keys = [sum(d << 6 * (level - 1 - i) for i, d in enumerate(p)) for p in sorted(paths)]
        assert volume.keys(level).tolist() == keys
        assert volume.n_cells(level) == len(keys)
    assert volume.block_keys(3).tolist() == volume.keys(2).tolist()
    assert len(volume) == volume.n_voxels == len(volume.voxels())


def test_every_voxel_is_found_and_no_other_cell() -> None:
    """`find` is the inverse of `voxels`; everything else is -1, indices never wrap round."""
    volume = making.volume_of(VOXELS, 2)
    grid = np.stack(np.meshgrid(*[np.arange(-2, 18)] * 3, indexing="ij"), -1).reshape(-1, 3)
    found = volume.find(grid)
    rows = [tuple(row) for row in volume.voxels().tolist()]
    expected = [rows.index(tuple(c)) if tuple(c) in rows else -1 for c in grid.tolist()]
    assert found.tolist() == expected
    assert volume.contains_cells(grid).sum() == len(VOXELS)
    assert volume.contains_cells([[0, 0, 0], [3, 3, 3], [2, 0, 0]], level=1).tolist() == [1, 1, 0]


def test_centers_lie_in_their_voxels() -> None:
    """The middles of the cells are contained, at large coordinates and other vertical units too."""
    volume = making.random_volume(3, 300)
    assert volume.crs.z_ratio != 1
    assert volume.contains(volume.centers()).all()
    x, _, z = volume.cube.origin
    assert not volume.contains([[x - 1, 0, 0], [np.nan, 0, 0], [np.inf, 0, z]]).any()
    unusable = volume.centers()[np.arange(9)]
    unusable[range(9), [0, 1, 2] * 3] = [np.nan] * 3 + [np.inf] * 3 + [-np.inf] * 3
    assert not volume.contains(unusable).any()
    assert (volume.cell_indices(unusable) == -1).all()


@pytest.mark.parametrize("depth", [1, 2, 3, 4, 5])
@pytest.mark.parametrize("n", [1, 5000])
def test_contains_in_one_pass_is_find_of_the_cells(depth, n) -> None:
    """With and without a table for the first levels, on and beside faces, inside and outside."""
    volume = making.random_volume(depth, n)
    rng = np.random.default_rng(n)
    corner, side = np.array(volume.cube.origin), volume.cube.side
    xyz = corner + rng.uniform(-0.1, 1.1, (2000, 3)) * side
    xyz[:500] = volume.centers()[rng.integers(0, len(volume), 500)]
    faces = volume.cube.corners(rng.integers(0, 4**depth + 1, (500, 3)).astype(np.int32), depth)
    xyz[500:1000] = faces + rng.choice([0, 1e-10, -1e-10], (500, 3))
    xyz[1000:1004] = [[1e300] * 3, [-1e300] * 3, [np.nan, *xyz[0, 1:]], [*xyz[0, :2], np.inf]]
    xyz[1004:1010] = xyz[0] + side * np.vstack([2**40 * np.eye(3), -(2**40) * np.eye(3)])
    xyz[:1000, 2] /= [1] * 500 + [float(volume.crs.z_ratio)] * 500
    found = volume.contains(xyz)
    assert found.tolist() == volume.contains_cells(volume.cell_indices(xyz)).tolist()
    assert found[:500].all()
    assert len(volume.directory.jump) == 64**volume.directory.jump_level
    assert n == 1 or volume.directory.jump_level == min(depth - 1, 2)


def test_points_on_faces_belong_to_the_cell_above() -> None:
    """Coordinates a rounding error below a face count as on it; the cube's far face is inside."""
    cube = Cube((637000.01, 4850000.53, 0.07), 25.6)
    stored = np.arange(257)
    xyz = np.column_stack([stored * 0.1 + corner for corner in cube.origin])
    volume = making.volume_of([(0, 0, 0)], 4, cube=cube, info=VolumeInfo())
    assert volume.cell_indices(xyz)[:, 0].tolist() == [*range(256), 255]
    assert volume.cell_indices(xyz - 0.001)[1:, 2].tolist() == list(range(256))
    assert (volume.cell_indices(xyz + 25.7) == -1).all()


def test_a_tie_of_the_toolkit_is_decided_as_the_toolkit_did() -> None:
    """Its side is a difference of floats; that of decimals sends this point (golden) down."""
    box = (1639600.0, 1454500.02, 7077.92, 1639799.98, 1454700.0, 7139.7)
    volume = open_volume(naive.header(0, 3, 0, box) + bytes(8))
    assert volume.cube.side == 199.98
    point = [1639602.22, 1454501.24, 7089.03]
    assert volume.cell_indices([point]).tolist() == [[1, 0, 4]]


def test_toolkit_volumes_place_voxels_where_the_toolkit_rounded_to() -> None:
    """Voxel k is at min + k L / (S - 1), and a point belongs to the nearest of these places."""
    volume = making.volume_of(
        [(0, 0, 0), (15, 15, 15), (7, 0, 0)],
        2,
        cube=Cube((0.0, 0.0, 0.0), 15.0),
        info=VolumeInfo(quantizer="unknown"),
    )
    assert sorted(volume.centers()[:, 0].tolist()) == [0.0, 7.0, 15.0]
    assert volume.cell_indices([[7.4, 6.6, 15.0]]).tolist() == [[7, 7, 15]]
    assert volume.cell_indices([[7.4, 6.6, 15.0]], level=1).tolist() == [[1, 1, 3]]
    assert volume.centers(1)[0].tolist() == [1.5, 1.5, 1.5]


def test_a_cube_without_extent_holds_its_one_place() -> None:
    """All points equal: one voxel, contained; a point elsewhere is not."""
    cube = Cube((5.0, 6.0, 7.0), 0.0)
    volume = making.volume_of([(0, 0, 0)], 2, cube=cube, info=VolumeInfo())
    assert volume.contains([[5.0, 6.0, 7.0], [5.0, 6.0, 7.1]]).tolist() == [True, False]
    assert volume.centers().tolist() == [[5.0, 6.0, 7.0]]


def test_heights_are_in_the_vertical_unit() -> None:
    """The cube's z counts in the horizontal unit; points and centres in the file's own."""
    crs = CrsInfo(metres_per_unit_xy=Fraction(1, 2), metres_per_unit_z=Fraction(1))
    cube = Cube((0.0, 0.0, 0.0), 4.0)
    volume = making.volume_of([(0, 0, 3)], 1, cube=cube, info=VolumeInfo(crs=crs))
    assert volume.centers().tolist() == [[0.5, 0.5, 1.75]]
    assert volume.contains([[0.5, 0.5, 1.75], [0.5, 0.5, 3.5]]).tolist() == [True, False]


def test_metadata_of_a_voxel_is_the_word_of_its_block() -> None:
    """One word a voxel, in the order of the voxels; channels are decoded with their scale."""
    volume = making.random_volume(2, 60)
    blocks = [tuple(row) for row in volume.voxels(1).tolist()]
    words = volume.metadata_words(2)
    for voxel, word in zip(volume.voxels().tolist(), volume.metadata(), strict=True):
        assert word == words[blocks.index(tuple(value // 4 for value in voxel))]
    heights = (volume.metadata() >> np.uint64(24) & np.uint64(255)) * 0.02 + 400.0
    assert np.array_equal(volume.channel("height"), heights)
    with pytest.raises(OptionError, match="no metadata channel 'red'; known: height"):
        volume.channel("red")
    with pytest.raises(OptionError, match="no metadata") as caught:
        making.random_volume(2, 60, metadata=False).metadata()
    assert caught.value.code == "E_NO_METADATA"


def test_a_volume_cannot_be_changed() -> None:
    """Arrays are read-only views, the caller's own stay writable."""
    root = np.array([1], np.uint64)
    volume = Volume((root,), None, making.CUBE)
    with pytest.raises(ValueError, match="read-only"):
        volume.levels[0][0] = 2
    with pytest.raises(AttributeError):
        volume.cube = making.CUBE  # type: ignore[misc]
    root[0] = 1


def test_levels_that_contradict_each_other_are_refused() -> None:
    """The number of words of a level is the number of bits set above it."""
    root = np.array([3], np.uint64)
    with pytest.raises(FormatError, match="level 2 has 1 blocks, the level above it says 2"):
        Volume((root, np.ones(1, np.uint64)), None, making.CUBE)
    with pytest.raises(FormatError, match="one metadata word for each"):
        Volume((root,), (np.ones(2, np.uint64),), making.CUBE)
    with pytest.raises(ResourceError, match="1 to 15 levels"):
        Volume((), None, making.CUBE)


def test_an_empty_volume_works() -> None:
    """A root of zero: no voxels at any level."""
    nothing = np.empty(0, np.uint64)
    volume = Volume((np.zeros(1, np.uint64), nothing, nothing), None, making.CUBE)
    assert len(volume) == 0
    assert volume.voxels().shape == (0, 3)
    assert volume.centers().shape == (0, 3)
    assert not volume.contains([[637001.0, 4850001.0, 401.0]]).any()
    assert [counts.blocks for counts in volume.counts()] == [1, 0, 0]


def test_levels_are_named_from_1_and_checked() -> None:
    """Level 0 and levels below the deepest are refused; a smaller depth shares its arrays."""
    volume = making.random_volume(3, 50)
    for level in (0, 4, -1):
        with pytest.raises(OptionError, match="levels 1 to 3"):
            volume.voxels(level)
    shallow = volume.truncated(2)
    assert shallow.depth == 2
    assert np.shares_memory(shallow.levels[1], volume.levels[1])
    assert shallow.keys().tolist() == volume.keys(2).tolist()
    for same in (volume.downsample(), volume.downsample(2)):
        assert making.same(same, shallow)
    with pytest.raises(OptionError, match="levels 1 to 3"):
        volume.downsample(0)


def test_deep_volumes_have_voxels_but_no_keys() -> None:
    """15 levels can be held and looked up; path keys end at level 10."""
    words = tuple(np.array([1 << 63], np.uint64) for _ in range(15))
    volume = Volume(words, None, making.CUBE)
    assert volume.voxels().tolist() == [[4**15 - 1] * 3]
    assert volume.find(volume.voxels()).tolist() == [0]
    with pytest.raises(ResourceError, match="path keys end at level 10"):
        volume.keys()


def test_repr_says_what_it_is() -> None:
    """Depth, voxels, cell, cube and CRS on one line."""
    text = repr(making.random_volume(2, 20))
    assert text.startswith("<Volume depth 2, ")
    assert "EPSG:2994, metadata>" in text


@settings(max_examples=40, deadline=None)
@given(
    st.integers(1, 4).flatmap(
        lambda depth: st.tuples(
            st.just(depth),
            st.sets(st.tuples(*[st.integers(0, 4**depth - 1)] * 3), max_size=40),
        )
    )
)
def test_levels_agree_with_the_naive_encoder(case) -> None:
    """Voxels out are the voxels in, and counts of a level are the blocks of the next."""
    depth, voxels = case
    volume = making.volume_of(voxels, depth)
    assert {tuple(row) for row in volume.voxels().tolist()} == voxels
    counts = volume.counts()
    for upper, lower in itertools.pairwise(counts):
        assert upper.voxels == lower.blocks
    assert counts[-1].voxels == len(voxels)
