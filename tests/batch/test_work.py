"""A unit of work and its result: what is in them, and that they go from process to process."""

import hashlib
import pickle
from pathlib import Path

import pytest

from volatool import tile
from volatool.batch.work import Unit, lost, perform
from volatool.model import Bounds
from volatool.options import ConvertOptions
from volatool.remote.path import path_of
from volatool.units import Length

FOREST = Path(__file__).resolve().parents[2] / "data_samples" / "forest.laz"


def unit_of(path, outdir, **more):
    options = ConvertOptions(dem=False, resources=False, meta=())
    return Unit(7, path, options, "convert", outdir, **more)


def test_a_result_has_the_report_the_outputs_and_their_digests(tmp_path):
    result = perform(unit_of(FOREST, tmp_path, with_digests=True))
    assert (result.index, result.code, result.attempts) == (7, None, 1)
    assert result.report.status == "ok"
    assert {output.path for output in result.outputs} == set(tmp_path.iterdir())
    for output in result.outputs:
        content = output.path.read_bytes()
        assert (output.size, output.sha256) == (len(content), hashlib.sha256(content).hexdigest())
    found = FOREST.stat()
    assert result.identity == {"size": found.st_size, "mtime_ns": found.st_mtime_ns}
    assert result.seconds > 0


def test_without_digests_outputs_are_not_read_again(tmp_path):
    assert {output.sha256 for output in perform(unit_of(FOREST, tmp_path)).outputs} == {None}


def test_units_and_results_survive_pickling(tmp_path):
    options = ConvertOptions(
        cell=Length.parse("1m"), bounds=Bounds(0, 0, 1, 1), cube=Length.parse("100ft"), classes=(2,)
    )
    unit = Unit(1, FOREST, options, "convert", tmp_path)
    assert pickle.loads(pickle.dumps(unit)) == unit
    path, outdir = path_of("https://me:secret@host/a/t%201.laz?sign=x"), path_of("s3://bucket/out")
    unit = pickle.loads(pickle.dumps(Unit(1, path, options, "convert", outdir)))
    assert (unit.path, unit.path.url, unit.path.name) == (path, path.url, "t 1.laz")
    assert unit.outdir == outdir
    result = perform(unit_of(FOREST, tmp_path))
    again = pickle.loads(pickle.dumps(result))
    assert again == result
    assert again.report.to_json() == result.report.to_json()


def test_an_input_that_cannot_be_used_is_a_failed_result(tmp_path):
    result = perform(unit_of(tmp_path / "gone.laz", tmp_path))
    assert (result.code, result.report.status, result.identity) == ("E_NOT_FOUND", "failed", None)
    assert pickle.loads(pickle.dumps(result)) == result


@pytest.mark.parametrize(
    ("error", "code"), [(ZeroDivisionError("x"), "E_INTERNAL"), (MemoryError(), "E_MEMORY")]
)
def test_a_bug_or_full_memory_is_a_failed_result_too(monkeypatch, tmp_path, error, code):
    def fail(*arguments, **more):
        raise error

    monkeypatch.setattr(tile, "convert_tile", fail)
    result = perform(unit_of(FOREST, tmp_path))
    assert result.code == code
    assert str(FOREST) in result.report.error["message"]


def test_a_unit_whose_worker_was_lost_may_replace_what_that_one_left(tmp_path):
    unit = unit_of(FOREST, tmp_path)
    perform(unit)
    assert perform(unit).code == "E_OUTPUT_EXISTS"
    again = perform(unit.again())
    assert (again.code, again.attempts) == (None, 2)


def test_a_unit_lost_for_good_is_failed(tmp_path):
    result = lost(unit_of(FOREST, tmp_path).again(), "was killed")
    assert (result.code, result.attempts, result.report.status) == ("E_WORKER", 2, "failed")
    assert "was killed, 2 times" in result.report.error["message"]
