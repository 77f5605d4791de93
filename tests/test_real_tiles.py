"""`convert` on every real tile: exact counts, valid outputs, sizes by the formulas."""

from __future__ import annotations

import json
import os
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from naive_tile import count_levels, stored_xyz

import volatool as vt
from volatool.report import schema
from volatool.validate import validate_file

SHARED = Path(os.environ.get("VOLATOOL_SHARED", "unset"))
TILES = sorted(str(path.relative_to(SHARED)) for path in SHARED.glob("tiles/**/*.la[sz]"))


@pytest.fixture(scope="module", params=TILES or [None])
def converted(request, tmp_path_factory, shared):
    """Convert a tile with everything; return its path and the report."""
    folder = tmp_path_factory.mktemp("out")
    path = shared / request.param
    return path, vt.convert(path, folder, layers=("count", "flag"), resources=False)


def test_every_output_of_a_real_tile_is_there_and_valid(converted):
    path, report = converted
    assert report.status == "ok"
    suffixes = sorted(
        output.name[len(path.stem.removesuffix(".copc")) :] for output in report.paths
    )
    assert set(suffixes) >= {".dem.tif", ".stats.json", ".vol.gz", ".dem.flag.tif"}
    for output in report.paths:
        checked = validate_file(output)
        assert checked.ok, checked.problems
    written = json.loads(report.paths[-1].read_text())
    jsonschema.validate(written, schema())
    assert written == report.to_dict()


def test_counts_of_a_real_tile_equal_a_plain_numpy_count_at_every_level(converted):
    path, report = converted
    xyz, used = stored_xyz(path)
    assert report.input["points_read"] == len(xyz)
    assert report.input["points_used"] == np.count_nonzero(used)
    counts = count_levels(xyz, used, len(report.levels))
    assert [(row["blocks"], row["voxels"]) for row in report.levels] == counts


def test_dense_and_sparse_files_hold_the_same_voxels_and_have_the_sizes_of_the_formulas(converted):
    _, report = converted
    volumes = {path.suffixes[-2]: vt.open(path) for path in report.paths if "vol" in path.name}
    sparse = volumes[".vol"]
    assert len(sparse) == report.levels[report.depth - 1]["voxels"]
    if ".dvol" in volumes:
        dense = volumes[".dvol"]
        assert all(map(np.array_equal, sparse.levels, dense.levels))
    blocks = sum(row["blocks"] for row in report.levels[: report.depth])
    for row in report.encodings:
        words = blocks if row["kind"] == "sparse" else (64**report.depth - 1) // 63
        assert row["payload_bytes"] == 8 * row["bits_per_voxel"] * words
        if row["codec"] == "none" and row["measured"]:
            assert row["file_bytes"] > row["payload_bytes"] + row["header_bytes"]
