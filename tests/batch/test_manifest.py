"""The manifest as a file: appended to, locked, repaired; and not mistaken for another file."""

import json
import resource
from pathlib import Path

import pytest

from volatool.batch.manifest import Manifest, read_records, record_of
from volatool.batch.work import Output, Result, Unit
from volatool.errors import OptionError, OutputError
from volatool.options import ConvertOptions
from volatool.report import Report


def record(name="a.laz", **more):
    unit = Unit(0, Path(name), ConvertOptions(), "convert")
    report = Report(status="ok", input={"name": name})
    outputs = (Output(Path("out/a.vol.gz"), 3, "abc"),)
    return record_of(unit, Result(0, report, {"size": 5, "mtime_ns": 7}, outputs, 1.23456), "dig")


def test_a_record_says_what_was_done(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    made = record()
    assert made.pop("finished").endswith("+00:00")
    assert made == {
        "schema": "volatool.manifest/1",
        "version": "0.1.0",
        "kind": "convert",
        "options": "dig",
        "input": {"path": str(tmp_path / "a.laz"), "size": 5, "mtime_ns": 7},
        "status": "ok",
        "code": None,
        "message": None,
        "outputs": [{"path": str(tmp_path / "out" / "a.vol.gz"), "size": 3, "sha256": "abc"}],
        "attempts": 1,
        "seconds": 1.235,
    }


def test_records_are_appended_by_run_after_run(tmp_path):
    path = tmp_path / "new" / "run.jsonl"
    for name in ("a", "b"):
        with Manifest(path) as manifest:
            manifest.append(record(name))
    assert [Path(each["input"]["path"]).name for each in read_records(path)] == ["a", "b"]
    assert list(read_records(tmp_path / "none.jsonl")) == []


@pytest.mark.parametrize("n_whole", [0, 1, 500])
def test_a_line_torn_at_any_byte_is_cut_off(tmp_path, n_whole):
    path = tmp_path / "run.jsonl"
    line = json.dumps(record(), sort_keys=True).encode() + b"\n"
    cuts = range(len(line)) if n_whole < 2 else (1, len(line) // 2, len(line) - 1)
    for cut in cuts:
        path.write_bytes(n_whole * line + line[:cut])
        assert len(list(read_records(path))) in (n_whole, n_whole + (cut == len(line) - 1))
        with Manifest(path) as manifest:
            assert path.read_bytes() == n_whole * line
            manifest.append(record())
        assert len(list(read_records(path))) == n_whole + 1


def test_damaged_lines_prove_nothing_and_harm_no_others(tmp_path):
    path = tmp_path / "run.jsonl"
    with Manifest(path) as manifest:
        manifest.append(record("a"))
    with path.open("ab") as file:
        file.write(b'\0\0\0\n{"half": \n[]\n{"schema": "another/1"}\n\xff\n')
    with Manifest(path) as manifest:
        manifest.append(record("b"))
    assert [Path(each["input"]["path"]).name for each in read_records(path)] == ["a", "b"]


@pytest.mark.parametrize("content", [b"LASF and more", b"x", b'{"attempt": 3}\n', b"\n"])
def test_another_file_is_refused_and_left_as_it_is(tmp_path, content):
    path = tmp_path / "tile.laz"
    path.write_bytes(content)
    with pytest.raises(OptionError, match="is not a manifest") as caught:
        Manifest(path)
    assert caught.value.code == "E_MANIFEST"
    assert path.read_bytes() == content


def test_two_runs_at_once_cannot_write_one_manifest(tmp_path):
    path = tmp_path / "run.jsonl"
    with Manifest(path), pytest.raises(OptionError, match="another run is writing"):
        Manifest(path)
    Manifest(path).__exit__(None, None, None)


def test_a_manifest_that_cannot_be_written_is_an_output_error(tmp_path):
    with pytest.raises(OutputError), Manifest(Path("/proc/nowhere/run.jsonl")):
        pass
    path = tmp_path / "run.jsonl"
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    with Manifest(path) as manifest:
        manifest.append(record("a"))
        resource.setrlimit(resource.RLIMIT_FSIZE, (path.stat().st_size + 100, limits[1]))
        try:
            with pytest.raises(OutputError, match="can't be written"):
                manifest.append(record("b"))
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        manifest.append(record("c"))
    assert [Path(each["input"]["path"]).name for each in read_records(path)] == ["a", "c"]
