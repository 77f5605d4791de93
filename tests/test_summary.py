"""Reports summed, as the paper sums the tiles of a data set."""

from __future__ import annotations

from pathlib import Path

import pytest
from making_tiles import hills, write_las

import volatool as vt
from volatool.summary import summarize
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


def test_nothing_can_not_be_summed(tmp_path):
    import numpy as np

    empty = vt.stats(write_las(tmp_path / "e.las", np.empty((0, 3), int)))
    with pytest.raises(vt.VolatoolError, match="nothing to sum"):
        empty.summary()
