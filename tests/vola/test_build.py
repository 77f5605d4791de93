"""Volumes from path keys."""

from __future__ import annotations

import making_volumes as making
import naive_algebra as twin
import naive_formats as naive
import naive_vola
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from volatool.errors import OptionError, ResourceError
from volatool.vola.build import from_keys
from volatool.vola.volume import VolumeInfo

KEYS = st.integers(1, 3).flatmap(
    lambda depth: st.tuples(
        st.just(depth),
        st.lists(st.tuples(st.integers(0, 64**depth - 1), st.integers(0, 2**64 - 1)), max_size=40),
    )
)


@settings(max_examples=60, deadline=None)
@given(KEYS)
def test_words_and_metadata_are_those_of_the_twin(made):
    """Any order, repeats allowed: words of the set, means over all rows, byte 7 is 1."""
    depth, rows = made
    keys = np.array([key for key, _ in rows], np.uint64)
    words = np.array([word for _, word in rows], np.uint64)
    volume = from_keys(keys, depth, making.CUBE, making.INFO, words)
    assert [list(level) for level in volume.levels] == naive_vola.level_words(keys.tolist(), depth)
    found = twin.block_words(volume)
    for level in range(1, depth + 1):
        members: dict[int, list[int]] = {}
        for key, word in rows:
            members.setdefault(key >> 6 * (depth - level + 1), []).append(word)
        for block, inside in members.items():
            digits = tuple(block >> 6 * (level - 2 - i) & 63 for i in range(level - 1))
            expected = naive.mean_word(inside) & (2**56 - 1) | 1 << 56
            assert found.pop(digits) == expected
    assert found == ({} if rows else {(): 1 << 56})
    assert np.array_equal(volume.keys(), np.unique(keys))


def test_a_volume_is_made_again_from_its_keys():
    """keys() and from_keys are inverse, with and without words; channels go with the words."""
    volume = making.random_volume(3, 300)
    plain = from_keys(volume.keys()[::-1], 3, volume.cube, volume.info)
    assert making.same(plain, making.random_volume(3, 300, metadata=False))
    assert plain.info.channels == ()
    words = from_keys(volume.keys(), 3, volume.cube, volume.info, volume.metadata())
    assert np.array_equal(words.metadata_words(3), volume.metadata_words(3))
    assert words.info == volume.info


def test_the_argument_is_not_changed_and_lists_will_do():
    keys = np.array([5, 3, 5], np.uint64)
    assert len(from_keys(keys, 1, making.CUBE, VolumeInfo())) == 2
    assert keys.tolist() == [5, 3, 5]
    assert from_keys([63, 0], 1, making.CUBE, VolumeInfo()).keys().tolist() == [0, 63]


def test_what_is_no_key_is_refused():
    with pytest.raises(OptionError, match="64 is no path key of depth 1"):
        from_keys([64], 1, making.CUBE, VolumeInfo())
    with pytest.raises(OptionError, match="2 keys need as many"):
        from_keys([1, 2], 1, making.CUBE, VolumeInfo(), [1])
    for depth in (0, 11):
        with pytest.raises(ResourceError, match="depth must be 1 to 10"):
            from_keys([], depth, making.CUBE, VolumeInfo())
