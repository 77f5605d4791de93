"""Files that we write, through a reader that behaves as the original toolkit's does."""

from __future__ import annotations

import gzip
import struct
from pathlib import Path

import golden_cases as golden
import making_volumes as making
import numpy as np
import pytest
import toolkit_reader as toolkit
from hypothesis import given, settings
from hypothesis import strategies as st

import volatool
from volatool.cube import Cube
from volatool.export.api import export_volume
from volatool.model import Bounds
from volatool.vola.algebra import combine, crop
from volatool.vola.regrid import regrid
from volatool.vola.volume import Volume

SAMPLES = Path(__file__).resolve().parents[2] / "data_samples"


def check_it_reads(data: bytes, volume: Volume, *, trailer: bool = True) -> toolkit.Reading:
    """Check that the toolkit gets our voxels, words and corners, and stops before the trailer."""
    found = toolkit.read(data)
    assert found.depth == volume.depth
    assert found.nbits == int(volume.has_metadata)
    assert found.voxels == [tuple(row) for row in volume.voxels().tolist()]
    assert found.words_per_level == [volume.n_blocks(level + 1) for level in range(volume.depth)]
    assert data[found.consumed :][:8] == (b"VOLATRL1" if trailer else b"")
    if volume.has_metadata:
        assert found.words == volume.metadata().tolist()
        assert 0 not in found.metadata_words
    corners = volume.cube.corners(volume.voxels(), volume.depth)
    if found.crs == toolkit.UNKNOWN_CRS:
        corners = volume.voxels().astype(float)
    largest = np.abs(volume.cube.origin).max() + volume.cube.side
    np.testing.assert_allclose(
        np.reshape(found.coordinates(), (-1, 3)), corners, rtol=0, atol=4e-16 * largest
    )
    return found


@pytest.mark.parametrize("metadata", [True, False])
@pytest.mark.parametrize("depth", [1, 2, 3, 4, 5, 8])
def test_random_volumes(depth: int, metadata: bool) -> None:
    """Every depth, with and without metadata, feet against US survey feet."""
    volume = making.random_volume(depth, 150, metadata=metadata)
    found = check_it_reads(making.written(volume), volume)
    for x, y, z in found.voxels[:20]:
        numbers = found.get_voxel(x, y, z)
        assert isinstance(numbers, list)
        assert numbers == found.get_voxel(x - 4**depth, y + 4**depth, z)
        words = [volume.levels[level][number] for level, number in enumerate(numbers)]
        assert all(words)


@settings(max_examples=40, deadline=None)
@given(st.sets(st.tuples(*[st.integers(0, 63)] * 3), max_size=60), st.integers(0, 99))
def test_any_volume(voxels: set[tuple[int, int, int]], seed: int) -> None:
    """No voxel, too."""
    volume = making.volume_of(voxels, 3, seed=seed)
    check_it_reads(making.written(volume), volume)


def test_words_of_zero_survive_our_writer() -> None:
    """The toolkit counts words: one that was left out would put it out of step."""
    volume = making.random_volume(3, 100)
    assert volume.metadata_levels is not None
    zero = tuple(words * np.uint64(0) for words in volume.metadata_levels)
    found = toolkit.read(making.written(Volume(volume.levels, zero, volume.cube, volume.info)))
    assert found.voxels == [tuple(row) for row in volume.voxels().tolist()]
    assert set(found.metadata_words) == {0x010101}


@pytest.mark.parametrize("depth", [2, 4, None])
@pytest.mark.parametrize("name", ["town", "forest"])
def test_what_convert_writes_of_the_samples(tmp_path: Path, name: str, depth: int | None) -> None:
    """Real metadata of all channels, at several depths."""
    report = volatool.convert(
        SAMPLES / f"{name}.laz", outdir=tmp_path, depth=depth, dem=False, dense="never"
    )
    (path,) = (path for path in report.paths if path.name.endswith(".vol.gz"))
    volume = volatool.open(path)
    found = check_it_reads(gzip.decompress(path.read_bytes()), volume)
    assert found.nbits == 1
    assert all(word >> 56 == 1 for word in found.metadata_words)


