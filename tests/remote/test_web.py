"""HTTP: ranges and their number, COPC by bounds, servers without ranges, failures, secrets."""

from __future__ import annotations

import json
import logging
import shutil
from itertools import pairwise

import numpy as np
import pytest
from making_servers import WebServer
from making_tiles import hills, write_las

import volatool as vt
from volatool import tile as tiles
from volatool.batch.plan import expand
from volatool.errors import InputError, InputNotFoundError, OptionError, ResourceError
from volatool.info import describe
from volatool.remote import ranges, store
from volatool.remote.path import path_of
from volatool.validate import validate_file

PLAIN = {"dem": False, "resources": False}


@pytest.fixture(autouse=True)
def no_waiting(monkeypatch):
    monkeypatch.setattr(store, "DELAYS", (0.0, 0.0))


@pytest.fixture
def tile(web):
    """A tile of 60,000 points (1.8 MB) that the server has."""
    return write_las(web.folder / "tile.las", hills(60_000))


def written(report):
    return {path.name: path.read_bytes() for path in report.paths}


def test_a_tile_over_http_gives_the_bytes_of_a_local_one(web, tile, tmp_path):
    local = vt.convert(tile, tmp_path / "local", **PLAIN)
    remote = vt.convert(web.url("tile.las"), tmp_path / "remote", **PLAIN)
    assert written(remote) == written(local)


def test_every_byte_is_fetched_once_in_few_requests(web, tile, tmp_path):
    vt.convert(web.url("tile.las"), tmp_path, **PLAIN)
    size = tile.stat().st_size
    assert web.n_bytes == size
    assert len(web.requests) <= 5  # one of them HEAD
    starts = sorted((start, start + n) for method, _, start, n in web.requests if method == "GET")
    assert starts[0][0] == 0
    assert all(before[1] == after[0] for before, after in pairwise(starts))


def test_info_fetches_the_header_only(web, tile):
    facts = describe(path_of(web.url("tile.las")))
    assert facts == describe(tile)
    assert web.n_bytes <= 2 * ranges.BLOCK


@pytest.mark.shared
def test_bounds_of_a_copc_file_fetch_only_their_chunks(web, shared, tmp_path):
    name = "lone-star.copc.laz"
    shutil.copy(shared / "tiles" / name, web.folder)
    bounds = vt.Bounds(515380.0, 4918340.0, 515390.0, 4918350.0)
    local = vt.convert(web.folder / name, tmp_path / "local", bounds=bounds, resources=False)
    remote = vt.convert(web.url(name), tmp_path / "remote", bounds=bounds, resources=False)
    ours, theirs = written(remote), written(local)
    reports = [json.loads(one.pop("lone-star.stats.json")) for one in (ours, theirs)]
    assert ours == theirs
    assert {"lone-star.vol.gz", "lone-star.dem.tif"} <= set(ours)
    assert web.n_bytes < 0.35 * (web.folder / name).stat().st_size

    counts, all_counts = (report.pop("input") for report in reports)
    assert reports[0] == reports[1]
    unread = counts["dropped"].pop("unread")
    assert unread > 0
    assert counts["points_read"] + unread == all_counts["points_read"]
    assert counts["dropped"]["bounds"] + unread == all_counts["dropped"]["bounds"]
    for same in ("points_used", "points_header", "bbox", "density", "passes"):
        assert counts[same] == all_counts[same]


@pytest.mark.shared
def test_bounds_far_from_a_copc_file_leave_no_point_to_use(web, shared, tmp_path):
    shutil.copy(shared / "tiles" / "lone-star.copc.laz", web.folder)
    bounds = vt.Bounds(0.0, 0.0, 1.0, 1.0)
    report = vt.convert(web.url("lone-star.copc.laz"), tmp_path, bounds=bounds, **PLAIN)
    assert "W_ALL_FILTERED" in [warning.code for warning in report.warnings]
    assert report.input["points_read"] == 0
    assert web.n_bytes < 0.1 * (web.folder / "lone-star.copc.laz").stat().st_size


