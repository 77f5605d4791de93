"""``volatool stats``: tables for people and scripts."""

from __future__ import annotations

import csv
import io
import json

import jsonschema

from volatool.report import schema


def test_the_table_begins_with_the_papers_columns(volatool):
    done = volatool("stats", "town.laz")
    assert done.returncode == 0, done.stderr
    header = next(line for line in done.stdout.splitlines() if line.startswith("Lvl"))
    assert header.split("  ")[0] == "Lvl"
    assert header.split()[:8] == ["Lvl", "Dense(MB)", "Sparse(MB)", "Mag", "Red", "Block", "Occup",
                                  "Cell"]  # fmt: skip
    assert "Depth 4: level 4 is the deepest" in done.stdout
    assert "LAS equivalent" in done.stdout


def test_points_and_the_volume_made_of_them_give_the_same_levels(volatool):
    assert volatool("convert", "town.laz", "-o", "out", "--no-dem").returncode == 0
    documents = []
    for name in ("town.laz", "out/town.vol.gz", "out/town.dvol.gz"):
        done = volatool("stats", name, "--format", "json")
        assert done.returncode == 0, done.stderr
        documents.append(json.loads(done.stdout))
        jsonschema.validate(documents[-1], schema())
    points, sparse, dense = documents
    depth = points["choice"]["depth"]
    assert sparse["levels"] == points["levels"][:depth] == dense["levels"]


def test_options_that_mean_nothing_for_a_volume_are_told(volatool):
    assert volatool("convert", "forest.laz", "-o", "out", "--no-dem", "-q").returncode == 0
    done = volatool("stats", "out/forest.vol.gz", "--class", "2")
    assert done.returncode == 0
    assert done.stderr.startswith("W_OPTIONS_IGNORED: forest.vol.gz: --classes")


def test_jsonl_csv_and_md(volatool):
    lines = volatool("stats", "town.laz", "forest.laz", "--format", "jsonl").stdout.splitlines()
    assert [json.loads(line)["input"]["name"] for line in lines] == ["town.laz", "forest.laz"]
    rows = list(
        csv.DictReader(io.StringIO(volatool("stats", "town.laz", "--format", "csv").stdout))
    )
    assert [row["level"] for row in rows if row["chosen"] == "True"] == ["4"]
    assert float(rows[0]["occupancy"]) == json.loads(lines[0])["levels"][0]["occupancy"]
    text = volatool("stats", "town.laz", "--format", "md").stdout
    assert "| Lvl | Dense(MB) | Sparse(MB) | Mag Red | Block Occup |" in text


def test_a_summary_adds_up(volatool):
    one = json.loads(volatool("stats", "town.laz", "--format", "json").stdout)
    done = volatool("stats", "town.laz", "town.laz", "forest.laz", "--summary", "--format", "json")
    both = json.loads(done.stdout)
    jsonschema.validate(both, schema())
    assert both["tiles"] == 2  # the same file twice is one input
    assert both["levels"][0]["dense_bytes"] == 2 * one["levels"][0]["dense_bytes"]
    assert both["levels"][2]["voxels"] > one["levels"][2]["voxels"]
    for upper, lower in zip(both["levels"], both["levels"][1:], strict=False):
        assert lower["blocks"] == upper["voxels"]


def test_a_bad_file_is_told_and_the_rest_printed(volatool):
    (volatool.folder / "bad.vol").write_bytes(b"x" * 100)
    done = volatool("stats", "bad.vol", "forest.laz")
    assert done.returncode == 3
    assert "forest.laz" in done.stdout
    assert done.stderr.startswith("E_")


def test_a_summary_reads_reports_instead_of_tiles(volatool):
    """What `convert` wrote sums up to the same table as the tiles; a broken report is told."""
    assert volatool("convert", "town.laz", "-o", "out", "--no-dem", "-q").returncode == 0
    from_tile = json.loads(
        volatool("stats", "town.laz", "--summary", "--format", "json", "--no-resources").stdout
    )
    done = volatool("stats", "out/town.stats.json", "--summary", "--format", "json")
    from_report = json.loads(done.stdout)
    assert from_report["levels"] == from_tile["levels"]
    assert from_report["choice"] == from_tile["choice"]
    (volatool.folder / "bad.json").write_text("{}", encoding="utf-8")
    done = volatool("stats", "bad.json", "out/town.stats.json", "--summary")
    assert done.returncode == 3
    assert done.stderr.startswith("E_NOT_REPORT: bad.json")
    assert "1 tiles" in done.stdout


def test_a_whole_data_set_has_the_depth_of_its_summary(volatool):
    """--depth-from takes what stats --summary writes; every tile says so."""
    done = volatool("stats", "town.laz", "forest.laz", "--summary", "--format", "json")
    (volatool.folder / "dataset.json").write_text(done.stdout, encoding="utf-8")
    depth = json.loads(done.stdout)["choice"]["depth"]
    names = ("town.laz", "forest.laz")
    done = volatool("convert", *names, "-o", "out", "--no-dem", "--depth-from", "dataset.json",
                    "--json")  # fmt: skip
    assert done.returncode == 0, done.stderr
    for line in done.stdout.splitlines():
        choice = json.loads(line)["choice"]
        assert (choice["depth"], choice["rule"]) == (depth, "dataset")
    (volatool.folder / "dataset.json").write_text("{}", encoding="utf-8")
    done = volatool("convert", *names, "-o", "out2", "--depth-from", "dataset.json")
    assert done.returncode == 2
    assert "choice.depth" in done.stderr
    assert not (volatool.folder / "out2").exists()
