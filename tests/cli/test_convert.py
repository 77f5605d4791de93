"""``volatool convert`` as a script sees it."""

from __future__ import annotations

import json
import os
import shutil
import subprocess

import jsonschema
import pytest

from volatool.report import schema

OUTPUTS = ["town.dem.tif", "town.dvol.gz", "town.stats.json", "town.vol.gz"]


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_the_four_outputs_are_written_and_their_paths_printed(volatool):
    done = volatool("convert", "town.laz", "-o", "out")
    assert done.returncode == 0, done.stderr
    assert sorted(done.stdout.split()) == sorted(f"out/{name}" for name in OUTPUTS)
    assert names(volatool.folder / "out") == OUTPUTS


def test_outputs_go_beside_the_input_by_default(volatool):
    real = volatool.folder / "real.laz"
    shutil.copy(volatool.folder / "forest.laz", real)
    assert volatool("convert", "real.laz", "--no-dem", "--dense", "never").returncode == 0
    assert (volatool.folder / "real.vol.gz").exists()
    assert not (volatool.folder / "real.dem.tif").exists()


def test_existing_outputs_are_refused_before_any_work(volatool):
    out = volatool.folder / "out"
    out.mkdir()
    (out / "town.dem.tif").write_text("precious")
    done = volatool("convert", "forest.laz", "town.laz", "-o", "out")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("E_OUTPUT_EXISTS: out/town.dem.tif")
    assert names(out) == ["town.dem.tif"]
    assert (out / "town.dem.tif").read_text() == "precious"
    assert volatool("convert", "town.laz", "-o", "out", "--overwrite").returncode == 0
    assert names(out) == OUTPUTS


def test_the_same_name_twice_is_refused_before_any_work(volatool):
    (volatool.folder / "copy").mkdir()
    (volatool.folder / "copy" / "town.las").symlink_to(volatool.folder / "town.laz")
    done = volatool("convert", "town.laz", "copy/town.las", "-o", "out")
    assert done.returncode == 2
    assert done.stderr.startswith("E_NAME_COLLISION")
    assert not (volatool.folder / "out").exists()


def test_one_bad_tile_does_not_stop_the_rest(volatool):
    (volatool.folder / "bad.laz").write_bytes(b"<html>404</html>")
    done = volatool("convert", "bad.laz", "forest.laz", "-o", "out", "--no-dem", "--json")
    assert done.returncode == 3
    assert "E_NOT_LAS: bad.laz" in done.stderr
    assert "Traceback" not in done.stderr
    failed, good = map(json.loads, done.stdout.splitlines())
    for report in (failed, good):
        jsonschema.validate(report, schema())
    assert (failed["status"], failed["error"]["code"]) == ("failed", "E_NOT_LAS")
    assert failed["input"] == {"name": "bad.laz"}
    assert good["status"] == "ok"


def test_when_every_tile_fails_the_status_is_4_and_fail_fast_stops(volatool):
    for name in ("a.laz", "b.laz"):
        (volatool.folder / name).write_bytes(b"")
    done = volatool("convert", "a.laz", "b.laz", "-o", "out")
    assert done.returncode == 4
    assert len(done.stderr.splitlines()) == 2
    done = volatool("convert", "a.laz", "b.laz", "-o", "out", "--fail-fast")
    assert len(done.stderr.splitlines()) == 1
    assert volatool("convert", "gone.laz").returncode == 4


def test_an_output_folder_that_can_not_be_is_status_5(volatool):
    (volatool.folder / "file").touch()
    done = volatool("convert", "forest.laz", "-o", "file/out")
    assert done.returncode == 5
    assert done.stderr.startswith("E_WRITE: ")
    assert len(done.stderr.splitlines()) == 1


def test_a_full_disk_is_status_5_and_leaves_nothing(volatool, tmp_path):
    """A file system of 64 KiB of its own, in a user namespace where the machine allows it."""
    mount = tmp_path / "small"
    mount.mkdir()
    script = (
        f"mount -t tmpfs -o size=64k none {mount} && "
        f"cd {volatool.folder} && {os.sys.executable} -m volatool_cli convert town.laz -o {mount};"
        f" echo status $?; ls -A {mount}"
    )
    done = subprocess.run(
        ["unshare", "-Urm", "bash", "-c", script], capture_output=True, text=True, check=False
    )
    if "status" not in done.stdout or "unshare" in done.stderr or "mount:" in done.stderr:
        pytest.skip("no mount in a user namespace here")
    assert done.stdout.split() == ["status", "5"]
    assert "E_WRITE" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_ceiling_that_can_not_be_kept_is_status_7(volatool):
    done = volatool("convert", "forest.laz", "-o", "out", "--memory", "20M")
    assert done.returncode == 7
    assert done.stderr.startswith("E_MEMORY: ")
    assert not (volatool.folder / "out").exists()


