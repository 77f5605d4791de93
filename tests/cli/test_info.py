"""``volatool info``, ``validate`` and ``doctor``."""

from __future__ import annotations

import json


def test_info_tells_points_volumes_and_elevation_models(volatool):
    assert volatool("convert", "town.laz", "-o", "out").returncode == 0
    done = volatool("info", "town.laz", "out/town.vol.gz", "out/town.dem.tif", "--json")
    assert done.returncode == 0, done.stderr
    points, volume, dem = map(json.loads, done.stdout.splitlines())
    assert (points["kind"], points["points"], points["point_format"]) == ("points", 247199, 7)
    assert points["crs"]["vertical"] == "EPSG:7837"
    assert (volume["kind"], volume["depth"], volume["quantizer"]) == ("volume", 4, "floor")
    assert volume["crs"] == points["crs"]
    assert (dem["kind"], dem["nodata"]) == ("dem", -9999.0)
    text = volatool("info", "town.laz", "out/town.vol.gz", "out/town.dem.tif").stdout
    assert "crs: EPSG:25832 + EPSG:7837 (from wkt)" in text


def test_info_of_what_is_no_file_of_ours(volatool):
    (volatool.folder / "x.txt").write_text("hello")
    done = volatool("info", "x.txt", "gone.laz", "town.laz")
    assert done.returncode == 3
    assert [line.split(":")[0] for line in done.stderr.splitlines()] == [
        "E_NOT_VOLA",
        "E_NOT_FOUND",
    ]


def test_validate_passes_what_we_write_and_fails_what_is_damaged(volatool):
    assert volatool("convert", "town.laz", "-o", "out", "--no-gzip").returncode == 0
    out = volatool.folder / "out"
    files = sorted(out.iterdir())
    done = volatool("validate", *files)
    assert done.returncode == 0, done.stdout
    assert done.stdout.count(": ok") == len(files)
    data = bytearray((out / "town.vol").read_bytes())
    data[5000] ^= 0x10
    (out / "town.vol").write_bytes(data)
    done = volatool("validate", *files, "--json")
    assert done.returncode == 6
    faulty = [record for record in map(json.loads, done.stdout.splitlines()) if not record["ok"]]
    assert len(faulty) == 1
    assert faulty[0]["problems"][0]["offset"] is not None or faulty[0]["problems"][0]["message"]


def test_validate_holds_the_files_of_a_tile_against_each_other(volatool):
    """By the report alone with --set; exit status 6, one line for each fault."""
    given = ("convert", "forest.laz", "-o", "out", "--no-dem", "--depth", "3")
    assert volatool(*given).returncode == 0
    done = volatool("validate", "out/forest.stats.json", "--set")
    assert done.returncode == 0
    assert sorted(done.stdout.splitlines()) == [
        "out/forest.dvol.gz: ok (dense)",
        "out/forest.stats.json: ok (report)",
        "out/forest.vol.gz: ok (sparse)",
    ]
    report = volatool.folder / "out" / "forest.stats.json"
    document = json.loads(report.read_text())
    document["levels"][2]["voxels"] += 1
    report.write_text(json.dumps(document))
    assert volatool("validate", report).returncode == 0
    (volatool.folder / "out" / "forest.dvol.gz").unlink()
    done = volatool("validate", report, "--set")
    assert done.returncode == 6
    faults = [line for line in done.stdout.splitlines() if line.startswith("  ")]
    assert [line.split(":")[0] for line in faults] == ["  E_MISMATCH"] * 2
    assert "names forest.dvol.gz, which is not beside it" in faults[0]
    assert "level 3: voxels is" in faults[1]


def test_doctor_names_backends_and_limits(volatool):
    facts = json.loads(volatool("doctor", "--json").stdout)
    assert "parallel" in facts["laz backend"].lower()
    assert facts["cores"] >= 1
    assert "kernel cache" in facts
