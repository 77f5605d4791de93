"""A volume on another grid."""

from __future__ import annotations

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
from volatool.errors import InputError, OptionError, ResourceError
from volatool.vola.algebra import combine
from volatool.vola.regrid import as_cells, regrid, regridded
from volatool.vola.volume import VolumeInfo

CUBE = Cube((0.0, 0.0, 0.0), 16.0)
VOXELS = st.sets(st.tuples(*[st.integers(0, 15)] * 3), max_size=20)
INFO = VolumeInfo()


def volume_of(voxels, depth=2, cube=CUBE, **options):
    return making.volume_of(voxels, depth, cube=cube, info=options.pop("info", INFO), **options)


@settings(max_examples=60, deadline=None)
@given(
    VOXELS,
    st.integers(-8, 8),
    st.sampled_from([Fraction(5), Fraction(16), Fraction(40), Fraction(33, 7), Fraction(160)]),
    st.integers(1, 2),
    st.booleans(),
)
def test_cells_are_those_of_the_definition(voxels, shift, side, depth, rounded):
    """Middles when the target is not finer, boxes when it is, places of toolkit voxels; exact."""
    info = VolumeInfo(quantizer="toolkit") if rounded else INFO
    source = volume_of(voxels, info=info)
    cube = Cube.from_exact([Fraction(shift, 2), Fraction(shift), Fraction(-1, 3)], side)
    result, n_lost = regridded(source, cube, depth)
    expected, lost = twin.regridded(source, cube, depth)
    assert twin.voxel_set(result) == expected
    assert n_lost == lost
    assert result.info.quantizer == "floor"
    assert [list(words) for words in result.levels] == naive.sparse_levels(expected, depth)


@settings(max_examples=40, deadline=None)
@given(VOXELS)
def test_aligned_grids_are_exact_both_ways(voxels):
    """Coarser: the levels above. Finer and back: the same. Shifted by whole cells: a shift."""
    source = volume_of(voxels)
    assert making.same(regrid(source, CUBE, 1), source.truncated(1), metadata=False)
    fine = source.regrid(CUBE, 3)
    assert len(fine) == 64 * len(source)
    assert making.same(fine.truncated(2), source, metadata=False)
    assert making.same(regrid(fine, CUBE, 2), source, metadata=False)
    shifted = regrid(source, Cube((-4.0, 0.0, 0.0), 64.0), 3)
    assert twin.voxel_set(shifted) == {(x + 4, y, z) for x, y, z in voxels}
    if voxels:
        assert np.array_equal(fine.metadata_words(3), source.metadata())


def test_what_lies_outside_is_counted_and_no_longer_described():
    source = volume_of({(0, 0, 0), (15, 15, 15)}, info=replace(INFO, n_points=9,
                       box=(0.5, 0.5, 0.5, 15.5, 15.5, 15.5)))  # fmt: skip
    part, n_lost = regridded(source, Cube((0.0, 0.0, 0.0), 8.0), 2)
    assert n_lost == 1
    assert len(part) == 8  # one voxel of 1 as eight of 0.5
    assert part.info.n_points is None
    assert part.info.box == (0.5, 0.5, 0.5, 1.0, 1.0, 1.0)
    whole, n_lost = regridded(source, Cube((-8.0, -8.0, -8.0), 32.0), 2)
    assert (n_lost, whole.info.n_points, whole.info.box) == (0, 9, source.info.box)


def test_a_place_on_the_far_face_is_in_the_last_cell():
    """The toolkit's last place is the cube's far corner: it is not lost."""
    corner = {(15, 15, 15), (0, 0, 0)}
    source = volume_of(corner, info=VolumeInfo(quantizer="unknown"))
    assert twin.voxel_set(regrid(source, CUBE, 2)) == corner
    assert twin.voxel_set(as_cells(source)) == corner
    assert as_cells(source).info.quantizer == "floor"
    assert as_cells(volume_of(corner)).info == INFO


def test_combine_resamples_on_request():
    """b comes to the grid of a; toolkit volumes become cells; else it is refused."""
    a = volume_of({(4, 4, 4)})
    b = volume_of({(0, 0, 0)}, cube=Cube((4.2, 4.2, 4.2), 16.0))
    with pytest.raises(InputError, match="resample"):
        combine(a, b, "and")
    assert len(combine(a, b, "and", resample=True)) == 1
    assert twin.voxel_set(combine(b, a, "or", resample=True)) == {(0, 0, 0)}
    rounded = volume_of({(4, 4, 4)}, info=VolumeInfo(quantizer="unknown"))
    for one, other in ((a, rounded), (rounded, a)):
        assert len(combine(one, other, "and", resample=True)) == 1
    coarse = combine(rounded, rounded.truncated(1), "or", resample=True)
    assert twin.voxel_set(coarse) == {(4, 4, 4), (5, 5, 5)}  # place 1 of 0..3 is at a third
    same = combine(a, a, "xor", resample=True)
    assert len(same) == 0


def test_sizes_that_make_no_sense_are_refused_before_any_work(monkeypatch):
    source = volume_of({(0, 0, 0)})
    for depth in (0, 11):
        with pytest.raises(ResourceError, match="1 to 10 levels"):
            regrid(source, CUBE, depth)
    with pytest.raises(OptionError, match="side greater than 0"):
        regrid(source, Cube((0.0, 0.0, 0.0), 0.0), 2)
    with pytest.raises(ResourceError, match="cells, at most") as e:
        regrid(source, Cube((0.0, 0.0, 0.0), 0.9), 10)
    assert e.value.code == "E_SIZE"


def test_pieces_make_no_difference(monkeypatch):
    """Cut after every few cells, or in the middle of empty voxels: the same volume."""
    source = volume_of({(x, y, (x * y) % 16) for x in range(16) for y in range(16)})
    cube = Cube((3.3, -2.0, 1.1), 11.0)
    whole = regrid(source, cube, 3)
    monkeypatch.setattr("volatool.vola.regrid._PIECE", 5)
    assert making.same(regrid(source, cube, 3), whole)


def test_numbers_beyond_64_bits_are_still_exact():
    """Corners and sides of odd decimals need larger integers than the machine's."""
    odd = Cube.from_exact([Fraction(1, 10**19 + 51)] * 3, Fraction(16) + Fraction(1, 10**17 + 3))
    voxels = {(0, 0, 0), (3, 7, 15), (15, 15, 15)}
    source = volume_of(voxels)
    assert twin.voxel_set(regrid(source, odd, 2)) == twin.regridded(source, odd, 2)[0] == voxels
