"""``benchmarks/query.py``: every row runs, and OctoMap answers as we do."""

from __future__ import annotations

import sys

import making_volumes as making
import pytest
import query

from volatool.cube import Cube


@pytest.fixture(scope="module")
def volume():
    return making.random_volume(4, 4000, cube=Cube((637000.0, 4850000.0, 400.0), 256.0))


def test_every_row_is_timed(volume):
    rows = query.rates(volume, 200, 1)
    assert [row["name"] for row in rows] == [name for name, _, _ in query.RATES]
    assert all(row["amount"] > 0 and row["seconds"] >= 0 for row in rows)


def test_octomap_finds_the_same_points_and_what_is_absent_is_skipped(volume, tmp_path, capsys):
    pytest.importorskip("pyoctomap")
    interpreters = {"octomap": sys.executable, "open3d": None}
    result = query.against_rivals(volume, 20_000, 1, interpreters, tmp_path)
    (rival,) = result["rivals"]
    assert rival["name"].startswith("OctoMap (pyoctomap ")
    assert rival["differ"] == 0
    assert 9_000 < result["found"] < 12_000
    assert "open3d is not installed: skipped" in capsys.readouterr().err
    query.show({"volume": repr(volume), "point": result, "rates": query.rates(volume, 100, 1)})
    assert "| point: OctoMap" in capsys.readouterr().out


def test_a_library_that_does_not_run_is_skipped(volume, tmp_path, capsys):
    result = query.against_rivals(volume, 100, 1, {"nonsense": sys.executable}, tmp_path)
    assert result["rivals"] == []
    assert "nonsense does not run in" in capsys.readouterr().err
