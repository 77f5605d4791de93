"""``volatool check``, ``--holdout`` and ``--layers sigma`` as commands."""

from __future__ import annotations

import json
from pathlib import Path

import jsonschema
import numpy as np
import pytest

CHECKPOINTS = Path(__file__).resolve().parents[2] / "data_samples" / "town-checkpoints.csv"


@pytest.fixture
def town(volatool):
    done = volatool(
        "dem", "town.laz", "--layers", "flag,sigma", "--holdout", "10", "--json", "--cell", "2m"
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_sigma_and_holdout_are_in_report_and_files(town, volatool):
    """The layer has heights' cells; intervals of the report hold about what they should."""
    from volatool.dem.raster import read_dem
    from volatool.report import schema

    jsonschema.validate(town, schema())
    heights = read_dem(volatool.folder / "town.dem.tif")
    sigma = read_dem(volatool.folder / "town.dem.sigma.tif")
    np.testing.assert_array_equal(np.isnan(heights.z), np.isnan(sigma.z))
    assert sigma.unit == heights.unit
    holdout = town["dem"]["holdout"]
    assert holdout["near"]["n"] + holdout["gaps"]["n"] + holdout["void"] == holdout["n"]
    assert 0.91 <= holdout["near"]["coverage_95"] <= 0.99
    assert holdout["near"]["rmse"] < holdout["gaps"]["rmse"] < 0.3
    assert town["dem"]["sigma"]["samples"] == 32


def test_check_by_the_samples_checkpoints(town, volatool):
    """48 points surveyed to 2 cm: reported, met, not met; from stdin; too few."""
    base = ("check", "town.dem.tif", "--points", CHECKPOINTS)
    done = volatool(*base, "--checkpoint-rmse", "2cm", "--require", "15cm", "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert (found["status"], found["schema"]) == ("met", "volatool.accuracy/1")
    assert found["nva"]["n"] + found["n_void"] == 48
    assert found["sigma"]["coverage_95"] > 0.85
    done = volatool(*base, "--checkpoint-rmse", "2cm", "--require", "1cm")
    assert done.returncode == 6
    assert "not met" in done.stdout
    few = "".join(CHECKPOINTS.read_text().splitlines(keepends=True)[:20])
    done = volatool("check", "town.dem.tif", "--points", "-", input=few)
    assert done.returncode == 0
    assert "not reportable: 19 checkpoints, 30 are needed" in done.stdout


def test_check_refuses_what_is_not_there(volatool):
    """A missing DEM, missing points, no points."""
    done = volatool("check", "none.tif", "--points", CHECKPOINTS)
    assert (done.returncode, done.stderr.split(":")[0]) == (4, "E_NOT_FOUND")
    assert volatool("check", "none.tif").returncode == 2


def test_sigma_is_for_springs(volatool):
    """Baselines have no standard errors; hold-outs have bounds."""
    done = volatool("dem", "town.laz", "--surface", "min", "--layers", "sigma")
    assert done.returncode == 2
    assert "--layers sigma" in done.stderr
    assert volatool("dem", "town.laz", "--holdout", "80").returncode == 2
