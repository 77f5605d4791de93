"""``volatool classify``."""

from __future__ import annotations

import json

import jsonschema
import laspy
import numpy as np

from volatool.report import schema


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_paths_or_reports_on_stdout(volatool):
    done = volatool("classify", "forest.laz", "town.laz", "-o", "out")
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["out/forest.laz", "out/town.laz"]
    done = volatool("classify", "forest.laz", "-o", "out", "--overwrite", "--json", "-q")
    assert done.stderr == ""
    report = json.loads(done.stdout)
    jsonschema.validate(report, schema())
    assert report["classification"]["points_ground"] > 10_000
    assert report["dem"] is None


def test_the_samples_ground_is_found(volatool):
    """The town was made by a program that knows which points are ground."""
    assert volatool("classify", "town.laz", "-o", "out").returncode == 0
    truth = laspy.read(volatool.folder / "town.laz").classification == 2
    found = laspy.read(volatool.folder / "out" / "town.laz").classification == 2
    assert np.mean(truth != found) < 0.02
    done = volatool("dem", "out/town.laz", "-o", "out", "--json")
    assert json.loads(done.stdout)["dem"]["ground_source"] == "class 2"


def test_an_input_is_refused_as_an_output_before_any_work(volatool):
    """Beside the input, and when another input stands in the output folder."""
    for arguments in (
        ["forest.laz"],
        ["forest.laz", "--overwrite"],
        ["forest.laz", "--dry-run"],
        ["town.laz", "forest.laz", "-o", "."],
    ):
        done = volatool("classify", *arguments)
        assert (done.returncode, done.stdout) == (2, "")
        assert done.stderr.startswith("E_OUTPUT_EXISTS: ")
        assert "is an input" in done.stderr
    assert names(volatool.folder) == ["forest.laz", "town.laz"]


def test_dry_run_writes_nothing(volatool):
    done = volatool("classify", "town.laz", "-o", "out", "--dry-run")
    assert (done.returncode, done.stdout.split()) == (0, ["out/town.laz"])
    assert not (volatool.folder / "out").exists()


def test_one_bad_tile_does_not_stop_the_rest(volatool):
    (volatool.folder / "bad.laz").write_bytes(b"LASF" + b"\0" * 500)
    done = volatool("classify", "bad.laz", "forest.laz", "-o", "out")
    assert done.returncode == 3
    assert done.stdout.split() == ["out/forest.laz"]
    assert names(volatool.folder / "out") == ["forest.laz"]


def test_progress_covers_both_reads(volatool):
    done = volatool("classify", "forest.laz", "-o", "out", "--progress", "json")
    events = [json.loads(line) for line in done.stderr.splitlines() if line.startswith("{")]
    assert events[-1] == {"event": "done", "name": "forest.laz"}
    assert events[-2]["done"] == events[-2]["total"]
    assert [event["done"] for event in events[:-1]] == sorted(e["done"] for e in events[:-1])
