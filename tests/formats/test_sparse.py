"""Sparse files, the trailer, gzip around them."""

from __future__ import annotations

import gzip
import io
import struct
import zlib

import making_volumes as making
import naive_formats as naive
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from volatool.encodings import Encoding, write_volume
from volatool.errors import FormatError, OutputError, TruncatedError
from volatool.formats import gz, sparse
from volatool.formats.registry import open_volume, read_info
from volatool.vola.volume import Volume, VolumeInfo

BOX = (0.0, 0.0, 0.0, 16.0, 16.0, 16.0)


def written(volume: Volume, **options) -> bytes:
    stream = io.BytesIO()
    size = sparse.write(stream, volume, **options)
    assert size == len(stream.getvalue())
    return stream.getvalue()


def plain(levels, metadata=None, box=BOX) -> bytes:
    """Return a file without trailer, made by hand."""
    data = naive.header(0, len(levels), int(metadata is not None), box)
    for i, words in enumerate(levels):
        data += struct.pack(f"<{len(words)}Q", *words)
        if metadata is not None:
            data += struct.pack(f"<{len(metadata[i])}Q", *metadata[i])
    return data


@pytest.mark.parametrize("metadata", [True, False])
@pytest.mark.parametrize("depth", [1, 2, 3, 5])
def test_round_trip(depth: int, metadata: bool) -> None:
    """Cells, metadata, the exact cube and all facts come back; the size is the formula's."""
    volume = making.random_volume(depth, 100, metadata=metadata)
    data = written(volume)
    again = open_volume(data)
    assert making.same(volume, again)
    expected = vars_of(volume.info)
    expected["generator"] = again.info.generator
    assert vars_of(again.info) == expected
    assert again.info.generator.startswith("volatool ")
    blocks = [len(words) for words in volume.levels]
    assert len(written(volume, with_trailer=False)) == sparse.sparse_bytes(blocks, metadata)


def vars_of(info: VolumeInfo) -> dict[str, object]:
    return {name: getattr(info, name) for name in info.__slots__}


def test_the_levels_are_those_of_the_naive_encoder() -> None:
    """Byte for byte, metadata after the occupancy of each level."""
    volume = making.random_volume(3, 150)
    levels = naive.sparse_levels([tuple(row) for row in volume.voxels().tolist()], 3)
    metadata = [words.tolist() for words in volume.metadata_levels]
    assert written(volume, with_trailer=False)[80:] == plain(levels, metadata)[80:]


def test_the_trailer_is_as_documented() -> None:
    """Magic, length, JSON, two checksums, length, magic backwards."""
    volume = making.random_volume(2, 30)
    body, data = written(volume, with_trailer=False), written(volume)
    trailer = data[len(body) :]
    (length,) = struct.unpack_from("<I", trailer, 8)
    text = trailer[12 : 12 + length]
    assert data[: len(body)] == body
    assert trailer[:8] == b"VOLATRL1"
    assert trailer[12 + length :] == (
        struct.pack("<III", zlib.crc32(body), zlib.crc32(text), length) + b"1LRTALOV"
    )
    info = read_info(data)
    assert info.trailer["blocks"] == [len(words) for words in volume.levels]
    assert info.trailer["quantizer"] == "floor"
    assert info.info.crs == volume.crs


def test_gzip_is_told_by_content_and_deterministic() -> None:
    """The same bytes every time, without name and time, and the same volume back."""
    volume = making.random_volume(3, 150)

    def packed() -> bytes:
        stream = io.BytesIO()
        with gz.writer(stream) as file:
            sparse.write(file, volume)
        return stream.getvalue()

    data = packed()
    assert data == packed()
    assert data[:8] == b"\x1f\x8b\x08\x00\x00\x00\x00\x00"
    assert making.same(open_volume(data), volume)
    assert read_info(data).is_gzip
    assert read_info(data).trailer == read_info(gzip.decompress(data)).trailer


@pytest.mark.parametrize("kind", ["sparse", "dense"])
def test_only_large_sparse_bodies_are_packed_at_the_faster_level(kind, monkeypatch) -> None:
    """The size of the body alone decides."""
    volume = making.random_volume(3, 150)
    plain, packed = Encoding(kind, 2, "none"), Encoding(kind, 2, "gzip")

    def bytes_of(encoding: Encoding) -> bytes:
        stream = io.BytesIO()
        write_volume(stream, volume, encoding)
        return stream.getvalue()

    def at_level(level: int) -> bytes:
        return gzip.compress(bytes_of(plain), level, mtime=0)[10:]

    assert gz.level_for(gz.LARGE_BYTES) == gz.LEVEL
    monkeypatch.setattr(gz, "LARGE_BYTES", packed.payload_bytes(volume))
    assert bytes_of(packed)[10:] == at_level(6)
    monkeypatch.setattr(gz, "LARGE_BYTES", packed.payload_bytes(volume) - 1)
    assert bytes_of(packed)[10:] == at_level(4 if kind == "sparse" else 6)
    assert making.same(open_volume(bytes_of(packed)), volume, metadata=kind == "sparse")


