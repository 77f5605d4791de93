"""Several processes, the manifest and resuming, as a user types them; every status for real."""

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from making_tiles import hills, write_las

QUICK = ["--no-dem", "--meta", "none", "--no-resources"]


@pytest.fixture
def tiles(volatool):
    """Six small tiles; the third is the largest."""
    folder = volatool.folder / "tiles"
    folder.mkdir()
    for k in range(6):
        write_las(folder / f"t{k}.las", hills(4000 if k == 2 else 1000, seed=k))
    return folder


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def events(done):
    return [json.loads(line) for line in done.stderr.splitlines() if line.startswith("{")]


def test_two_processes_write_the_bytes_of_one(volatool, tiles):
    one = volatool("convert", "tiles", "forest.laz", "-o", "one", "--no-resources", "--json")
    two = volatool("convert", "tiles", "forest.laz", "-o", "two", "--no-resources", "--json", "-j2")
    assert (one.returncode, two.returncode) == (0, 0), two.stderr
    assert contents(volatool.folder / "one") == contents(volatool.folder / "two")
    assert len(contents(volatool.folder / "one")) == 7 * 4
    reports = one.stdout.splitlines(), two.stdout.splitlines()
    assert sorted(reports[0]) == sorted(reports[1])
    assert [json.loads(line)["input"]["name"] for line in reports[0]] == [
        *(f"t{k}.las" for k in range(6)), "forest.laz",
    ]  # fmt: skip
    assert sorted(one.stderr.splitlines()) == sorted(two.stderr.splitlines())


def test_stats_are_in_the_order_of_the_inputs_whatever_the_jobs(volatool, tiles):
    words = ["stats", "forest.laz", "gone.las", "tiles", "--no-resources", "--format", "jsonl"]
    one, two = volatool(*words), volatool(*words, "--jobs", "2")
    assert (one.returncode, two.returncode) == (3, 3)
    assert one.stdout == two.stdout  # though the first input takes longest
    assert one.stderr == two.stderr


def test_progress_tells_of_tiles_and_points_and_ends_with_the_count(volatool, tiles):
    done = volatool("convert", "tiles", "gone.las", "-o", "out", *QUICK, "--progress=json", "-j2")
    assert done.returncode == 3
    told = events(done)
    last = told[-1]
    assert last.pop("seconds_left") == 0
    assert last == {"event": "tiles", "done": 7, "failed": 1, "skipped": 0, "total": 7}
    assert sum(event["event"] == "done" for event in told) == 6
    assert {"event": "failed", "name": "gone.las"} in told
    for name in (f"t{k}.las" for k in range(6)):
        points = [e["done"] / e["total"] for e in told if e.get("name") == name and "total" in e]
        assert points == sorted(points)
        assert points[-1] == 1


def test_statuses_0_3_4_and_the_list_of_failures(volatool, tiles):
    words = ["-o", "out", *QUICK, "-j", "2", "--manifest", "log/run.jsonl", "--resume"]
    failed = volatool.folder / "log" / "failed.txt"
    for name in ("x.las", "y.las"):
        (volatool.folder / name).write_bytes(b"not points")
    done = volatool("convert", "x.las", "y.las", *words)
    assert (done.returncode, done.stdout) == (4, "")
    assert done.stderr.count("E_NOT_LAS") == 2
    done = volatool("convert", "x.las", "y.las", "tiles", *words)
    assert done.returncode == 3
    assert len(done.stdout.split()) == 6 * 3
    assert sorted(failed.read_text().split()) == [
        str(volatool.folder / name) for name in ("x.las", "y.las")
    ]
    for name in ("x.las", "y.las"):
        write_las(volatool.folder / name, hills(500))
    done = volatool("convert", "@log/failed.txt", *words)
    assert done.returncode == 0
    assert not failed.exists()
    done = volatool("convert", "x.las", "y.las", "tiles", *words)
    assert (done.returncode, done.stdout) == (0, "")
    assert "8 of 8 inputs are done already" in done.stderr


def test_fail_fast_stops_the_others(volatool, tiles):
    (volatool.folder / "huge.las").write_bytes(b"not points" * 100_000)  # the first to be tried
    for number in range(100):  # more than one worker does while the other starts
        shutil.copy(tiles / "t0.las", tiles / f"more{number}.las")
    done = volatool("convert", "tiles", "huge.las", "-o", "out", *QUICK, "-j", "2", "--fail-fast")
    assert done.returncode in (3, 4)
    out = volatool.folder / "out"
    assert not out.exists() or len(contents(out)) < 106 * 3


