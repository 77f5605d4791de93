"""``stats --fail-if``: the exit status of a gate, and what it says."""

from __future__ import annotations

import json


def test_a_condition_that_is_true_is_status_6_and_one_line(volatool):
    done = volatool(
        "stats", "town.laz", "forest.laz", "--format", "jsonl", "--fail-if", "depth < 4"
    )
    assert done.returncode == 6
    assert done.stderr.splitlines()[-1] == "E_CHECK: forest.laz: depth < 4 (found 3)"
    assert done.stderr.count("E_CHECK") == 1
    reports = [json.loads(line) for line in done.stdout.splitlines()]
    assert [report["choice"]["depth"] for report in reports] == [4, 3]


def test_conditions_that_are_not_true_are_status_0(volatool):
    gates = ("--fail-if", "depth < 3", "--fail-if", "crs == none", "--fail-if", "classes lacks 1")
    done = volatool("stats", "town.laz", "forest.laz", *gates, "-q")
    assert (done.returncode, done.stderr) == (0, "")


def test_with_summary_the_sum_is_asked(volatool):
    command = ("stats", "town.laz", "forest.laz", "--summary", "--fail-if")
    total = 0
    for tile in ("town.laz", "forest.laz"):
        report = json.loads(volatool("stats", tile, "--format", "json").stdout)
        total += report["input"]["points_used"]
    assert volatool(*command, f"points_used != {total}").returncode == 0
    done = volatool(*command, f"points_used == {total}")
    assert done.returncode == 6
    assert f"E_CHECK: 2 tiles: points_used == {total} (found {total})" in done.stderr


def test_the_same_lines_whatever_the_number_of_processes(volatool):
    command = ("stats", "town.laz", "forest.laz", "--fail-if", "points_used > 9", "-q")
    one, two = volatool(*command), volatool(*command, "-j", "2")
    assert (one.returncode, one.stderr) == (two.returncode, two.stderr)
    assert one.stderr.count("E_CHECK") == 2


def test_the_sum_of_several_processes_is_asked_as_that_of_one(volatool):
    command = ("stats", "town.laz", "forest.laz", "--summary", "--fail-if", "depth < 9", "-q")
    one, two = volatool(*command), volatool(*command, "-j", "2")
    assert one.returncode == two.returncode == 6
    assert (one.stdout, one.stderr) == (two.stdout, two.stderr)
    assert one.stderr.startswith("E_CHECK: 2 tiles: depth < 9 (found ")


def test_an_unreadable_tile_is_status_3_and_the_others_are_asked(volatool):
    (volatool.folder / "bad.laz").write_bytes(b"no points here")
    done = volatool("stats", "bad.laz", "town.laz", "--fail-if", "depth < 9")
    assert done.returncode == 3
    assert "E_NOT_LAS: " in done.stderr
    assert "E_CHECK: town.laz: depth < 9 (found 4)" in done.stderr


def test_a_wrong_name_is_refused_before_any_work(volatool):
    done = volatool("stats", "nowhere.laz", "--fail-if", "dpth < 4")
    assert done.returncode == 2
    assert done.stderr.startswith("E_OPTION: Invalid value for '--fail-if': 'dpth' is not in")
    assert "depth, dropped" in done.stderr
    assert done.stdout == ""
