"""The shell recipes of the documentation, run as they stand on four small tiles that meet."""

from __future__ import annotations

import json
import os
import re
import shutil

import laspy
import numpy as np
import pytest
from running_docs import TOP, blocks, put_command, shell

PAGE = "docs/how-to/shell.md"
NAMES = ("north", "quay", "south", "old mill")


def section(title):
    """Return the blocks below a heading, by language."""
    text = (TOP / PAGE).read_text(encoding="utf-8")
    (body,) = re.findall(rf"^## {title}\n(.*?)(?=^## |\Z)", text, re.MULTILINE | re.DOTALL)
    found = re.findall(r"^```(\w+)\n(.*?)^```$", body, re.MULTILINE | re.DOTALL)
    return [code for language, code in found if language == "sh"], dict(found)


def need(*tools):
    for tool in tools:
        if shutil.which(tool) is None:
            pytest.skip(f"{tool} is not installed")


def run(script, folder, status=0, **environment):
    done = shell(script, folder, **environment)
    assert done.returncode == status, f"{script}\n{done.stdout}\n{done.stderr}"
    return done


def names(folder, pattern="*.stats.json"):
    return sorted(path.name for path in folder.glob(pattern))


@pytest.fixture(scope="module")
def four(tmp_path_factory):
    """Four squares of the town, 30 m wide, around one corner; one name has a space."""
    folder = tmp_path_factory.mktemp("four")
    town = laspy.read(TOP / "data_samples" / "town.laz")
    west, south = (float(side) for side in town.header.mins[:2] + 60)
    for number, name in enumerate(NAMES):
        x, y = west + 30 * (number % 2), south + 30 * (number // 2)
        inside = (town.x >= x) & (town.x < x + 30) & (town.y >= y) & (town.y < y + 30)
        tile = laspy.LasData(town.header, town.points[inside])
        tile.write(folder / f"{name}.laz")
    return folder


@pytest.fixture
def folder(four, tmp_path):
    put_command(tmp_path)
    shutil.copytree(four, tmp_path / "tiles")
    return tmp_path


def break_tile(folder, name="quay"):
    path = folder / "tiles" / f"{name}.laz"
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    return whole


def test_find_takes_only_tiles_that_are_new(folder):
    old = folder / "tiles" / "quay.laz"
    os.utime(old, (0, 0))
    (since_last, xargs), _ = section("find and xargs")
    run(since_last, folder)
    assert names(folder / "out") == ["north.stats.json", "old mill.stats.json", "south.stats.json"]
    run("rm -r out", folder)
    run(xargs, folder)
    assert len(names(folder / "out")) == 4
    run("rm -r out", folder)
    break_tile(folder)
    run(xargs, folder, status=123)
    assert len(names(folder / "out")) == 3


def test_parallel_does_again_what_failed_and_nothing_else(folder):
    need("parallel")
    (first, again, awk), _ = section("GNU parallel")
    whole = break_tile(folder)
    run(first, folder, status=1)  # the number of jobs that failed
    assert run(awk, folder).stdout.split()[0] == "4"
    assert len(names(folder / "out")) == 3
    before = {path: path.stat().st_mtime_ns for path in (folder / "out").iterdir()}
    (folder / "tiles" / "quay.laz").write_bytes(whole)
    run(again, folder)
    assert len(names(folder / "out")) == 4
    assert all(path.stat().st_mtime_ns == time for path, time in before.items())


def test_make_rebuilds_what_is_old_and_goes_on_after_a_failure(folder):
    need("make", "gdaldem")
    (command,), files = section("make")
    (folder / "Makefile").write_text(files["make"])
    (folder / "tiles" / "old mill.laz").unlink()
    whole = break_tile(folder)
    done = run(command, folder, status=2)
    assert "E_TRUNCATED: quay.laz" in done.stderr
    assert names(folder / "out", "*.tif") == [
        "north.dem.tif", "north.shade.tif", "south.dem.tif", "south.shade.tif"
    ]  # fmt: skip
    before = (folder / "out" / "south.shade.tif").stat().st_mtime_ns
    (folder / "tiles" / "quay.laz").write_bytes(whole)
    run(command, folder)
    assert len(names(folder / "out", "*.shade.tif")) == 3
    assert (folder / "out" / "south.shade.tif").stat().st_mtime_ns == before
    assert "Nothing to be done" in run(command, folder).stdout


def test_jq_tells_of_reports_and_manifests(folder):
    need("jq")
    break_tile(folder)
    run("volatool convert tiles/ -o out --manifest run.jsonl -q", folder, status=3)
    reports = [json.loads(path.read_text()) for path in sorted((folder / "out").glob("*.json"))]
    assert len(reports) == 3
    (tables, density), _ = section("jq on reports")
    rows = run(tables, folder).stdout.splitlines()
    first = reports[0]["input"]
    assert rows[0].split("\t")[:2] == ["north.laz", str(first["points_used"])]
    assert rows[3] == str(sum(report["input"]["points_used"] for report in reports))
    shares = [line.split("\t") for line in run(density, folder).stdout.splitlines()]
    assert [float(share[2]) for share in shares if share[:2] == ["north.laz", "2"]] == [
        pytest.approx(first["classes"]["2"] / first["points_read"])
    ]
    (states, digests), _ = section("jq on the manifest")
    shown = run(states, folder).stdout.splitlines()
    assert shown[:2] == ["failed\t1", "ok\t3"]
    assert shown[2] == f"E_TRUNCATED\t{folder}/tiles/quay.laz"
    assert len(shown) == 3 + 4
    run(digests, folder)
    with (folder / "out" / "north.vol.gz").open("ab") as file:
        file.write(b"x")
    assert "north.vol.gz: FAILED" in run(digests, folder, status=1).stdout


def test_gdal_takes_the_models(folder):
    need("gdalbuildvrt", "gdaldem", "gdal_contour", "gdal_translate", "gdalinfo")
    (mosaic, measured), _ = section("GDAL on the elevation models")
    run(mosaic, folder)
    found = json.loads(run("gdalinfo -json -stats mosaic.tif", folder).stdout)
    assert found["size"] == [60, 60]
    assert found["bands"][0]["metadata"][""]["STATISTICS_VALID_PERCENT"] == "100"
    assert "DHHN2016" in found["coordinateSystem"]["wkt"]
    contours = run("ogrinfo -so contours.gpkg contour", folder).stdout
    assert int(re.search(r"Feature Count: (\d+)", contours)[1]) > 0
    share = run(measured, folder).stdout
    assert 0 < float(share.split("=")[1]) < 100


def test_the_gate_lets_good_deliveries_pass_and_names_what_is_wrong_with_others(folder):
    (gate, script), found = section("A gate for deliveries")
    run(gate, folder)
    assert len((folder / "reports.jsonl").read_text().splitlines()) == 4
    assert run(script, folder).stdout == "accepted\n"

    path = folder / "tiles" / "quay.laz"
    tile = laspy.read(path)
    tile.classification[tile.classification == 2] = 1
    thinned = laspy.LasData(tile.header, tile.points[np.arange(0, len(tile.points), 8)])
    thinned.write(path)
    lines = run(gate, folder, status=6).stderr.splitlines()
    shape = r"E_CHECK: quay\.laz: (density\S+ < 3|classes lacks 2) \(found [\d., ]+\)"
    assert len(lines) == 2
    for line in (*lines, *found["text"].splitlines()):
        assert re.fullmatch(shape, line), line
    assert run(script, folder).stdout == "sent back:\n quay.laz\n"

    break_tile(folder)
    assert "unreadable:\nE_TRUNCATED: quay.laz" in run(script, folder).stdout


def test_the_conditions_of_the_table_are_conditions():
    from volatool.conditions import parse_condition

    text = (TOP / PAGE).read_text(encoding="utf-8")
    examples = re.findall(r"`([\w.]+ (?:<|>|==|!=|has|lacks) [\w.]+)`", text)
    assert len(examples) >= 12
    for example in examples:
        parse_condition(example)


def test_the_tasks_of_a_slurm_array_share_the_tiles_and_resume(folder):
    need("awk", "jq")
    (failed,), files = section("A Slurm job array")
    (folder / "tiles.sbatch").write_text(files["bash"])
    run("find tiles -name '*.laz' > tiles.txt", folder)
    break_tile(folder)
    array = {"SLURM_ARRAY_TASK_COUNT": "3"}
    done = [
        shell("bash tiles.sbatch", folder, SLURM_ARRAY_TASK_ID=str(task), **array)
        for task in (1, 2, 3)  # as of --array=1-3; 0-2 is the same modulo 3
    ]
    assert sorted(task.returncode for task in done)[:2] == [0, 0]
    assert max(task.returncode for task in done) in (3, 4)
    records = [
        json.loads(line)
        for path in (folder / "manifests").glob("*.jsonl")
        for line in path.read_text().splitlines()
    ]
    tiles = sorted(os.path.basename(record["input"]["path"]) for record in records)  # noqa: PTH119
    assert tiles == sorted(f"{name}.laz" for name in NAMES)
    assert run(failed, folder).stdout.startswith("E_TRUNCATED\tquay.laz")
    again = shell("bash tiles.sbatch", folder, SLURM_ARRAY_TASK_ID="1", **array)
    assert again.stdout == ""  # all of it is done, or the broken one alone is tried
    idle = {"SLURM_ARRAY_TASK_ID": "7", "SLURM_ARRAY_TASK_COUNT": "9"}
    assert run("bash tiles.sbatch", folder, **idle).stdout == ""


def test_completion_scripts_are_put_in_place(folder):
    (script,), _ = section("Completion and manual pages")
    run(script, folder, HOME=str(folder))
    scripts = [
        ".local/share/bash-completion/completions/volatool",
        ".config/fish/completions/volatool.fish",
        ".zfunc/_volatool",
    ]
    assert all("_VOLATOOL_COMPLETE" in (folder / name).read_text() for name in scripts)


def test_every_block_of_the_page_is_run_here():
    tried = [
        "find and xargs",
        "GNU parallel",
        "make",
        "jq on reports",
        "jq on the manifest",
        "GDAL on the elevation models",
        "A gate for deliveries",
        "A Slurm job array",
        "Completion and manual pages",
    ]
    assert sum(len(section(title)[0]) for title in tried) == len(blocks(PAGE, "sh"))
