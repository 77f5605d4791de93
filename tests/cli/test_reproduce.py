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


VOLA = ("vola", "--points", "2000", "--samples", "500", "--no-resources")


def test_vola_tables_of_a_tile_as_json(volatool):
    done = volatool("reproduce", *VOLA, "forest.laz", "--json", "--progress", "json")
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    assert document["schema"] == "volatool.reproduce_vola/1"
    assert document["setup"]["tiles"] == ["forest.laz"]
    table = document["tiles"]["sum"]
    assert table["identity"] == {**table["identity"], "holds": True, "broken": {}}
    assert table["sizes"]["laz"] == (volatool.folder / "forest.laz").stat().st_size
    assert 0 < table["sizes"]["volazip_percent_of_laz"] < 20
    assert "resources" not in document
    assert '"event": "done"' in done.stderr


def test_vola_report_on_stdout_and_in_a_folder(volatool):
    done = volatool("reproduce", *VOLA, "town.laz", "-o", "paper")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("# VOLA: the paper's tables\n")
    assert done.stdout == (volatool.folder / "paper" / "report.md").read_text()
    assert "| C12 |" in done.stdout
    assert (volatool.folder / "paper" / "figure-4-to-7-density-town.png").stat().st_size > 1000
    assert "wrote" in done.stderr
    again = volatool("reproduce", *VOLA, "-o", "paper")
    assert again.returncode == 2
    assert "E_OUTPUT_EXISTS" in again.stderr
    assert again.stdout == ""


def test_vola_refuses_what_it_can_not_use(volatool):
    (volatool.folder / "bad.laz").write_bytes(b"LASF" + bytes(400))
    for arguments, status, code in (
        (("missing.laz",), 4, "E_NOT_FOUND"),
        (("bad.laz",), 4, "E_"),
        (("--samples", "1"), 2, "E_OPTION"),
        (("-o", ""), 2, "E_OPTION"),
        (("",), 2, "E_OPTION"),
    ):
        done = volatool("reproduce", *VOLA, *arguments)
        assert done.returncode == status, (arguments, done.stderr)
        assert code in done.stderr
        assert done.stdout == ""
        assert "Traceback" not in done.stderr


def test_vola_takes_names_from_stdin(volatool):
    done = volatool("reproduce", *VOLA, "-0", "-", "-q", "--json", input="forest.laz\0")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["setup"]["tiles"] == ["forest.laz"]
    assert done.stderr == ""
