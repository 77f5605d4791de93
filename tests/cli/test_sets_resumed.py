"""Data sets under the batch engine: killed and resumed, on workers, indexed."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from making_servers import WebServer
from making_tiles import hills, write_las

RETILE = ("retile", "tiles", "-o", "out", "--split", "20m", "--no-resources", "-q")
MOSAIC = ("dem", "tiles", "-o", "out", "--mosaic", "all", "--cell", "1m", "-q")
GROUPS = (*RETILE[:5], "4m", *RETILE[6:])  # of cubes: more than one
RECORD = ("-j", "2", "--manifest", "run.jsonl", "--resume")


@pytest.fixture
def tiles(volatool):
    """Six tiles in two rows."""
    folder = volatool.folder / "tiles"
    folder.mkdir()
    for k in range(6):
        xyz = hills(4000, k, extent=4200) + np.array((4000 * (k % 3), 4000 * (k // 3), 0))
        codes = np.full(len(xyz), 2, np.uint8)
        write_las(folder / f"t{k}.las", xyz, crs="EPSG:25832", classification=codes)
    return folder


def contents(folder):
    # the plan and the set name the times of the tiles, which are the same; so all must be
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }


def records(volatool):
    path = volatool.folder / "run.jsonl"
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def kill_when(volatool, asked, n_records):
    """Start a run and kill it, and it alone, once its manifest has some records."""
    command = [sys.executable, "-m", "volatool_cli", *asked]
    run = subprocess.Popen(command, cwd=volatool.folder, stdout=subprocess.DEVNULL)
    deadline = time.monotonic() + 100
    while run.poll() is None and len(records(volatool)) < n_records:
        assert time.monotonic() < deadline
        time.sleep(0.01)
    assert run.poll() is None, "it ended before it was killed"
    os.kill(run.pid, signal.SIGKILL)
    run.wait()


@pytest.mark.parametrize("asked", [GROUPS, MOSAIC], ids=["retile", "mosaic"])
def test_killed_and_resumed_a_set_is_as_if_nothing_had_happened(volatool, tiles, asked):
    done = volatool(*asked)
    assert done.returncode == 0, done.stderr
    calm = contents(volatool.folder / "out")
    shutil.rmtree(volatool.folder / "out")
    kill_when(volatool, (*asked, *RECORD), 1)
    done = volatool(*asked, *RECORD)
    assert done.returncode == 0, done.stderr
    found = contents(volatool.folder / "out")
    assert found.keys() - calm.keys() <= {"tile.cubes/dataset.proof.json"}
    assert {name: found[name] for name in calm} == calm
    n_units = len({record["input"]["path"] for record in records(volatool)})
    n_before = len(records(volatool))
    assert n_before == n_units >= 3  # none twice
    again = volatool(*asked[:-1], *RECORD)
    assert again.returncode == 0
    assert f"{n_units} of {n_units} inputs are done already" in again.stderr
    assert len(records(volatool)) == n_before
    assert contents(volatool.folder / "out") == found


@pytest.mark.slow
def test_the_points_are_counted_once_as_long_as_nothing_changes(volatool, tiles):
    assert volatool(*RETILE, *RECORD).returncode == 0
    count = volatool.folder / "out/tile.cubes/dataset.json"
    before = count.stat().st_mtime_ns
    assert volatool(*RETILE, *RECORD).returncode == 0
    assert count.stat().st_mtime_ns == before
    content = count.read_bytes()
    count.write_bytes(content + b" ")  # not what was counted
    assert volatool(*RETILE, *RECORD).returncode == 0
    assert count.read_bytes() == content
    before = count.stat().st_mtime_ns
    assert volatool(*RETILE, *RECORD, "--exclude-class", "7").returncode == 0
    assert count.stat().st_mtime_ns > before


@pytest.mark.slow
@pytest.mark.parametrize("asked", [RETILE, MOSAIC], ids=["retile", "mosaic"])
def test_a_changed_tile_has_all_done_again_that_depends_on_it(volatool, tiles, asked):
    """As many points in the same box, but not at the same heights."""
    assert volatool(*asked, *RECORD).returncode == 0
    path = tiles / "t0.las"
    xyz = hills(4000, 0, extent=4200)
    order = np.argsort(xyz[:, 2], kind="stable")
    xyz[order[50:-50], 2] = xyz[order[50:-50], 2][::-1].copy()
    size = path.stat().st_size
    write_las(path, xyz, crs="EPSG:25832", classification=np.full(len(xyz), 2, np.uint8))
    assert path.stat().st_size == size
    assert volatool(*asked, *RECORD).returncode == 0
    found = contents(volatool.folder / "out")
    shutil.rmtree(volatool.folder / "out")
    assert volatool(*asked).returncode == 0
    calm = contents(volatool.folder / "out")
    assert {name: found[name] for name in calm} == calm


@pytest.mark.slow
@pytest.mark.parametrize("asked", [RETILE, MOSAIC], ids=["retile", "mosaic"])
def test_a_set_on_a_local_cluster_has_the_same_bytes(volatool, tiles, asked):
    pytest.importorskip("distributed", reason="needs the extra dask")
    assert volatool(*asked).returncode == 0
    calm = contents(volatool.folder / "out")
    shutil.rmtree(volatool.folder / "out")
    done = volatool(*asked, "--scheduler", "local", "-j", "2")
    assert done.returncode == 0, done.stderr
    assert contents(volatool.folder / "out") == calm


@pytest.mark.slow
def test_a_recommendation_does_not_depend_on_the_number_of_processes(volatool, tiles):
    one = volatool("recommend", "tiles", "--json")
    two = volatool("recommend", "tiles", "--json", "-j", "2")
    assert one.returncode == two.returncode == 0
    assert one.stdout == two.stdout


def test_a_set_of_volumes_and_models_made_by_workers_is_indexed(volatool, tiles):
    made = volatool("convert", "tiles", "-o", "out", "-j", "2", "--mosaic", "all", "--cell", "1m")
    assert made.returncode == 0, made.stderr
    said = ("--author", "A", "--license", "CC0-1.0", "--stac", "--datetime", "2020-01-01")
    done = volatool("index", "out", "--name", "set", *said)
    assert done.returncode == 0, done.stderr
    out = volatool.folder / "out"
    assert (out / "set.vola").read_text(encoding="utf-8").count(".vol.gz") == 6
    assert (out / "set.dem.vrt").read_text(encoding="utf-8").count("<SourceFilename") == 6
    assert len(json.loads((out / "collection.json").read_text())["links"]) >= 6


@pytest.mark.slow
def test_tiles_at_urls_are_cut_and_mosaicked_as_local_ones(volatool, tiles):
    pytest.importorskip("aiohttp", reason="needs the extra cloud")
    assert volatool(*RETILE).returncode == 0
    cubes = {p.name: p.read_bytes() for p in (volatool.folder / "out").glob("*.vol.gz")}
    assert volatool(*MOSAIC).returncode == 0
    model = (volatool.folder / "out/t4.dem.tif").read_bytes()
    shutil.rmtree(volatool.folder / "out")
    with WebServer(tiles) as server:
        urls = [server.url(f"t{k}.las") for k in range(6)]
        done = volatool(RETILE[0], *urls, *RETILE[2:], "-j", "2")
        assert done.returncode == 0, done.stderr
        found = {p.name: p.read_bytes() for p in (volatool.folder / "out").glob("*.vol.gz")}
        assert found == cubes
        done = volatool(MOSAIC[0], *urls, *MOSAIC[2:], "-j", "2")
        assert done.returncode == 0, done.stderr
        assert (volatool.folder / "out/t4.dem.tif").read_bytes() == model
        shutil.rmtree(volatool.folder / "out")
        for asked in (RETILE, MOSAIC):
            done = volatool(asked[0], urls[0] + "?sign=secret", *asked[2:])
            assert done.returncode == 2
            assert "can't be kept" in done.stderr
            assert "secret" not in done.stderr
            assert not any((volatool.folder / "out").rglob("*"))


@pytest.mark.parametrize("asked", [RETILE, MOSAIC], ids=["retile", "mosaic"])
def test_a_set_can_not_be_written_to_a_url(volatool, tiles, asked):
    done = volatool(*asked[:2], "-o", "s3://bucket/out", *asked[4:])
    assert done.returncode == 2
    assert "needs a local folder" in done.stderr
    assert not (volatool.folder / "s3:").exists()
