"""Seamless mosaics: tiles with the neighbours that an index of headers finds equal one model."""

from __future__ import annotations

import json
from dataclasses import replace

import laspy
import numpy as np
import pytest
from making_tiles import write_las

from volatool import opening as opening_module
from volatool import tile as tile_module
from volatool.catalog.headers import index_headers, read_set, set_lines
from volatool.dem import mosaic as mosaics
from volatool.dem.gdal import opened
from volatool.dem.raster import read_dem
from volatool.errors import FormatError, InputError
from volatool.options import ConvertOptions
from volatool.tile import convert_tile


def las(path, xyz, code=2, crs="EPSG:25832"):
    """Write points of one class."""
    return write_las(path, xyz, crs=crs, classification=np.full(len(xyz), code, np.uint8))


def quarters(folder, n=40_000, side=200.0):
    """Write four tiles of hills and all in one; return the paths of the four, and of the one."""
    rng = np.random.default_rng(4)
    x, y = rng.uniform(0, side, (2, n))
    z = 100 + 5 * np.sin(x / 20) * np.cos(y / 17) + rng.normal(0, 0.03, n)
    xyz = np.round(np.column_stack([x, y, z]) * 100).astype(np.int64)
    at = np.minimum(xyz[:, :2] // round(side * 50), 1)
    folder.mkdir()
    paths = []
    for col in (0, 1):
        for row in (0, 1):
            part = xyz[np.all(at == (col, row), axis=1)]
            paths.append(las(folder / f"t{col}{row}.las", part))
    return paths, las(folder.parent / "whole.las", xyz)


def make(paths, folder, name="set", **options):
    """Make models of tiles and their mosaic, as the command does; return what it says."""
    shared = str(mosaics.set_path(folder, name))
    asked = ConvertOptions(**options, neighbours=(shared,), params_from=shared)
    mosaics.prepare(paths, asked, folder, name)
    reports = [convert_tile(path, asked, kind="dem", outdir=folder) for path in paths]
    models = [report.paths[0] for report in reports]
    document, _ = mosaics.finish(models, folder, name, asked, cog=True, overwrite=False)
    return reports, document


def off_by(part, whole):
    """Largest difference of two models of one extent, and cells that only one has."""
    assert part.z.shape == whole.z.shape
    assert (part.grid.left, part.grid.top) == (whole.grid.left, whole.grid.top)
    return np.nanmax(np.abs(part.z - whole.z)), np.count_nonzero(
        np.isnan(part.z) != np.isnan(whole.z)
    )


@pytest.mark.shared
@pytest.mark.parametrize("code", [2, 1], ids=["class", "filter"])
def test_delft_is_seamless_across_x_85000(shared, tmp_path, code):
    """The mosaic of the two AHN3 tiles is the model of all points to 1 mm in every cell."""
    paths, records = [], []
    for name in ("ahn3_cropped_1", "ahn3_cropped_2"):
        read = laspy.read(shared / "tiles" / f"{name}.laz")
        if code == 1:
            read.classification[:] = 1
        records.append(read.points.array)
        read.write(tmp_path / f"{name}.las")
        paths.append(tmp_path / f"{name}.las")
    whole = laspy.LasData(read.header)
    whole.points = laspy.ScaleAwarePointRecord(
        np.concatenate(records),
        whole.header.point_format,
        whole.header.scales,
        whole.header.offsets,
    )
    whole.write(tmp_path / "whole.las")
    out = tmp_path / "out"
    _, said = make(paths, out, cell=1, layers=("flag",))
    rule = ConvertOptions(params_from=str(out / "set.set.json"), layers=("flag",))
    report = convert_tile(tmp_path / "whole.las", rule, kind="dem", outdir=out)
    wanted = read_dem(out / "whole.dem.tif")
    for suffix in ("vrt", "tif"):
        difference, only_one = off_by(read_dem(out / f"set.dem.{suffix}"), wanted)
        assert difference <= 1e-3
        assert only_one == 0
    for key in ("cells_measured", "cells_filled", "cells_void", "width", "height"):
        assert said[key] == report.dem[key], key


def test_a_mosaic_of_four_is_the_model_of_all(tmp_path):
    paths, whole = quarters(tmp_path / "in")
    out = tmp_path / "out"
    _, said = make(paths, out, max_gap=5, layers=("flag", "count"))
    rule = ConvertOptions(params_from=str(out / "set.set.json"), max_gap=5, layers=("flag",))
    report = convert_tile(whole, rule, kind="dem", outdir=out)
    wanted = read_dem(out / "whole.dem.tif")
    difference, only_one = off_by(read_dem(out / "set.dem.tif"), wanted)
    assert difference <= 1e-3
    assert only_one == 0
    assert said["tiles"] == 4
    assert said == json.loads((out / "set.mosaic.json").read_text(encoding="utf-8"))
    for key in ("cells_measured", "cells_filled", "cells_void", "cell"):
        assert said[key] == report.dem[key], key
    flags = [read_dem(out / f"{name}.dem.flag.tif").z for name in ("set", "whole")]
    np.testing.assert_array_equal(*flags)


def test_the_spacing_is_that_of_all_points_in_one(tmp_path):
    """Measured on the tiles, it is within 1 % of what the model of all points would take."""
    paths, whole = quarters(tmp_path / "in")
    out = tmp_path / "out"
    options = ConvertOptions()
    mosaics.prepare(paths, options, out, "set")
    with (out / "set.set.json").open(encoding="utf-8") as lines:
        document = json.loads(next(lines))
    alone = convert_tile(whole, options, kind="dem", outdir=out)
    assert document["dem"]["cell"] == alone.dem["cell"]
    assert document["dem"]["spacing"] == pytest.approx(alone.dem["spacing"], rel=0.01)


def test_a_tile_opens_only_its_neighbours(tmp_path, monkeypatch):
    """Of a hundred tiles each opens itself and those whose points it reads, no other header."""
    paths, _ = quarters(tmp_path / "in", n=8000)
    far = []
    for number in range(100):
        xyz = np.array([[0, 0, 0], [100, 100, 0]]) + 1_000_000 * (number + 1)
        far.append(las(tmp_path / "in" / f"far{number}.las", xyz))
    shared = str(mosaics.set_path(tmp_path, "set"))
    asked = ConvertOptions(cell=2, max_gap=5, neighbours=(shared,), params_from=shared)
    mosaics.prepare([*paths, *far], asked, tmp_path, "set")
    seen = []
    opening = tile_module.open_source

    def told(path, *arguments, **more):
        seen.append(path.name)
        return opening(path, *arguments, **more)

    for module in (tile_module, opening_module):
        monkeypatch.setattr(module, "open_source", told)
    report = convert_tile(paths[0], asked, kind="dem", outdir=tmp_path / "out")
    assert sorted(seen) == ["t00.las", "t01.las", "t10.las", "t11.las"]
    assert report.dem["buffer"]["neighbours"] == ["t01.las", "t10.las", "t11.las"]


def test_the_index_file_holds_what_the_headers_say(tmp_path):
    paths, _ = quarters(tmp_path / "in", n=2000)
    (tmp_path / "in" / "bad.las").write_bytes(b"LASF" + b"\0" * 400)
    empty = las(tmp_path / "in" / "empty.las", np.empty((0, 3), int))
    index = index_headers([*paths, tmp_path / "in" / "bad.las", empty], ConvertOptions())
    assert [path.name for path in index.failed] == ["bad.las"]
    assert len(index) == 4
    boxes = index.boxes.copy()
    boxes[1] = np.nan  # a header without a box may be anywhere
    path = tmp_path / "a.set.json"
    path.write_bytes(b"".join(set_lines(replace(index, boxes=boxes), 1.0, 0.5)))
    again = read_set(path)
    assert list(again.paths) == [p.resolve() for p in paths]
    assert again.crs == list(index.crs)
    assert np.array_equal(again.boxes, boxes, equal_nan=True)
    assert again.near(-50, -50, -10, -10) == [1]
    assert again.near(99.5, 99.5, 101, 101) == [0, 1, 2, 3]
    cut = path.read_text(encoding="utf-8").rpartition("[")[0]
    for text in ("", "{}", "[", '{"schema": "volatool.set/1", "tiles": {}}', cut):
        path.write_text(text, encoding="utf-8")
        with pytest.raises(FormatError, match=r"a\.set\.json") as error:
            read_set(path)
        assert error.value.code == "E_NOT_REPORT"


def test_a_set_without_points_is_refused(tmp_path):
    empty = las(tmp_path / "e.las", np.empty((0, 3), int))
    with pytest.raises(InputError, match="has a point"):
        mosaics.prepare([empty], ConvertOptions(), tmp_path / "out", "set")
    assert not (tmp_path / "out").exists()


def test_a_wide_mosaic_is_read_in_squares(tmp_path, monkeypatch):
    """The COG's tags are those of all cells, whatever the squares."""
    paths, _ = quarters(tmp_path / "in", n=8000)
    monkeypatch.setattr(mosaics, "WINDOW", 64)
    make(paths, tmp_path / "out", cell=1, max_gap=5)
    model = read_dem(tmp_path / "out" / "set.dem.tif")
    assert model.statistics["STATISTICS_MAXIMUM"] == pytest.approx(np.nanmax(model.z), abs=1e-4)
    assert model.tags["surface"] == "dtm"
    assert model.tags["TILES"] == "4"
    with opened(tmp_path / "out" / "set.dem.tif") as file:
        assert file.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
