"""Cut, changed and crafted files: one VolatoolError, little memory, no surprise."""

from __future__ import annotations

import contextlib
import gzip
import io
import json
import struct
import tracemalloc
import zlib
from pathlib import Path

import golden_cases as golden
import making_volumes as making
import naive_formats as naive
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from volatool.errors import (
    FormatError,
    InputError,
    InputNotFoundError,
    OptionError,
    ResourceError,
    TruncatedError,
    VolatoolError,
)
from volatool.formats import dense, gz, sparse, trailer
from volatool.formats.registry import open_volume, read_info

BOX = (0.0, 0.0, 0.0, 16.0, 16.0, 16.0)


def sparse_file(depth: int = 2, n: int = 12) -> bytes:
    stream = io.BytesIO()
    sparse.write(stream, making.random_volume(depth, n))
    return stream.getvalue()


def packed(data: bytes) -> bytes:
    stream = io.BytesIO()
    with gz.writer(stream) as file:
        file.write(data)
    return stream.getvalue()


@pytest.mark.parametrize("depth", [1, 2, 3])
def test_every_cut_of_our_file_is_refused(depth: int) -> None:
    """At any byte; only a cut exactly after the levels leaves a file, one without trailer."""
    data = sparse_file(depth)
    body = sparse.sparse_bytes([len(words) for words in open_volume(data).levels], True)
    for length in range(len(data)):
        if length == body:
            assert open_volume(data[:length]).info.quantizer == "unknown"
        elif depth == 1 and length == 88:
            # nothing tells one word alone from a toolkit's file that lost all its metadata
            (warning,) = open_volume(data[:length]).info.warnings
            assert warning.code == "W_ZERO_METADATA"
        else:
            with pytest.raises(FormatError) as caught:
                open_volume(data[:length])
            assert caught.value.code in ("E_TRUNCATED", "E_NOT_VOLA"), length
            assert "offset" in str(caught.value)


def test_every_changed_byte_of_our_file_is_refused() -> None:
    """Header and levels have a checksum, the trailer another, its frame is fixed."""
    data = sparse_file()
    for place in range(len(data)):
        changed = bytearray(data)
        changed[place] ^= 1 << place % 8
        with pytest.raises(VolatoolError):
            open_volume(bytes(changed))


def test_every_cut_and_change_of_the_gzip_is_refused_or_harmless() -> None:
    """The checks of gzip and ours; a changed time in the gzip header changes nothing."""
    plain = sparse_file()
    data, volume = packed(plain), open_volume(plain)
    for length in range(len(data)):
        with pytest.raises(VolatoolError):
            open_volume(data[:length])
    for place in range(len(data)):
        changed = bytearray(data)
        changed[place] ^= 1 << place % 8
        with contextlib.suppress(VolatoolError):
            assert making.same(open_volume(bytes(changed)), volume)
    for extra in (b"\1", b"\x1f\x8b", packed(b"more")):
        with pytest.raises(FormatError):
            open_volume(data + extra)


@settings(max_examples=200, deadline=None)
@given(
    st.binary(max_size=200),
    st.integers(0, 1),
    st.integers(0, 255),
    st.integers(0, 1),
    st.booleans(),
)
def test_any_body_is_a_volume_or_one_error(body, mode, depth, nbits, is_gzip) -> None:
    """Random levels after any header."""
    data = naive.header(mode, depth, nbits, BOX) + body
    with contextlib.suppress(VolatoolError):
        volume = open_volume(packed(data) if is_gzip else data)
        assert len(volume.voxels()) == len(volume)
    with contextlib.suppress(VolatoolError):
        read_info(packed(data) if is_gzip else data)


@pytest.mark.shared
def test_changed_bytes_of_toolkit_files_are_volumes_or_one_error(shared: Path) -> None:
    """They have no checksum: whatever is read must at least be consistent."""
    rng = np.random.default_rng(5)
    names = ["cols8-s3n.vol", "megaplot-s2n.vol", "cols8-d2n.dvol", "line-s4.vol"]
    for name in names:
        data = golden.unpacked(shared / "golden" / "files" / name)
        for place in rng.integers(0, len(data), 60):
            changed = bytearray(data)
            changed[place] ^= 1 << int(rng.integers(8))
            with contextlib.suppress(VolatoolError):
                volume = open_volume(bytes(changed))
                assert len(volume.voxels()) == len(volume)
        for length in rng.integers(0, len(data), 30):
            with pytest.raises(VolatoolError):
                open_volume(data[:length])


