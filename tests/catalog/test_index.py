"""The index of a folder: what the original viewer reads, and what it must never be."""

from __future__ import annotations

import json
import struct
from dataclasses import replace
from pathlib import Path

import pytest
import toolkit_reader as toolkit
from making_volumes import CUBE, INFO, random_volume

from volatool.catalog.index import index_folder
from volatool.cube import Cube
from volatool.encodings import Encoding, write_volume
from volatool.errors import FormatError, InputError, InputNotFoundError, OptionError
from volatool.formats.vola_index import read_index
from volatool.info import describe
from volatool.validate import validate_file

WHO = {"author": "Somebody", "license": "CC-BY-4.0"}
TEXTS = ["dataset", "info", "url", "author", "authorurl", "license", "licenseurl"]


def save(path, volume=None, *, packed=False, kind="sparse"):
    volume = random_volume() if volume is None else volume
    with path.open("wb") as stream:
        bits = 2 if volume.has_metadata else 1
        write_volume(stream, volume, Encoding(kind, bits, "gzip" if packed else "none"))
    return path


@pytest.fixture
def folder(tmp_path):
    """Two tiles side by side, made in the wrong order."""
    folder = tmp_path / "set"
    folder.mkdir()
    x, y, z = CUBE.origin
    beside = Cube((x + CUBE.side, y, z), CUBE.side)
    save(folder / "b.vol", random_volume(cube=beside))
    save(folder / "a.vol")
    return folder


def test_the_index_has_what_the_original_writes_sorted_and_relative(folder):
    """All its keys; names that open from the folder; the box of all files."""
    indexed = index_folder(folder, attribution=WHO)
    assert [path.name for path in indexed.paths] == ["set.vola"]
    assert indexed.warnings == ()
    text = (folder / "set.vola").read_text()
    document = json.loads(text, parse_constant=pytest.fail)
    assert all(isinstance(document[name], str) for name in TEXTS)
    assert document["dataset"] == "set"
    assert [one["filename"] for one in document["files"]] == ["a.vol", "b.vol"]
    assert (document["depth"], document["nbits"], document["crs"], document["mode"]) == (
        3, 1, 2994, 0,
    )  # fmt: skip
    (x, y, z), side = CUBE.origin, CUBE.side
    assert document["bbox"] == pytest.approx([x, y, z, x + 2 * side, y + side, z + side])
    assert document["sides"] == pytest.approx([2 * side, side, side])
    first = document["files"][0]
    assert first["centroid"] == pytest.approx([x + side / 2, y + side / 2, z + side / 2])
    assert (first["lat"], first["lon"], first["crs"]) == (44.0, -123.0, 2994)
    assert first["points_bbox"] == list(INFO.box)
    assert list(document) == sorted(document)


def test_the_top_has_only_what_all_files_agree_on(folder):
    """The original takes the last file's depth, nbits and crs for everybody's."""
    info = replace(INFO, epsg=25832)
    save(folder / "c.vol", random_volume(depth=2, metadata=False, info=info))
    indexed = index_folder(folder, attribution=WHO)
    document = json.loads((folder / "set.vola").read_text())
    assert not {"depth", "nbits", "crs", "bbox"} & set(document)
    assert [warning.code for warning in indexed.warnings] == ["W_INDEX_CRS"]
    assert [one["depth"] for one in document["files"]] == [3, 3, 2]


def test_a_place_that_is_not_known_is_null(folder):
    for path in folder.iterdir():
        path.unlink()
    path = save(folder / "a.vol", random_volume(info=INFO))
    data = bytearray(path.read_bytes())
    data[16:24] = struct.pack("<d", float("inf"))  # as the original writes it, without a trailer
    path.write_bytes(data[: data.index(b"VOLATRL1")])
    index_folder(folder, attribution=WHO)
    one = json.loads((folder / "set.vola").read_text(), parse_constant=pytest.fail)["files"][0]
    assert (one["lat"], one["lon"]) == (None, None)


def test_gzip_is_listed_with_a_warning_and_the_plain_file_is_preferred(folder):
    save(folder / "a.vol.gz", packed=True)
    save(folder / "c.vol.gz", packed=True)
    save(folder / "d.dvol", kind="dense")  # the original lists no dense files
    indexed = index_folder(folder, attribution=WHO)
    assert [(one.code, one.count) for one in indexed.warnings] == [("W_INDEX_GZIP", 1)]
    names = [one.filename for one in read_index(folder / "set.vola").files]
    assert names == ["a.vol", "b.vol", "c.vol.gz"]


@pytest.mark.parametrize("missing", ["author", "license"])
def test_author_and_licence_are_asked_for(folder, missing):
    given = {name: text for name, text in WHO.items() if name != missing}
    with pytest.raises(
        OptionError, match=f"give --{missing}, or '{missing}' in info.json"
    ) as caught:
        index_folder(folder, attribution=given)
    assert caught.value.code == "E_ATTRIBUTION"
    assert not (folder / "set.vola").exists()


