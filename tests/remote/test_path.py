"""URLs as paths: names, parents, what is shown of them, and what they refuse."""

from __future__ import annotations

import os
import pickle
from pathlib import Path

import pytest

from volatool.errors import InputError, OptionError
from volatool.naming import stem
from volatool.remote import store
from volatool.remote.path import RemotePath, is_url, path_of


@pytest.mark.parametrize(
    ("url", "shown", "name", "parent"),
    [
        ("s3://b/t/a.laz", "s3://b/t/a.laz", "a.laz", "s3://b/t"),
        ("s3://b/a?.laz", "s3://b/a?.laz", "a?.laz", "s3://b"),
        ("s3://b", "s3://b", "b", "s3://b"),
        ("HTTPS://h/t/a.laz?k=s/x#f", "https://h/t/a.laz", "a.laz", "https://h/t"),
        ("https://me:pw@h:8/a%20b.las", "https://h:8/a%20b.las", "a b.las", "https://h:8"),
        ("http://h/..%2Fa.las", "http://h/..%2Fa.las", ".._a.las", "http://h"),
        ("http://[::1]:8/a.las", "http://[::1]:8/a.las", "a.las", "http://[::1]:8"),
        ("sftp://me:pw@h/d/a.las", "sftp://h/d/a.las", "a.las", "sftp://h/d"),
        ("abfs://c@acc.net/a.las", "abfs://c@acc.net/a.las", "a.las", "abfs://c@acc.net"),
    ],
)
def test_names_and_parents(url, shown, name, parent):
    path = path_of(url)
    assert isinstance(path, RemotePath)
    assert (str(path), path.name, str(path.parent)) == (shown, name, parent)
    assert "pw" not in repr(path)
    assert str(path.parent / "x.vol") == f"{parent}/x.vol"
    assert stem(path) == name.removesuffix(".laz").removesuffix(".las")


def test_paths_of_one_url_are_one_and_go_to_other_processes():
    one, other = path_of("https://h/get?id=1"), path_of("https://h/get?id=2")
    assert one == path_of("https://h/get?id=1")
    assert one != other
    assert one != Path("https://h/get")
    assert len({one, other, path_of("https://h/get?id=1")}) == 2
    copy = pickle.loads(pickle.dumps(one))
    assert (copy, copy.url, copy.name) == (one, one.url, "get")


def test_local_names_stay_local():
    for name in ("a.laz", "/a/b.laz", "C:/a.laz", "a:b/c.laz", "./s3:/a"):
        assert not is_url(name)
        assert path_of(name) == Path(name)
    assert path_of("file:///a/b%20c.laz") == Path("/a/b c.laz")
    assert type(path_of("file:///a")) is type(Path())


def test_what_only_works_with_files_says_so():
    path = path_of("s3://b/a.laz?versionId=1")
    for attempt in (
        path.unlink,
        path.mkdir,
        lambda: path.replace("x"),
        lambda: os.open(path, os.O_RDONLY),
    ):
        with pytest.raises(InputError, match=r"s3://b/a\.laz.*: is a URL; this works with local"):
            attempt()


def test_urls_in_urls_and_protocols_nobody_knows_are_refused():
    for url in ("zip://a.laz::https://h/b.zip", "simplecache::s3://b/a.laz"):
        with pytest.raises(OptionError, match="URLs inside URLs"):
            path_of(url)
    with pytest.raises(OptionError, match="no protocol that fsspec knows"):
        store.filesystem(RemotePath("nonsense://a/b.laz"))


@pytest.mark.parametrize(("url", "package"), [("gs://b/a.laz", "gcsfs"), ("az://b/a.laz", "adlfs")])
def test_a_package_that_is_missing_is_named(url, package):
    with pytest.raises(OptionError, match=f"pip install {package}") as caught:
        store.filesystem(RemotePath(url))
    assert caught.value.code == "E_NO_EXTRA"


def test_the_extra_is_named_when_it_is_missing(monkeypatch):
    for module, url in (("fsspec", "https://h/a.laz"), ("s3fs", "s3://b/a.laz")):
        with monkeypatch.context() as patch:
            patch.setitem(__import__("sys").modules, module, None)
            with pytest.raises(OptionError, match=r"pip install 'volatool\[cloud\]'") as caught:
                store.filesystem(RemotePath(url))
            assert caught.value.code == "E_NO_EXTRA"