def peak_of(data: bytes, error: type[VolatoolError], match: str, **options) -> float:
    tracemalloc.start()
    with pytest.raises(error, match=match):
        open_volume(data, **options)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak


def test_claims_beyond_the_file_take_no_memory() -> None:
    """A header of a dense petabyte, levels that would grow by 64: refused from the size."""
    assert peak_of(naive.header(1, 10, 1, BOX), TruncatedError, "offset 80") < 1e6
    full = 2**64 - 1
    data = naive.header(0, 10, 0, BOX) + struct.pack("<65Q", *[full] * 65) + bytes(999)
    assert peak_of(data, TruncatedError, "level 3 should take 32768 bytes") < 1e6


def test_gzip_bombs_are_refused() -> None:
    """Unpacking stops at the limit, whatever the bomb claims to be."""
    full = naive.header(0, 10, 0, BOX) + b"\xff" * (8 * (1 + 64 + 64**2 + 64**3))
    bomb = gzip.compress(full + b"\xff" * 20_000_000, 6)
    assert len(bomb) < 30_000
    limit = 4 << 20
    assert peak_of(bomb, ResourceError, "the limit is 4194304", size_limit=limit) < 2e7
    hollow = gzip.compress(naive.header(1, 6, 0, BOX) + bytes(9_000_000))
    assert peak_of(hollow, ResourceError, "the limit is") < 4e6
    tail = gzip.compress(naive.header(0, 1, 0, BOX) + bytes(20_000_000))
    assert peak_of(tail, FormatError, "no known trailer", size_limit=limit) < 1.5e7
    with pytest.raises(ResourceError, match="the limit is"):
        read_info(tail, size_limit=limit)


def with_trailer(text: bytes) -> bytes:
    """Return a one-voxel file with this JSON, all checksums right."""
    body = naive.header(0, 1, 0, BOX) + struct.pack("<Q", 1)
    return body + trailer.frame(text, zlib.crc32(body))


def good_content() -> dict[str, object]:
    volume = making.volume_of([(0, 0, 0)], 1, metadata=False, cube=making.Cube((0, 0, 0), 16))
    content: dict[str, object] = json.loads(trailer.describe(volume, [1]))
    return content


def test_a_good_trailer_is_read() -> None:
    """The base of the crafted ones below."""
    assert len(open_volume(with_trailer(json.dumps(good_content()).encode()))) == 1


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (["cube"], None),
        (["cube", "side"], "1e999999999/1"),
        (["cube", "side"], "1/0"),
        (["cube", "side"], "17/1"),
        (["cube", "side"], "-16/1"),
        (["cube", "side"], 16),
        (["cube", "side"], "9" * 5000 + "/1"),
        (["cube", "origin"], ["0/1", "0/1"]),
        (["cube", "origin"], ["1/1", "0/1", "0/1"]),
        (["cube", "origin"], ["1" + "0" * 399 + "/1", "0/1", "0/1"]),
        (["crs"], []),
        (["crs", "wkt2"], 7),
        (["crs", "epsg"], -1),
        (["crs", "epsg"], True),
        (["crs", "metres_per_unit_z"], "0/1"),
        (["crs", "metres_per_unit_xy"], "-1/3"),
        (["box"], [1, 2, 3]),
        (["box"], [1, 2, 3, 4, 5, "6"]),
        (["box"], [1, 2, 3, 4, 5, 10**400]),
        (["quantizer"], "rounded"),
        (["quantizer"], ["floor"]),
        (["points"], "many"),
        (["points"], 1.5),
        (["source"], "tile.laz"),
        (["source", "name"], {"a": 1}),
        (["channels"], 3),
        (["channels"], [{"byte": 8, "name": "x", "scale": 1, "offset": 0}]),
        (["channels"], [{"byte": 0, "name": "x", "scale": 10**400, "offset": 0}]),
        (["channels"], [{"byte": 0}]),
        (["channels"], [[0]]),
        (["blocks"], [2]),
        (["blocks"], None),
    ],
)
def test_crafted_trailers_are_refused(path: list[str], value: object) -> None:
    """Wrong types, impossible numbers, contradictions with the header: E_CORRUPT, at once."""
    content = good_content()
    place = content
    for key in path[:-1]:
        place = place[key]  # type: ignore[assignment]
    place[path[-1]] = value
    with pytest.raises(FormatError) as caught:
        open_volume(with_trailer(json.dumps(content).encode()))
    assert caught.value.code == "E_CORRUPT"


