"""``volatool recommend``: voxel and cell size from tiles, reports or a summary."""

from __future__ import annotations

import json

import pytest
from making_tiles import hills, write_las


@pytest.fixture
def tiles(volatool):
    """Six tiles of about 1.6 points per square metre."""
    folder = volatool.folder / "tiles"
    folder.mkdir()
    for k in range(6):
        write_las(folder / f"t{k}.las", hills(4000, k), crs="EPSG:25832")
    return folder


def test_from_tiles_from_reports_and_from_a_summary_it_is_the_same_depth(volatool, tiles):
    done = volatool("recommend", "tiles", "--json")
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)
    (chosen,) = (row for row in said["curve"] if row["is_recommended"])
    assert chosen["level"] == said["voxel"]["depth"]
    assert said["voxel"]["occupancy"] >= 0.15
    assert said["curve"][chosen["level"]]["occupancy"] < 0.15
    assert said["dem"]["is_measured"]
    assert said["dem"]["cell"] == 1
    total = volatool("stats", "tiles", "--summary", "--format", "json", "--no-resources").stdout
    (volatool.folder / "dataset.json").write_text(total, encoding="utf-8")
    lines = volatool("stats", "tiles", "--format", "jsonl").stdout
    (volatool.folder / "set.jsonl").write_text(lines, encoding="utf-8")
    summed = json.loads(total)
    assert chosen["volume_bytes"] == summed["levels"][chosen["level"] - 1]["sparse_bytes"]
    assert said["expected"]["volume_bytes"] == chosen["volume_bytes"]
    for name in ("dataset.json", "set.jsonl"):
        told = json.loads(volatool("recommend", name, "--json").stdout)
        assert told["voxel"]["depth"] == said["voxel"]["depth"]
        assert told["tiles"] == {"looked_at": 6, "all": 6}
        assert not told["dem"]["is_measured"]
        assert told["dem"]["cell"] == said["dem"]["cell"]


def test_a_sample_is_scaled_by_the_points_and_says_so(volatool, tiles):
    whole = json.loads(volatool("recommend", "tiles", "--json").stdout)
    done = volatool("recommend", "tiles", "--sample", "2", "--json")
    said = json.loads(done.stdout)
    assert said["tiles"] == {"looked_at": 2, "all": 6}
    assert said["expected"]["is_extrapolated"]
    assert said["expected"]["factor"] == 3
    for key in ("volume_bytes", "dem_cells"):
        assert said["expected"][key] == pytest.approx(whole["expected"][key], rel=0.05)
    text = volatool("recommend", "tiles", "--sample", "2").stdout
    assert "Looked at 2 of 6 tiles; sizes below are theirs times 3" in text
    assert "Expected for 6 tiles: volumes " in text


def test_what_can_not_be_used_is_told(volatool, tiles):
    (tiles / "bad.las").write_bytes(b"nothing")
    done = volatool("recommend", "tiles")
    assert done.returncode == 3
    assert "E_NOT_LAS: bad.las" in done.stderr
    assert "Voxels: depth" in done.stdout
    done = volatool("recommend", "tiles/bad.las")
    assert done.returncode == 4
    assert done.stdout == ""
    done = volatool("recommend", "tiles", "x.json")
    assert done.returncode == 2
    (volatool.folder / "x.json").write_text("{}", encoding="utf-8")
    done = volatool("recommend", "x.json", "--sample", "3")
    assert done.returncode == 2
    done = volatool("recommend", "x.json")
    assert done.returncode == 4
    assert "E_NOT_REPORT" in done.stderr
