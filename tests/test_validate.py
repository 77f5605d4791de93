"""`validate_file`."""

from __future__ import annotations

import json
from pathlib import Path

import golden_cases as golden
import making_volumes as making
import naive_formats as naive
import pytest

from volatool.formats import dense, gz, sparse
from volatool.validate import validate_file


@pytest.mark.parametrize(("name", "kind"), [("a.vol", "sparse"), ("a.dvol.gz", "dense")])
def test_our_files_are_valid(tmp_path: Path, name: str, kind: str) -> None:
    """Nothing to say about them."""
    path = tmp_path / name
    module = sparse if kind == "sparse" else dense
    with path.open("wb") as file:
        if name.endswith(".gz"):
            with gz.writer(file) as packed:
                module.write(packed, making.random_volume(2, 30))
        else:
            module.write(file, making.random_volume(2, 30))
    report = validate_file(path)
    assert report.to_dict() == {
        "path": str(path),
        "kind": kind,
        "ok": True,
        "problems": [],
        "warnings": [],
    }


def test_a_fault_has_code_and_offset(tmp_path: Path) -> None:
    """One problem, not an error."""
    path = tmp_path / "a.vol"
    path.write_bytes(naive.header(0, 2, 0, (0.0,) * 6) + b"\1" + bytes(7))
    report = validate_file(path)
    assert not report.ok
    (problem,) = report.problems
    assert (problem.code, problem.offset) == ("E_TRUNCATED", 88)
    assert str(problem).startswith("E_TRUNCATED: ")
    assert report.kind == "sparse"


def test_missing_files_are_problems(tmp_path: Path) -> None:
    """Of every kind."""
    for name, kind in {
        "a.vol": "sparse",
        "b.json": "report",
        "c.tif": "dem",
        "d": "unknown",
    }.items():
        report = validate_file(tmp_path / name)
        assert (report.kind, report.problems[0].code) == (kind, "E_NOT_FOUND")


@pytest.mark.shared
def test_the_damaged_golden_files_are_found(shared: Path) -> None:
    """Those whose metadata words were dropped; the others are valid."""
    for case in golden.expected(shared)["cases"]:
        report = validate_file(golden.stored(shared, case))
        assert report.ok == ("dropped_zero_meta_words" not in case), case["file"]
        assert report.kind == case["mode"] or not report.ok


def test_a_wrong_suffix_is_a_warning(tmp_path: Path) -> None:
    """The content decides."""
    path = tmp_path / "a.dvol"
    with path.open("wb") as file:
        sparse.write(file, making.random_volume(2, 30))
    report = validate_file(path)
    assert report.ok
    assert [warning.code for warning in report.warnings] == ["W_SUFFIX"]


@pytest.mark.parametrize("data", [b"", b"II*\0junk", b"<html>"])
def test_what_is_no_dem_is_a_problem(tmp_path: Path, data: bytes) -> None:
    """Whatever GDAL says about it, it is one line."""
    path = tmp_path / "a.dem.tif"
    path.write_bytes(data)
    report = validate_file(path)
    assert report.kind == "dem"
    assert report.problems
    assert all("\n" not in str(problem) for problem in report.problems)


@pytest.mark.parametrize("text", ["", "{", "[]", '{"schema": "volatool.stats/1"}', "\x00"])
def test_what_is_no_report_is_a_problem(tmp_path: Path, text: str) -> None:
    """Empty, cut, something else, half of it."""
    path = tmp_path / "a.stats.json"
    path.write_text(text)
    report = validate_file(path)
    assert not report.ok
    assert {problem.code for problem in report.problems} == {"E_NOT_REPORT"}


def test_more_faults_of_a_report_are_listed(tmp_path: Path) -> None:
    """Each is one problem that names its place."""
    path = tmp_path / "a.stats.json"
    keys = ("status", "input", "cube", "levels", "choice", "encodings", "dem")
    document = dict.fromkeys(keys, 0) | {
        "schema": "volatool.stats/1",
        "tool": {"options": {}},
        "warnings": [],
    }
    path.write_text(json.dumps(document))
    assert len(validate_file(path).problems) > 3