def test_info_json_gives_the_texts_and_options_go_before_it(folder):
    (folder / "info.json").write_text(
        json.dumps({"dataset": "Town", "author": "A", "license": "MIT", "more": [1]}), "utf-8-sig"
    )
    index_folder(folder, attribution={"author": "B", "info": None})
    document = json.loads((folder / "set.vola").read_text())
    assert [document[name] for name in TEXTS] == ["Town", "", "", "B", "", "MIT", ""]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("{", "is not JSON"),
        ("[]", "not a JSON object"),
        ('{"author": 3}', "'author' is not text"),
        ("[" * 100_000, "is not JSON"),
        (" " * 200_000, "longer than"),
    ],
)
def test_a_bad_info_json_is_refused(folder, text, says):
    (folder / "info.json").write_text(text)
    with pytest.raises(OptionError, match=says) as caught:
        index_folder(folder, attribution=WHO)
    assert caught.value.code == "E_ATTRIBUTION"


def test_what_can_not_be_indexed_is_named(tmp_path, folder):
    with pytest.raises(InputNotFoundError, match="no such folder"):
        index_folder(tmp_path / "gone", attribution=WHO)
    with pytest.raises(InputNotFoundError, match="is not a folder"):
        index_folder(folder / "a.vol", attribution=WHO)
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match=r"holds no \.vol or \.vol\.gz"):
        index_folder(tmp_path / "empty", attribution=WHO)
    with pytest.raises(InputNotFoundError, match="no such file"):
        index_folder(folder, info_file=tmp_path / "x.json", attribution=WHO)
    with pytest.raises(OptionError, match="without folders"):
        index_folder(folder, name="../x", attribution=WHO)
    save(folder / "z.vol", kind="dense")
    with pytest.raises(InputError, match=r"z\.vol: is a dense volume"):
        index_folder(folder, attribution=WHO)
    (folder / "z.vol").write_bytes(b"hello")
    with pytest.raises(FormatError, match=r"z\.vol"):
        index_folder(folder, attribution=WHO)
    assert not (folder / "set.vola").exists()


def test_an_index_is_not_replaced_unasked(folder):
    index_folder(folder, attribution=WHO)
    before = (folder / "set.vola").read_bytes()
    with pytest.raises(OptionError, match="--overwrite"):
        index_folder(folder, attribution=WHO)
    index_folder(folder, attribution=WHO, overwrite=True)
    assert (folder / "set.vola").read_bytes() == before


def test_info_and_validate_know_an_index(folder, monkeypatch):
    """Counts and what is missing; validate compares it with the files' headers."""
    index_folder(folder, attribution=WHO)
    index = folder / "set.vola"
    assert validate_file(index).ok
    facts = describe(index)
    assert (facts["kind"], facts["files"], facts["missing"]) == ("index", 2, [])
    (folder / "b.vol").unlink()
    save(folder / "a.vol", random_volume(depth=2))
    assert describe(index)["missing"] == ["b.vol"]
    report = validate_file(index)
    assert report.kind == "index"
    assert [problem.code for problem in report.problems] == ["E_CORRUPT", "E_NOT_FOUND"]
    assert "depth is 3 in the index, 2 in the file" in report.problems[0].message


def test_files_beside_the_index_go_before_those_of_the_same_name_elsewhere(
    tmp_path, folder, monkeypatch
):
    """Where the command is run must not matter: tiles of several folders are called alike."""
    index_folder(folder, attribution=WHO)
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    index = read_index(folder / "set.vola")
    for one in index.files:
        (elsewhere / one.filename).write_bytes(b"another file")
    assert read_index(folder / "set.vola") == index
    assert not validate_file(folder / "set.vola").problems


def test_an_index_of_the_original_is_read_with_its_defects(folder, monkeypatch):
    """Infinity, names relative to where it was run, no order."""
    content = {"dataset": "x", "files": [
        {"filename": "set/b.vol", "lat": 1e999, "crs": 2000, "bbox": [0] * 6},
        {"filename": "a.vol"},
    ]}  # fmt: skip
    path = folder / "old.vola"
    path.write_text(json.dumps(content))
    assert "Infinity" in path.read_text()
    monkeypatch.chdir(folder.parent)
    found = read_index(path)
    assert [one.path is not None for one in found.files] == [True, True]
    assert found.files[0].content["lat"] is None
    assert describe(path)["missing"] == []


@pytest.mark.parametrize(
    "text", ["", "x", "[]", "{}", '{"files": 3}', '{"files": [{}]}', '{"files": [{"filename": 1}]}']
)
def test_what_is_no_index_is_refused(tmp_path, text):
    path = tmp_path / "x.vola"
    path.write_text(text)
    with pytest.raises(FormatError) as caught:
        read_index(path)
    assert caught.value.code == "E_NOT_INDEX"
    assert [problem.code for problem in validate_file(path).problems] == ["E_NOT_INDEX"]


def test_the_original_viewer_opens_what_the_index_names(folder, monkeypatch):
    """Each name, from the index's folder, through a reader that behaves as the original's."""
    index_folder(folder, attribution=WHO)
    monkeypatch.chdir(folder)
    n_voxels = 0
    for one in json.loads(Path("set.vola").read_text())["files"]:
        found = toolkit.read(Path(one["filename"]).read_bytes())
        assert list(found.box) == one["bbox"]
        n_voxels += len(found.voxels)
    assert n_voxels == 2 * len(random_volume())
