"""Streaming gives what laspy reads, in any chunk size, and damage ends in one clear error."""

from __future__ import annotations

import io
import os
import struct
from pathlib import Path

import lazrs
import numpy as np
import pytest
from naive_points import las_bytes, random_las, written

from volatool.errors import FormatError, InputError, InputNotFoundError, TruncatedError
from volatool.model import PointChunk
from volatool.points.crs import database_version
from volatool.points.reader import PointSource, laz_backend_name, open_points, stream
from volatool.points.reproject import Reprojected
from volatool.points.source import Source

ALL = (
    "classification",
    "return_number",
    "number_of_returns",
    "intensity",
    "red",
    "green",
    "blue",
    "withheld",
    "synthetic",
    "key_point",
)


def joined(chunks: list[PointChunk]) -> dict[str, np.ndarray]:
    """All columns of a list of chunks."""
    out = {axis: np.concatenate([getattr(c, axis) for c in chunks]) for axis in "xyz"}
    for name in chunks[0].attributes:
        out[name] = np.concatenate([c.attributes[name] for c in chunks])
    return out


def source_of(data: bytes, **options: bool | str) -> PointSource:
    return open_points(io.BytesIO(data), **options)  # type: ignore[arg-type]


def chunk_table_at(data: bytes) -> int:
    (at,) = struct.unpack_from("<I", data, 96)
    return int(struct.unpack_from("<q", data, at)[0])


@pytest.mark.parametrize("compress", [False, True])
@pytest.mark.parametrize("point_format", range(11))
def test_all_formats_equal_laspy(point_format: int, compress: bool) -> None:
    """Stored integers and every attribute, LAS and LAZ, formats 0 to 10."""
    las = random_las(point_format)
    with source_of(written(las, compress)) as source:
        got = joined(list(source.chunks(ALL)))
        assert source.header.is_compressed == compress
        assert not source.header.warnings
        assert set(got) == source.header.dimensions | set("xyz")
    for name, values in got.items():
        wanted = np.asarray(las[name.upper() if name in "xyz" else name])
        assert np.array_equal(values, wanted), name
        assert values.flags.c_contiguous
    assert got["x"].dtype == np.int32
    assert got["classification"].dtype == got["return_number"].dtype == np.uint8
    assert got["intensity"].dtype == np.uint16
    assert got["withheld"].dtype == np.bool_


