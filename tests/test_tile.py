"""One tile from file to files: determinism, boxes, selections, degenerate tiles."""

from __future__ import annotations

import json
import os
import shutil
import struct
import subprocess
import sys
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from making_tiles import hills, write_las
from naive_tile import count_levels

import volatool as vt
from volatool.dem.raster import read_dem
from volatool.report import Report, schema
from volatool.validate import validate_file

SAMPLES = Path(__file__).resolve().parents[1] / "data_samples"


def converted(path, folder, **options):
    """Convert, check every output and return the report."""
    report = vt.convert(path, folder, resources=False, **options)
    jsonschema.validate(report.to_dict(), schema())
    for output in report.paths:
        checked = validate_file(output)
        assert checked.ok, (output, checked.problems)
    return report


def contents(report):
    return {path.name: path.read_bytes() for path in report.paths}


def codes(report):
    return [warning.code for warning in report.warnings]


@pytest.mark.parametrize("sample", ["town.laz", "forest.laz"])
def test_the_bytes_do_not_depend_on_chunks_memory_or_the_run(sample, tmp_path):
    runs = [{}, {"chunk_points": 1000}, {"chunk_points": 100_000}, {"chunk_points": 10**6}]
    runs += [{"memory": "2G"}, {}]
    made = [
        contents(
            vt.convert(
                SAMPLES / sample,
                tmp_path / str(number),
                layers=("count", "flag", "distance"),
                resources=False,
                **options,
            )
        )
        for number, options in enumerate(runs)
    ]
    assert len(made[0]) >= 7
    for other in made[1:]:
        assert other == made[0]