def test_a_dry_run_writes_nothing_and_prints_what_would_be(volatool):
    done = volatool("convert", "town.laz", "-o", "out", "--dry-run", "--layers", "flag")
    assert done.returncode == 0
    assert "out/town.dem.flag.tif" in done.stdout.split()
    assert "247,199 points" in done.stderr
    assert not (volatool.folder / "out").exists()


def test_names_from_stdin(volatool):
    done = volatool("convert", "-0", "-", "-o", "out", "--no-dem", input="forest.laz\0town.laz\0")
    assert done.returncode == 0, done.stderr
    assert len(done.stdout.split()) == 6


def test_progress_in_json_ends_with_a_completion_event(volatool):
    done = volatool("convert", "forest.laz", "-o", "out", "--no-dem", "--progress", "json")
    events = [json.loads(line) for line in done.stderr.splitlines() if line.startswith("{")]
    assert events[-1] == {"event": "done", "name": "forest.laz"}
    assert events[-2]["done"] == events[-2]["total"]
    (volatool.folder / "bad.laz").touch()
    done = volatool("convert", "bad.laz", "-o", "out2", "--progress", "json")
    assert json.loads(done.stderr.splitlines()[0]) == {"event": "failed", "name": "bad.laz"}


def test_warnings_go_to_stderr_unless_quiet(volatool):
    done = volatool("convert", "forest.laz", "-o", "out")
    assert "W_NO_GROUND_CLASS: forest.laz: " in done.stderr
    assert volatool("convert", "forest.laz", "-o", "out2", "-q").stderr == ""


def test_a_log_holds_the_trace_that_stderr_does_not(volatool):
    (volatool.folder / "bad.laz").write_bytes(b"LASF" + b"\0" * 500)
    done = volatool("convert", "bad.laz", "--log", "run.log")
    assert len(done.stderr.splitlines()) == 1
    assert "Traceback" in (volatool.folder / "run.log").read_text()


def test_reports_of_the_samples_validate_and_say_no_resources_when_asked(volatool):
    done = volatool("convert", "town.laz", "-o", "out", "--json", "--no-resources")
    report = json.loads(done.stdout)
    jsonschema.validate(report, schema())
    assert "resources" not in report
    assert report == json.loads((volatool.folder / "out" / "town.stats.json").read_text())


def test_split_writes_one_volume_per_cube_and_loses_no_point(volatool):
    import volatool as vt

    done = volatool("convert", "town.laz", "-o", "out", "--split", "100m", "--no-dem", "--json")
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    jsonschema.validate(report, schema())
    volumes = [vt.open(path) for path in (volatool.folder / "out").glob("*.vol.gz")]
    assert len(volumes) == report["cube"]["cubes"] > 4
    assert sum(volume.info.n_points for volume in volumes) == report["input"]["points_used"]
    for volume in volumes:
        assert volume.depth == report["choice"]["depth"]
        assert [value % 100 for value in volume.cube.origin] == [0, 0, 0]
    voxels = report["levels"][report["choice"]["depth"] - 1]["voxels"]
    assert sum(map(len, volumes)) == voxels


def test_a_budget_is_kept_by_the_file(volatool):
    done = volatool("convert", "town.laz", "-o", "out", "--budget", "20K", "--no-dem")
    assert done.returncode == 0, done.stderr
    report = json.loads((volatool.folder / "out" / "town.stats.json").read_text())
    assert report["choice"]["rule"] == "budget"
    assert (volatool.folder / "out" / "town.vol.gz").stat().st_size <= 20 << 10