@pytest.mark.shared
def test_a_copc_file_whose_box_is_wrong_is_read_whole(web, shared, tmp_path):
    """A header's box that the points asked for contradict can't stand for the others."""
    data = bytearray((shared / "tiles" / "lone-star.copc.laz").read_bytes())
    box = np.frombuffer(data, "<f8", 6, 179)  # max, min of x, y, z
    bounds = vt.Bounds(515380.0, 4918340.0, 515390.0, 4918350.0)
    box[4] = 2330.0  # max z
    (web.folder / "wrong.copc.laz").write_bytes(data)
    local = vt.convert(web.folder / "wrong.copc.laz", tmp_path / "l", bounds=bounds, **PLAIN)
    remote = vt.convert(web.url("wrong.copc.laz"), tmp_path / "r", bounds=bounds, **PLAIN)
    ours, theirs = written(remote), written(local)
    assert ours["wrong.vol.gz"] == theirs["wrong.vol.gz"]
    assert "unread" not in remote.input["dropped"]
    assert "W_HEADER_BBOX" in [warning.code for warning in remote.warnings]


@pytest.mark.parametrize("says_so", [True, False])
def test_a_server_without_ranges_is_downloaded_from(tmp_path, caplog, says_so):
    folder = tmp_path / "served"
    folder.mkdir()
    local = write_las(folder / "tile.las", hills(60_000))
    with WebServer(folder, ranges=False, says_so=says_so) as web, caplog.at_level("WARNING"):
        report = vt.convert(web.url("tile.las"), tmp_path / "out", **PLAIN)
    assert report.input["points_read"] == 60_000
    assert report.input["bytes"] == local.stat().st_size
    assert "tile.las: the server gives no byte ranges" in caplog.text


def test_a_download_that_has_no_room_is_refused(tmp_path, monkeypatch):
    folder = tmp_path / "served"
    folder.mkdir()
    write_las(folder / "tile.las", hills(1000))
    usage = shutil.disk_usage(tmp_path)._replace(free=1000)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage)
    with (
        WebServer(folder, ranges=False) as web,
        pytest.raises(ResourceError, match="1000 free; set TMPDIR") as caught,
    ):
        vt.convert(web.url("tile.las"), tmp_path / "out", **PLAIN)
    assert caught.value.code == "E_SIZE"


def test_volumes_models_and_reports_are_read_from_urls(web, tile, tmp_path):
    report = vt.convert(tile, web.folder, resources=False, cell="1")
    volume = vt.open(web.url("tile.vol.gz"))
    assert volume.depth == report.depth
    assert len(volume) == len(vt.open(web.folder / "tile.vol.gz"))
    for path in report.paths:
        if not path.name.endswith(".json"):
            assert describe(path_of(web.url(path.name))) == describe(path)
        assert validate_file(web.url(path.name)).ok
    (table,) = vt.stats(web.url("tile.vol.gz"))
    assert table.levels == vt.stats(web.folder / "tile.vol.gz")[0].levels


def test_imports_are_copied_and_errors_name_the_url(web, tmp_path):
    (web.folder / "a.xyz").write_text("0 0 0\n1 1 1\n5 4 3\n")
    report = vt.import_points(web.url("a.xyz"), tmp_path / "out", resources=False)
    assert report.input["points_read"] == 3
    assert report.input["name"] == "a.xyz"
    (web.folder / "b.xyz").write_text("0 0 0\n1 one 1\n")
    with pytest.raises(InputError, match=r"b\.xyz") as caught:
        vt.import_points(web.url("b.xyz"), tmp_path / "out")
    assert "/volatool-" not in str(caught.value)


def test_points_of_bounds_are_streamed(web, tile):
    bounds = (10.0, 10.0, 20.0, 20.0)
    counts = [
        sum(len(chunk) for chunk in vt.stream(place, bounds=bounds))
        for place in (tile, web.url("tile.las"))
    ]
    assert counts[0] == counts[1] > 0


def test_pages_with_links_are_folders_and_patterns_match_them(web, tile):
    write_las(web.folder / "other tile.laz", hills(10))
    (web.folder / "notes.txt").touch()
    found = expand([web.url()])
    assert [path.name for path in found] == ["other tile.laz", "tile.las"]
    assert [path.name for path in expand([web.url("t*.las")])] == ["tile.las"]
    with pytest.raises(OptionError, match="matches nothing"):
        expand([web.url("x*.las")])


def test_a_failure_that_passes_is_asked_again(web, tile, tmp_path):
    web.failures = [503, None, 0, 500]
    report = vt.convert(web.url("tile.las"), tmp_path, **PLAIN)
    assert report.input["points_read"] == 60_000
    assert not web.failures
    assert web.statuses[503] == web.statuses[500] == 1


