"""Toolkit compatibility: byte for byte what the original writes."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import golden_cases as golden
import numpy as np
import pytest

from volatool.errors import InputError, ResourceError
from volatool.formats import toolkit as toolkit_files
from volatool.formats.registry import open_volume
from volatool.imports.registry import read_points
from volatool.imports.toolkit import build as build_import
from volatool.model import PointChunk
from volatool.options import ConvertOptions
from volatool.points.reader import open_points
from volatool.vola.toolkit import ToolkitBuilder, ToolkitVolume, build, las_words, rounded_cells

POINTS = {".las", ".laz"}


def from_las(path: Path, case: dict[str, Any], chunk_points: int = 10_007) -> ToolkitVolume:
    with open_points(path) as source:
        return build(
            lambda names: source.chunks(names, chunk_points),
            case["depth"],
            with_metadata=bool(case["nbits"]),
            header_zmax=source.header.box[5],
            epsg=case["header"]["crs"],
        )


def imported(path: Path, case: dict[str, Any], folder: Path) -> ToolkitVolume:
    """Read the input by `import`, unpacked into a folder if need be."""
    stored = path
    if path.suffix == ".gz":
        path = folder / path.stem
        path.write_bytes(golden.unpacked(stored))
    return build_import(
        read_points(path, ConvertOptions()),
        case["depth"],
        with_metadata="-n" in case["args"],
        swap_yz="-z" in case["args"],
        epsg=case["header"]["crs"],
    )


@pytest.mark.shared
@pytest.mark.parametrize("number", range(golden.N_CASES))
def test_a_golden_file_is_written_byte_for_byte(shared: Path, number: int, tmp_path: Path) -> None:
    """From LAS, LAZ, xyz, txt, npy, ply, pcd: all bytes but lat and lon, the defects included."""
    case = golden.expected(shared)["cases"][number]
    path = golden.input_path(shared, case["input"])
    content = from_las(path, case) if path.suffix in POINTS else imported(path, case, tmp_path)
    stream = io.BytesIO()
    if case["mode"] == "dense":
        size = toolkit_files.write_dense(stream, content)
    elif case.get("dropped_zero_meta_words"):
        with pytest.raises(InputError, match="metadata word of zero") as caught:
            toolkit_files.write_sparse(stream, content)
        assert caught.value.code == "E_TOOLKIT"
        assert not stream.getvalue()
        return
    else:
        size = toolkit_files.write_sparse(stream, content)
        assert open_volume(stream.getvalue()).info.quantizer == "unknown"
    data, reference = stream.getvalue(), golden.unpacked(golden.stored(shared, case))
    assert size == len(data) == case["file_bytes"]
    assert data[:16] == reference[:16]
    assert data[32:] == reference[32:]


@pytest.mark.shared
@pytest.mark.parametrize("number", range(golden.N_FAILURES))
def test_what_the_original_stops_at_is_done_or_refused(
    shared: Path, number: int, tmp_path: Path
) -> None:
    """No traceback: a coded error, or an output where one makes sense."""
    case = dict(golden.expected(shared)["writer_failures"][number])
    args = case["args"]
    case["depth"], case["nbits"] = int(args[1]), int("-n" in args)
    case["header"] = {"crs": int(args[args.index("--crs") + 1]) if "--crs" in args else 2000}
    path = golden.input_path(shared, case["input"])
    stream = io.BytesIO()
    refusals = {
        "bad_val256.xyz": "line 1: 256 in column 4",
        "cols9.xyz": "9 columns behind x, y, z",
        "empty.xyz": "the file is empty",
    }
    if path.name in refusals:
        with pytest.raises(InputError, match=refusals[path.name]):
            imported(path, case, tmp_path)
    elif "-d" in args:
        with pytest.raises(InputError, match="all points are in one place"):
            toolkit_files.write_dense(stream, imported(path, case, tmp_path))
    elif "maxz0" in path.name:
        with pytest.raises(InputError, match="largest z is 0"):
            from_las(path, case)
    else:
        toolkit_files.write_sparse(stream, from_las(path, case))
        assert len(open_volume(stream.getvalue()))


@pytest.mark.shared
@pytest.mark.parametrize("chunk_points", [1, 7, 100, 100_000])
def test_chunks_do_not_matter(shared: Path, chunk_points: int) -> None:
    """The last point wins in file order, wherever the chunks are cut."""
    path = shared / "golden" / "inputs" / "meta_scale1.las"
    case = {"depth": 2, "nbits": 1, "header": {"crs": 2000}}
    streams = []
    for size in (chunk_points, 11):
        stream = io.BytesIO()
        toolkit_files.write_sparse(stream, from_las(path, case, size))
        streams.append(stream.getvalue())
    assert streams[0] == streams[1]


def test_half_way_values_go_to_the_even_index() -> None:
    """At depth 1 the coordinates 0, 0.5 ... 3 become 0, 0, 1, 2, 2, 2, 3."""
    xyz = np.zeros((7, 3))
    xyz[:, 0] = np.arange(7) / 2
    cells, is_exact = rounded_cells(xyz, (0.0, 0.0, 0.0, 3.0, 0.0, 0.0), 1)
    assert cells[:, 0].tolist() == [0, 0, 1, 2, 2, 2, 3]
    assert is_exact


def test_channels_are_scaled_as_the_original_does() -> None:
    """Grey 200 for black, the stored z over the scaled maximum, the class with its flag bits."""
    attributes = {
        "red": np.array([0, 65535], np.uint16),
        "green": np.array([255, 256], np.uint16),
        "blue": np.array([0, 0], np.uint16),
        "number_of_returns": np.array([0, 15], np.uint8),
        "intensity": np.array([500, 40000], np.uint16),
        "classification": np.array([2, 2], np.uint8),
        "withheld": np.array([False, True]),
    }
    z = np.array([-5, 50], np.int32)
    chunk = PointChunk(0, z, z, z, (0.01,) * 3, (0.0,) * 3, attributes)
    words = las_words(chunk, 100.0).tolist()
    assert [list(word.to_bytes(8, "little")) for word in words] == [
        [200, 200, 200, 0, 0, 127, 16, 0],
        [255, 1, 0, 127, 255, 255, 255, 0],
    ]


def test_no_points_and_too_deep_are_refused() -> None:
    """The original writes no file for them."""
    with pytest.raises(InputError, match="no points"):
        build(lambda names: [], 2)
    with pytest.raises(InputError, match="no points"):
        ToolkitBuilder(2, (0.0,) * 6).finish()
    with pytest.raises(ResourceError, match="depth must be 1 to 10"):
        ToolkitBuilder(11, (0.0,) * 6)