@pytest.mark.parametrize(
    ("points", "extent", "cell"),
    [
        (400_000, 30_000, "auto"),
        (200_000, 150_000, "1"),  # grids of 2 M cells, with far fewer points
        pytest.param(400_000, 400_000, "1", marks=pytest.mark.slow),  # 16 M cells
    ],
)
def test_a_low_ceiling_is_kept_by_spilling_and_changes_no_byte(tmp_path, points, extent, cell):
    """In a process of its own: the ceiling is for a whole process."""
    path = write_las(tmp_path / "t.las", hills(points, extent=extent), point_format=7)
    free = contents(vt.convert(path, tmp_path / "free", resources=False, cell=cell))
    code = (
        "import sys, volatool as vt\n"
        f"out, options = {str(tmp_path / 'kept')!r}, {{'memory': '256M', 'cell': {cell!r}}}\n"
        f"report = vt.convert({str(path)!r}, out, **options)\n"
        "print(report.to_dict()['resources']['peak_rss_bytes'])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) <= 256 << 20
    for name, data in free.items():
        if not name.endswith(".json"):
            assert (tmp_path / "kept" / name).read_bytes() == data


def test_the_order_of_points_changes_no_volume_byte_and_no_height_by_a_tenth_of_a_millimetre(
    tmp_path,
):
    xyz = hills(40_000)
    rng = np.random.default_rng(1)
    columns = {
        "classification": rng.choice([1, 2], len(xyz)),
        "intensity": rng.integers(0, 4000, len(xyz)),
        "return_number": np.ones(len(xyz), int),
        "number_of_returns": rng.integers(1, 5, len(xyz)),
        **{band: rng.integers(0, 65536, len(xyz)) for band in ("red", "green", "blue")},
    }
    order = rng.permutation(len(xyz))
    reports = []
    for name, places in (("one", np.arange(len(xyz))), ("two", order)):
        (tmp_path / name).mkdir()
        path = tmp_path / name / "tile.laz"
        write_las(path, xyz[places], point_format=7, crs=25832,
                  **{key: values[places] for key, values in columns.items()})  # fmt: skip
        reports.append(converted(path, tmp_path / name))
    one, two = reports
    assert one.levels == two.levels
    volumes = [
        vt.open(next(p for p in report.paths if p.name == "tile.vol.gz")) for report in reports
    ]
    for first, second in zip(
        (*volumes[0].levels, *volumes[0].metadata_levels),
        (*volumes[1].levels, *volumes[1].metadata_levels),
        strict=True,
    ):
        assert np.array_equal(first, second)
    heights = [
        read_dem(next(p for p in report.paths if p.suffix == ".tif")).z for report in reports
    ]
    assert np.array_equal(np.isnan(heights[0]), np.isnan(heights[1]))
    assert np.nanmax(np.abs(heights[0] - heights[1])) <= 1e-4


def test_levels_hang_together(tmp_path):
    report = converted(SAMPLES / "town.laz", tmp_path)
    for upper, lower in zip(report.levels, report.levels[1:], strict=False):
        assert lower["blocks"] == upper["voxels"]
        assert lower["cell"] * 4 == upper["cell"]
    for row in report.levels:
        assert row["dense_bytes"] == 8 * (64 ** row["level"] - 1) // 63
        assert sum(row["occupancy_histogram"]) == row["blocks"]


def break_header_box(path, **changes):
    """Overwrite values of the header's box: max x, min x, max y, min y, max z, min z."""
    data = bytearray(path.read_bytes())
    names = ("max_x", "min_x", "max_y", "min_y", "max_z", "min_z")
    for name, value in changes.items():
        struct.pack_into("<d", data, 179 + 8 * names.index(name), value)
    path.write_bytes(data)


@pytest.mark.parametrize(
    "wrong",
    [
        {"max_x": 1e6},
        {"min_x": -300.0},
        {"max_x": 20.0},
        {"min_z": 15.0, "max_z": 16.0},
        {"min_x": float("nan")},
        {"min_x": 10.0, "max_x": 1.0},
        {"max_x": 1e300},
    ],
)
def test_a_wrong_header_box_gives_the_result_of_a_right_one_and_is_told(wrong, tmp_path):
    xyz = hills(5000)
    for name in ("right", "wrong"):
        (tmp_path / name).mkdir()
        write_las(tmp_path / name / "tile.las", xyz, crs=25832)
    break_header_box(tmp_path / "wrong" / "tile.las", **wrong)
    right = converted(tmp_path / "right" / "tile.las", None)
    report = converted(tmp_path / "wrong" / "tile.las", None)
    assert "W_HEADER_BBOX" in codes(report)
    assert report.input["passes"] == 2
    assert right.input["passes"] == 1
    one, other = contents(right), contents(report)
    assert {name for name in one if one[name] != other[name]} == {"tile.stats.json"}
    assert (right.levels, right.cube, right.dem) == (report.levels, report.cube, report.dem)


def test_withheld_and_noise_points_are_left_out_counted_and_part_of_the_cube(tmp_path):
    xyz = np.vstack([hills(5000), [[0, 0, 9999], [50, 50, 0], [7, 7, 900]]])
    classes = np.full(len(xyz), 2)
    classes[-3:-1] = 7, 18
    withheld = np.zeros(len(xyz), bool)
    withheld[-1] = True
    path = write_las(tmp_path / "t.las", xyz, classification=classes, withheld=withheld)
    report = converted(path, None)
    assert report.input["dropped"] == {"noise": 2, "withheld": 1}
    used = np.arange(len(xyz)) < 5000
    expected = count_levels(xyz, used, len(report.levels))
    assert [(row["blocks"], row["voxels"]) for row in report.levels] == expected
    kept = vt.stats(path, keep_noise=True, keep_withheld=True)[0]
    assert kept.input["points_used"] == len(xyz)


def test_selections_are_those_of_plain_numpy(tmp_path):
    xyz = hills(5000)
    rng = np.random.default_rng(3)
    classes = rng.choice([1, 2, 5, 9], 5000)
    of = rng.integers(1, 4, 5000)
    number = np.minimum(rng.integers(1, 4, 5000), of)
    path = write_las(
        tmp_path / "t.las",
        xyz,
        classification=classes,
        return_number=number,
        number_of_returns=of,
    )
    x, y = xyz[:, 0] / 100, xyz[:, 1] / 100
    cases = [
        ({"classes": (2, 9)}, np.isin(classes, (2, 9))),
        ({"exclude_classes": (5,)}, classes != 5),
        ({"returns": "first"}, number == 1),
        ({"returns": "last"}, number == of),
        ({"thin": 7}, np.arange(5000) % 7 == 0),
        (
            {"bounds": vt.Bounds(10.0, 5.5, 30.25, 40.0)},
            (x >= 10) & (x <= 30.25) & (y >= 5.5) & (y <= 40),
        ),
    ]
    for options, expected in cases:
        report = vt.stats(path, **options)[0]
        assert report.input["points_used"] == np.count_nonzero(expected), options
        counts = count_levels(xyz, expected, len(report.levels))
        assert [(row["blocks"], row["voxels"]) for row in report.levels] == counts


def test_isolated_points_are_told_and_left_out_on_request(tmp_path):
    xyz = np.vstack([hills(5000), [[100, 100, 400_000]]])
    path = write_las(tmp_path / "t.las", xyz, classification=np.full(5001, 2))
    report = converted(path, tmp_path / "a")
    assert "W_Z_OUTLIER" in codes(report)
    robust = converted(path, tmp_path / "b", robust_z=True)
    assert robust.input["dropped"] == {"z_outlier": 1}
    assert robust.cube["side"] == pytest.approx(49.99, abs=0.02)
    assert robust.dem["z_max"] < 20
    counts = count_levels(xyz[:-1], np.ones(5000, bool), len(robust.levels))
    assert [(row["blocks"], row["voxels"]) for row in robust.levels] == counts


DEGENERATE = {
    "one point": [[5, 5, 5]],
    "all equal": [[5, 5, 5]] * 100,
    "one column": [[5, 5, z] for z in range(100)],
    "flat": [[x, y, 7] for x in range(40) for y in range(40)],
    "a line": [[x, 0, 0] for x in range(1000)],
    "far apart": [[-(2**31), -(2**31), -(2**31)], [2**31 - 1, 2**31 - 1, 2**31 - 1]],
}


@pytest.mark.parametrize("name", DEGENERATE)
def test_degenerate_tiles_give_valid_outputs(name, tmp_path):
    xyz = np.array(DEGENERATE[name])
    path = write_las(tmp_path / "t.las", xyz)
    report = converted(path, tmp_path / "out", cell="1000km" if name == "far apart" else "auto",
                       crs=None if name != "far apart" else "EPSG:25832")  # fmt: skip
    assert report.status == "ok"
    counts = count_levels(xyz, np.ones(len(xyz), bool), len(report.levels))
    assert [(row["blocks"], row["voxels"]) for row in report.levels] == counts
    assert len(report.levels) >= report.depth >= 2


def test_no_points_give_statistics_and_no_volume(tmp_path):
    path = write_las(tmp_path / "t.las", np.empty((0, 3), int))
    report = converted(path, tmp_path / "out")
    assert (report.status, report.depth) == ("empty", None)
    assert codes(report)[-1] == "W_EMPTY"
    assert [output.name for output in report.paths] == ["t.stats.json"]


def test_when_nothing_is_left_the_dem_is_all_nodata(tmp_path):
    path = write_las(tmp_path / "t.las", hills(1000), classification=np.full(1000, 9))
    report = converted(path, tmp_path / "out", classes=(2,), cell="1", crs="EPSG:25832")
    assert report.status == "empty"
    assert "W_ALL_FILTERED" in codes(report)
    assert report.dem["cells_measured"] == 0
    assert report.dem["cells_void"] == report.dem["width"] * report.dem["height"] >= 49 * 49
    assert report.dem["z_min"] is None


def test_heights_in_feet_over_metres_are_scaled_for_the_cube_and_kept_in_the_dem(tmp_path):
    xyz = hills(5000)
    path = write_las(tmp_path / "t.las", xyz, classification=np.full(5000, 2))
    report = converted(path, tmp_path / "out", crs="EPSG:25832+6360", cell="1m")
    assert report.cube["z_scale"] == pytest.approx(1200 / 3937)
    crs = report.input["crs"]
    assert (crs["unit_xy"], crs["unit_z"]) == ("metre", "US survey foot")
    volume = vt.open(tmp_path / "out" / "t.vol.gz")
    assert volume.cube.origin[2] == pytest.approx(xyz[:, 2].min() / 100 * 1200 / 3937)
    assert report.dem["z_max"] == pytest.approx(xyz[:, 2].max() / 100, abs=0.5)
    assert volume.contains(xyz[::97] / 100).all()


def test_robust_z_drops_no_good_point_when_the_header_is_a_little_wrong(tmp_path):
    xyz = np.vstack([hills(5000), [[100, 100, 400_000]]])
    path = write_las(tmp_path / "t.las", xyz, crs=25832)
    break_header_box(path, min_z=xyz[:, 2].min() / 100 + 0.05, max_z=100.0)
    report = converted(path, tmp_path / "out", robust_z=True, dem=False)
    assert report.input["dropped"] == {"z_outlier": 1}
    assert report.cube["side"] == pytest.approx(49.99, abs=0.02)


def test_statistics_of_a_wrong_header_are_those_of_a_right_one(tmp_path):
    xyz = np.vstack([hills(5000), [[100, 100, 400_000]]])
    one = write_las(tmp_path / "one.las", xyz, crs=25832)
    two = write_las(tmp_path / "two.las", xyz, crs=25832)
    break_header_box(two, max_x=5e5, max_z=30.0)
    right, wrong = vt.stats([one, two])
    assert right.input["density"] == wrong.input["density"]
    assert "W_Z_OUTLIER" in codes(right)
    assert {"W_Z_OUTLIER", "W_HEADER_BBOX"} <= set(codes(wrong))


def test_overwriting_leaves_no_output_that_contradicts_the_new_ones(tmp_path):
    path = write_las(tmp_path / "t.las", hills(3000), crs=25832)
    converted(path, tmp_path / "out", depth=3, dem=False)
    assert (tmp_path / "out" / "t.dvol.gz").exists()
    converted(path, tmp_path / "out", depth=6, dem=False, overwrite=True)
    assert not (tmp_path / "out" / "t.dvol.gz").exists()


def test_each_cube_of_a_split_has_its_own_place(tmp_path):
    path = write_las(
        tmp_path / "t.las",
        hills(3000) * np.array([400, 400, 1]) + np.array([5e7, 5.5e8, 0]),
        crs=25832,
    )
    report = converted(path, tmp_path / "out", split="5km", depth=3, dem=False)
    places = {
        (volume.info.lat, volume.info.lon)
        for volume in map(vt.open, (tmp_path / "out").glob("*.vol.gz"))
    }
    assert len(places) == report.cube["cubes"] > 10


@pytest.mark.parametrize("side", ["1cm", "1e15"])
def test_a_split_into_too_many_cubes_is_refused(side, tmp_path):
    path = write_las(tmp_path / "t.las", hills(3000), crs=25832)
    if side == "1cm":
        with pytest.raises(vt.VolatoolError, match="more than 2048 cubes"):
            vt.convert(path, tmp_path / "out", split=side, dem=False)
    else:  # one cube for all, on integers that don't fit 64 bits
        assert converted(path, tmp_path / "out", split=side, dem=False).cube["cubes"] == 1


def test_a_given_length_makes_one_net(tmp_path):
    """--ell: a single net in the report, of that length in units of the CRS."""
    path = write_las(tmp_path / "t.las", hills(300), crs=25832)
    solver = vt.convert(path, tmp_path / "out", ell="2.5m", cell=1).dem["solver"]
    assert solver["rule"] == "given"
    (net,) = solver["nets"]
    assert net["ell"] == pytest.approx(2.5)
    assert net["tether"] is None


@pytest.mark.parametrize("k_surface", [1e-320, 1e-11, 1e300])
def test_a_stiffness_out_of_all_proportion_is_refused(k_surface, tmp_path):
    path = write_las(tmp_path / "t.las", hills(300), crs=25832)
    with pytest.raises(vt.VolatoolError, match="out of all proportion"):
        vt.convert(path, tmp_path / "out", k_surface=k_surface, cell=1)
    assert not (tmp_path / "out").exists() or not list((tmp_path / "out").iterdir())


@pytest.mark.parametrize("k_surface", [1e-7, 1e-3, 1e6])
def test_a_solver_that_gives_up_is_told(k_surface, tmp_path):
    path = write_las(tmp_path / "t.las", hills(300), crs=25832)
    report = vt.convert(path, tmp_path / "out", k_surface=k_surface, cell=1)
    assert report.dem["solver"]["converged"] == ("W_NOT_CONVERGED" not in codes(report))
    assert np.isfinite([report.dem["z_min"], report.dem["z_max"]]).all()


def test_degrees_are_refused_as_a_target_too(tmp_path):
    path = write_las(tmp_path / "t.las", hills(300) + np.array([5e7, 5.5e8, 0]), crs=25832)
    with pytest.raises(vt.VolatoolError, match="projected") as caught:
        vt.convert(path, tmp_path / "out", to_crs="EPSG:4326")
    assert caught.value.code == "E_GEOGRAPHIC"


@pytest.mark.parametrize("depth", [1, 2, 9, 10])
def test_every_depth_can_be_had_with_metadata(depth, tmp_path):
    path = write_las(tmp_path / "t.las", hills(3000), crs=25832, intensity=np.arange(3000))
    report = converted(path, tmp_path / "out", depth=depth, dem=False, dense="never")
    volume = vt.open(tmp_path / "out" / "t.vol.gz")
    assert volume.depth == depth == report.depth
    assert volume.has_metadata


@pytest.mark.parametrize(
    ("budget", "gzip"), [(1325, True), (1342, True), (6150, True), (93215, True), (100_000, False)]
)
def test_a_budget_is_kept_to_the_byte(budget, gzip, tmp_path):
    report = converted(SAMPLES / "town.laz", tmp_path, budget=budget, gzip=gzip, dem=False)
    assert report.paths[0].stat().st_size <= budget


def test_long_names_do_not_get_in_each_others_way(tmp_path):
    path = write_las(tmp_path / ("a" * 230 + ".las"), hills(3000), crs=25832)
    report = converted(path, tmp_path / "out", cell=1)
    assert len(report.paths) == 4
    assert not [other for other in (tmp_path / "out").iterdir() if other.name.startswith(".")]


@pytest.mark.parametrize("crs", ["EPSG:5773", "EPSG:4978"])
def test_a_crs_without_a_map_is_refused(crs, tmp_path):
    path = write_las(tmp_path / "t.las", hills(300))
    with pytest.raises(vt.VolatoolError, match=r"vertical|geocentric") as caught:
        vt.convert(path, tmp_path / "out", crs=crs)
    assert caught.value.code == "E_CRS"


def test_a_name_that_is_not_unicode_is_an_obstacle_to_gdal_only(tmp_path, caplog):
    caplog.set_level("CRITICAL", logger="volatool")  # pytest's workers send logs as Unicode
    path = Path(os.fsdecode(bytes(tmp_path) + b"/bad\xff.las"))
    write_las(path, hills(3000), crs=25832)
    assert len(vt.convert(path, tmp_path / "out", dem=False).paths) == 3
    with pytest.raises(vt.VolatoolError, match="Unicode only"):
        vt.convert(path, tmp_path / "out2", cell=1)


def test_a_pipe_is_refused_and_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "pipe.las")
    for work in (vt.convert, vt.stats, vt.open):
        with pytest.raises(vt.VolatoolError, match="regular file"):
            work(tmp_path / "pipe.las")


