"""Windows of a volume against the definition, cell by cell."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from making_exports import full_volume, toolkit_volume
from making_volumes import same

from volatool.errors import OptionError
from volatool.model import Bounds
from volatool.vola.algebra import crop
from volatool.vola.window import cells_inside

VOLUME = full_volume(depth=3, n=2000)


def naive(volume, level, first, shape):
    """Return the dense window, one look-up a cell."""
    found = np.zeros(shape, bool)
    for place in np.ndindex(*shape):
        found[place] = volume.contains_cells([np.add(first, place)], level)[0]
    return found


@pytest.mark.parametrize("level", [1, 2, 3])
def test_a_window_is_what_look_ups_say(level):
    x, y, _ = VOLUME.cube.origin
    window = VOLUME.window(Bounds(x + 3, y + 1, x + 4, y + 2.5), level, z=(401.0, 402.5))
    assert window.level == level
    assert window.cell == VOLUME.cell(level)
    dense = window.to_numpy()
    assert np.array_equal(dense, naive(VOLUME, level, window.first, window.shape))
    assert dense.any()


def test_the_place_of_a_window_is_told():
    """Its set cells lie where the volume's centres are, z in the vertical unit."""
    x, y, _ = VOLUME.cube.origin
    window = VOLUME.window(Bounds(x + 3, y + 1, x + 6, y + 5), z=(403.0, 407.0))
    ratio = float(VOLUME.crs.z_ratio)
    cell = np.array([window.cell, window.cell, window.cell / ratio])
    places = np.argwhere(window.to_numpy()) * cell + cell / 2 + window.origin
    assert len(places) > 0
    assert VOLUME.contains(places).all()
    inside = crop(VOLUME, Bounds(x + 3, y + 1, x + 6, y + 5), z=(403.0, 407.0))
    assert len(places) == len(inside)


@given(data=st.data())
@settings(max_examples=40, deadline=None)
def test_only_the_cells_between_two_corners_are_found(data):
    ends = st.integers(0, 63)
    a, b = (np.array(data.draw(st.tuples(ends, ends, ends)), np.int64) for _ in range(2))
    first, last = np.minimum(a, b), np.maximum(a, b)
    voxels = VOLUME.voxels()
    keep = np.all((voxels >= first) & (voxels <= last), axis=1)
    assert np.array_equal(cells_inside(VOLUME, first, last), voxels[keep])


def test_the_whole_cube_and_places_outside():
    window = VOLUME.window()
    assert (window.first, window.shape) == ((0, 0, 0), (64, 64, 64))
    assert len(window) == len(VOLUME) == window.to_numpy().sum()
    with pytest.raises(OptionError, match="outside the cube"):
        VOLUME.window(Bounds(0, 0, 1, 1))
    with pytest.raises(OptionError, match="level 4 is not in this volume"):
        VOLUME.window(level=4)
    for z in ((2, 1), (np.nan, 1)):
        with pytest.raises(OptionError, match="z must be lowest, highest"):
            VOLUME.window(z=z)


def test_bounds_may_be_four_numbers():
    x, y, _ = VOLUME.cube.origin
    numbers = [x + 3, y + 1, x + 6, y + 5]
    expected, found = VOLUME.window(Bounds(*numbers)), VOLUME.window(np.array(numbers))
    assert (found.first, found.shape) == (expected.first, expected.shape)
    assert same(VOLUME.crop(tuple(numbers), z=(403.0, 407.0)), crop(
        VOLUME, Bounds(*numbers), z=(403.0, 407.0)
    ))  # fmt: skip
    for bad in ([1, 2, 3], [2, 0, 1, 0], [np.nan, 0, 1, 1]):
        for cut in (VOLUME.window, VOLUME.crop):
            with pytest.raises(OptionError, match="bounds "):
                cut(bad)


def test_windows_of_a_toolkit_file_are_centred_on_its_points():
    volume = toolkit_volume()
    window = volume.window(level=2)
    places = np.argwhere(window.to_numpy()) * window.cell + window.cell / 2 + window.origin
    assert np.allclose(np.sort(places, axis=0), np.sort(volume.centers(2), axis=0))
