"""``volatool import``: what it prints and writes, statuses, and the original's bytes."""

from __future__ import annotations

import json
from pathlib import Path

import golden_cases as golden
import jsonschema
import numpy as np
import pytest
from click.testing import CliRunner
from making_imports import ply

import volatool as vt
from volatool_cli.main import cli

SCHEMA = Path(vt.__file__).parent / "report.schema.json"
ROWS = "".join(f"{x}.5 {y}.25 {x * y % 7}.0 {x} {y} 9 4\n" for x in range(20) for y in range(20))


def test_paths_are_printed_and_the_report_says_what_was_read(volatool):
    (volatool.folder / "cloud.xyz").write_text(ROWS)
    done = volatool("import", "cloud.xyz", "--crs", "EPSG:28992+5709", "--depth", "3")
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["cloud.vol.gz", "cloud.dvol.gz", "cloud.stats.json"]
    report = json.loads((volatool.folder / "cloud.stats.json").read_text())
    jsonschema.validate(report, json.loads(SCHEMA.read_text()))
    assert report["input"]["format"] == "xyz"
    assert report["input"]["las_version"] is None
    assert report["input"]["points_used"] == 400
    assert report["input"]["bbox"] == [0.5, 0.25, 0.0, 19.5, 19.25, 6.0]
    assert report["input"]["crs"]["vertical"] == "EPSG:5709"
    assert report["dem"] is None
    volume = vt.open(volatool.folder / "cloud.vol.gz")
    assert {c["name"] for c in volume.info.channels} >= {"red", "green", "blue", "intensity"}
    assert volume.crs.epsg == 28992
    facts = json.loads(volatool("info", "cloud.vol.gz", "--json").stdout)
    assert facts["crs"]["horizontal"] == "EPSG:28992"
    assert volatool("validate", "cloud.vol.gz").returncode == 0


def test_options_of_convert_hold(volatool):
    """Selection, cube, metadata, reprojection and the elevation model, as for LAS."""
    (volatool.folder / "cloud.csv").write_text(
        "x,y,z,class\n"
        + "".join(f"{x},{y},{x % 3},{2 + y % 2}\n" for x in range(30) for y in range(30))
    )
    arguments = ["--class", "2", "--bounds", "0,0,20,20", "--cube", "32", "--depth", "2", "--dem"]
    done = volatool(
        "import", "cloud.csv", *arguments, "--cell", "1", "--meta", "class", "--json", "--no-gzip"
    )
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert report["input"]["dropped"] == {"class": 450, "bounds": 450 - 21 * 11}
    assert report["cube"]["side"] == 32.0
    assert report["dem"]["cells_measured"] > 0
    assert {path.name for path in volatool.folder.glob("cloud.*")} == {
        "cloud.csv", "cloud.vol", "cloud.dvol", "cloud.dem.tif", "cloud.stats.json",
    }  # fmt: skip
    moved = volatool(
        "import",
        "cloud.csv",
        "-o",
        "utm",
        "--crs",
        "EPSG:28992",
        "--to-crs",
        "EPSG:32631",
        "--json",
    )
    assert moved.returncode == 0, moved.stderr
    document = json.loads(moved.stdout)["input"]
    assert (document["crs"]["horizontal"], document["format"]) == ("EPSG:32631", "csv")


def test_a_folder_is_searched_and_failures_are_told(volatool):
    folder = volatool.folder / "in"
    folder.mkdir()
    (folder / "a.xyz").write_text(ROWS)
    (folder / "b.ply").write_bytes(ply({axis: np.arange(9.0) for axis in "xyz"}))
    (folder / "c.csv").write_text("x,y,z\n1,2\n")
    (folder / "notes.md").write_text("no points")
    done = volatool("import", "in", "-o", "out", "--dense", "never")
    assert done.returncode == 3
    assert "E_CORRUPT: c.csv: line 2: 2 values, the header names 3" in done.stderr
    assert sorted(path.name for path in (volatool.folder / "out").iterdir()) == [
        "a.stats.json", "a.vol.gz", "b.stats.json", "b.vol.gz",
    ]  # fmt: skip
    assert volatool("import", "in", "--from", "csv", "-o", "o2").returncode == 4
    again = volatool("import", "in/a.xyz", "-o", "out")
    assert (again.returncode, "E_OUTPUT_EXISTS" in again.stderr) == (2, True)
    assert volatool("import", "in/a.xyz", "-o", "out", "--overwrite").returncode == 0
    dry = volatool("import", "in/a.xyz", "-o", "o3", "--dry-run")
    assert "400 points" in dry.stderr
    assert not (volatool.folder / "o3").exists()