def test_a_depth_from_a_data_set(volatool):
    summary = volatool("stats", "town.laz", "forest.laz", "--summary", "--format", "json").stdout
    (volatool.folder / "dataset.json").write_text(summary)
    done = volatool(
        "convert", "town.laz", "-o", "out", "--no-dem", "--json", "--depth-from", "dataset.json"
    )
    report = json.loads(done.stdout)
    assert report["choice"]["rule"] == "dataset"
    assert report["choice"]["depth"] == json.loads(summary)["choice"]["depth"]
    (volatool.folder / "dataset.json").write_text("{")
    done = volatool("convert", "town.laz", "-o", "o2", "--depth-from", "dataset.json")
    assert (done.returncode, done.stderr[:9]) == (2, "E_OPTION:")


def test_uncompressed_outputs(volatool):
    done = volatool("convert", "town.laz", "-o", "out", "--no-gzip", "--no-dem")
    assert done.returncode == 0, done.stderr
    assert names(volatool.folder / "out") == ["town.dvol", "town.stats.json", "town.vol"]


def test_degrees_are_refused_with_the_code_to_use(volatool, tmp_path):
    done = volatool("convert", "town.laz", "-o", "out", "--crs", "EPSG:4326")
    assert done.returncode == 4
    assert "E_GEOGRAPHIC" in done.stderr


def test_reprojecting_keeps_every_point(volatool):
    done = volatool(
        "convert", "town.laz", "-o", "out", "--no-dem", "--json", "--to-crs", "EPSG:3035"
    )
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert report["input"]["crs"]["horizontal"] == "EPSG:3035"
    assert report["input"]["points_used"] == 247005


def test_the_elevation_model_alone_and_its_report(volatool):
    done = volatool("dem", "town.laz", "-o", "out", "--json", "--cell", "2m", "--layers", "flag")
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    jsonschema.validate(report, schema())
    assert names(volatool.folder / "out") == ["town.dem.flag.tif", "town.dem.tif"]
    dem = report["dem"]
    assert (dem["cell"], dem["surface"], dem["ground_source"]) == (2.0, "dtm", "class 2")
    assert dem["cells_measured"] + dem["cells_filled"] + dem["cells_void"] == 120 * 100


@pytest.mark.parametrize("surface", ["dtm", "dsm", "min", "max", "mean", "idw", "tin"])
def test_surfaces_have_honest_names(surface, volatool):
    done = volatool("dem", "town.laz", "-o", "out", "--json", "--surface", surface)
    assert json.loads(done.stdout)["dem"]["surface"] == surface


@pytest.mark.parametrize("surface", ["auto", "dtm"])
def test_a_dtm_without_a_ground_class_is_made_by_the_ground_filter(surface, volatool):
    done = volatool("dem", "forest.laz", "-o", "out", "--surface", surface, "--json")
    assert done.returncode == 0, done.stderr
    assert "points that the ground filter kept" in done.stderr
    dem = json.loads(done.stdout)["dem"]
    assert (dem["surface"], dem["ground_source"]) == ("dtm", "ground filter")


def test_odd_names_end_in_one_coded_line(volatool):
    done = volatool("convert", "a" * 300 + ".laz", "-o", "out")
    assert done.returncode in (2, 4)
    assert done.stderr.startswith(("E_OPTION", "E_INPUT"))
    done = volatool("convert", "-", "-o", "out", input="nul\0byte.laz\n")
    assert done.returncode in (2, 4)
    assert done.stderr.startswith("E_")
    done = volatool("info", "/dev/stdin", input="x")
    assert "Traceback" not in done.stderr
    assert done.stderr.startswith("E_")


def test_every_failure_is_a_report_with_json(volatool):
    done = volatool("convert", "town.laz", "-o", "out", "--cube", "10m", "--json")
    assert (done.returncode, done.stderr.split(":")[0]) == (2, "E_CUBE")
    report = json.loads(done.stdout)
    jsonschema.validate(report, schema())
    assert (report["status"], report["error"]["code"]) == ("failed", "E_CUBE")


def test_a_dry_run_goes_on_after_a_bad_tile(volatool):
    done = volatool("convert", "gone.laz", "town.laz", "-o", "out", "--dry-run")
    assert done.returncode == 3
    assert "out/town.vol.gz" in done.stdout
    assert "E_NOT_FOUND" in done.stderr


def test_when_nothing_can_be_written_the_status_is_5(volatool):
    (volatool.folder / "file").touch()
    assert volatool("convert", "town.laz", "forest.laz", "-o", "file/out").returncode == 5
