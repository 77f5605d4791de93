"""What a manifest proves, and what a resumed run does and leaves."""

import json
import os
from dataclasses import replace
from pathlib import Path

import making_work
import pytest

from volatool.batch import resume
from volatool.batch.executor import Serial
from volatool.batch.manifest import Manifest, read_records
from volatool.batch.resume import options_digest
from volatool.batch.run import run_inputs
from volatool.errors import OutputExistsError
from volatool.options import ConvertOptions
from volatool.units import Length

BASE = ConvertOptions()


class Batch:
    """A folder of inputs and their run."""

    def __init__(self, folder, names="abcd"):
        self.folder, self.out, self.manifest = folder, folder / "out", folder / "run.jsonl"
        self.paths = [folder / f"{name}.laz" for name in names]
        for path in self.paths:
            path.write_text(f"points of {path.name}")

    def run(self, *, options=BASE, outdir=None, paths=None, **more):
        """Return the names of the inputs that were worked on."""
        paths = self.paths if paths is None else paths
        with Manifest(self.manifest) as manifest:
            results = run_inputs(
                paths,
                options,
                kind=more.pop("kind", "convert"),
                outdir=outdir or self.out,
                executor=Serial(making_work.copy),
                manifest=manifest,
                **{"resume": True, **more},
            )
            return "".join(paths[result.index].stem[0] for result in results)


@pytest.fixture
def batch(tmp_path):
    made = Batch(tmp_path)
    assert made.run() == "abcd"
    return made


def test_what_is_proven_is_not_done_again(batch):
    assert batch.run() == ""
    assert len(list(read_records(batch.manifest))) == 4


def test_without_resume_outputs_that_exist_are_refused(batch):
    with pytest.raises(OutputExistsError):
        batch.run(resume=False)
    assert batch.run(resume=False, overwrite=True) == "abcd"


@pytest.mark.parametrize("what", ["content", "time", "gone output", "short output", "no record"])
def test_what_is_not_proven_is_done_again_and_only_that(batch, what):
    output = batch.out / "b.stats.json"
    if what == "content":
        batch.paths[1].write_text("other points of b")
    elif what == "time":
        os.utime(batch.paths[1], ns=(0, 0))
    elif what == "gone output":
        output.unlink()
    elif what == "short output":
        os.truncate(output, 3)
    else:  # killed between the outputs' names and the record
        lines = batch.manifest.read_text().splitlines(keepends=True)
        batch.manifest.write_text("".join(line for line in lines if "/b.laz" not in line))
    assert batch.run() == "b"
    assert output.read_text() == batch.paths[1].read_text()
    assert batch.run() == ""


def test_a_changed_output_of_the_same_size_is_found_by_verify(batch):
    output = batch.out / "c.stats.json"
    output.write_text(output.read_text().upper())
    assert batch.run() == ""
    assert batch.run(verify=True) == "c"
    assert batch.run(verify=True) == ""
    assert output.read_text() == "points of c.laz"


def test_other_options_kind_folder_or_version_prove_nothing(batch, monkeypatch):
    assert batch.run(options=replace(BASE, max_depth=5)) == "abcd"
    assert batch.run(options=replace(BASE, resources=False)) == "abcd"
    assert batch.run(outdir=batch.folder / "other") == "abcd"
    assert batch.run(outdir=batch.folder / "other", kind="import") == "abcd"
    assert batch.run(outdir=batch.folder / "other") == "abcd"  # the last record has other options
    monkeypatch.setattr(resume, "__version__", "9")
    assert batch.run(outdir=batch.folder / "other") == "abcd"


def test_options_that_change_no_result_keep_the_proof(batch):
    assert batch.run(options=replace(BASE, memory=1 << 29, chunk_points=1000)) == ""


def test_the_folder_the_run_is_started_in_does_not_matter(batch, monkeypatch):
    monkeypatch.chdir(batch.folder)
    paths = [Path(path.name) for path in batch.paths]
    assert batch.run(paths=paths, outdir=Path("out")) == ""
    monkeypatch.chdir(batch.out)
    assert batch.run(paths=[Path("..") / path for path in paths], outdir=Path()) == ""


def test_files_that_options_name_count_with_their_content(tmp_path):
    dataset, tile = tmp_path / "set.json", tmp_path / "n.laz"
    dataset.write_text("1")
    tile.write_text("1")
    options = replace(BASE, depth_from=str(dataset))
    first = options_digest(options, "convert")
    os.utime(dataset, ns=(0, 0))
    assert options_digest(options, "convert") == first
    dataset.write_text("2")
    assert options_digest(options, "convert") != first
    options = replace(BASE, neighbours=(str(tmp_path),), cell=Length.parse("1m"))
    first = options_digest(options, "dem")
    os.utime(tile, ns=(0, 0))
    assert options_digest(options, "dem") != first


def test_failed_inputs_are_listed_for_the_next_run_and_done_again(tmp_path):
    batch = Batch(tmp_path, ["a", "bad", "c", "bad two"])
    listed = tmp_path / "failed.txt"
    assert batch.run() == "abcb"
    assert listed.read_text().splitlines() == [str(batch.paths[1]), str(batch.paths[3])]
    assert batch.run() == "bb"
    records = [each for each in read_records(batch.manifest) if "bad.laz" in each["input"]["path"]]
    assert [each["status"] for each in records] == ["failed", "failed"]
    assert records[0]["code"] == "E_CORRUPT"
    assert batch.run(paths=batch.paths[::2]) == ""
    assert not listed.exists()


def test_fail_fast_stops_at_the_first_and_resume_goes_on(tmp_path):
    batch = Batch(tmp_path, ["a", "bad", "c", "d"])
    assert batch.run(fail_fast=True) == "ab"
    batch.paths[1] = batch.paths[1].rename(tmp_path / "good.laz")
    assert batch.run() == "gcd"


def test_records_that_lack_something_prove_nothing(batch):
    lines = batch.manifest.read_text().splitlines()
    for key in ("input", "outputs", "status", "version"):
        broken = [json.loads(line) for line in lines]
        del broken[2][key]
        batch.manifest.write_text("".join(json.dumps(r, sort_keys=True) + "\n" for r in broken))
        assert batch.run() == "c"


def test_leftovers_of_killed_runs_go_even_when_nothing_is_left_to_do(batch):
    import platform
    import re

    host = re.sub("[^A-Za-z0-9_]", "_", platform.node())[:24]
    leftover = batch.out / f".a.vol.gz.0.volatool-{host}-99999999999.tmp.gz"
    leftover.touch()
    assert batch.run() == ""
    assert not leftover.exists()
