"""The order of inputs, of work and of results."""

import platform
import re
import subprocess

import making_work
import pytest

from volatool.batch.executor import Serial, Watcher
from volatool.batch.pool import Pool
from volatool.batch.run import in_order, run_inputs
from volatool.batch.work import Result
from volatool.errors import VolatoolError
from volatool.options import ConvertOptions
from volatool.report import Report


class Order(Watcher):
    """Keeps the order in which work begins, and what was planned."""

    def __init__(self):
        self.begun, self.ends = [], 0

    def planned(self, sizes, n_done):
        self.sizes = list(sizes)

    def started(self, unit):
        self.begun.append(unit.path.stem)

    def ended(self):
        self.ends += 1


@pytest.fixture
def paths(tmp_path):
    for name, size in (("a", 10), ("b", 30), ("c", 20)):
        (tmp_path / f"{name}.laz").write_bytes(bytes(size))
    return [tmp_path / f"{name}.laz" for name in "abc"] + [tmp_path / "gone.laz"]


@pytest.mark.parametrize(
    ("kind", "executor", "order"),
    [
        ("convert", Serial(making_work.quick), ["a", "b", "c", "gone"]),
        ("convert", Pool(1, work=making_work.quick), ["b", "c", "a", "gone"]),
        ("stats", Pool(1, work=making_work.quick), ["a", "b", "c", "gone"]),
    ],
)
def test_the_largest_come_first_where_the_order_is_free(paths, tmp_path, kind, executor, order):
    watcher = Order()
    out = tmp_path / "out"
    results = list(
        run_inputs(
            paths, ConvertOptions(), kind=kind, outdir=out, executor=executor, watcher=watcher
        )
    )
    assert watcher.begun == order
    assert watcher.sizes == [10, 30, 20, 1]
    assert watcher.ends == 1
    assert sorted(result.index for result in results) == [0, 1, 2, 3]


def test_what_a_process_was_writing_that_ends_during_the_run_is_removed(paths, tmp_path):
    with subprocess.Popen(["sleep", "60"]) as process:
        host = re.sub("[^A-Za-z0-9_]", "_", platform.node())[:24]
        left = tmp_path / f".old.vol.gz.0.volatool-{host}-{process.pid}.tmp.gz"
        left.touch()
        results = run_inputs(
            paths,
            ConvertOptions(),
            kind="convert",
            outdir=tmp_path,
            executor=Serial(making_work.quick),
        )
        next(results)
        assert left.exists()  # it may still be written
        process.kill()
    list(results)
    assert not left.exists()


def test_an_executor_that_fails_ends_the_run_for_its_watcher_too(paths, tmp_path):
    class Failing:
        in_order = True

        def results(self, units, watcher):
            raise VolatoolError("no cluster")
            yield

    watcher = Order()
    run = run_inputs(paths, ConvertOptions(), kind="stats", executor=Failing(), watcher=watcher)
    with pytest.raises(VolatoolError, match="no cluster"):
        next(run)
    assert watcher.ends == 1


def test_results_are_put_in_order_as_soon_as_they_can_be():
    results = [Result(index, Report(status="ok", input=None)) for index in (2, 0, 1, 5, 4)]
    taken = []

    def run():
        for result in results:
            taken.append(result.index)
            yield result

    ordered = in_order(run())
    assert next(ordered).index == 0
    assert taken == [2, 0]
    assert [result.index for result in ordered] == [1, 2, 4, 5]  # 3 never came
