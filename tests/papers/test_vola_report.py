"""The report as a whole: keys, errata, files, the same bytes each time."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from making_tiles import hills, write_las
from PIL import Image

from volatool.errors import OptionError, OutputError, OutputExistsError, ResourceError
from volatool.papers import emap_octomap, figures, vola, vola_claims, vola_figures, vola_lookups
from volatool.papers.markdown import table
from volatool.papers.vola_errata import errata
from volatool.report import dumps

QUICK = {"points": 2000, "samples": 500}
KEYS = ["C1", "C1a", *(f"C{n}" for n in range(2, 13)), "C24"]


@pytest.fixture(scope="module")
def tile(tmp_path_factory):
    return write_las(
        tmp_path_factory.mktemp("tile") / "hills.las",
        hills(4000, extent=1000),
        crs="EPSG:28992",
        intensity=np.arange(4000) % 999,
    )


@pytest.fixture(scope="module")
def plain():
    """Without tiles, without times."""
    return vola.reproduce(timing=False, **QUICK)


def test_the_document_has_all_tables(plain):
    document = json.loads(dumps(plain.document))
    assert document["schema"] == "volatool.reproduce_vola/1"
    assert set(document) == {
        "schema", "tool", "setup", "table_1", "tables_2_to_5", "table_6", "table_7", "tiles",
        "effects", "errata", "not_in_documents", "warnings",
    }  # fmt: skip
    assert len(document["table_1"]["claims"]) == 11
    assert [row["depth"] for row in document["table_1"]["memory"]["depths"]] == [*range(2, 9)]
    assert [row["table"] for row in document["tables_2_to_5"]] == [2, 3, 4, 5]
    assert document["tiles"] is None
    assert len(document["table_6"]) == 6
    assert len(document["table_7"]) == 4


def test_the_same_options_give_the_same_bytes(plain):
    """And another seed other samples."""
    again = vola.reproduce(timing=False, **QUICK)
    assert dumps(again.document) == dumps(plain.document)
    assert again.markdown == plain.markdown
    other = vola.reproduce(timing=False, seed=2, **QUICK)
    assert other.document["table_6"] != plain.document["table_6"]


def test_each_erratum_is_computed(plain):
    """In words that say the numbers of the tables."""
    rows = {erratum.key: erratum for erratum in errata(plain.document)}
    assert list(rows) == KEYS
    assert all(all(erratum) for erratum in rows.values())
    for key, text in {
        "C1": "1.33 to 1.83",
        "C1a": "12.8 to 43.4 points",
        "C2": "Montreal 4 (margin 0.62 points), paper 3",
        "C3": "the pairs are those of 7 cells",
        "C5": "5 of the 5",
        "C6": "0.79 % (1762.6 MB of 224 GB)",
        "C8": "9.77 cm",
        "C9": "758 million voxels",
        "C10": "1.347 %",
        "C12": "100 % of the points",
    }.items():
        assert text in rows[key].measured, key


def test_markdown_has_a_section_for_each_table_and_no_empty_cells_of_code(plain):
    for heading in ("Table 1", "Tables 2 to 5", "Table 6", "Table 7", "Errata"):
        assert f"\n## {heading}\n" in plain.markdown
    assert "None given" in plain.markdown
    assert "None" not in plain.markdown.replace("None given", "").replace("None of them", "")
    assert "nan" not in plain.markdown.replace("Fernando", "")
    for line in plain.markdown.splitlines():
        if line.startswith("| C"):
            assert line.count(" | ") == 3, line


def test_columns_of_a_table_are_as_many_as_its_heads():
    lines = table("a | b", [("1|1", "2")]).splitlines()
    assert lines == ["| a | b |", "| --- | --- |", "| 1\\|1 | 2 |"]
    assert table(("a",), []).splitlines() == ["| a |", "| --- |"]


def test_files_and_figures_of_a_tile(tile, tmp_path):
    """Each picture is one; names are those that were refused beforehand if they existed."""
    made = vola.reproduce([tile], timing=False, outdir=tmp_path / "out", **QUICK)
    names = {path.name for path in made.paths}
    assert names == {
        "report.md",
        "report.json",
        "figure-1-to-3-subdivision.png",
        "figure-1-to-3-levels-hills.png",
        "figure-4-to-7-density-hills.png",
    }
    for path in made.paths:
        if path.suffix == ".png":
            assert f"![{path.name}]({path.name})" in made.markdown
            with Image.open(path) as picture:
                assert min(picture.size) > 300
                assert len(picture.convert("RGB").getcolors(1 << 24)) > 10
    document = json.loads((tmp_path / "out" / "report.json").read_text())
    assert document["tiles"]["sum"]["points"] == 4000
    assert (tmp_path / "out" / "report.md").read_text() == made.markdown
    first = {path.name: path.read_bytes() for path in made.paths}
    with pytest.raises(OutputExistsError, match=r"report\.md"):
        vola.reproduce([tile], timing=False, outdir=tmp_path / "out", **QUICK)
    again = vola.reproduce([tile], timing=False, outdir=tmp_path / "out", overwrite=True, **QUICK)
    assert {path.name: path.read_bytes() for path in again.paths} == first


def test_times_are_drawn_and_a_run_without_them_removes_their_pictures(tmp_path, monkeypatch):
    """Figures of an earlier run must not stand beside a report without their numbers."""
    monkeypatch.setattr(vola_lookups, "QUERIES", 50)
    monkeypatch.setattr(vola_lookups.times, "__kwdefaults__", {
        "queries": 50, "runs": 1, "progress": lambda done, total: None,
    })  # fmt: skip
    monkeypatch.setattr(vola_claims.packing_times, "__defaults__", ((2,), 1))
    made = vola.reproduce(timing=True, outdir=tmp_path, **QUICK)
    assert {vola_figures.LOOK_UPS, vola_figures.PACKING} <= {path.name for path in made.paths}
    assert "## Figure 8" in made.markdown
    assert "not measured: 35,742,854,185,480 bytes" in made.markdown
    vola.reproduce(timing=False, outdir=tmp_path, overwrite=True, **QUICK)
    assert not (tmp_path / vola_figures.LOOK_UPS).exists()


def test_without_the_extras(tmp_path, monkeypatch):
    """The rest is made, and what is missing is said with the command that installs it."""
    monkeypatch.setattr(emap_octomap, "is_available", lambda: False)
    monkeypatch.setattr(vola, "is_available", lambda: False)
    made = vola.reproduce(timing=False, outdir=tmp_path, **QUICK)
    assert [warning["code"] for warning in made.document["warnings"]] == [
        "W_NO_OCTOMAP",
        "W_NO_FIGURES",
    ]
    assert figures.MISSING in made.markdown
    assert [path.name for path in made.paths] == ["report.md", "report.json"]


def test_names_of_pictures_do_not_collide():
    paths = [
        Path("a/t.laz"),
        Path("b/t.laz"),
        Path("c.vol.gz"),
        *(Path(f"{n}.las") for n in "defghij"),
    ]
    names = vola_figures.tile_names(paths)
    flat = [name for own in names.values() for name in own.values()]
    assert len(flat) == len(set(flat))
    assert len(names) == vola_figures.MOST_TILES
    assert names[paths[1]]["levels"] == "figure-1-to-3-levels-t-2.png"
    assert "density" not in names[paths[2]]


@pytest.mark.parametrize(
    ("options", "error"),
    [
        ({"points": 0}, OptionError),
        ({"samples": 1}, OptionError),
        ({"points": 10**9}, ResourceError),
        ({"samples": 10**9}, ResourceError),
    ],
)
def test_numbers_that_are_refused(options, error):
    """Before anything is allocated."""
    with pytest.raises(error):
        vola.reproduce(**options)


def test_a_folder_that_can_not_be_made(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="file"):
        vola.reproduce(timing=False, outdir=tmp_path / "file", **QUICK)
