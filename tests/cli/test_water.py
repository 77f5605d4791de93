"""``--water`` and ``--breaklines`` on the command line: the sample's lake, and files that fail."""

from __future__ import annotations

import json

import jsonschema
import pytest
from rasterio import open as open_raster

from volatool.report import schema

LAKE = "town-lake.geojson"


@pytest.fixture
def folder(volatool):
    """The folder with the samples, the lake among them."""
    (volatool.folder / LAKE).symlink_to((volatool.folder / "town.laz").resolve().parent / LAKE)
    return volatool.folder


def test_the_sample_lake_is_level(volatool, folder):
    """One level near the scene's 299.0 m, in every cell of the lake, and a valid report."""
    done = volatool("dem", "town.laz", "-o", "out", "--water", LAKE, "--layers", "flag", "--json")
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    jsonschema.validate(report, schema())
    barriers = report["dem"]["barriers"]
    (lake,) = barriers["lakes"]
    assert lake["source"] == "shore"
    assert lake["level"] == pytest.approx(299.0, abs=0.1)
    assert barriers["cut_edges"] == 0
    with open_raster(folder / "out" / "town.dem.tif") as raster:
        z = raster.read(1)
    with open_raster(folder / "out" / "town.dem.flag.tif") as raster:
        flag = raster.read(1)
    is_level = abs(z - lake["level"]) < 1e-4
    assert (is_level & (flag == 2)).sum() >= 0.99 * lake["cells"]
    assert z[z > -9999].min() > 298.5


def test_the_same_bytes_with_little_memory(volatool, folder):
    for name, memory in (("a", "1G"), ("b", "300M")):
        done = volatool("dem", "town.laz", "-o", name, "--water", LAKE, "--memory", memory, "-q")
        assert done.returncode == 0, done.stderr
    one, other = ((folder / name / "town.dem.tif").read_bytes() for name in "ab")
    assert one == other


@pytest.mark.parametrize(
    ("options", "status", "code"),
    [
        (("--water", "none.gpkg"), 4, "E_NOT_FOUND"),
        (("--breaklines", "town.laz"), 4, "E_NOT_VECTOR"),
        (("--breaklines", LAKE, "--surface", "tin"), 2, "E_OPTION"),
    ],
)
def test_what_is_refused_leaves_nothing(volatool, folder, options, status, code):
    done = volatool("dem", "town.laz", "-o", "out", *options)
    assert done.returncode == status, done.stderr
    lines = [line for line in done.stderr.splitlines() if line.startswith("E_")]
    assert len(lines) == 1
    assert lines[0].startswith(f"{code}: ")
    assert not (folder / "out").exists() or not list((folder / "out").iterdir())
