"""``benchmarks/run.py``: the table, its JSON, tiles made twice alike, and the check that fails."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import costs
import inputs
import jsonschema
import laspy
import machine
import numpy as np
import peers
import pytest
import results
import rows
from costs import Cost
from results import Measured
from rows import Row

RUN = Path(rows.__file__).with_name("run.py")
SAMPLE = Path(__file__).resolve().parents[1] / "data_samples" / "town.laz"

NUMBER = {"type": "number", "minimum": 0}
OR_NULL = [{"type": "null"}]


def numbers(*names):
    return {"type": "object", "required": list(names), "additionalProperties": NUMBER}


SCHEMA = {
    "type": "object",
    "required": ["schema", "machine", "settings", "tiles", "peers", "rows"],
    "properties": {
        "schema": {"const": 1},
        "machine": {"required": ["cpu", "cores", "memory_gib", "system", "load", "load_after"]},
        "tiles": {"additionalProperties": {"type": "integer", "minimum": 1}},
        "rows": {
            "items": {
                "required": ["name", "group", "what", "ratios", "reached", "target", "met"],
                "properties": {
                    "median": {"anyOf": [numbers("wall_s", "cpu_s", "peak_mib"), *OR_NULL]},
                    "ratios": {"anyOf": [numbers("wall", "cpu", "peak"), *OR_NULL]},
                    "reached": {"anyOf": [NUMBER, *OR_NULL]},
                    "met": {"type": ["boolean", "null"]},
                    "skipped": {"type": ["string", "null"]},
                },
            }
        },
    },
}


def run(*words):
    command = [sys.executable, str(RUN), *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def quick(tmp_path_factory):
    """Folder, outcome and JSON of a quick run of a stage, jobs, a peer and growth."""
    folder = tmp_path_factory.mktemp("benchmark")
    only = ["occupancy", "solve-250k", "convert-occupancy", "help", "pdal-idw-1m", "growth-1M"]
    words = ["--quick", "--work", folder, "--json", folder / "out.json", "--only", *only]
    done = run(*words, "--save-baseline", "--baseline", folder / "baseline.json")
    assert done.returncode == 0, done.stderr
    return folder, done, json.loads((folder / "out.json").read_text())


def test_a_quick_run_prints_one_table(quick):
    _, done, document = quick
    machine_line, empty, header, rule, *body = done.stdout.splitlines()
    assert "cores" in machine_line
    assert empty == ""
    n_columns = header.count("|")
    assert set(rule) <= set("|-:")
    assert [line.count("|") for line in body] == [n_columns] * len(document["rows"])
    assert "pdal is absent" in done.stdout


def test_its_json_has_every_row_asked_for_and_their_floors(quick):
    _, _, document = quick
    jsonschema.validate(document, SCHEMA)
    by_name = {row["name"]: row for row in document["rows"]}
    assert set(by_name) == {
        *("decode", "occupancy", "decode-solver", "solve-250k", "decode-process"),
        *("convert-occupancy", "help", "decode-4M", "dem-1m", "pdal-idw-1m", "growth-1M"),
    }
    for name, row in by_name.items():
        assert row["runs"] == (0 if name == "pdal-idw-1m" else 1), name
    occupancy, floor = by_name["occupancy"], by_name["decode"]
    wall = occupancy["median"]["wall_s"] / floor["median"]["wall_s"]
    assert occupancy["ratios"]["wall"] == pytest.approx(wall)
    assert occupancy["reached"] == occupancy["ratios"]["wall"]
    assert occupancy["met"] == (wall <= 1.2)
    assert occupancy["units"] == document["tiles"]["tile"] == 20_000
    assert by_name["convert-occupancy"]["median"]["peak_mib"] > 30
    assert by_name["help"]["reached"] == by_name["help"]["median"]["wall_s"]


def test_the_check_passes_against_itself_and_fails_when_a_ratio_is_worse(quick):
    folder, _, document = quick
    words = ["--from", folder / "out.json", "--check", "--baseline", folder / "baseline.json"]
    assert run(*words).returncode == 0
    for row in document["rows"]:
        if row["name"] == "occupancy":
            row["ratios"]["cpu"] *= 1.2
    (folder / "slow.json").write_text(json.dumps(document))
    done = run("--from", folder / "slow.json", *words[2:])
    assert done.returncode == 1
    assert "worse: occupancy: cpu is" in done.stderr
    assert run("--from", folder / "slow.json", *words[2:], "--by", "wall", "peak").returncode == 0


def test_without_a_baseline_the_check_says_so(quick, tmp_path):
    folder, _, _ = quick
    done = run("--from", folder / "out.json", "--check", "--baseline", tmp_path / "none.json")
    assert done.returncode == 2
    assert "none.json is not there" in done.stderr


def test_a_name_that_no_row_has_is_refused():
    done = run("--only", "nonsense")
    assert done.returncode == 2
    assert "no row or group is called nonsense" in done.stderr


# comparing and reaching, without running anything


def ratios(**rows):
    return {
        "ratios": {name: dict(zip(results.MEASURES, v, strict=True)) for name, v in rows.items()}
    }


def test_worse_names_rows_and_measures_beyond_the_tolerance_only():
    before = ratios(a=(1.0, 2.0, 3.0), b=(1.0, 1.0, 1.0), gone=(1.0, 1.0, 1.0))
    now = ratios(a=(1.14, 2.4, 3.0), b=(0.5, 1.0, 1.16), new=(9.0, 9.0, 9.0))
    faults = results.worse(now, before)
    assert [fault.split(" is ")[0] for fault in faults] == ["a: cpu", "b: peak"]
    assert "(+20%)" in faults[0]
    assert results.worse(now, before, ["wall"]) == []
    assert len(results.worse(now, before, tolerance=0.1)) == 3


def costs_of(*walls):
    return [Cost(wall, 2 * wall, 100 * wall) for wall in walls]


def test_ratios_are_medians_of_the_turns_and_not_of_the_times():
    row = Row("job", "g", "", "command", floor="floor")
    # a busy second turn hits both
    measured = {
        "floor": Measured(costs_of(1.0, 10.0, 1.0)),
        "job": Measured(costs_of(2.0, 30.0, 4.0)),
    }
    assert results.ratios(row, measured) == {"wall": 3.0, "cpu": 3.0, "peak": 3.0}
    assert results.ratios(row, {"job": measured["job"]}) is None


@pytest.mark.parametrize(
    ("reach", "of", "expected"),
    [
        ("wall_s", "", 2.0),
        ("peak_mib", "", 200.0),
        ("us_per_unit", "", 4.0),
        ("us_per_point_wall", "", 2.0),
        ("toolkit", "", 5e5 / results.TOOLKIT_RATE),
        ("faster", "other", 4.0),
    ],
)
def test_what_is_reached(reach, of, expected):
    row = Row("job", "g", "", "command", reach=reach, of=of)
    measured = {
        "job": Measured(costs_of(2.0), 10**6),
        "other": Measured(costs_of(0.5), 10**6),
    }
    assert results.reached(row, measured) == pytest.approx(expected)
    assert results.reached(row, {"job": Measured(skipped="absent")}) is None


def test_growth_is_per_unit_and_unknown_without_both_ends():
    measured = {
        "large": Measured(costs_of(22.0), 100),
        "small": Measured(costs_of(2.0), 10),
    }
    time_row = Row("t", "g", "", "derived", reach="units_ratio", of="large small", limit=1.1)
    peak_row = Row("m", "g", "", "derived", reach="peak_ratio", of="large small", limit=1.1)
    found = results.result_rows([time_row, peak_row], measured)
    assert [row["reached"] for row in found] == [pytest.approx(1.1), pytest.approx(11.0)]
    assert found[1]["met"] is False
    assert results.reached(time_row, {"small": measured["small"]}) is None


def test_names_are_unique_and_what_rows_refer_to_is_there():
    names = [row.name for row in rows.ROWS]
    assert len(set(names)) == len(names)
    for row in rows.ROWS:
        assert {row.floor, *row.of.split()} - {""} <= set(names), row.name
        assert row.input in inputs.RECIPES


def test_groups_and_patterns_choose_rows_with_what_they_need():
    assert {row.group for row in rows.chosen(["growth"])} == {"growth"}
    found = [row.name for row in rows.chosen(["pdal-idw-*"])]
    assert found == ["decode-4M", "dem-1m", "pdal-idw-1m", "dem-0.5m", "pdal-idw-0.5m"]
    assert rows.chosen([]) == rows.ROWS


# costs


@pytest.mark.skipif(not costs.PROC.is_dir(), reason="no /proc")
def test_memory_is_that_of_the_whole_tree():
    child = "import time; held = bytearray(60 << 20); time.sleep(1)"
    parent = (
        "import subprocess, sys;"
        f"all([p.wait() == 0 for p in [subprocess.Popen([sys.executable, '-c', {child!r}]) "
        "for _ in range(3)]])"
    )
    cost = costs.run([sys.executable, "-c", parent])
    assert 180 < cost.peak_mib < 300
    assert cost.wall_s > 1


def test_cpu_seconds_count_children():
    child = "import time\nwhile time.process_time() < 0.5: pass"
    parent = (
        f"import subprocess, sys; subprocess.run([sys.executable, '-c', {child!r}], check=True)"
    )
    assert costs.run([sys.executable, "-c", parent]).cpu_s >= 0.5


def test_a_command_that_fails_ends_the_benchmark_with_its_message():
    with pytest.raises(SystemExit, match="oh no"):
        costs.run([sys.executable, "-c", "raise SystemExit('oh no')"])
    assert costs.run([sys.executable, "-c", "raise SystemExit(7)"], allowed=[7]) is None


@pytest.mark.skipif(not costs.PROC.is_dir(), reason="no /proc")
def test_descendants_are_found():
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as child:
        time.sleep(0.05)
        assert child.pid in costs.descendants(os.getpid())
        child.communicate(b"\n")


# tiles


def xyz(path):
    las = laspy.read(path)
    return np.stack([las.X, las.Y, las.Z], axis=1).astype(np.int64), las


def test_a_crop_has_exactly_the_points_asked_for_from_the_corner(tmp_path):
    path = inputs.made(inputs.Recipe("sparse", crop=5000), SAMPLE, tmp_path)
    points, las = xyz(path)
    everything, original = xyz(SAMPLE)
    assert len(points) == 5000
    corner = everything[:, :2].min(axis=0)
    limit = (points[:, :2] - corner).max()
    nearer = np.count_nonzero((everything[:, :2] - corner).max(axis=1) < limit)
    assert nearer <= 5000
    assert las.header.parse_crs() == original.header.parse_crs()


def test_copies_stand_side_by_side_and_are_the_same_bytes_again(tmp_path, monkeypatch):
    monkeypatch.setattr(inputs, "CHUNK", 100_000)
    recipe = inputs.Recipe("sparse", places=3, in_place=2, jitter_m=0.05)
    path = inputs.made(recipe, SAMPLE, tmp_path / "a")
    assert path.read_bytes() == inputs.made(recipe, SAMPLE, tmp_path / "b").read_bytes()
    points, las = xyz(path)
    one, original = xyz(SAMPLE)
    assert len(points) == 6 * len(one)
    step = np.round((original.header.maxs - original.header.mins) / original.header.scales) + 1
    size = np.ptp(one, axis=0)
    parts = points.reshape(6, len(one), 3)
    assert np.array_equal(parts[0], one)
    for part, (column, row) in zip(parts[::2], [(0, 0), (1, 0), (0, 1)], strict=True):
        assert np.allclose(part - one, [column * step[0], row * step[1], 0], atol=1)
    moved = np.abs(parts[1] - parts[0]).max(axis=0)
    assert (moved > 0).all()
    assert (moved * las.header.scales <= 0.05 + 1e-9).all()
    assert (np.ptp(parts[0], axis=0) == size).all()


def test_a_tile_is_made_once(tmp_path):
    recipe = inputs.Recipe("sparse", crop=100)
    path = inputs.made(recipe, SAMPLE, tmp_path)
    before = path.stat().st_mtime_ns
    assert inputs.made(recipe, SAMPLE, tmp_path).stat().st_mtime_ns == before
    assert list(tmp_path.iterdir()) == [path]


def test_a_crop_of_more_points_than_there_are_leaves_nothing(tmp_path):
    with pytest.raises(SystemExit, match="points, 1000000 are wanted"):
        inputs.made(inputs.Recipe("sparse", crop=1_000_000), SAMPLE, tmp_path)
    assert list(tmp_path.iterdir()) == []


# peers and machine


def test_pipelines_of_pdal_are_in_the_tiles_unit(tmp_path):
    tile, out = tmp_path / "a.laz", tmp_path / "out"
    _, voxels, writer = peers.pdal_pipeline("voxels", tile, out, 0.3048)
    assert voxels["cell"] == pytest.approx(0.5 / 0.3048)
    assert writer["filename"].endswith("out.laz")
    _, idw = peers.pdal_pipeline("idw 0.5m", tile, out, 1.0)
    assert (idw["type"], idw["output_type"], idw["resolution"]) == ("writers.gdal", "idw", 0.5)
    types = [stage["type"] for stage in peers.pdal_pipeline("faceraster 1m", tile, out, 1.0)]
    assert types == ["readers.las", "filters.delaunay", "filters.faceraster", "writers.raster"]
    command = peers.pdal_command("pdal", "idw 1m", tile, out, 1.0)
    assert command[:2] == ["pdal", "pipeline"]
    assert json.loads(Path(command[2]).read_text())[0]["filename"] == str(tile)


def test_an_interpreter_without_open3d_is_no_peer(tmp_path):
    false = tmp_path / "python"
    false.write_text("#!/bin/sh\nexit 1\n")
    false.chmod(0o755)
    assert peers.found(str(false))["open3d"] is None


def test_the_machine_is_described_in_a_line():
    found = machine.describe()
    assert machine.is_same(found, found)
    assert not machine.is_same(found, {**found, "cores": 1000})
    assert f"{found['cores']} cores" in machine.line(found)
