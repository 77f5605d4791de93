"""``volatool index``."""

from __future__ import annotations

import json

import pytest


@pytest.fixture
def folder(volatool):
    done = volatool("convert", "town.laz", "-o", "out", "--no-gzip", "--cell", "2m")
    assert done.returncode == 0, done.stderr
    return volatool.folder / "out"


def test_index_of_a_folder(volatool, folder):
    """Index, mosaic and STAC; paths on stdout; info and validate read the index."""
    who = ("--author", "City", "--license", "CC-BY-4.0")
    done = volatool("index", "out", *who, "--stac", "--datetime", "2019-05-01")
    assert done.returncode == 0, done.stderr
    names = ["out.vola", "out.dem.vrt", "town.stac.json", "collection.json"]
    assert done.stdout.splitlines() == [f"out/{name}" for name in names]
    assert done.stderr == ""
    assert json.loads((folder / "out.vola").read_text())["files"][0]["filename"] == "town.vol"
    done = volatool("validate", "out/out.vola", "out/out.dem.vrt")
    assert "out/out.vola: ok (index)" in done.stdout
    facts = json.loads(volatool("info", "out/out.vola", "--json").stdout)
    assert (facts["kind"], facts["author"], facts["files"]) == ("index", "City", 1)
    done = volatool("index", "out", *who)
    assert done.returncode == 2
    assert done.stderr.startswith("E_OUTPUT_EXISTS: ")
    assert volatool("index", "out", *who, "--overwrite", "--no-vrt").returncode == 0


@pytest.mark.parametrize(
    ("arguments", "status", "code"),
    [
        (("out",), 2, "E_ATTRIBUTION"),
        (("out", "--author", "a", "--license", "b", "--stac"), 2, "E_OPTION"),
        (("out", "--author", "a", "--license", "b", "--datetime", "2019-05-01"), 2, "E_OPTION"),
        (("gone", "--author", "a", "--license", "b"), 4, "E_NOT_FOUND"),
        ((), 2, "E_OPTION"),
    ],
)
def test_what_is_missing_is_said(volatool, folder, arguments, status, code):
    done = volatool("index", *arguments)
    assert done.returncode == status
    assert done.stderr.startswith(f"{code}: ")
    assert len(done.stderr.splitlines()) == 1
    assert not (folder / "out.vola").exists()