@pytest.mark.parametrize(
    ("status", "code", "text"),
    [
        (503, "E_NETWORK", "the server answers HTTP 503"),
        (403, "E_ACCESS", r"access is refused \(HTTP 403\)"),
        (404, "E_NOT_FOUND", "no such file"),
        (400, "E_INPUT", "the server answers HTTP 400"),
    ],
)
def test_a_failure_that_stays_is_told(web, tile, tmp_path, status, code, text):
    web.failures = [status] * 20
    with pytest.raises(InputError, match=text) as caught:
        vt.convert(web.url("tile.las?sign=secret"), tmp_path / "out", **PLAIN)
    assert caught.value.code == code
    assert "secret" not in str(caught.value)
    assert web.url("tile.las") in str(caught.value)
    assert not (tmp_path / "out").exists() or not list((tmp_path / "out").iterdir())


def test_size_and_time_are_those_of_the_file(web, tile):
    told, there = path_of(web.url("tile.las")).stat(), tile.stat()
    assert (told.st_size, told.st_mtime) == (there.st_size, int(there.st_mtime))
    identity = store.identity(path_of(web.url("tile.las?sign=secret")))
    assert identity["size"] == there.st_size
    assert set(identity) == {"size", "etag", "modified"}


def test_what_is_not_there(web, tmp_path):
    with pytest.raises(InputNotFoundError, match=r"gone\.laz: no such file"):
        vt.convert(web.url("gone.laz"), tmp_path)
    with pytest.raises(InputNotFoundError, match=r"gone\.vol: no such file"):
        vt.open(web.url("gone.vol"))


def test_nobody_listens(tmp_path):
    with pytest.raises(InputError, match="the network or the server fails") as caught:
        vt.convert("http://me:secret@127.0.0.1:9/tile.laz?key=secret", tmp_path)
    assert caught.value.code == "E_NETWORK"
    assert "secret" not in str(caught.value)


def test_an_error_page_in_place_of_a_tile(web, tmp_path):
    (web.folder / "tile.laz").write_text("<!DOCTYPE html><html>Please log in</html>")
    with pytest.raises(InputError, match="it looks like an HTML page") as caught:
        vt.convert(web.url("tile.laz"), tmp_path)
    assert caught.value.code == "E_NOT_LAS"


def test_nothing_can_be_written_to_the_web(web, tile, tmp_path):
    with pytest.raises(OptionError, match="give another folder by -o"):
        vt.convert(web.url("tile.las"), **PLAIN)
    assert web.n_bytes == 0


def test_users_and_passwords_open_files_and_appear_nowhere(web, tile, tmp_path, caplog):
    web.users = ["Basic bWU6aHVzaA=="]  # me:hush
    with pytest.raises(InputError, match="HTTP 401"):
        vt.convert(web.url("tile.las"), tmp_path, **PLAIN)
    url = web.url("tile.las?token=hush").replace("//", "//me:hush@")
    with caplog.at_level(logging.DEBUG, "volatool"):
        report = vt.convert(url, tmp_path, **PLAIN)
    for text in [report.to_json(), caplog.text, *map(str, report.paths)]:
        assert "hush" not in text
    assert b"hush" not in b"".join(path.read_bytes() for path in report.paths)


def test_a_copy_in_the_web_has_the_header_of_its_file(web, tile):
    with tiles.open_source(path_of(web.url("tile.las")), tiles.ConvertOptions()) as source:
        assert source.name == "tile.las"
        assert source.path == web.url("tile.las")


def test_secrets_stay_out_of_what_the_command_prints(web, tile, volatool):
    web.users = ["Basic bWU6aHVzaA=="]
    good = web.url("tile.las?token=hush").replace("//", "//me:hush@")
    bad = web.url("gone.las?token=hush").replace("//", "//me:hush@")
    done = volatool("convert", good, bad, "-o", "out", "--no-dem", "-v", "--log", "log.txt")
    assert done.returncode == 3
    assert "E_NOT_FOUND" in done.stderr
    log = (web.folder.parent / "log.txt").read_text()
    assert "requests" in log
    for text in (done.stdout, done.stderr, log):
        assert "hush" not in text
