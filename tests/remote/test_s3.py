"""Object storage: a real S3 server as input and as output."""

from __future__ import annotations

import hashlib
import json
import shutil

import pytest
from making_tiles import hills, write_las

import volatool as vt
from volatool.batch.plan import expand
from volatool.errors import InputError, InputNotFoundError, OutputError, OutputExistsError
from volatool.options import ConvertOptions
from volatool.remote import store, uploads
from volatool.remote.path import path_of

QUICK = {"dem": False, "resources": False, "depth": 2}


@pytest.fixture
def tile(tmp_path):
    return write_las(tmp_path / "tile.las", hills(5000))


def digests_of(paths):
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in paths}


def test_a_tile_in_a_bucket_gives_the_bytes_of_a_local_one(s3, tile, tmp_path):
    s3.put_file(str(tile), "tiles/in/tile.las")
    local = vt.convert(tile, tmp_path / "local", resources=False)
    remote = vt.convert("s3://tiles/in/tile.las", "s3://tiles/out/", resources=False)
    assert [str(path) for path in remote.paths] == [
        f"s3://tiles/out/tile{suffix}"
        for suffix in (".vol.gz", ".dvol.gz", ".dem.tif", ".stats.json")
    ]
    assert digests_of(remote.paths) == digests_of(local.paths)
    assert remote.to_dict() == local.to_dict()
    assert sorted(s3.ls("tiles/out")) == sorted(f"tiles/out/{path.name}" for path in local.paths)


def test_outputs_go_beside_an_input_in_a_bucket(s3, tile):
    s3.put_file(str(tile), "tiles/in/tile.las")
    report = vt.convert("s3://tiles/in/tile.las", **QUICK)
    assert str(report.paths[0]) == "s3://tiles/in/tile.vol.gz"
    volume = vt.open("s3://tiles/in/tile.vol.gz")
    assert volume.depth == 2
    assert len(volume)


def test_workers_of_a_cluster_read_and_write_a_bucket(s3, tile, tmp_path):
    pytest.importorskip("distributed", reason="needs the extra dask")
    from volatool.batch.cluster import Cluster
    from volatool.batch.run import run_inputs

    names = ("a", "b")
    for name in names:
        s3.put_file(str(tile), f"tiles/in/{name}.las")
    paths = [path_of(f"s3://tiles/in/{name}.las") for name in names]
    options, executor = ConvertOptions(**QUICK), Cluster("local", jobs=2)
    outdir = path_of("s3://tiles/out")
    results = list(run_inputs(paths, options, kind="convert", outdir=outdir, executor=executor))
    assert [result.code for result in results] == [None, None]
    local = []
    for name in names:
        shutil.copy(tile, tmp_path / f"{name}.las")
        local.append(tmp_path / f"{name}.las")
    list(run_inputs(local, options, kind="convert", outdir=tmp_path / "out"))
    found = {name.rpartition("/")[2]: s3.cat_file(name) for name in s3.ls("tiles/out")}
    assert found == {path.name: path.read_bytes() for path in (tmp_path / "out").iterdir()}


def test_folders_patterns_and_lists_of_urls_are_inputs(s3, tile, tmp_path):
    for name in ("in/b.las", "in/a.LAZ", "in/a.copc.laz", "in/readme.txt", "in/deeper/c.las"):
        s3.pipe_file(f"tiles/{name}", b"LASF")
    s3.pipe_file("tiles/list.txt", b"s3://tiles/in/b.las\ns3://tiles/in/x.las\n")
    a, copc, b = (f"s3://tiles/in/{name}" for name in ("a.LAZ", "a.copc.laz", "b.las"))
    assert [str(path) for path in expand(["s3://tiles/in/"])] == [a, copc, b]
    assert [str(path) for path in expand(["s3://tiles/in"])] == [a, copc, b]
    assert [str(path) for path in expand(["s3://tiles/in/?.las"])] == [b]
    assert len(expand(["s3://tiles/**/*.las"])) == 2
    assert [str(path) for path in expand(["@s3://tiles/list.txt", "-"], [a])] == [
        b, "s3://tiles/in/x.las", a,
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("argument", "code"),
    [("s3://tiles/gone/", "E_NOT_FOUND"), ("s3://tiles/*.laz", "E_OPTION")],
)
def test_a_folder_or_pattern_without_inputs_is_an_error(s3, argument, code):
    with pytest.raises(vt.VolatoolError, match="s3://tiles/") as caught:
        expand([argument])
    assert caught.value.code == code


def test_outputs_that_exist_are_refused_before_any_work(s3, tile):
    s3.pipe_file("tiles/out/tile.dvol.gz", b"old")
    with pytest.raises(OutputExistsError, match=r"s3://tiles/out/tile\.dvol\.gz: exists"):
        vt.convert(tile, "s3://tiles/out", **QUICK)
    assert s3.ls("tiles/out") == ["tiles/out/tile.dvol.gz"]
    report = vt.convert(tile, "s3://tiles/out", overwrite=True, **QUICK)
    assert s3.info("tiles/out/tile.dvol.gz")["size"] > 3
    assert len(report.paths) == 3