@pytest.mark.parametrize("op", ["or", "and", "xor", "sub"])
def test_volumes_put_together(op: str) -> None:
    """Set algebra makes new words, and means of words; none is lost."""
    one, other = (making.random_volume(2, n, seed=n) for n in (700, 701))
    volume = combine(one, other, op)
    assert len(volume)
    check_it_reads(making.written(volume), volume)


def test_crops_and_regridded_volumes() -> None:
    """Their metadata goes with the cells."""
    volume = making.random_volume(3, 300)
    x, y, _ = volume.cube.origin
    part = crop(volume, Bounds(x, y, x + 6.0, y + 4.0))
    assert 0 < len(part) < len(volume)
    check_it_reads(making.written(part), part)
    moved = regrid(volume, Cube((x - 1.0, y - 1.0, volume.cube.origin[2] - 1.0), 16.0), 3)
    assert len(moved)
    check_it_reads(making.written(moved), moved)


@pytest.mark.parametrize("name", ["vol", "vol1"])
def test_what_export_writes_for_the_toolkit(tmp_path: Path, name: str) -> None:
    """With and without the trailer."""
    volume = making.random_volume(3, 200)
    (path,) = export_volume(volume, tmp_path / "a.vol", name).paths
    check_it_reads(path.read_bytes(), volume, trailer=name == "vol")


def test_what_import_writes(tmp_path: Path) -> None:
    """Points of a text file, with colours and with an intensity of nothing but zeros."""
    chance = np.random.default_rng(3)
    rows = [f"{x:.2f},{y:.2f},{z:.2f},0" for x, y, z in chance.uniform(0, 50, (400, 3))]
    text = "\n".join(["x,y,z,intensity", *rows, ""])
    (tmp_path / "a.csv").write_text(text)
    report = volatool.import_points(tmp_path / "a.csv", tmp_path, depth=3)
    (path,) = (path for path in report.paths if path.name.endswith(".vol.gz"))
    volume = volatool.open(path)
    assert volume.has_metadata
    check_it_reads(gzip.decompress(path.read_bytes()), volume)


def test_dense_files_are_wrong_there_as_the_text_says() -> None:
    """Of depth 1 they are right; deeper ones are taken as sparse, without a message."""
    one = making.random_volume(1, 20)
    check_it_reads(making.written(one, 1), one)
    two = making.random_volume(2, 40)
    found = toolkit.read(making.written(two, 1))
    assert set(found.voxels) != {tuple(row) for row in two.voxels().tolist()}


def test_cut_files_end_as_the_text_says() -> None:
    """At a word and inside one; only the header."""
    data = making.written(making.random_volume(2, 40))
    for length, error in [(80, toolkit.EndOfFileError), (120, toolkit.EndOfFileError),
                          (121, struct.error), (79, struct.error)]:  # fmt: skip
        with pytest.raises(error):
            toolkit.read(data[:length])


@pytest.mark.shared
def test_it_is_the_reader_that_read_the_golden_files(shared: Path) -> None:
    """Counts, voxels, words and coordinates of every file are those that the toolkit returned."""
    n_read = 0
    for case in golden.expected(shared)["cases"]:
        told = case["reference_reader"]
        if told.get("bytes_consumed", 0) > 200_000:
            continue
        n_read += 1
        data = golden.unpacked(golden.stored(shared, case))
        if told["status"] == "exit":
            with pytest.raises(toolkit.EndOfFileError):
                toolkit.read(data)
            continue
        found = toolkit.read(data)
        assert found.consumed == told["bytes_consumed"], case["file"]
        assert found.words_per_level == told["words_per_level"]
        assert len(found.voxels) == told["voxel_count"]
        voxels = np.reshape(found.voxels, (-1, 3))
        order = np.lexsort((voxels[:, 2], voxels[:, 1], voxels[:, 0]))
        assert golden.sha256(voxels[order], "<i4") == told["voxels_sha256"]
        if "voxel_words_sha256" in told:
            words = np.array(found.words, np.uint64)
            assert golden.sha256(words[order], "<u8") == told["voxel_words_sha256"]
            assert (
                golden.sha256(np.array(found.metadata_words, np.uint64), "<u8")
                == (told["meta_sha256"])
            )
        if "coords_sha256" in told:
            places = np.reshape(found.coordinates(), (-1, 3))[order]
            assert golden.sha256(places, "<f8") == told["coords_sha256"], case["file"]
    assert n_read > 140