def test_zero_metadata_words_are_never_written() -> None:
    """Tools of the original's family drop them; 1, 1, 1 stands in their place."""
    levels = (np.array([1], np.uint64), np.array([3], np.uint64))
    zeros = (np.zeros(1, np.uint64), np.zeros(1, np.uint64))
    volume = Volume(levels, zeros, making.CUBE)
    again = open_volume(written(volume))
    assert [words.tolist() for words in again.metadata_levels] == [[0x010101], [0x010101]]


def test_all_metadata_dropped_is_repaired_and_reported() -> None:
    """The one repairable case of a writer that leaves out zero words."""
    volume = open_volume(with_nbits(plain([[3], [1, 2]])))
    assert volume.has_metadata
    assert not volume.metadata().any()
    assert [warning.code for warning in volume.info.warnings] == ["W_ZERO_METADATA"]


def with_nbits(data: bytes) -> bytes:
    return data[:8] + b"\1" + data[9:]


@pytest.mark.parametrize(
    ("data", "error", "match"),
    [
        (plain([[3], [1]]), TruncatedError, r"level 2 should take 16 bytes .*offset 96"),
        (plain([[3]]) + b"\0", FormatError, r"1 bytes that are no known trailer .*offset 88"),
        (plain([[3], [1, 2]]) + b"junkjunk", FormatError, "no known trailer"),
        (plain([[3], [1, 2]]) + b"VOLAT", TruncatedError, r"inside its trailer \(offset 109\)"),
        (plain([[3], [1, 2]], [[7], [7]]), TruncatedError, "left out metadata words of zero"),
        (plain([[3], [1, 0]], [[7], [7, 7]]), FormatError, r"is empty \(offset 104\)"),
        (plain([[3], [1, 2]], [[7], [7, 7]]) + b"x" * 8, FormatError, "or its writer left out"),
    ],
)
def test_files_that_do_not_add_up_are_refused(data, error, match) -> None:
    """With the offset, and no voxels."""
    with pytest.raises(error, match=match) as caught:
        open_volume(data)
    assert caught.value.code in ("E_TRUNCATED", "E_CORRUPT")
    assert str(caught.value).startswith("<bytes>: ")


def test_empty_blocks_without_metadata_are_read_with_a_warning() -> None:
    """The original reads them as blocks without voxels."""
    volume = open_volume(plain([[3], [0, 5]]))
    assert volume.voxels().tolist() == [[4, 0, 0], [6, 0, 0]]
    assert [warning.code for warning in volume.info.warnings] == ["W_EMPTY_BLOCKS"]


def test_a_root_of_zero_is_no_voxels() -> None:
    """The same with and without metadata and trailer."""
    assert len(open_volume(plain([[0], [], []]))) == 0
    empty = making.volume_of([], 3)
    assert making.same(open_volume(written(empty)), empty)


def test_files_without_trailer_tell_what_the_header_knows() -> None:
    """Quantizer unknown, box as stored, a cube of its longest extent, EPSG 2000 unset."""
    data = plain([[1]], box=(1.0, 2.0, 3.0, 3.0, 6.0, 4.0))
    volume = open_volume(data)
    assert volume.info.quantizer == "unknown"
    assert volume.info.box == (1.0, 2.0, 3.0, 3.0, 6.0, 4.0)
    assert volume.cube.origin == (1.0, 2.0, 3.0)
    assert volume.cube.side == 4.0
    assert volume.info.epsg is None
    assert read_info(data).trailer is None


def test_a_full_disk_is_an_output_error() -> None:
    """Not a bare OSError."""

    class Full(io.BytesIO):
        def write(self, data) -> int:
            raise OSError(28, "No space left on device")

    with pytest.raises(OutputError, match="No space left on device"):
        sparse.write(Full(), making.random_volume(2, 20))


@settings(max_examples=30, deadline=None)
@given(
    st.integers(1, 4).flatmap(
        lambda depth: st.tuples(
            st.just(depth), st.sets(st.tuples(*[st.integers(0, 4**depth - 1)] * 3), max_size=30)
        )
    ),
    st.booleans(),
)
def test_any_volume_survives(case, metadata: bool) -> None:
    """Whatever its voxels."""
    volume = making.volume_of(case[1], case[0], metadata=metadata)
    assert making.same(open_volume(written(volume)), volume)
