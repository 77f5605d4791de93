"""Seams: a model made tile by tile equals the one made whole, and only strips are read for it."""

from __future__ import annotations

import json

import jsonschema
import laspy
import numpy as np
import pytest
from making_tiles import write_las

from volatool.dem.raster import read_dem
from volatool.errors import CRSError, InputError, OptionError
from volatool.options import ConvertOptions
from volatool.points.reader import PointSource
from volatool.report import schema
from volatool.tile import convert_tile

SIZE = 300.0
"""Side of the made-up ground in metres; the tiles meet at x = 150."""


def ground(n=60_000, seed=0, hole=None):
    """Return stored x, y, z in cm of points on hills, without those of a hole."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(0, SIZE, (2, n))
    z = 100 + 5 * np.sin(x / 20) * np.cos(y / 17) + rng.normal(0, 0.03, n)
    xyz = np.round(np.column_stack([x, y, z]) * 100).astype(np.int64)
    if hole is not None:
        left, bottom, right, top = (100 * side for side in hole)
        x, y = xyz[:, 0], xyz[:, 1]
        xyz = xyz[~((x > left) & (x < right) & (y > bottom) & (y < top))]
    return xyz


def tiles(folder, xyz, *, classification=2, **attributes):
    """Write west, east and both; return their paths."""
    folder.mkdir()
    west = xyz[:, 0] < 15_000
    names = {"west": west, "east": ~west, "whole": np.ones(len(xyz), bool)}
    return {
        name: las(folder / f"{name}.las", xyz[part], classification, **attributes)
        for name, part in names.items()
    }


def las(path, xyz, code=2, crs="EPSG:25832", **attributes):
    """Write points of one class."""
    codes = np.full(len(xyz), code, np.uint8)
    return write_las(path, xyz, crs=crs, classification=codes, **attributes)


def model(path, outdir, **options):
    """Return report, model and flags of a tile."""
    report = convert_tile(
        path, ConvertOptions(layers=("flag",), **options), kind="dem", outdir=outdir, overwrite=True
    )
    jsonschema.validate(report.to_dict(), schema())
    stem = path.stem
    return report, read_dem(outdir / f"{stem}.dem.tif"), read_dem(outdir / f"{stem}.dem.flag.tif").z


def largest_difference(part, whole):
    """Largest difference in height where both have one, and cells of which only one has."""
    row = round((whole.grid.top - part.grid.top) / part.grid.cell)
    col = round((part.grid.left - whole.grid.left) / part.grid.cell)
    same = whole.z[row : row + part.grid.height, col : col + part.grid.width]
    assert same.shape == part.z.shape
    return np.nanmax(np.abs(part.z - same)), np.count_nonzero(np.isnan(part.z) != np.isnan(same))


def reports_of(path, *reports):
    path.write_text("\n".join(report.to_json() for report in reports), encoding="utf-8")
    return str(path)


@pytest.mark.shared
@pytest.mark.parametrize("code", [2, 1], ids=["class", "filter"])
def test_delft_by_tiles_is_delft_whole(shared, tmp_path, code):
    """Two AHN3 tiles that meet in a canal and blocks of houses: to 1 mm in every cell."""
    parts = {"west": "ahn3_cropped_1", "east": "ahn3_cropped_2"}
    read = {name: laspy.read(shared / "tiles" / f"{stem}.laz") for name, stem in parts.items()}
    whole = laspy.LasData(read["west"].header)
    records = np.concatenate([las.points.array for las in read.values()])
    whole.points = laspy.ScaleAwarePointRecord(
        records, whole.header.point_format, whole.header.scales, whole.header.offsets
    )
    for name, las in {**read, "whole": whole}.items():
        if code == 1:
            las.classification[:] = 1
        las.write(tmp_path / f"{name}.las")
    report, wanted, flags = model(tmp_path / "whole.las", tmp_path, cell=1)
    rule = {"params_from": reports_of(tmp_path / "set.json", report)}
    for name in parts:
        alone, found, _ = model(tmp_path / f"{name}.las", tmp_path, **rule)
        assert largest_difference(found, wanted)[0] > 0.1
        assert "buffer" not in alone.dem
        near, found, found_flags = model(
            tmp_path / f"{name}.las",
            tmp_path,
            neighbours=tuple(str(tmp_path / f"{other}.las") for other in parts),
            **rule,
        )
        difference, only_one = largest_difference(found, wanted)
        assert difference <= 1e-3
        assert only_one == 0
        left = round(found.grid.left - wanted.grid.left)
        assert np.array_equal(found_flags, flags[:, left : left + found.grid.width])
        (other,) = set(parts) - {name}
        assert near.dem["buffer"]["neighbours"] == [f"{other}.las"]
        if name == "east":  # the western tile is 192 m wide: not all of it is read
            assert near.dem["buffer"]["length"] < 150
            assert near.dem["buffer"]["points"] < 0.7 * len(read["west"].points)
        assert near.input["points_used"] == len(read[name].points)


def test_the_buffer_grows_beyond_a_gap_at_the_seam(tmp_path):
    """A gap of 60 cells across the seam: 32 cells are not enough, the chosen buffer is."""
    paths = tiles(tmp_path / "in", ground(hole=(140, 60, 200, 240)))
    report, whole, _ = model(paths["whole"], tmp_path, cell=1)
    rule = {"params_from": reports_of(tmp_path / "set.json", report), "max_gap": 5}
    names = {"neighbours": (str(paths["west"]), str(paths["east"]))}
    short, part, _ = model(paths["west"], tmp_path, buffer=32, **names, **rule)
    assert [w.code for w in short.warnings] == ["W_SEAM_GAP"]
    assert largest_difference(part, whole)[0] > 1e-3
    grown, part, _ = model(paths["west"], tmp_path, **names, **rule)
    assert grown.warnings == ()
    assert 50 + 32 <= grown.dem["buffer"]["cells"] < 150
    assert largest_difference(part, whole)[0] <= 1e-3
    plain = tiles(tmp_path / "plain", ground())
    names = {"neighbours": (str(plain["east"]),)}
    small, _, _ = model(plain["west"], tmp_path, **names, **rule)
    assert small.dem["buffer"]["cells"] == 32


def test_only_strips_are_read(tmp_path, monkeypatch):
    """Points of neighbours are decoded only if their header's box meets the buffer."""
    xyz = ground(20_000)
    paths = tiles(tmp_path / "in", xyz)
    far = las(tmp_path / "in" / "far.las", xyz + np.array((0, 100_000, 0)))
    read = []
    chunks = PointSource.chunks

    def told(self, *arguments, **near):
        read.append(self.name)
        return chunks(self, *arguments, **near)

    monkeypatch.setattr(PointSource, "chunks", told)
    paths["whole"].unlink()
    report, _, _ = model(paths["west"], tmp_path, cell=2, max_gap=5, neighbours=(str(far.parent),))
    assert set(read) == {"west.las", "east.las"}
    buffer = report.dem["buffer"]
    strip = np.count_nonzero((xyz[:, 0] >= 15_000) & (xyz[:, 0] <= 15_000 + 100 * buffer["length"]))
    assert (buffer["neighbours"], buffer["points"]) == (["east.las"], strip)
    assert buffer["length"] == 64
    assert [w.code for w in report.warnings] == ["W_SEAM_SPRINGS"]


