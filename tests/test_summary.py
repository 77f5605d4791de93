"""Reports summed, as the paper sums the tiles of a data set."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace
from pathlib import Path

import pytest
from making_tiles import hills, write_las

import volatool as vt
from volatool.summary import Summary, read_reports, summarize
from volatool.tables import FORMATS, render

SAMPLES = Path(__file__).resolve().parents[1] / "data_samples"


@pytest.fixture(scope="module")
def reports(tmp_path_factory):
    folder = tmp_path_factory.mktemp("tiles")
    paths = [
        write_las(folder / f"{seed}.las", hills(4000 + 500 * seed, seed), crs=25832)
        for seed in range(3)
    ]
    return vt.stats(paths)


def test_every_count_is_the_sum_of_the_tiles(reports):
    total = reports.summary()
    assert total.tiles == 3
    for key in ("points_read", "points_used", "bytes", "las_equivalent_bytes"):
        assert total.input[key] == sum(report.input[key] for report in reports)
    for number, row in enumerate(total.levels):
        for key in ("blocks", "voxels", "dense_bytes", "sparse_bytes"):
            assert row[key] == sum(report.levels[number][key] for report in reports), key
        n_cells = sum(report.levels[number]["voxels"] for report in reports)
        assert row["occupancy"] == n_cells / (64 * row["blocks"])


def test_encodings_add_up_where_all_tiles_have_the_depth_of_the_sum(tmp_path):
    paths = [write_las(tmp_path / f"{n}.las", hills(3000, n), crs=25832) for n in range(2)]
    reports = vt.stats(paths, depth=3)
    total = reports.summary()
    assert (total.choice["rule"], total.depth) == ("fixed", 3)
    assert len(total.encodings) == len(reports[0].encodings)
    for k, row in enumerate(total.encodings):
        assert row["file_bytes"] == sum(report.encodings[k]["file_bytes"] for report in reports)
    assert summarize([*reports, *vt.stats(paths[0], depth=4)]).encodings == ()


def test_densities_are_weighted_by_area(reports):
    total = reports.summary().input["density"]["all_per_area_bbox"]
    areas = [
        report.input["points_read"] / report.input["density"]["all_per_area_bbox"]
        for report in reports
    ]
    assert total == pytest.approx(sum(r.input["points_read"] for r in reports) / sum(areas))


def test_a_sum_of_one_is_the_one(reports):
    total = summarize([reports[0]])
    assert total.levels == tuple(reports[0].levels)
    assert total.depth == reports[0].depth
    assert total.input["density"]["first_per_area_occupied"] == pytest.approx(
        reports[0].input["density"]["first_per_area_occupied"]
    )


def test_what_differs_between_tiles_is_null(reports):
    other = vt.stats(SAMPLES / "forest.laz")
    total = summarize([*reports, *other])
    assert total.cube["side"] is None
    assert total.input["crs"] is None
    assert all(row["cell"] is None for row in total.levels)
    for form in FORMATS:
        assert render([total], form)


def test_a_nearly_empty_tile_does_not_end_the_table_of_a_set(tmp_path):
    """Tiles list all levels for a sum: a corner with five points is in it and decides nothing."""
    paths = [write_las(tmp_path / f"{n}.las", hills(20_000, n), crs=25832) for n in range(2)]
    few = write_las(tmp_path / "few.las", hills(5, 9), crs=25832)
    whole = vt.stats(paths, all_levels=True).summary()
    with_few = vt.stats([*paths, few], all_levels=True).summary()
    assert len(with_few.levels) == len(whole.levels) > 2
    assert with_few.depth == whole.depth
    assert len(whole.levels) == len(vt.stats(paths[0])[0].levels)  # no deeper than of use
    short = vt.stats([*paths, few]).summary()
    assert len(short.levels) == 2
    assert [w.code for w in short.warnings if w.code.startswith("W_SUM")] == ["W_SUMMARY_LEVELS"]


def test_reports_read_again_give_the_same_sum(reports, tmp_path):
    lines = tmp_path / "set.jsonl"
    lines.write_text("\n".join(report.to_json() for report in reports) + "\n", encoding="utf-8")
    array = tmp_path / "set.json"
    array.write_text(render(list(reports), "json"), encoding="utf-8")
    wanted = reports.summary().to_json()
    assert summarize(read_reports(lines)).to_json() == wanted
    assert summarize(read_reports(array)).to_json() == wanted


def test_files_that_are_no_reports_are_named(tmp_path):
    for text, name in (("{", "a.json"), ("[1]", "b.json"), ('{"schema": "x"}\n', "c.jsonl")):
        path = tmp_path / name
        path.write_text(text, encoding="utf-8")
        with pytest.raises(vt.VolatoolError, match=name) as error:
            list(read_reports(path))
        assert error.value.code == "E_NOT_REPORT"
    with pytest.raises(vt.VolatoolError, match="no such file"):
        list(read_reports(tmp_path / "none.json"))


def test_no_report_is_kept(reports):
    """Memory of a sum over 3,000 tiles: the names, and less than 0.5 MB beside."""
    summary = Summary()
    tracemalloc.start()
    try:
        for number in range(3_000):
            source = {**reports[0].input, "name": f"{number:020}"}
            summary.add(replace(reports[0], input=source))
        used = tracemalloc.get_traced_memory()[0]
    finally:
        tracemalloc.stop()
    assert summary.report().levels[0]["blocks"] == 3_000
    assert used < 3_000 * 100 + 500_000


def test_cubes_of_very_different_sides_are_told(tmp_path):
    big = write_las(tmp_path / "big.las", hills(4000, 1), crs=25832)
    small = write_las(tmp_path / "small.las", hills(4000, 2, extent=1500), crs=25832)
    total = vt.stats([big, small], depth=3).summary()
    (warning,) = total.warnings
    assert warning.code == "W_CUBE_SIDES"
    assert "retile" in warning.message


def test_nothing_can_not_be_summed(tmp_path):
    import numpy as np

    empty = vt.stats(write_las(tmp_path / "e.las", np.empty((0, 3), int)))
    with pytest.raises(vt.VolatoolError, match="nothing to sum"):
        empty.summary()