def test_texts_of_a_trailer_can_be_printed() -> None:
    """No terminal escapes and no lone surrogates come out, and no message is long."""
    content = good_content()
    content["source"] = {"name": "a\x1b[2J\ud800\u202e.laz", "bytes": 1}
    data = with_trailer(json.dumps(content).encode())
    assert open_volume(data).info.source_name == "a\ufffd[2J\ufffd\ufffd.laz"
    assert json.dumps(read_info(data).trailer, ensure_ascii=False).encode()
    for key, value in (("blocks", [1] * 100_000), ("quantizer", "x" * 300_000)):
        with pytest.raises(FormatError) as caught:
            open_volume(with_trailer(json.dumps(good_content() | {key: value}).encode()))
        assert len(str(caught.value)) < 500


@pytest.mark.parametrize(
    "text",
    [
        b"",
        b"[]",
        b"7",
        b"{",
        b"\xff\xfe",
        b"[" * 100_000,
        b'{"a":' * 100_000,
        b'{"a": NaN}',
        b'{"a": ' + b"9" * 10_000 + b"}",
        b"{}",
        b"\xef\xbb\xbf{}",
    ],
)
def test_trailers_that_are_no_object_are_refused(text: bytes) -> None:
    """Nesting, byte order marks, huge integers and NaN included."""
    with pytest.raises(FormatError) as caught:
        open_volume(with_trailer(text))
    assert caught.value.code == "E_CORRUPT"


def test_a_trailer_that_claims_too_much_is_refused() -> None:
    """Its length is checked against the file and a limit."""
    body = naive.header(0, 1, 0, BOX) + struct.pack("<Q", 1)
    with pytest.raises(FormatError, match="claims 4294967295 bytes"):
        open_volume(body + trailer.MAGIC + b"\xff" * 4)
    with pytest.raises(TruncatedError, match="should have 132 bytes"):
        open_volume(body + trailer.MAGIC + struct.pack("<I", 100))
    end = struct.pack("<I", 10**9) + trailer.END
    with pytest.raises(FormatError, match="no proper start"):
        read_info(body + bytes(64) + end)


def test_names_and_streams(tmp_path: Path) -> None:
    """Paths, bytes and files are opened; what is none of them, or not there, says so."""
    data = sparse_file()
    path = tmp_path / "anything.txt"
    path.write_bytes(packed(data))
    volume = open_volume(data)
    assert making.same(open_volume(path), volume)
    assert making.same(open_volume(str(path)), volume)
    assert making.same(open_volume(memoryview(data)), volume)
    stream = io.BytesIO(b"before" + data)
    stream.seek(6)
    assert making.same(open_volume(stream), volume)

    class Pipe(io.BytesIO):
        name = "pipe"

        def seekable(self) -> bool:
            return False

    assert making.same(open_volume(Pipe(data)), volume)
    assert read_info(Pipe(data)).name == "pipe"
    with pytest.raises(ResourceError, match="pipe: the volume takes at least"):
        open_volume(Pipe(data), size_limit=100)
    with pytest.raises(InputNotFoundError, match=r"missing\.vol: no such file") as caught:
        open_volume(tmp_path / "missing.vol")
    assert caught.value.code == "E_NOT_FOUND"
    with pytest.raises(InputError, match="is a folder"):
        open_volume(tmp_path)
    with pytest.raises(InputError, match="can't be opened"):
        open_volume("nul\0byte")
    with pytest.raises(OptionError, match="binary mode"):
        open_volume(io.StringIO("text"))  # type: ignore[arg-type]
    with pytest.raises(OptionError, match="expected a path, bytes or a binary file"):
        open_volume(7)  # type: ignore[arg-type]
    closed = io.BytesIO(data)
    closed.close()
    with pytest.raises(InputError, match="can't be read"):
        open_volume(closed)


def test_dense_gzip_with_metadata_survives_the_same_treatment() -> None:
    """Cuts at any of a hundred places."""
    stream = io.BytesIO()
    dense.write(stream, making.random_volume(2, 30))
    data = packed(stream.getvalue())
    assert len(open_volume(data))
    for length in np.linspace(0, len(data) - 1, 100).astype(int):
        with pytest.raises(VolatoolError):
            open_volume(data[:length])
