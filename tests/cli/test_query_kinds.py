"""The kinds of ``volatool query``: lines and JSON say what the library says."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from making_volumes import INFO, random_volume

from volatool.formats import sparse
from volatool_cli.main import cli

SAMPLES = Path(__file__).resolve().parents[2] / "data_samples"


@pytest.fixture(scope="module")
def volume():
    channel = {"byte": 6, "name": "class", "scale": 1.0, "offset": 0.0, "unit": "", "reduction": ""}
    return random_volume(3, 2000, info=replace(INFO, channels=(*INFO.channels, channel)))


@pytest.fixture
def ask(volume, tmp_path):
    """Run ``volatool query`` in this process; return its lines, or JSON objects with --json."""
    path = tmp_path / "v.vol"
    with path.open("wb") as file:
        sparse.write(file, volume)

    def run(*words, stdin="", status=0):
        done = CliRunner().invoke(cli, ["query", str(path), *map(str, words)], input=stdin)
        assert done.exit_code == status, done.output
        if status:
            return done.stderr
        lines = done.stdout.splitlines()
        return [json.loads(line) for line in lines] if "--json" in words else lines

    run.folder = tmp_path
    return run


def rows_of(values):
    return "".join(" ".join(map(repr, row)) + "\n" for row in np.asarray(values).tolist())


def test_points_tell_cell_and_metadata(ask, volume):
    xyz = volume.centers()[:40]
    found = ask("point", "--json", stdin=rows_of(xyz))
    assert [record["cell"] for record in found] == volume.voxels()[:40].tolist()
    for name in ("height", "class"):
        values = volume.channel(name)[:40]
        assert [record["metadata"][name] for record in found] == pytest.approx(values.tolist())
    assert [record["query"] for record in found] == xyz.tolist()
    free = volume.cube.corners(np.array([[0, 0, 0]], np.int32), 3)[0]
    (record,) = ask("point", "--json", *(free - 0.001).tolist())
    assert record == {"answer": "outside", "query": (free - 0.001).tolist()}


def test_boxes(ask, volume):
    center = volume.centers()[3].tolist()
    (record,) = ask("box", "--json", *center, *center)
    assert (record["answer"], record["voxels"], record["blocks"], record["fill"]) == (
        "some", 1, 1, 1.0,
    )  # fmt: skip
    assert (np.array(record["tight"][:3]) < center).all()
    assert (np.array(record["tight"][3:]) > center).all()
    (line,) = ask("box", *["-inf"] * 3, *["inf"] * 3)
    assert line.startswith(f"{len(volume)} voxels in {volume.n_blocks()} blocks, fill 0.0")
    assert ask("box", 0, 0, 0, 1, 1, 1) == ["outside"]
    low = np.array(volume.cube.origin) + 0.01
    empty = [*low, *low] if not volume.contains([low])[0] else None
    assert empty is None or ask("box", *empty) == ["none"]
    error = ask("box", stdin="0 0 0 1 1 1\n#\n1 0 0 0 1 1\n", status=2)
    assert error.startswith("E_OPTION: line 3 of stdin: a box needs X0 <= X1")


def test_a_box_that_is_none_ends_after_the_answers_before_it(ask):
    error = CliRunner().invoke(
        cli,
        ["query", str(ask.folder / "v.vol"), "box"],
        input="0 0 0 1 1 1\n1 1 1 2 2 2\n1 0 0 0 1 1\n0 0 0 1 1 1\n",
    )
    assert (error.exit_code, error.stdout) == (2, "outside\noutside\n")


def test_columns(ask, volume):
    x, y, _ = volume.centers()[5]
    (line,) = ask("column", x, y)
    (record,) = ask("column", x, y, "--json")
    runs = list(map(list, volume.column(x, y)))
    assert record["runs"] == runs
    assert line.startswith(f"{len(runs)} run")
    assert line.count("..") == len(runs)
    corner = np.array(volume.cube.origin[:2])
    grid = corner + (np.stack(np.meshgrid(range(64), range(64)), -1).reshape(-1, 2) + 0.5) / 6.4
    words = ask("column", stdin=rows_of(grid))
    is_empty = [not len(column) for column in volume.columns(grid)]
    assert [word == "empty" for word in words] == is_empty
    assert any(is_empty)
    assert ask("column", 0, 0, "nan", 1) == ["outside", "outside"]


def test_rays(ask, volume):
    centers = volume.centers()
    origin = centers.mean(0) + np.array([0, 0, 50])
    rows = np.hstack([np.tile(origin, (20, 1)), centers[:20] - origin])
    found = ask("ray", "--json", stdin=rows_of(rows))
    hits = volume.ray(origin, centers[:20] - origin)
    assert [record["voxel"] for record in found] == hits.voxels.tolist()
    assert [record["distance"] for record in found] == hits.distance.tolist()
    assert [record["blocks"] for record in found] == hits.blocks.tolist()
    (line,) = ask("ray", *rows[0].tolist())
    word, distance, *point = line.replace(" at", "").split()
    assert word == "hit"
    assert float(distance) == pytest.approx(hits.distance[0], abs=1e-6)
    assert list(map(float, point)) == pytest.approx(hits.points[0].tolist(), abs=1e-6)
    assert ask("ray", *origin.tolist(), 0, 0, 1) == ["none"]
    assert ask("ray", *origin.tolist(), "nan", 0, 1) == ["outside"]
    away = float(hits.distance[0])
    assert ask("ray", *rows[0].tolist(), "--max-distance", f"{away - 0.01:.6f}") == ["none"]
    assert ask("ray", *rows[0].tolist(), "--max-distance", f"{away + 0.01:.6f}ft") != ["none"]
    metres = f"{(away + 0.01) * 0.3048:.6f}m"
    assert ask("ray", *rows[0].tolist(), "--max-distance", metres) != ["none"]
    error = ask("ray", stdin="1 2 3 4 5 6\n1 2 3 0 0 0\n", status=2)
    assert error == "E_OPTION: line 2 of stdin: a ray needs a direction that is not zero\n"


def test_sights(ask, volume):
    a, b = volume.centers()[[0, -1]]
    (record,) = ask("sight", "--json", *a, *b)
    assert (record["answer"], record["distance"]) == ("blocked", 0.0)
    found = volume.sight(a, b, ignore_ends=True)
    (record,) = ask("sight", "--json", "--ignore-ends", *a, *b)
    assert (record["answer"] == "clear") == found.is_clear[0]
    assert record["length"] == found.length[0]
    up = np.array([0, 0, 100])
    far = [*(a + up), *(b + up)]
    (line,) = ask("sight", *far)
    assert line.startswith("clear ")
    assert float(line.split()[1]) == pytest.approx(found.length[0], abs=1e-6)
    assert ask("sight", *a, "inf", 0, 0) == ["outside"]
    assert ask("sight", "-1.7e308", 0, 0, "1.7e308", 0, 0) == ["outside"]


def test_neighbours(ask, volume):
    xyz = volume.centers()[:30]
    found = ask("neighbours", "--json", stdin=rows_of(xyz))
    for name in (6, 26):
        expected = volume.neighbours(xyz, connectivity=name).tolist()
        assert [record[str(name)] for record in found] == expected
    inside = volume.neighbours(xyz[:1], connectivity=18, exact=False)[0]
    assert ask("neighbours", "--by-block", "--connectivity", 18, *xyz[0]) == [f"{inside} of 18"]
    n = volume.neighbours(xyz[:1], radius=2.5)[0]
    assert ask("neighbours", "--radius", 2.5, *xyz[0]) == [f"{n} within 2.5 cells"]
    assert ask("neighbours", 0, 0, 0) == ["outside"]
    errors = ask("neighbours", "--error", "--json")
    assert errors == [volume.neighbour_error(6).to_dict(), volume.neighbour_error(26).to_dict()]
    assert ask("neighbours", "--error")[0].startswith("of 6: mean ")
    assert "no coordinates" in ask("neighbours", "--error", 1, 2, 3, status=2)
    assert "not both" in ask("neighbours", "--radius", 1, "--connectivity", 6, 1, 2, 3, status=2)


def test_a_census_of_boxes(ask, volume):
    low, high = volume.centers()[[100, 1500]]
    low, high = np.minimum(low, high), np.maximum(low, high)
    flat = [*low[:2].tolist(), *high[:2].tolist()]
    records = ask("census", "--json", "--bands", "-inf,401,inf", stdin=rows_of([flat]))
    expected = volume.census(flat, bands=[-np.inf, 401, np.inf])
    assert records[0]["classes"] == {str(code): n for code, n in expected.classes.items()}
    assert records[0]["channels"]["height"]["mean"] == expected.channels["height"].mean
    assert records[0]["tight"] == [*expected.low.tolist(), *expected.high.tolist()]
    assert [band["voxels"] for band in records[0]["bands"]] == [b.voxels for b in expected.bands]
    assert records[0]["query"] == [*flat[:2], None, *flat[2:], None]
    (record,) = ask("census", "--json", *low, *high)
    assert record["voxels"] == volume.census([*low, *high]).voxels
    (line,) = ask("census", "--all", "--z", 401, "inf", "--bands", "400,401,402.5")
    census = volume.census(z=(401, np.inf), bands=[400, 401, 402.5])
    assert line.startswith(f"{census.voxels} voxels in {census.blocks} blocks, ")
    assert f"; 400..401: 0; 401..402.5: {census.bands[1].voxels} (" in line
    assert "cubic foot; classes " in line
    assert ask("census", 0, 0, 1, 1) == ["none"]
    assert "not two of them" in ask("census", "--all", 0, 0, 1, 1, status=2)
    assert "ascending" in ask("census", "--all", "--bands", "2,1", status=2)
    assert "not a list of numbers" in ask("census", "--all", "--bands", "2,x", status=2)
    error = ask("census", stdin="0 0 1 1\n0 0 0 1 1\n", status=2)
    assert error.startswith(
        "E_OPTION: line 2 of stdin: expected 6 numbers, X0 Y0 Z0 X1 Y1 Z1, or 4"
    )


def test_a_census_of_polygons(ask, volume):
    """A file of WKT, and WKT itself."""
    import shapely

    (x0, y0), (x1, y1) = volume.centers()[:, :2].min(0), volume.centers()[:, :2].max(0)
    triangle = shapely.Polygon([(x0, y0), (x1, y0), (x0, y1)])
    square = shapely.box(x0, y0, (x0 + x1) / 2, (y0 + y1) / 2)
    (ask.folder / "areas.wkt").write_text(f"{triangle.wkt} # of the trees\n\n# and\n{square.wkt}\n")
    expected = [volume.census(polygon=shape).voxels for shape in (triangle, square)]
    wkt = ask("census", "--json", "--polygon", ask.folder / "areas.wkt")
    assert [record["voxels"] for record in wkt] == expected
    assert [record["polygon"] for record in wkt] == [1, 2]
    (line,) = ask("census", "--polygon", square.wkt)
    assert line.startswith(f"{expected[1]} voxels in ")


def test_polygons_that_can_not_be_read(ask, monkeypatch):
    (ask.folder / "bad.wkt").write_text("POLYGON ((0 0, 1 1")
    for name, code in (
        (ask.folder / "gone.geojson", "E_NOT_FOUND"),
        (ask.folder / "bad.wkt", "E_NOT_VECTOR"),
        ("GEOMETRYCOLLECTION (POINT (1 1))", "E_NOT_VECTOR"),
        ("POLYGON ((0 0, 1 inf, 1 1, 0 0))", "E_NOT_VECTOR"),
        (ask.folder / "v.vol", "E_NOT_VECTOR"),
    ):
        assert ask("census", "--polygon", name, status=4).startswith(f"{code}: ")
    (ask.folder / "bad.wkt").write_text("POLYGON ((0 0, 1 1, 1 0, 0 0))\n\nPOINT")
    assert "bad.wkt: line 3: is not WKT" in ask(
        "census", "--polygon", ask.folder / "bad.wkt", status=4
    )
    monkeypatch.setitem(sys.modules, "shapely", None)
    error = ask("census", "--polygon", "POLYGON ((0 0, 1 1, 1 0, 0 0))", status=2)
    assert error.startswith("E_NO_EXTRA: --polygon")
    assert "volatool[vector]" in error


def test_polygons_in_another_crs_are_brought_over(volatool):
    """The outline of the town's lake, and the same in degrees."""
    from pyproj import Transformer

    lake = SAMPLES / "town-lake.geojson"
    assert volatool("convert", "town.laz", "-q", "--no-dem").returncode == 0
    document = json.loads(lake.read_text())
    move = Transformer.from_crs(25832, 4326, always_xy=True).transform
    document.pop("crs", None)
    for feature in document["features"]:
        geometry = feature["geometry"]
        geometry["coordinates"] = [
            [list(move(*place[:2])) for place in ring] for ring in geometry["coordinates"]
        ]
    (volatool.folder / "degrees.geojson").write_text(json.dumps(document))
    found = []
    for name in (lake, "degrees.geojson"):
        done = volatool("query", "town.vol.gz", "census", "--polygon", name, "--json")
        assert done.returncode == 0, done.stderr
        found.append(json.loads(done.stdout))
    # some voxels' centres are on the outline, to a nanometre
    assert found[0]["voxels"] == pytest.approx(found[1]["voxels"], rel=0.01)
    assert "9" in found[0]["classes"]  # water