@pytest.mark.parametrize("point_format", [3, 7])
@pytest.mark.parametrize("compress", [False, True])
def test_chunk_size_changes_nothing(
    point_format: int, compress: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Any chunk size gives the same points; starts are consecutive; a second pass is the same."""
    las = random_las(point_format, n=120_500)
    with source_of(written(las, compress)) as source:
        wanted = joined(list(source.chunks(ALL, 10**9)))
        for size in (999, 50_000, 77_777, 250_000):
            chunks = list(source.chunks(ALL, size))
            assert max(map(len, chunks)) <= size
            starts = np.cumsum([0] + [len(c) for c in chunks])
            assert [c.start for c in chunks] == starts[:-1].tolist()
            got = joined(chunks)
            assert all(np.array_equal(got[name], wanted[name]) for name in wanted)
    assert np.array_equal(wanted["x"], las.X)


def test_chunks_keep_their_values_while_others_are_read() -> None:
    """Also chunks of one point, which numpy calls contiguous whatever buffer they lie in."""
    las = random_las(7, n=100_001)
    with source_of(written(las, True)) as source:
        chunks = list(source.chunks(ALL, 50_000))
    assert len(chunks[-1]) == 1
    assert np.array_equal(joined(chunks)["x"], las.X)
    assert chunks[-1].x.base is None or chunks[-1].x.base.nbytes == 4


def test_only_what_is_asked_for_is_delivered() -> None:
    """And attributes that the format lacks are left out."""
    with source_of(written(random_las(6), True)) as source:
        chunk = next(iter(source.chunks({"red", "classification"})))
        assert set(chunk.attributes) == {"classification"}
        assert not next(iter(source.chunks())).attributes


def test_huge_chunks_are_read_piece_by_piece(monkeypatch: pytest.MonkeyPatch) -> None:
    """One LAZ chunk that unpacks to more than the limit gives the same points."""
    monkeypatch.setattr("volatool.points.laz.MAX_CHUNK_BYTES", 1000)
    for point_format in (1, 7):
        las = random_las(point_format, n=60_000)
        with source_of(written(las, True)) as source:
            chunks = list(source.chunks(ALL, 7_000))
        got = joined(chunks)
        assert np.array_equal(got["z"], las.Z)
        assert np.array_equal(got["classification"], np.asarray(las.classification))


def test_zero_points_are_fine() -> None:
    """No chunk, no error, LAS and LAZ."""
    for compress in (False, True):
        with source_of(written(random_las(6, n=0), compress)) as source:
            assert source.n_points == 0
            assert list(source.chunks(ALL)) == []
    with source_of(las_bytes([])) as source:
        assert source.n_points == 0


def test_a_plain_file_that_ends_early() -> None:
    """E_TRUNCATED with the point; salvage reads the others and says how many are lost."""
    data = las_bytes([(i, 0, 0) for i in range(10)])[:-25]
    with pytest.raises(TruncatedError, match="point 8 of 10"):
        source_of(data)
    with source_of(data, salvage=True) as source:
        assert joined(list(source.chunks()))["x"].tolist() == list(range(8))
        assert source.is_partial
        assert [(w.code, w.count) for w in source.warnings if w.code == "W_SALVAGED"] == [
            ("W_SALVAGED", 2)
        ]


def test_a_count_lower_than_the_file_holds() -> None:
    """The real number is read: writers that die leave 0 in the header."""
    with source_of(las_bytes([(1, 2, 3)] * 5, n_points=0)) as source:
        assert source.n_points == 5
        assert "W_HEADER_COUNT" in [w.code for w in source.warnings]
        assert sum(map(len, source.chunks())) == 5


def test_padding_is_not_taken_for_points() -> None:
    """Whole records of zeros, or of places outside the box, behind the claimed ones."""
    for points, claimed in (([(1, 2, 3)] * 5, 5), ([], 0)):
        with source_of(las_bytes(points, n_points=claimed, tail=bytes(20 * 4))) as source:
            assert source.n_points == claimed


def test_more_points_than_claimed_inside_the_box() -> None:
    """Are read."""
    with source_of(las_bytes([(1, 2, 3)] * 5, n_points=3)) as source:
        assert source.n_points == 5


def test_what_follows_the_points_is_not_taken_for_points() -> None:
    """Trailing bytes that are no whole record."""
    with source_of(las_bytes([(1, 2, 3)] * 5, tail=b"x" * 30)) as source:
        assert source.n_points == 5


@pytest.mark.parametrize("point_format", [1, 7])
@pytest.mark.parametrize("count", [1, 60_000, 130_000])
def test_a_wrong_count_in_a_laz_header(point_format: int, count: int) -> None:
    """Layered chunks know their own number; others are read as far as the header says."""
    data = bytearray(written(random_las(point_format, n=120_000), True))
    struct.pack_into("<Q", data, 247, count)
    struct.pack_into("<I", data, 107, 0)
    if point_format == 1 and count > 120_000:
        with source_of(bytes(data)) as source, pytest.raises(FormatError, match="of 130000"):
            list(source.chunks())
        return
    with source_of(bytes(data)) as source:
        assert "W_HEADER_COUNT" in [w.code for w in source.warnings]
        n = sum(map(len, source.chunks(ALL, 50_000)))
    assert n == source.n_points == (120_000 if point_format == 7 else count)


@pytest.mark.parametrize("point_format", [1, 7])
def test_a_lost_chunk_table_is_done_without(point_format: int) -> None:
    """A LAZ file whose table is gone, but none of its points, is read whole with a warning."""
    las = random_las(point_format, n=120_000)
    data = written(las, True)
    with source_of(data[: chunk_table_at(data)]) as source:
        got = joined(list(source.chunks(ALL)))
        assert "W_CHUNK_TABLE" in [w.code for w in source.warnings]
        assert not source.is_partial
    assert np.array_equal(got["x"], las.X)
    assert np.array_equal(got["intensity"], np.asarray(las.intensity))


def test_a_cut_layered_file_says_how_far_it_reads() -> None:
    """Complete chunks are counted when opening; salvage reads just those."""
    las = random_las(7, n=120_000)
    data = written(las, True)
    cut = data[: int(len(data) * 0.6)]
    with pytest.raises(TruncatedError, match="point 50000 of 120000"):
        source_of(cut)
    with source_of(cut, salvage=True) as source:
        got = joined(list(source.chunks()))
        list(source.chunks())
        salvaged = [w for w in source.warnings if w.code == "W_SALVAGED"]
    assert np.array_equal(got["x"], las.X[:50_000])
    assert [w.count for w in salvaged] == [70_000]


def test_a_cut_pointwise_file_is_read_to_the_last_byte() -> None:
    """The error has the point number, salvage keeps all points before it."""
    las = random_las(1, n=120_000)
    data = written(las, True)
    cut = data[: int(len(data) * 0.6)]
    with source_of(cut) as source, pytest.raises(TruncatedError, match=r"point 7\d{4} of 120000"):
        list(source.chunks())
    with source_of(cut, salvage=True) as source:
        got = joined(list(source.chunks()))
        lost = next(w.count for w in source.warnings if w.code == "W_SALVAGED")
        assert source.is_partial
    assert len(got["x"]) + lost == 120_000
    assert len(got["x"]) > 70_000
    assert np.array_equal(got["x"], las.X[: len(got["x"])])


def test_a_damaged_chunk_is_left_out_and_the_next_ones_are_read() -> None:
    """Salvage skips the chunk; chunk starts keep the numbers of the file."""
    las = random_las(7, n=120_000)
    data = bytearray(written(las, True))
    table = chunk_table_at(bytes(data))
    (start,) = struct.unpack_from("<I", data, 96)
    record = lazrs.LazVlr(_laszip_record(bytes(data)))
    stream_ = io.BytesIO(bytes(data))
    stream_.seek(start)
    sizes = [size for _, size in lazrs.read_chunk_table(stream_, record)]
    second = start + 8 + sizes[0]
    assert second + sum(sizes[1:]) == table
    data[second + 36 + 4 : second + 36 + 8] = b"\xff\xff\xff\x7f"  # its first layer: 2 GiB
    with source_of(bytes(data)) as source, pytest.raises(FormatError, match="point 50000 of"):
        list(source.chunks())
    with source_of(bytes(data), salvage=True) as source:
        chunks = list(source.chunks(chunk_points=50_000))
        assert source.is_partial
    assert [c.start for c in chunks] == [0, 100_000]
    assert np.array_equal(chunks[1].x, las.X[100_000:])


def _laszip_record(data: bytes) -> bytes:
    at = data.index(b"laszip encoded")
    (length,) = struct.unpack_from("<H", data, at + 18)
    return data[at + 52 : at + 52 + length]


@pytest.mark.parametrize(
    ("at", "layout", "value"),
    [
        (0, "<H", 9),  # compressor
        (2, "<H", 1),  # coder
        (12, "<I", 0),  # chunk size
        (32, "<H", 500),  # items
        (36, "<H", 7),  # size of the first item
        (38, "<H", 77),  # its version
    ],
)
def test_a_senseless_laszip_record_is_one_error(
    at: int, layout: str, value: int, capfd: pytest.CaptureFixture[str]
) -> None:
    """Whatever lazrs makes of it, nothing but our errors comes out, and nothing on stderr."""
    data = bytearray(written(random_las(3), True))
    struct.pack_into(layout, data, data.index(b"laszip encoded") + 52 + at, value)
    try:
        with source_of(bytes(data)) as source:
            n = sum(map(len, source.chunks()))
        assert n == 5000
    except FormatError:
        pass
    assert capfd.readouterr().err == ""


def test_crafted_counts_are_refused_before_allocation() -> None:
    """A small file that claims billions of points or of chunks."""
    data = bytearray(written(random_las(7), True))
    struct.pack_into("<Q", data, 247, 2**60)
    struct.pack_into("<I", data, 107, 0)
    with pytest.raises(FormatError, match="claims 1152921504606846976 points"):
        source_of(bytes(data))
    data = bytearray(written(random_las(3), True))
    struct.pack_into("<I", data, chunk_table_at(bytes(data)) + 4, 2**32 - 1)
    with source_of(bytes(data)) as source:
        assert "W_CHUNK_TABLE" in [w.code for w in source.warnings]
        assert sum(map(len, source.chunks())) == 5000
    with pytest.raises(TruncatedError, match="point 1 of 1152921504606846976"):
        source_of(las_bytes([(1, 2, 3)], minor=4, n_points=2**60, n_legacy=0))


def test_random_damage_ends_in_chunks_or_one_error(capfd: pytest.CaptureFixture[str]) -> None:
    """Bytes flipped and files cut at random: only our errors, nothing on stderr."""
    rng = np.random.default_rng(5)
    files = [written(random_las(f, n=900), True) for f in (1, 3, 7, 8)]
    for _ in range(150):
        data = bytearray(files[rng.integers(len(files))])
        for at in rng.integers(4, len(data), rng.integers(1, 12)):
            data[at] = rng.integers(256)
        if rng.random() < 0.3:
            data = data[: rng.integers(len(data))]
        for salvage in (False, True):
            try:
                with source_of(bytes(data), salvage=salvage) as source:
                    n = sum(map(len, source.chunks(ALL)))
                    assert source.is_partial or n == source.n_points
            except InputError:
                continue
    assert capfd.readouterr().err == ""


def test_stderr_is_back_after_a_panic(capfd: pytest.CaptureFixture[str]) -> None:
    """File descriptor 2 is only turned away while the decoder runs."""
    with source_of(written(random_las(7), True)) as source:
        list(source.chunks())
    os.write(2, b"heard")
    assert capfd.readouterr().err == "heard"


def test_strict_refuses_what_could_be_read_around() -> None:
    """But not a file that only has no CRS."""
    with source_of(las_bytes(), strict=True) as source:
        assert source.n_points == 1
    with pytest.raises(FormatError, match="W_VLR_COUNT") as caught:
        source_of(las_bytes(n_vlrs=3), strict=True)
    assert caught.value.code == "E_STRICT"


def test_errors_name_the_file(tmp_path: Path) -> None:
    """Once, in front."""
    path = tmp_path / "tile.las"
    with pytest.raises(InputNotFoundError, match="no such file") as caught:
        open_points(path)
    assert caught.value.code == "E_NOT_FOUND"
    path.write_bytes(b"")
    with pytest.raises(FormatError, match=r"^tile.las: not a LAS or LAZ file: the file is empty"):
        open_points(path)
    with pytest.raises(InputError, match="is a folder"):
        open_points(tmp_path)


def test_a_file_that_shrinks_while_it_is_read(tmp_path: Path) -> None:
    """E_TRUNCATED at the point where it ends now."""
    path = tmp_path / "tile.las"
    path.write_bytes(las_bytes([(1, 2, 3)] * 1000))
    with open_points(path) as source:
        os.truncate(path, 227 + 20 * 600)
        with pytest.raises(TruncatedError, match="ends at point 600 of 1000"):
            list(source.chunks(chunk_points=100))


def test_stream_opens_selects_and_closes(tmp_path: Path) -> None:
    """The public short form."""
    las = random_las(7, n=2000)
    path = tmp_path / "tile.laz"
    path.write_bytes(written(las, True))
    got = joined(list(stream(path, classes=[2, 7], keep_withheld=True, chunk_points=300)))
    codes = np.asarray(las.classification)
    assert np.array_equal(got["x"], las.X[(codes == 2) | (codes == 7)])
    assert set(got["classification"]) <= {2, 7}


def test_chunks_are_not_longer_than_asked_for() -> None:
    """Though more is decoded at once, so that all cores have work."""
    with source_of(written(random_las(7, n=120_000), True)) as source:
        assert {len(c) for c in source.chunks(chunk_points=40_000)} == {40_000, 20_000}


def test_sources_are_interchangeable() -> None:
    """What is checked by mypy: both fit the protocol."""
    with source_of(las_bytes(), crs="EPSG:32632") as source:
        both: list[Source] = [source, Reprojected(source, "EPSG:32631")]
        assert [s.n_points for s in both] == [1, 1]


def test_versions_for_doctor() -> None:
    """Say what decodes and what knows the codes."""
    assert laz_backend_name().startswith("lazrs ")
    assert database_version().startswith("PROJ ")
