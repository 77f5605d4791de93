"""All golden files of the original toolkit, read."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import golden_cases as golden
import numpy as np
import pytest

from volatool.errors import FormatError
from volatool.formats import dense
from volatool.formats.header import Header
from volatool.formats.registry import open_volume, opened, read_info

pytestmark = pytest.mark.shared


@pytest.fixture(params=range(golden.N_CASES))
def case(request: pytest.FixtureRequest, shared: Path) -> dict[str, Any]:
    found: dict[str, Any] = golden.expected(shared)["cases"][request.param]
    return found


def test_a_golden_file_is_read_as_expected(shared: Path, case: dict[str, Any]) -> None:
    """Header, levels, voxels and metadata words; damaged files are refused or repaired."""
    path = golden.stored(shared, case)
    check_header(path, case)
    if case.get("dropped_zero_meta_words", 0) not in (0, case.get("meta_words")):
        with pytest.raises(FormatError, match="left out metadata words of zero"):
            open_volume(path)
        return
    volume = open_volume(path)
    voxels = volume.voxels()
    order = np.lexsort((voxels[:, 2], voxels[:, 1], voxels[:, 0]))
    assert len(volume) == case["voxel_count"]
    assert golden.sha256(voxels[order], "<i4") == case["voxels_sha256"]
    levels = raw_levels(path) if case["mode"] == "dense" else sparse_levels(volume)
    for (words, metadata), level in zip(levels, case["levels"], strict=True):
        assert len(words) == level["blocks"]
        assert golden.sha256(words, "<u8") == level["occ_sha256"]
        if case["nbits"]:
            assert golden.sha256(metadata, "<u8") == level["meta_sha256"]
    if case["nbits"]:
        words = volume.metadata() if case["mode"] == "sparse" else strip_words(levels, voxels)
        assert golden.sha256(words[order], "<u8") == case["voxel_words_sha256"]
    if case["reference_reader"].get("voxels_correct"):
        check_corners(volume, order, case)
    dropped = bool(case.get("dropped_zero_meta_words"))
    assert [warning.code for warning in volume.info.warnings] == ["W_ZERO_METADATA"] * dropped


def check_header(path: Path, case: dict[str, Any]) -> None:
    info = read_info(path)
    header, expected = info.header, case["header"]
    box = tuple(expected[end + axis] for end in ("min", "max") for axis in "xyz")
    assert header.box == box
    assert header.to_bytes().hex() == case["header_hex"]
    assert (header.depth, header.nbits, header.crs) == (
        case["depth"],
        case["nbits"],
        expected["crs"],
    )
    assert info.trailer is None
    assert info.info.epsg == (None if expected["crs"] == 2000 else expected["crs"])


def sparse_levels(volume: Any) -> list[tuple[Any, Any]]:
    metadata = volume.metadata_levels or [None] * volume.depth
    return list(zip(volume.levels, metadata, strict=True))


def raw_levels(path: Path) -> list[tuple[Any, Any]]:
    with opened(path) as (_, source):
        strips = dense.read_strips(source, Header.from_bytes(source.read(80)))
    return [level.full(number) for number, level in enumerate(strips, 1)]


def strip_words(levels: list[tuple[Any, Any]], voxels: Any) -> Any:
    side = 4 ** len(levels)
    x, y, z = voxels.T.astype(np.int64)
    return levels[-1][1][(x + y * side + z * side * side) // 64]


def check_corners(volume: Any, order: Any, case: dict[str, Any]) -> None:
    """The original's reader gives minimum corners of a grid that its writer did not use."""
    reference = case["reference_reader"]
    if case["header"]["crs"] == 2000 or "coords_first" not in reference:
        return  # then it returns indices
    corners = volume.cube.corners(volume.voxels()[order], volume.depth)
    ends = [reference["coords_first"], reference["coords_last"]]
    assert np.allclose(corners[[0, -1]], np.reshape(ends, (2, 3)), rtol=0, atol=1e-6)