def test_an_explicit_cube_holds_the_points_or_is_refused(tmp_path):
    path = write_las(tmp_path / "t.las", hills(3000) + np.array([10_000, 20_000, 0]), crs=25832)
    report = converted(path, tmp_path / "a", cube="64m", dem=False)
    assert report.cube["side"] == 64
    snapped = converted(path, tmp_path / "b", cube="1024m", snap=True, dem=False)
    assert [value % 1024 for value in snapped.cube["origin"]] == [0, 0, 0]
    assert snapped.cube["snapped"]
    with pytest.raises(vt.VolatoolError, match="shorter than the points"):
        vt.convert(path, tmp_path / "c", cube="10m")
    assert not (tmp_path / "c").exists() or not list((tmp_path / "c").iterdir())


def test_the_resolution_asked_for_is_not_exceeded(tmp_path):
    path = write_las(tmp_path / "t.las", hills(3000), crs=25832)
    report = converted(path, tmp_path / "a", resolution="1m", dem=False)
    assert report.choice["cell"] <= 1 < 4 * report.choice["cell"]
    assert report.choice["rule"] == "resolution"


def test_every_report_survives_json(tmp_path):
    report = vt.convert(SAMPLES / "forest.laz", tmp_path)
    again = Report.from_dict(json.loads(report.to_json()))
    assert again.to_dict() == report.to_dict()
    with pytest.raises(vt.VolatoolError, match="not a report"):
        Report.from_dict({"schema": "other"})
    assert "<table>" in report._repr_html_()


