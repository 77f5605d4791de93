"""``volatool emap``: lines come out as scans go in, and every end is a clean one."""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from making_scans import height, npy_bytes, pcd_bytes, scan

import volatool as vt
from volatool.dem.raster import read_dem
from volatool.dem.recheck import check_dem

RECORD = {
    "schema", "scan", "name", "points", "used", "dropped", "pose", "window", "cells", "z_min",
    "z_max", "residual_rmse", "solver", "snapshot",
}  # fmt: skip

PRODUCER = """
import sys, time
from making_scans import npy_bytes, scan
for k in range(int(sys.argv[1])):
    sys.stdout.buffer.write(npy_bytes(scan(0.2 * k, seed=k)))
    sys.stdout.buffer.flush()
    time.sleep(float(sys.argv[2]))
"""


def lines(text):
    return [json.loads(line) for line in text.splitlines()]


@pytest.fixture
def live(volatool):
    """Start ``volatool emap`` with pipes to and from it."""
    started = []

    def start(*arguments, **options):
        process = subprocess.Popen(
            [sys.executable, "-m", "volatool_cli", "emap", *map(str, arguments)],
            stdin=options.pop("stdin", subprocess.PIPE),
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            cwd=volatool.folder,
        )
        started.append(process)
        return process

    yield start
    for process in started:
        process.kill()
        process.wait()
        for stream in (process.stdin, process.stdout, process.stderr):
            if stream is not None and not stream.closed:
                with contextlib.suppress(BrokenPipeError):
                    stream.close()


def next_line(process, timeout=90):
    """The next line of stdout, or a failure when none comes."""
    assert select.select([process.stdout], [], [], timeout)[0], "no line came"
    return json.loads(process.stdout.readline())


def give(process, points):
    process.stdin.write(npy_bytes(points))
    process.stdin.flush()


def test_lines_come_out_as_scans_go_in(live):
    process = live("--format", "npy")
    for k in range(3):  # the next scan is not written before the line of this one is there
        give(process, scan(0.2 * k, seed=k))
        record = next_line(process)
        assert set(record) == RECORD | {"resources"}
        assert (record["scan"], record["points"], record["used"]) == (k, 2000, 2000)
    process.stdin.close()
    assert process.wait(60) == 0
    assert process.stderr.read() == b""


def test_a_producer_that_takes_its_time(live, volatool):
    """Lines have the pace of the scans, not of a buffer."""
    volatool("emap", "--format", "npy", text=False, input=npy_bytes(scan()))  # compiled by now
    producer = subprocess.Popen(
        [sys.executable, "-c", PRODUCER, "4", "0.5"],
        stdout=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    )
    process = live("--format", "npy", stdin=producer.stdout)
    next_line(process)
    came = [(next_line(process), time.monotonic())[1] for _ in range(3)]
    assert came[-1] - came[0] > 0.5
    assert process.wait(60) == 0
    assert producer.wait(60) == 0
    producer.stdout.close()