@contextlib.contextmanager
def running(volatool, *words):
    command = [sys.executable, "-m", "volatool_cli", *words]
    with subprocess.Popen(
        command,
        cwd=volatool.folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as process:
        yield process


def group_members(group):
    found = []
    for status in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            fields = status.read_text().rpartition(")")[2].split()
            if int(fields[2]) == group and fields[0] != "Z":
                found.append(status.parent.name)
    return found


def test_ctrl_c_is_status_130_stops_the_workers_and_leaves_nothing_half_written(volatool, tiles):
    out = volatool.folder / "out"
    words = ["convert", "tiles", "-o", "out", *QUICK, "--chunk-points", "1", "--progress", "json"]
    with running(volatool, *words, "-j", "2", "--manifest", "run.jsonl") as process:
        process.stderr.readline()  # points are being read
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does
        _, stderr = process.communicate(timeout=60)
        assert process.returncode == 130
    assert "Traceback" not in stderr
    assert "interrupted" in stderr
    assert group_members(process.pid) == []
    assert [name for name in contents(out) if name.startswith(".")] == [] if out.exists() else True
    done = volatool("convert", "tiles", "-o", "out", *QUICK, "--manifest=run.jsonl", "--resume")
    assert done.returncode == 0, done.stderr
    assert len(contents(out)) == 6 * 3


def test_a_closed_stdout_is_status_141_and_stops_the_workers(volatool, tiles):
    with running(volatool, "convert", "tiles", "-o", "out", *QUICK, "-j", "2") as process:
        process.stdout.close()
        stderr = process.stderr.read()
        assert process.wait(60) == 141
    assert "Traceback" not in stderr
    assert group_members(process.pid) == []


def test_a_worker_killed_from_outside_costs_nothing(volatool, tiles):
    from kill_test import workers_of

    words = ["convert", "tiles", "-o", "out", *QUICK, "--chunk-points", "1", "--progress", "json"]
    with running(volatool, *words, "-j", "2") as process:
        process.stderr.readline()
        os.kill(workers_of(process.pid)[0], signal.SIGKILL)
        stdout, stderr = process.communicate(timeout=100)
        assert process.returncode == 0
    assert "was killed (SIGKILL); it is tried once more" in stderr
    assert len(stdout.split()) == 6 * 3
    assert sorted(contents(volatool.folder / "out")) == sorted(Path(x).name for x in stdout.split())


@pytest.mark.parametrize(
    ("words", "status", "message"),
    [
        (["--resume"], 2, "--resume needs the --manifest"),
        (["--manifest", "run.jsonl", "--verify"], 2, "--verify is for --resume"),
        (["--manifest", "forest.laz"], 2, "is not a manifest"),
        (["-j", "0"], 2, "is not auto or a number"),
        (["-j", "4", "--memory", "512M"], 7, "raise it to 1.0 GiB, or lower --jobs"),
    ],
)
def test_options_that_do_not_fit_are_told_before_any_work(volatool, tiles, words, status, message):
    done = volatool("convert", "tiles", "-o", "out", *words)
    assert done.returncode == status
    assert message in done.stderr
    assert not (volatool.folder / "out").exists()
    assert (volatool.folder / "forest.laz").stat().st_size > 0


def test_auto_takes_what_cores_and_memory_allow_and_one_tile_needs_no_worker(volatool, tiles):
    words = ["-o", "out", *QUICK, "--overwrite", "--progress", "none", "-v"]
    done = volatool("convert", "tiles", *words, "-j", "auto", "--memory", "300M")
    assert done.returncode == 0, done.stderr
    if len(os.sched_getaffinity(0)) > 1:
        assert "1 of " in done.stderr
    done = volatool("convert", "tiles/t0.las", *words, "-j", "8")  # 8 shares would be too small
    assert done.returncode == 0, done.stderr


def test_a_dry_run_of_a_resumed_batch_names_what_is_left(volatool, tiles):
    words = ["-o", "out", *QUICK, "--manifest", "run.jsonl"]
    assert volatool("convert", "tiles/t1.las", *words).returncode == 0
    done = volatool("convert", "tiles/t1.las", "tiles/t3.las", *words, "--resume", "--dry-run")
    assert done.returncode == 0
    assert {Path(line).name.split(".")[0] for line in done.stdout.split()} == {"t3"}


def test_a_log_gets_the_workers_traces(volatool, tiles):
    (volatool.folder / "bad.las").write_bytes(b"LASF" + b"\0" * 500)
    done = volatool("convert", "bad.las", "tiles", "-o", "out", *QUICK, "-j2", "--log", "run.log")
    assert done.returncode == 3
    log = (volatool.folder / "run.log").read_text()
    assert "Traceback" in log
    assert "t4.las: 1000 points read" in log
    assert "Traceback" not in done.stderr