@pytest.mark.parametrize("surface", ["dsm", "min", "mean", "idw", "tin"])
def test_every_surface_meets_its_neighbour(tmp_path, surface):
    paths = tiles(tmp_path / "in", ground(30_000))
    options = {"surface": surface}
    report, whole, _ = model(paths["whole"], tmp_path, cell=2, **options)
    if surface == "dsm":
        options["params_from"] = reports_of(tmp_path / "set.json", report)
    else:
        options["cell"] = 2
    for name, other in (("west", "east"), ("east", "west")):
        made, part, _ = model(paths[name], tmp_path, neighbours=str(paths[other]), **options)
        difference, only_one = largest_difference(part, whole)
        assert difference <= 1e-3
        assert only_one == 0
        assert made.warnings == ()


def test_another_scale_and_offset_are_the_same_points(tmp_path):
    """A neighbour stored otherwise gives the same model; finer digits are rounded."""
    xyz = ground(20_000)
    paths = tiles(tmp_path / "in", xyz)
    east = xyz[xyz[:, 0] >= 15_000]
    moved = las(
        tmp_path / "moved.las",
        (east - np.array((30_000, 0, 10_000))) * 10,
        scale=0.001,
        offset=(300.0, 0.0, 100.0),
    )
    options = {"cell": 2, "max_gap": 5}
    found = [
        model(paths["west"], tmp_path, neighbours=str(path), **options)[1].z
        for path in (paths["east"], moved)
    ]
    np.testing.assert_array_equal(*found)


