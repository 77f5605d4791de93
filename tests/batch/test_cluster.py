"""Work on a real Dask cluster on loopback: a scheduler and workers in processes of their own."""

import contextlib
import json
import shutil
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

from volatool.batch.run import run_inputs
from volatool.errors import VolatoolError
from volatool.options import ConvertOptions

pytest.importorskip("distributed", reason="needs the extra dask")

from volatool.batch.cluster import Cluster

FOREST = Path(__file__).resolve().parents[2] / "data_samples" / "forest.laz"


class Processes:
    """A scheduler and its workers."""

    def __init__(self, folder, *worker_options):
        self.folder, self.running = folder, []
        self.file = folder / "scheduler.json"
        self.worker_options = worker_options
        self._start("scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard")
        while not self.file.exists():
            assert self.running[0].poll() is None
            time.sleep(0.05)

    @property
    def address(self):
        return json.loads(self.file.read_text())["address"]

    def _start(self, what, *options):
        log = (self.folder / f"{what}-{len(self.running)}.log").open("wb")
        command = [sys.executable, "-m", f"distributed.cli.dask_{what}"]
        process = subprocess.Popen(
            [*command, "--scheduler-file", str(self.file), *options], stdout=log, stderr=log
        )
        log.close()
        self.running.append(process)
        return process

    def worker(self):
        options = ("--no-nanny", "--nthreads", "1", "--no-dashboard", *self.worker_options)
        place = ("--local-directory", str(self.folder), "--host", "127.0.0.1")
        return self._start("worker", *options, *place)

    def stop(self):
        for process in reversed(self.running):
            process.terminate()
        for process in self.running:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(10)
            process.kill()
            process.wait()


@pytest.fixture
def cluster(tmp_path):
    folder = tmp_path / "cluster"
    folder.mkdir()
    processes = Processes(folder, "--resources", "tile=1")
    try:
        yield processes
    finally:
        processes.stop()


@pytest.fixture
def tiles(tmp_path):
    folder = tmp_path / "tiles"
    folder.mkdir()
    paths = [folder / f"t{number}.laz" for number in range(6)]
    for path in paths:
        shutil.copy(FOREST, path)
    return paths


OPTIONS = ConvertOptions(dem=False, resources=False)


def converted(tiles, outdir, executor=None):
    results = list(run_inputs(tiles, OPTIONS, kind="convert", outdir=outdir, executor=executor))
    assert sorted(result.index for result in results) == list(range(len(tiles)))
    return results


def contents(folder):
    # names with a dot are what a killed worker was writing: the next run removes them
    return {p.name: p.read_bytes() for p in folder.iterdir() if not p.name.startswith(".")}


@pytest.fixture
def expected(tiles, tmp_path):
    converted(tiles, tmp_path / "one")
    return contents(tmp_path / "one")


def test_a_cluster_gives_the_bytes_of_one_process(cluster, tiles, tmp_path, expected, monkeypatch):
    cluster.worker()
    cluster.worker()
    monkeypatch.chdir(tmp_path)  # names may be relative: the workers are elsewhere
    names = [path.relative_to(tmp_path) for path in tiles]
    results = converted(names, Path("out"), Cluster(cluster.address))
    assert {result.code for result in results} == {None}
    assert {path.parent for result in results for path in result.report.paths} == {Path("out")}
    assert contents(tmp_path / "out") == expected


@pytest.mark.slow
def test_a_failed_tile_fails_alone(cluster, tiles, tmp_path, expected):
    tiles[2].write_bytes(b"no points")
    cluster.worker()
    results = converted(tiles, tmp_path / "out", Cluster(cluster.address))
    codes = {result.index: result.code for result in results}
    assert codes == {0: None, 1: None, 2: "E_NOT_LAS", 3: None, 4: None, 5: None}
    assert contents(tmp_path / "out") == {
        name: content for name, content in expected.items() if not name.startswith("t2.")
    }


def test_tiles_of_a_killed_worker_are_done_by_another(cluster, tiles, tmp_path, expected):
    workers = [cluster.worker(), cluster.worker()]
    results = run_inputs(
        tiles, OPTIONS, kind="convert", outdir=tmp_path / "out", executor=Cluster(cluster.address)
    )
    first = next(results)
    workers[0].send_signal(signal.SIGKILL)
    indices = [first.index, *(result.index for result in results)]
    assert sorted(indices) == list(range(len(tiles)))
    assert contents(tmp_path / "out") == expected


def test_a_run_that_is_stopped_leaves_no_worker_writing(cluster, tiles, tmp_path, expected):
    cluster.worker()
    out = tmp_path / "out"
    more = [tiles[0].with_name(f"t{number}.laz") for number in range(len(tiles), 40)]
    for path in more:  # so many that the worker is not done, however late the stop comes
        shutil.copy(FOREST, path)
    results = run_inputs(
        tiles + more, OPTIONS, kind="convert", outdir=out, executor=Cluster(cluster.address)
    )
    next(results)
    results.close()
    before = contents(out)
    time.sleep(1.0)
    assert contents(out) == before
    assert all(before[name] == expected[name] for name in before.keys() & expected.keys())
    assert len(before) < len(expected) / len(tiles) * len(tiles + more)


@pytest.mark.slow
def test_a_scheduler_that_dies_ends_the_run_with_a_word(cluster, tiles, tmp_path):
    cluster.worker()
    results = run_inputs(
        tiles, OPTIONS, kind="convert", outdir=tmp_path / "out", executor=Cluster(cluster.address)
    )
    next(results)
    cluster.running[0].send_signal(signal.SIGKILL)
    with pytest.raises(VolatoolError, match="--resume") as caught:
        list(results)
    assert caught.value.code == "E_CLUSTER"


def test_a_local_cluster_needs_no_scheduler_and_no_certain_port(tiles, tmp_path, expected):
    with socket.socket() as taken:
        with contextlib.suppress(OSError):  # then another test has it
            taken.bind(("127.0.0.1", 8787))
            taken.listen()
        converted(tiles, tmp_path / "out", Cluster("local", jobs=2))
    assert contents(tmp_path / "out") == expected


@pytest.mark.slow
def test_no_scheduler_and_other_versions_are_told(cluster, tiles, tmp_path, monkeypatch):
    monkeypatch.setattr("volatool.batch.cluster._CONNECT_S", 1.0)
    with pytest.raises(VolatoolError, match="no Dask scheduler answers") as caught:
        converted(tiles, tmp_path / "out", Cluster("tcp://127.0.0.1:9"))
    assert caught.value.code == "E_CLUSTER"
    monkeypatch.setattr("volatool.batch.cluster._CONNECT_S", 20.0)
    monkeypatch.setattr("volatool.batch.cluster.__version__", "0.0.0")
    cluster.worker()
    distributed = pytest.importorskip("distributed")
    with distributed.Client(cluster.address, set_as_default=False) as client:
        client.wait_for_workers(1, timeout=60)
    with pytest.raises(VolatoolError, match="install the same on all") as caught:
        converted(tiles, tmp_path / "out", Cluster(cluster.address))
    assert caught.value.code == "E_CLUSTER"
    assert not (tmp_path / "out").exists()