def test_compat_toolkit_writes_no_trailer_and_all_points(tmp_path):
    path = tmp_path / "town.laz"
    shutil.copy(SAMPLES / "town.laz", path)
    report = converted(path, tmp_path / "o", compat="toolkit", depth=3, dem=False, gzip=False)
    assert "W_TOOLKIT" in codes(report)
    sparse = next(row for row in report.encodings if row["kind"] == "sparse")
    assert sparse["file_bytes"] == 80 + sparse["payload_bytes"]


GOLDEN = [
    "4_6_crop-s3n.vol",
    "autzen_trim-s4.vol",
    "lonestar9-d2n.dvol",
    "megaplot-s3n-nocrs.vol",
    "meta_offset-s3n.vol",
    "meta_fmt1-s2n.vol",
]


@pytest.mark.parametrize("name", GOLDEN)
def test_compat_toolkit_from_the_command_line_equals_the_golden_file(name, shared, tmp_path):
    cases = json.loads((shared / "golden" / "expected.json").read_text())["cases"]
    case = next(case for case in cases if case["file"] == name)
    source = {
        "megaplot": "lidR-Megaplot.laz",
        "4_6_crop": "../../tiles/4_6_crop.las",
        "autzen_trim": "../../tiles/autzen_trim.las",
        "lonestar9": "lonestar9.laz",
    }
    stem = name.rsplit("-s" if "-s" in name else "-d", 1)[0]
    path = shared / "golden" / "inputs" / source.get(stem, f"{stem}.las")
    report = vt.convert(
        path,
        tmp_path,
        compat="toolkit",
        depth=case["depth"],
        gzip=False,
        dem=False,
        crs=f"EPSG:{case['header']['crs']}" if case["header"]["crs"] != 2000 else None,
        meta=("rgb", "height", "returns", "intensity", "class") if case["nbits"] else (),
        dense="always" if case["mode"] == "dense" else "never",
    )
    suffix = Path(name).suffix
    made = next(output for output in report.paths if output.suffix == suffix).read_bytes()
    golden = (shared / "golden" / "files" / name).read_bytes()
    assert made[:16] + made[32:] == golden[:16] + golden[32:]


def test_a_length_asks_for_a_single_net(tmp_path):
    """`--ell` is in units of its own, and the report tells it in those of the CRS."""
    path = write_las(tmp_path / "t.las", hills(3000), crs=2263)  # feet
    report = vt.convert(path, tmp_path / "out", ell="250cm", cell="1m")
    (net,) = report.dem["solver"]["nets"]
    assert report.dem["solver"]["rule"] == "given"
    assert net["ell"] == pytest.approx(2.5 / (1200 / 3937))
