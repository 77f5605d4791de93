"""Workers: each unit once, killed workers, stopping, news and log from inside."""

import logging
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import making_work
import pytest

from volatool.batch.executor import Watcher
from volatool.batch.pool import Pool
from volatool.batch.work import Unit
from volatool.errors import VolatoolError
from volatool.options import ConvertOptions

OPTIONS = ConvertOptions()


def units_of(names, outdir=None):
    kind = "stats" if outdir is None else "convert"
    return [Unit(k, Path(name), OPTIONS, kind, outdir) for k, name in enumerate(names)]


def run(pool, names, watcher=None):
    return [result for _, result in pool.results(units_of(names), watcher or Watcher())]


def is_alive(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return "Z" not in Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]


def wait_until(condition, seconds=20):
    end = time.monotonic() + seconds
    while not condition() and time.monotonic() < end:
        time.sleep(0.01)
    assert condition()


def test_each_unit_is_done_once_by_all_the_workers_there_are():
    results = run(Pool(2, work=making_work.say_pid), ["a"] * 40)
    assert sorted(result.index for result in results) == list(range(40))
    pids = {result.report.input["pid"] for result in results}
    assert len(pids) == 2
    assert os.getpid() not in pids
    assert not any(is_alive(pid) for pid in pids)


def test_a_killed_worker_costs_no_tile_and_a_tile_that_kills_two_is_given_up(caplog):
    names = ["a", "once", "b", "twice", "c", "once more", "d"]
    results = {result.index: result for result in run(Pool(2, work=making_work.die_of_some), names)}
    assert sorted(results) == list(range(7))
    assert {k: r.code for k, r in results.items() if r.code} == {3: "E_WORKER"}
    assert "was killed (SIGKILL), 2 times" in results[3].report.error["message"]
    assert [results[k].attempts for k in range(7)] == [1, 2, 1, 2, 1, 2, 1]
    assert len([r for r in caplog.records if "tried once more" in r.getMessage()]) == 3


def test_units_are_taken_as_they_are_needed_and_no_more_workers_than_units_start():
    taken = []

    def units():
        for unit in units_of(["a"] * 9):
            taken.append(unit)
            yield unit

    started = []
    watcher = Watcher()
    watcher.started = started.append
    results = Pool(3, work=making_work.quick).results(units(), watcher)
    for n_yielded, _ in enumerate(results, 1):
        assert len(taken) <= n_yielded + 3
    assert len(started) == 9
    assert len(run(Pool(50, work=making_work.quick), ["a", "b"])) == 2


def test_closing_stops_the_workers_and_nothing_half_written_is_left(tmp_path):
    pids = {}

    class Closing(Watcher):
        def advanced(self, unit, done, total):
            pids[unit.index] = done
            if len(pids) == 2:
                assert len(list(tmp_path.iterdir())) == 2
                raise KeyboardInterrupt

    results = Pool(2, work=making_work.write_for_ever).results(
        units_of(["a", "b", "c"], tmp_path), Closing()
    )
    with pytest.raises(KeyboardInterrupt):
        next(results)
    assert not any(is_alive(pid) for pid in pids.values())
    assert list(tmp_path.iterdir()) == []


def test_what_a_killed_worker_had_begun_to_write_is_removed(tmp_path):
    pids = []

    class Killing(Watcher):
        def advanced(self, unit, done, total):
            pids.append(done)
            os.kill(done, signal.SIGKILL)

    ((unit, result),) = Pool(1, work=making_work.write_for_ever).results(
        units_of(["a"], tmp_path), Killing()
    )
    assert (unit.attempt, unit.overwrite, result.code) == (2, True, "E_WORKER")
    assert len(set(pids)) == 2
    assert list(tmp_path.iterdir()) == []


def test_progress_and_log_come_from_the_workers(caplog):
    told = []
    watcher = Watcher()
    watcher.advanced = lambda unit, done, total: told.append((unit.index, done, total))
    run(Pool(1, work=making_work.quick), ["a"], watcher)
    assert told == [(0, 1, 2), (0, 2, 2)]
    logger = logging.getLogger("volatool")
    logger.addHandler(caplog.handler)
    try:
        run(Pool(1, work=making_work.log), ["a.laz"])
    finally:
        logger.removeHandler(caplog.handler)
    assert "a line of a.laz\nTraceback" in caplog.text
    assert "VolatoolError: told" in caplog.text


def test_workers_that_cannot_start_end_the_run(monkeypatch):
    monkeypatch.setattr(sys, "executable", "/bin/false")
    with pytest.raises(VolatoolError, match="can't be started: the last one ended with status 1"):
        run(Pool(2, work=making_work.quick), ["a", "b"])
    monkeypatch.setattr(sys, "executable", "/nowhere")
    with pytest.raises(VolatoolError, match="can't be started"):
        run(Pool(2, work=making_work.quick), ["a", "b"])


def test_a_worker_that_ends_by_itself_is_a_lost_one():
    (result,) = run(Pool(1, work=making_work.exit_at_once), ["a"])
    assert "ended with status 3, 2 times" in result.report.error["message"]


def test_workers_do_not_outlive_a_killed_parent_and_leave_nothing_half_written(tmp_path):
    code = (
        "import sys, making_work\n"
        "from pathlib import Path\n"
        "from volatool.batch.executor import Watcher\n"
        "from volatool.batch.pool import Pool\n"
        "from volatool.batch.work import Unit\n"
        "from volatool.options import ConvertOptions\n"
        "watcher = Watcher()\n"
        "watcher.advanced = lambda unit, done, total: print(done, flush=True)\n"
        "out, options = Path(sys.argv[1]), ConvertOptions()\n"
        "units = [Unit(k, Path(f'{k}'), options, 'dem', out) for k in (0, 1)]\n"
        "list(Pool(2, work=making_work.write_for_ever).results(units, watcher))\n"
    )  # not a main module with a guard: workers don't run it
    with subprocess.Popen(
        [sys.executable, "-c", code, str(tmp_path)],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    ) as parent:
        pids = [int(parent.stdout.readline()) for _ in range(2)]
        assert all(map(is_alive, pids))
        assert len(list(tmp_path.iterdir())) == 2
        parent.kill()
    wait_until(lambda: not any(map(is_alive, pids)))
    assert list(tmp_path.iterdir()) == []