def test_other_units_are_refused_and_no_crs_is_taken_for_the_same(tmp_path):
    paths = tiles(tmp_path / "in", ground(5_000))
    options = {"cell": 5, "neighbours": (str(paths["east"]),)}
    east = ground(5_000)
    east = east[east[:, 0] >= 15_000]
    for crs, what in (("EPSG:25833", "CRS"), ("EPSG:25832+6360", "vertical unit")):
        las(paths["east"], east, crs=crs)
        with pytest.raises(CRSError, match=f"neighbour east.las: its ({what}) is") as error:
            model(paths["west"], tmp_path / "out", **options)
        assert error.value.code == "E_CRS"
        assert not (tmp_path / "out").exists()
    las(paths["east"], east, crs=None)
    assert model(paths["west"], tmp_path, **options)[0].dem["buffer"]["points"] > 0


def test_two_kinds_of_ground_are_told(tmp_path):
    xyz = ground(20_000)
    classed, plain = tiles(tmp_path / "a", xyz), tiles(tmp_path / "b", xyz, classification=1)
    for tile, other, word in (
        (classed, plain, "it has none"),
        (plain, classed, "the tile has none"),
    ):
        report, _, _ = model(tile["west"], tmp_path, cell=2, neighbours=str(other["east"]))
        (told,) = (w for w in report.warnings if w.code == "W_NEIGHBOUR_GROUND")
        assert word in told.message


def test_a_broken_neighbour_fails_the_tile_by_its_name(tmp_path):
    paths = tiles(tmp_path / "in", ground(2_000))
    paths["east"].write_bytes(paths["east"].read_bytes()[:1000])
    with pytest.raises(InputError, match=r"neighbour east\.las") as error:
        model(paths["west"], tmp_path / "out", cell=5, neighbours=str(paths["east"]))
    assert error.value.code == "E_TRUNCATED"
    with pytest.raises(InputError, match="no such file") as error:
        model(paths["west"], tmp_path / "out", cell=5, neighbours=str(tmp_path / "none.las"))
    assert error.value.code == "E_NOT_FOUND"
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"neighbours": "x"}, "needs --cell, --like or --params-from"),
        ({"buffer": "10m"}, "--buffer is for --neighbours"),
        ({"neighbours": "x", "cell": 1, "bounds": (0, 0, 1, 1)}, "--bounds is about one tile"),
        ({"neighbours": "x", "cell": 1, "robust_z": True}, "--robust-z is about one tile"),
        ({"like": "x.tif", "cell": 1}, "leave out --cell"),
    ],
)
def test_options_that_do_not_go_together(options, message):
    with pytest.raises(OptionError, match=message):
        ConvertOptions(**options)


def test_parameters_of_a_set_are_medians(tmp_path):
    """Of reports a line; other cells or units, and files that are no reports, are refused."""
    paths = tiles(tmp_path / "in", ground(3_000))
    found = [model(paths[name], tmp_path, cell=5)[0] for name in ("west", "east", "whole")]
    name = reports_of(tmp_path / "set.jsonl", *found)
    made, part, _ = model(paths["west"], tmp_path, params_from=name)
    assert made.dem["spacing"] == np.median([report.dem["spacing"] for report in found])
    stiffness = [report.dem["solver"]["k_surface"] for report in found]
    assert made.dem["solver"]["k_surface"] == pytest.approx(np.median(stiffness))
    assert part.grid.cell == 5
    other = model(paths["west"], tmp_path, cell=4)[0]
    with pytest.raises(OptionError, match="cells of 4, 5"):
        model(paths["west"], tmp_path, params_from=reports_of(tmp_path / "two", *found, other))
    feet = las(tmp_path / "feet.las", ground(2_000), crs="EPSG:2994")
    with pytest.raises(OptionError, match="this tile is in foot"):
        model(feet, tmp_path, params_from=name)
    for text in ("", "{", "[]", "{}", json.dumps({"dem": {"spacing": 1}})):
        (tmp_path / "bad").write_text(text, encoding="utf-8")
        with pytest.raises(InputError) as error:
            model(paths["west"], tmp_path, params_from=str(tmp_path / "bad"))
        assert error.value.code == "E_NOT_REPORT"
    with pytest.raises(InputError, match="can't be read") as error:
        model(paths["west"], tmp_path, params_from=str(tmp_path / "none"))
    assert error.value.code == "E_NOT_FOUND"
