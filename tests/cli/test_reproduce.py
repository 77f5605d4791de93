"""``volatool reproduce``."""

from __future__ import annotations

import json

QUICK = ("--runs", "1", "--duration", "2", "--no-resources")


def test_json_has_the_scenarios(volatool):
    done = volatool("reproduce", "emap", *QUICK, "--json", "--progress", "json")
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    assert document["schema"] == "volatool.reproduce_emap/1"
    assert set(document["scenarios"]) == {"raw", "nearest", "gaussian", "cdf"}
    for row in document["scenarios"].values():
        assert {"octomap_mse", "emap_mse", "improvement_percent", "paper_percent"} <= set(row)
    assert "resources" not in document
    assert '"event": "done"' in done.stderr


def test_markdown_on_stdout_and_files_in_a_folder(volatool):
    done = volatool("reproduce", "emap", "--runs", "1", "--duration", "2", "-o", "paper")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("# EMap: the paper's experiment\n")
    assert done.stdout == (volatool.folder / "paper" / "report.md").read_text()
    assert "| C23 |" in done.stdout
    assert "wrote" in done.stderr
    document = json.loads((volatool.folder / "paper" / "report.json").read_text())
    assert [loop["nodes"] for loop in document["resources"]["loop"]][1] == 1600
    again = volatool("reproduce", "emap", *QUICK, "-o", "paper")
    assert again.returncode == 2
    assert "E_OUTPUT_EXISTS" in again.stderr


def test_bad_numbers_are_usage_errors(volatool):
    for arguments in (("--runs", "0"), ("--duration", "0.1"), ("--seed", "-1"), ("-o", "")):
        done = volatool("reproduce", "emap", *arguments)
        assert done.returncode == 2, arguments
        assert "E_OPTION" in done.stderr


def test_the_group_alone_shows_what_there_is(volatool):
    done = volatool("reproduce", "--help")
    assert done.returncode == 0
    assert "emap" in done.stdout