def test_many_outputs_are_refused_by_one_listing(s3):
    targets = [path_of(f"s3://tiles/out/{n}.vol") for n in range(100)]
    uploads.refuse_remote(targets, overwrite=False)
    s3.pipe_file("tiles/out/71.vol", b"old")
    with pytest.raises(OutputExistsError, match=r"out/71\.vol: exists"):
        uploads.refuse_remote(targets, overwrite=False)


def test_a_failed_upload_leaves_nothing_that_looks_like_a_result(s3, tile, monkeypatch):
    put = s3.put_file

    def broken(local, remote):
        if remote.endswith(".stats.json"):
            raise PermissionError("Access Denied")
        put(local, remote)

    monkeypatch.setattr(s3, "put_file", broken)
    with pytest.raises(OutputError, match=r"s3://tiles/out/tile\.stats\.json: can't be written"):
        vt.convert(tile, "s3://tiles/out", **QUICK)
    assert not s3.exists("tiles/out/tile.vol.gz")
    assert s3.find("tiles/out") == []


def test_the_size_is_checked_after_the_upload(s3, tile, monkeypatch):
    monkeypatch.setattr(s3, "put_file", lambda local, remote: s3.pipe_file(remote, b"cut"))
    with pytest.raises(OutputError, match="has 3 bytes after the upload, expected"):
        vt.convert(tile, "s3://tiles/out", **QUICK)
    assert s3.find("tiles/out") == []


def test_a_bucket_that_is_not_there_is_told_before_any_work(s3, tile):
    with pytest.raises(OutputError, match="s3://nobucket: no such bucket") as caught:
        vt.convert(tile, "s3://nobucket/out", **QUICK)
    assert caught.value.code == "E_WRITE"


def test_an_object_that_is_not_there(s3):
    with pytest.raises(InputNotFoundError, match=r"s3://tiles/gone\.laz: no such file"):
        vt.convert("s3://tiles/gone.laz", "out")
    with pytest.raises(InputNotFoundError):
        vt.open("s3://nobucket/gone.vol.gz")


def test_identity_changes_with_the_object(s3):
    s3.pipe_file("tiles/a.laz", b"one")
    first = store.identity(path_of("s3://tiles/a.laz"))
    assert first["modified"] == s3.info("tiles/a.laz")["LastModified"].isoformat()
    assert first["size"] == 3
    assert first["etag"] == hashlib.md5(b"one").hexdigest()
    s3.pipe_file("tiles/a.laz", b"two")
    assert store.identity(path_of("s3://tiles/a.laz")) != first


def test_access_that_is_refused_says_so(s3, monkeypatch):
    def refused(name):
        raise PermissionError("Access Denied")

    s3.pipe_file("tiles/a.laz", b"one")
    monkeypatch.setattr(s3, "info", refused)
    with pytest.raises(InputError, match="access is refused") as caught:
        vt.convert("s3://tiles/a.laz", "out")
    assert caught.value.code == "E_ACCESS"


def test_a_manifest_proves_what_is_in_a_bucket(s3, tile, volatool):
    for name in ("a", "b"):
        s3.put_file(str(tile), f"tiles/in/{name}.las")
    asked = ["s3://tiles/in/", "-o", "s3://tiles/out/", "--no-dem", "--dense=never"]
    asked += ["--manifest", "run.jsonl"]
    assert volatool("convert", *asked).returncode == 0
    before = {name: s3.info(name)["LastModified"] for name in s3.find("tiles/out")}
    s3.pipe_file("tiles/in/b.las", tile.read_bytes())  # the same bytes, a second later or so
    s3.rm_file("tiles/out/a.vol.gz")
    done = volatool("convert", *asked, "--resume")
    assert done.returncode == 0, done.stderr
    assert "s3://tiles/out/a.vol.gz" in done.stdout
    s3.invalidate_cache()
    assert set(s3.find("tiles/out")) == set(before)
    again = volatool("convert", *asked, "--resume", "--verify")
    assert (again.returncode, again.stdout) == (0, "")
    assert "2 of 2 inputs are done" in again.stderr


def test_the_command_line_from_bucket_to_bucket(s3, tile, volatool):
    for name in ("a", "b"):
        s3.put_file(str(tile), f"tiles/in/{name}.las")
    s3.pipe_file("tiles/in/c.las", b"not a tile")
    done = volatool(
        "convert", "s3://tiles/in/", "-o", "s3://tiles/out", "--no-dem", "--dense=never"
    )
    assert done.returncode == 3
    assert done.stdout.splitlines() == [
        f"s3://tiles/out/{name}{suffix}" for name in "ab" for suffix in (".vol.gz", ".stats.json")
    ]
    assert "E_NOT_LAS: c.las" in done.stderr
    report = json.loads(s3.cat_file("tiles/out/a.stats.json"))
    assert report["input"]["name"] == "a.las"
    again = volatool(
        "convert", "s3://tiles/in/", "-o", "s3://tiles/out", "--no-dem", "--dense=never"
    )
    assert (again.returncode, again.stdout) == (2, "")
    assert "E_OUTPUT_EXISTS: s3://tiles/out/a.vol.gz" in again.stderr