@pytest.mark.parametrize(
    ("arguments", "status", "message"),
    [
        (["town.laz"], 4, "E_NOT_IMPORT: town.laz: `volatool convert` reads LAS and LAZ"),
        (["nothing.ply"], 4, "E_NOT_FOUND"),
        (["a.xyz", "--columns", "x,y,q"], 2, "'q' is not one of"),
        (["a.xyz", "--from", "ply"], 4, "E_NOT_IMPORT: a.xyz: is no PLY file"),
        (["a.xyz", "--from", "doc"], 2, "'doc' is not one of"),
        (["a.xyz", "--spacing", "1m"], 2, "--spacing is for --mesh sample"),
        (["a.xyz", "--class", "2"], 2, "E_OPTION: a.xyz: --class can't choose"),
        (["a.xyz", "--compat", "toolkit"], 2, "--compat toolkit needs --depth"),
        (["a.xyz", "--compat", "toolkit", "--depth", "2", "--from", "csv"], 4, "E_TOOLKIT"),
    ],
)
def test_what_can_not_be_is_refused(tmp_path, monkeypatch, arguments, status, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.xyz").write_text(ROWS)
    (tmp_path / "town.laz").write_text("LASF")
    done = CliRunner().invoke(cli, ["import", *arguments])
    assert done.exit_code == status
    assert message in done.stderr
    assert done.stdout == ""
    assert not list(tmp_path.glob("*.vol*"))


def test_a_missing_package_is_a_matter_of_usage(volatool):
    """Exit status 2, as for export; not one of the input."""
    (volatool.folder / "m.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    hidden = volatool.folder / "hidden"
    hidden.mkdir()
    text = "raise ModuleNotFoundError('No module named trimesh', name='trimesh')"
    (hidden / "trimesh.py").write_text(text)
    done = volatool("import", "m.obj", env={"PYTHONPATH": str(hidden)})
    assert (done.returncode, "pip install 'volatool[mesh]'" in done.stderr) == (2, True)


def test_no_points_are_an_empty_report(volatool):
    (volatool.folder / "a.ply").write_bytes(ply({axis: np.zeros(0) for axis in "xyz"}))
    done = volatool("import", "a.ply")
    assert (done.returncode, done.stdout.split()) == (0, ["a.stats.json"])
    assert "W_EMPTY" in done.stderr


@pytest.mark.shared
@pytest.mark.parametrize(
    ("name", "stem"),
    [
        ("cloud-s3n.vol", "cloud"),
        ("cloud-d2n.dvol", "cloud"),
        ("mesh-s3.vol", "mesh"),
        ("cloud_pcd-s2.vol", "cloud"),
        ("reverse2-s2-z.vol", "reverse2"),
        ("bad_neg-s2n.vol", "bad_neg"),
    ],
)
def test_compat_writes_the_bytes_of_the_original(tmp_path, shared, name, stem):
    cases = golden.expected(shared)["cases"]
    case = next(
        case for case in cases if golden.stored(shared, case).name.removesuffix(".gz") == name
    )
    source = golden.input_path(shared, case["input"])
    path = tmp_path / f"{stem}{source.suffix}"
    path.write_bytes(source.read_bytes())
    dense = "always" if case["mode"] == "dense" else "never"
    arguments = [
        "--compat",
        "toolkit",
        "--depth",
        str(case["depth"]),
        "--no-gzip",
        "--dense",
        dense,
    ]
    arguments += [] if "-n" in case["args"] else ["--meta", "none"]
    arguments += ["--swap-yz"] if "-z" in case["args"] else []
    if case["header"]["crs"] != 2000:
        arguments += ["--crs", f"EPSG:{case['header']['crs']}"]
    done = CliRunner().invoke(cli, ["import", str(path), *arguments])
    assert done.exit_code == 0, done.stderr
    data = (tmp_path / f"{stem}{Path(name).suffix}").read_bytes()
    expected = golden.unpacked(golden.stored(shared, case))
    assert data[:16] == expected[:16]
    assert data[32:] == expected[32:]
