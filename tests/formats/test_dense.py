"""Dense files."""

from __future__ import annotations

import gzip
import io
import struct

import making_volumes as making
import naive_formats as naive
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from volatool.errors import FormatError, ResourceError, TruncatedError
from volatool.formats import dense
from volatool.formats.header import Header
from volatool.formats.registry import open_volume, opened

BOX = (0.0, 0.0, 0.0, 16.0, 16.0, 16.0)


def written(volume, **options) -> bytes:
    stream = io.BytesIO()
    size = dense.write(stream, volume, **options)
    assert size == len(stream.getvalue())
    return stream.getvalue()


@pytest.mark.parametrize("depth", [1, 2, 3])
def test_occupancy_is_the_naive_bit_array(depth: int) -> None:
    """x fastest over the whole grid of each level, upper levels stored too."""
    volume = making.random_volume(depth, 80, metadata=False)
    voxels = [tuple(row) for row in volume.voxels().tolist()]
    expected = b"".join(
        struct.pack(f"<{64 ** (level - 1)}Q", *naive.dense_level(voxels, depth, level))
        for level in range(1, depth + 1)
    )
    data = written(volume, with_trailer=False)
    assert data[80:] == expected
    assert len(data) == dense.dense_bytes(depth, False)
    assert making.same(open_volume(written(volume)), volume)


@pytest.mark.parametrize("depth", [2, 3])
def test_a_strip_has_the_mean_of_the_words_of_its_voxels(depth: int) -> None:
    """Each voxel weighs the same; empty strips are zero; one word a strip at every level."""
    volume = making.random_volume(depth, 300)
    data = written(volume)
    assert len(written(volume, with_trailer=False)) == dense.dense_bytes(depth, True)
    with opened(data) as (_, source):
        levels = dense.read_strips(source, Header.from_bytes(source.read(80)))
    for level, strips in enumerate(levels, 1):
        side = 4**level
        words: dict[int, list[int]] = {}
        cells = volume.voxels(level).tolist()
        for (x, y, z), word in zip(cells, volume.metadata(level).tolist(), strict=True):
            words.setdefault((x + y * side + z * side * side) // 64, []).append(word)
        _, metadata = strips.full(level)
        expected = [naive.mean_word(words[i]) if i in words else 0 for i in range(len(metadata))]
        assert metadata.tolist() == expected


def test_reading_gives_blocks_the_mean_of_their_strips() -> None:
    """The same rule the other way; the voxels are exact."""
    volume = making.random_volume(2, 300)
    again = open_volume(written(volume))
    assert making.same(volume, again, metadata=False)
    with opened(written(volume)) as (_, source):
        strips = dense.read_strips(source, Header.from_bytes(source.read(80)))[1]
    _, words = strips.full(2)
    blocks: dict[tuple[int, ...], list[int]] = {}
    for x, y, z in volume.voxels().tolist():
        strip = int(words[(x + 16 * y + 256 * z) // 64])
        blocks.setdefault(naive.path((x, y, z), 2)[:1], []).append(strip)
    expected = [naive.mean_word(strips) for _, strips in sorted(blocks.items())]
    assert again.metadata_words(2).tolist() == expected


def test_level_1_is_the_same_as_sparse() -> None:
    """The strips of the first level are its one block."""
    volume = making.random_volume(1, 20)
    assert making.same(open_volume(written(volume)), volume)


def test_an_empty_volume_is_all_zeros() -> None:
    """And comes back empty."""
    volume = making.volume_of([], 3)
    data = written(volume, with_trailer=False)
    assert not any(data[80:])
    assert len(open_volume(written(volume))) == 0


@pytest.mark.parametrize(
    ("change", "error", "match"),
    [
        (lambda data: data[:-1], TruncatedError, r"should take 520 bytes from offset 80"),
        (lambda data: data[:90], TruncatedError, r"offset 90"),
        (lambda data: data + b"\0" * 8, FormatError, r"no known trailer .*offset 600"),
        (lambda data: data[:80] + b"\0" * 8 + data[88:], FormatError, "level 2 has voxels where"),
        (lambda data: data[:88] + b"\0" * 512, FormatError, "level 2 has voxels where"),
    ],
)
def test_files_that_do_not_add_up_are_refused(change, error, match) -> None:
    """Cut, longer, or levels that contradict each other."""
    data = written(making.random_volume(2, 20, metadata=False), with_trailer=False)
    assert len(data) == 600
    with pytest.raises(error, match=match):
        open_volume(change(data))


def test_sizes_that_nobody_can_want_are_refused_before_any_work() -> None:
    """Writing from depth 7 on, reading what the file or the limit has no room for."""
    words = tuple(np.array([1], np.uint64) for _ in range(7))
    volume = making.Volume(words, None, making.CUBE)
    with pytest.raises(ResourceError, match="depth 7 takes 558482096728 bytes"):
        dense.write(io.BytesIO(), volume)
    header = naive.header(1, 15, 1, BOX)
    with pytest.raises(TruncatedError, match="the file ends after 8 of them"):
        open_volume(header + b"\0" * 8)
    with pytest.raises(ResourceError, match="the limit is") as caught:
        open_volume(gzip.compress(header + b"\0" * 8))
    assert caught.value.code == "E_SIZE"


def test_depth_5_needs_memory_for_its_voxels_only() -> None:
    """A dense file of 136 MB of zeros is written and read in a few megabytes."""
    import tracemalloc

    words = tuple(np.array([1 << 63], np.uint64) for _ in range(5))
    volume = making.Volume(words, None, making.CUBE)
    packed = io.BytesIO()
    with gzip.GzipFile(fileobj=packed, mode="wb", compresslevel=1) as file:
        dense.write(file, volume)
    tracemalloc.start()
    again = open_volume(packed.getvalue())
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert making.same(again, volume)
    assert peak < 32e6


@settings(max_examples=25, deadline=None)
@given(
    st.integers(1, 3).flatmap(
        lambda depth: st.tuples(
            st.just(depth), st.sets(st.tuples(*[st.integers(0, 4**depth - 1)] * 3), max_size=30)
        )
    )
)
def test_any_volume_survives(case) -> None:
    """Whatever its voxels."""
    volume = making.volume_of(case[1], case[0])
    assert making.same(open_volume(written(volume)), volume, metadata=False)