def test_the_surface_and_its_files(volatool):
    """Line, snapshot and last model say the same as the class."""
    scans = [scan(0.2 * k, seed=k) for k in range(4)]
    run = volatool(
        "emap", "--format", "npy", "-o", "out/map.tif", "--layers", "flag,count,distance,sigma",
        "--snapshot", "snaps", "--every", "2",
        stdin=None, input=npy_bytes(*scans), text=False,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr
    records = lines(run.stdout)
    m = vt.EMap()
    for points in scans:
        m.update(points)
        surface = m.window(np.median(points[:, :2], axis=0), 10.0)
    last = records[-1]
    assert last["window"]["bounds"] == [
        surface.bounds.left, surface.bounds.bottom, surface.bounds.right, surface.bounds.top
    ]  # fmt: skip
    assert last["cells"]["measured"] == surface.measured.sum()
    assert last["z_max"] == pytest.approx(float(surface.z.max()), abs=1e-3)
    assert 0.03 < last["residual_rmse"] < 0.07
    assert [r["snapshot"] and Path(r["snapshot"]).name for r in records] == [
        None, "emap-000001.tif", None, "emap-000003.tif"
    ]  # fmt: skip
    out = volatool.folder / "out"
    assert sorted(path.name for path in out.iterdir()) == [
        "map.count.tif", "map.distance.tif", "map.flag.tif", "map.sigma.tif", "map.tif"
    ]  # fmt: skip
    dem = read_dem(out / "map.tif")
    assert not check_dem(out / "map.tif")
    np.testing.assert_array_equal(dem.z, read_dem(volatool.folder / "snaps/emap-000003.tif").z)
    flag = read_dem(out / "map.flag.tif").z
    np.testing.assert_array_equal(np.isnan(dem.z), flag == 0)
    assert read_dem(out / "map.count.tif").z.sum() == 8000
    sigma = read_dem(out / "map.sigma.tif").z
    np.testing.assert_array_equal(np.isnan(sigma), flag == 0)
    assert np.nanmean(sigma[flag == 2]) > np.nanmean(sigma[flag == 1]) > 0
    row, col = np.nonzero(flag == 1)
    x = dem.grid.left + (col + 0.5) * dem.grid.cell
    y = dem.grid.top - (row + 0.5) * dem.grid.cell
    assert np.sqrt(np.mean((dem.z[row, col] - height(x, y)) ** 2)) < 0.05


def test_files_with_poses(volatool):
    """Scans in the sensor's frame of each format; the map is that of the scans in the world."""
    folder = volatool.folder
    (folder / "scans").mkdir()
    poses, places = [], []
    for k in range(4):
        place, turn = np.array([0.5 * k, 0.1, 2.0]), 0.3 * k
        rotation = np.array(
            [[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]]
        )
        local = (scan(0.5 * k, seed=k) - place) @ rotation
        name = folder / "scans" / f"{k}.{'npy' if k == 0 else 'pcd'}"
        kind = ("", "ascii", "binary", "binary_compressed")[k]
        name.write_bytes(npy_bytes(local) if k == 0 else pcd_bytes(local, kind, "f8"))
        poses.append(",".join(map(repr, np.column_stack([rotation, place]).ravel().tolist())))
        places.append(place)
    (folder / "poses.csv").write_text("\n".join(poses))
    run = volatool("emap", "scans", "--poses", "poses.csv", "--radius", "8", "--window", "6")
    assert run.returncode == 0, run.stderr
    records = lines(run.stdout)
    assert [r["name"] for r in records] == [f"scans/{k}.{e}" for k, e in
                                            enumerate(("npy", "pcd", "pcd", "pcd"))]  # fmt: skip
    np.testing.assert_allclose([r["pose"] for r in records], places)
    for record in records:
        assert 300 < record["dropped"]["far"] < 500  # a fifth of the returns
        assert record["residual_rmse"] < 0.07
        assert record["window"]["width"] == 24


def test_names_on_stdin_are_taken_as_they_come(live, volatool):
    process = live("-")
    for k in range(2):
        (volatool.folder / f"{k}.pcd").write_bytes(pcd_bytes(scan()))
        process.stdin.write(f"{k}.pcd\n".encode())
        process.stdin.flush()
        assert next_line(process)["name"] == f"{k}.pcd"
    process.stdin.close()
    assert process.wait(60) == 0


def test_a_las_tile_is_a_scan_too(volatool):
    run = volatool("emap", "town.laz", "--cell", "1", "--window", "all", "--no-resources")
    assert run.returncode == 0, run.stderr
    (record,) = lines(run.stdout)
    assert set(record) == RECORD
    assert record["used"] > 1000
    assert record["cells"]["measured"] > 1000


def test_bad_scans_are_counted_and_passed_over(volatool):
    folder = volatool.folder
    (folder / "0.pcd").write_bytes(pcd_bytes(scan()))
    (folder / "1.pcd").write_bytes(pcd_bytes(scan())[:-100])
    (folder / "2.npy").write_bytes(b"what is this")
    (folder / "3.npy").write_bytes(npy_bytes(scan()))
    names = ["0.pcd", "1.pcd", "2.npy", "gone.npy", "3.npy"]
    run = volatool("emap", *names, "--no-resources")
    assert run.returncode == 3
    assert [r["scan"] for r in lines(run.stdout)] == [0, 4]
    codes = [line.split(":")[0] for line in run.stderr.splitlines()]
    assert codes == ["E_TRUNCATED", "E_NOT_SCAN", "E_NOT_FOUND"]
    run = volatool("emap", *names, "--fail-fast")
    assert (run.returncode, len(run.stdout.splitlines())) == (3, 1)
    run = volatool("emap", *names[1:4])
    assert (run.returncode, run.stdout) == (4, "")


def test_a_bad_array_in_the_pipe_is_passed_over_and_a_broken_one_ends_it(volatool):
    good, flat = scan(), np.zeros((5, 2))
    data = npy_bytes(good, flat, good)
    run = volatool("emap", "--format", "npy", text=False, input=data + npy_bytes(good)[:-40])
    assert run.returncode == 3
    assert [r["scan"] for r in lines(run.stdout)] == [0, 2]
    first, second = run.stderr.decode().splitlines()
    assert first.startswith("E_NOT_SCAN: stdin, byte 48128: ")
    assert second.startswith("E_TRUNCATED: stdin: ends at byte ")


def test_scans_without_points_and_with_odd_ones(volatool):
    points = scan()
    points[::2, 2] = np.nan
    data = npy_bytes(np.empty((0, 3)), np.full((4, 3), np.inf), points)
    run = volatool("emap", "--format", "npy", text=False, input=data)
    assert run.returncode == 0, run.stderr
    empty, odd, good = lines(run.stdout)
    assert empty["window"] is odd["window"] is None
    assert odd["dropped"]["invalid"] == 4
    assert (good["used"], good["dropped"]["invalid"]) == (1000, 1000)
    assert good["z_min"] < 0 < good["z_max"]


def test_no_scan_at_all(volatool):
    run = volatool("emap", "--format", "npy", "-o", "map.tif", input="")
    assert (run.returncode, run.stdout) == (0, "")
    assert run.stderr.startswith("W_EMPTY: ")
    assert not (volatool.folder / "map.tif").exists()


def test_sigint_ends_it_with_the_model_written(live, volatool):
    process = live("--format", "npy", "-o", "map.tif")
    give(process, scan())
    next_line(process)
    process.send_signal(signal.SIGINT)
    out, errors = process.communicate(timeout=60)
    assert (process.returncode, out, errors) == (130, b"", b"interrupted\n")
    assert not check_dem(volatool.folder / "map.tif")


def test_sigint_in_the_midst_of_a_scan_waits_for_it(live, volatool):
    """Whenever the signal comes, lines are whole and nothing temporary is left."""
    for delay in (0.0, 0.02, 0.05):
        process = live("--format", "npy", "-o", "map.tif", "--overwrite")
        give(process, scan())
        next_line(process)
        for k in range(8):
            give(process, scan(n=20000, seed=k))
        time.sleep(delay)
        process.send_signal(signal.SIGINT)
        out, errors = process.communicate(timeout=60)
        assert (process.returncode, errors) == (130, b"interrupted\n")
        assert all(set(record) == RECORD | {"resources"} for record in lines(out))
        assert not check_dem(volatool.folder / "map.tif")
        assert not [p for p in volatool.folder.iterdir() if p.name.startswith(".")]


def test_closed_stdout_ends_it(live, volatool):
    process = live("--format", "npy", "-o", "map.tif")
    give(process, scan())
    next_line(process)
    process.stdout.close()
    give(process, scan())
    assert process.wait(60) == 141
    assert process.stderr.read() == b""
    assert not check_dem(volatool.folder / "map.tif")


def test_a_snapshot_file_is_replaced_whole(live, volatool):
    """Each time it is looked at it is a sound file."""
    path = volatool.folder / "now.tif"
    process = live("--format", "npy", "--snapshot", path.name, "--every", "1")
    sizes = []
    for k in range(4):
        give(process, scan(4.0 * k, seed=k))
        assert next_line(process)["snapshot"] == "now.tif"
        assert not check_dem(path)
        sizes.append(read_dem(path).grid.width)
    assert sizes == sorted(sizes)
    assert sizes[-1] > sizes[0]
    process.stdin.close()
    assert process.wait(60) == 0


def test_outputs_that_exist_are_refused_before_any_work(volatool):
    (volatool.folder / "map.flag.tif").touch()
    for option in ("-o", "--snapshot"):
        run = volatool("emap", "none.pcd", option, "map.tif", "--layers", "flag")
        assert run.returncode == 2
        assert run.stderr.startswith("E_OUTPUT_EXISTS: map.flag.tif")


def test_a_map_that_would_not_fit_ends_it_with_what_is_known(volatool):
    spread = np.random.default_rng(0).uniform(-1e5, 1e5, (3000, 3))
    run = volatool(
        "emap", "--format", "npy", "--memory", "20M", "-o", "map.tif",
        text=False, input=npy_bytes(scan(), spread, scan()),
    )  # fmt: skip
    assert run.returncode == 7
    assert run.stderr.startswith(b"E_MEMORY: ")
    assert len(lines(run.stdout)) == 1
    assert not check_dem(volatool.folder / "map.tif")


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["a.pcd", "--format", "npy"],
        ["a.pcd", "--radius", "5"],
        ["a.pcd", "--forget", "0"],
        ["a.pcd", "--cell", "-1"],
        ["a.pcd", "--k-surface", "nan"],
        ["a.pcd", "--crs", "EPSG:4326"],
        ["a.pcd", "-o", "x.tif", "--snapshot", "x.tif"],
        ["a.pcd", "-o", ""],
    ],
)
def test_usage(volatool, arguments):
    run = volatool("emap", *arguments)
    assert run.returncode in (2, 4)
    assert run.stderr.startswith("E_")
    assert run.stdout == ""
    assert len(run.stderr.splitlines()) == 1


def test_the_same_lines_each_time(volatool):
    data = npy_bytes(*(scan(0.2 * k, seed=k) for k in range(3)))
    runs = [
        volatool("emap", "--format", "npy", "--no-resources", text=False, input=data)
        for _ in range(2)
    ]
    assert runs[0].stdout == runs[1].stdout


def test_feet_and_a_crs(volatool):
    """Lengths with a unit are converted; the model has the CRS."""
    data = npy_bytes(scan(n=4000) / 0.3048 + [1e6, 2e5, 0])
    run = volatool(
        "emap", "--format", "npy", "--crs", "EPSG:2225+6360", "--cell", "0.25m", "--window", "10m",
        "-o", "map.tif", text=False, input=data,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr
    (record,) = lines(run.stdout)
    assert record["window"]["width"] == 40
    dem = read_dem(volatool.folder / "map.tif")
    assert "NAVD88" in dem.wkt
    assert dem.unit == "US survey foot"
