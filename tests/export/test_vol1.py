"""Files for the original toolkit: its own come out as they were."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import golden_cases as golden
import numpy as np
import pytest
from making_exports import full_volume, toolkit_volume
from making_volumes import random_volume

import volatool as vt
from volatool.errors import FormatError
from volatool.formats.header import Header
from volatool.model import Bounds


@pytest.mark.shared
@pytest.mark.parametrize("number", range(golden.N_CASES))
def test_a_golden_file_is_written_again_byte_for_byte(shared: Path, tmp_path: Path, number: int):
    """But for bytes 16 to 31, latitude and longitude; files with lost words are refused."""
    case: dict[str, Any] = golden.expected(shared)["cases"][number]
    path = golden.stored(shared, case)
    is_dense = case["mode"] == "dense"
    output = tmp_path / ("t.vol1.dvol" if is_dense else "t.vol1.vol")
    options = {"dense": True} if is_dense else {}
    dropped = case.get("dropped_zero_meta_words", 0)
    if dropped not in (0, case.get("meta_words")):
        with pytest.raises(FormatError, match="left out metadata words of zero"):
            vt.export_volume(path, output, "vol1", **options)
        assert not output.exists()
        return
    vt.export_volume(path, output, "vol1", **options)
    written, before = output.read_bytes(), golden.unpacked(path)
    if dropped:  # all of them: they are written, and not zero, so that the toolkit reads the file
        words = np.frombuffer(written[80:], "<u8")
        assert len(words) == 2 * (len(before) - 80) // 8
        assert np.count_nonzero(words == 0x010101) == dropped
        return
    assert written[:16] == before[:16]
    assert written[32:] == before[32:]
    assert np.isfinite(np.frombuffer(written[16:32], "<f8")).all()


@pytest.mark.parametrize("metadata", [True, False])
def test_our_volumes_have_the_cube_as_their_box_and_no_trailer(tmp_path, metadata):
    volume = full_volume(metadata=metadata)
    done = vt.export_volume(volume, tmp_path / "t", "vol1")
    assert [one.code for one in done.warnings] == ["W_UNITS"]
    data = done.paths[0].read_bytes()
    assert len(data) == 80 + 8 * (1 + metadata) * sum(map(len, volume.levels))
    header = Header.from_bytes(data[:80])
    x, y, z = volume.cube.origin
    side = volume.cube.side
    assert header.box == (x, y, z, x + side, y + side, z + side)
    assert (header.crs, header.mode, header.nbits) == (2994, 0, int(metadata))
    again = vt.open(data)
    assert again.info.quantizer == "unknown"
    assert np.array_equal(again.voxels(), volume.voxels())
    if metadata:
        assert np.array_equal(again.metadata(), volume.metadata())


def test_no_metadata_word_is_zero(tmp_path):
    """The toolkit's reader would lose its place in the file."""
    volume = toolkit_volume()
    words = tuple(np.where(w % 3 == 0, np.uint64(0), w) for w in volume.metadata_levels)
    volume = vt.Volume(volume.levels, words, volume.cube, volume.info)
    (path,) = vt.export_volume(volume, tmp_path / "t.vol1.vol").paths
    again = vt.open(path)
    assert all((w != 0).all() for w in again.metadata_levels)
    expected = np.where(volume.metadata() == 0, 0x010101, volume.metadata())
    assert np.array_equal(again.metadata(), expected)


def test_a_crop_of_a_toolkit_file_keeps_the_cube(tmp_path):
    """Its tight box would be another grid for the toolkit."""
    volume = toolkit_volume()
    x, y, _ = volume.cube.origin
    bounds = Bounds(x + 2, y + 2, x + 6, y + 7)
    (path,) = vt.export_volume(volume, tmp_path / "t.vol1.vol", bounds=bounds).paths
    again = vt.open(path)
    assert again.cube.exact == volume.cube.exact
    assert 0 < len(again) < len(volume)
    assert volume.contains(again.centers()).all()


def test_a_dense_file_is_told_to_be_unreadable_for_the_toolkit(tmp_path):
    volume = random_volume(2, 40)
    done = vt.export_volume(volume, tmp_path / "t.vol1.dvol", "vol1", dense=True)
    assert "W_TOOLKIT_READER" in [one.code for one in done.warnings]
    assert done.paths[0].stat().st_size == 80 + 16 * 65
    assert np.array_equal(vt.open(done.paths[0]).voxels(), volume.voxels())
    flat = random_volume(1, 10, metadata=False)
    done = vt.export_volume(flat, tmp_path / "u.vol1.dvol", "vol1", dense=True)
    assert [one.code for one in done.warnings] == ["W_UNITS"]


def test_a_level_of_a_dense_file_is_not_the_strips_that_it_stores(tmp_path):
    volume = random_volume(3, 100)
    (path,) = vt.export_volume(volume, tmp_path / "t.dvol").paths
    done = vt.export_volume(path, tmp_path / "u", "vol1", dense=True, level=2)
    assert np.array_equal(vt.open(done.paths[0]).voxels(), volume.voxels(2))
