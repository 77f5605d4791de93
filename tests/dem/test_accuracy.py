"""Accuracy against checkpoints: what is read, what it comes to, what may be said of it."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from making_dems import ground, hills

from volatool.dem import accuracy, geotiff, raster
from volatool.dem.checkpoints import parse
from volatool.dem.surfaces import make_dem
from volatool.errors import CRSError, FormatError, InputError
from volatool.model import CrsInfo

METRES = CrsInfo(metres_per_unit_xy=Fraction(1), metres_per_unit_z=Fraction(1))


@pytest.fixture(scope="module")
def dem(tmp_path_factory):
    """Return the path of a DEM of hills with a void corner, and the flag layer beside it."""
    x, y, z = hills(6000)
    keep = ((x < 45) | (y < 45)) & ((abs(x - 20) > 3) | (abs(y - 20) > 3))
    made = make_dem(ground(x[keep], y[keep], z[keep]), METRES, 1.0, max_gap=4.0)
    path = tmp_path_factory.mktemp("dem") / "hills.dem.tif"
    geotiff.write_dem(path, made)
    geotiff.write_layer(path.with_name("hills.dem.flag.tif"), made, "flag")
    return path


def surveyed(n=40, low=3.0, high=40.0, seed=0, error=0.02):
    """Return text of checkpoints on the true hills."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(low, high, (2, n))
    z = 100 + 3 * np.sin(x / 9) * np.cos(y / 7) + rng.normal(0, error, n)
    return "x,y,z\n" + "".join(f"{a},{b},{c}\n" for a, b, c in zip(x, y, z, strict=True))


@pytest.mark.parametrize(
    "text",
    [
        "x,y,z\n1,2,3\n4,5,6\n",
        "\ufeffid;Northing;Easting;Height\nA;2;1;3\nB;5;4;6\n",
        "# survey\nA 1 2 3\n\nB\t4\t5\t6\n".replace("\t", " "),
        "1\t2\t3\n4\t5\t6\n",
        'name,x,y,elev,cover\n"A",1,2,3,NVA\n"B",4,5,6,vva\n',
    ],
)
def test_the_forms_of_checkpoints(text):
    """Heads in any order and case, separators, comments, byte order marks."""
    points = parse(text, "points.csv")
    found = np.column_stack([points.x, points.y, points.z])
    np.testing.assert_array_equal(found, [[1, 2, 3], [4, 5, 6]])
    assert points.vegetated.tolist() == [False, "vva" in text]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "no checkpoints"),
        ("x,y,z\n", "no checkpoints below"),
        ("x,y,depth\n1,2,3\n", "no column z"),
        ("1,2\n", "x, y, z are needed"),
        (
            "x;y;z\n1,5;2;3\n",
            "line 2, x: '1,5' is not a number; write the decimal comma as a point",
        ),
        ("x,y,z\n1,5,2,3\n", "line 2 has 4 fields, the first line has 3"),
        ("x,y,z\n1,2,nan\n", "not finite"),
        ("x,y,z,cover\n1,2,3,moss\n", "write NVA or VVA"),
    ],
)
def test_what_is_no_checkpoint_is_told(text, says):
    """One line: where and what to do."""
    with pytest.raises(FormatError, match=says) as caught:
        parse(text, "points.csv")
    assert caught.value.code == "E_CHECKPOINTS"


def test_figures_equal_naive_ones(dem):
    """Errors by a plain bilinear reading; the standard's figures from them."""
    points = parse(surveyed(), "p")
    found = accuracy.assess(dem, points, checkpoint_rmse=0.02)
    file = raster.read_dem(dem)
    errors = []
    for x, y, z in zip(points.x, points.y, points.z, strict=True):
        u, v = x - file.grid.left - 0.5, file.grid.top - y - 0.5
        q, r = int(u), int(v)
        u, v = u - q, v - r
        (a, b), (c, d) = file.z[r : r + 2, q : q + 2].astype(float)
        errors.append((1 - v) * ((1 - u) * a + u * b) + v * ((1 - u) * c + u * d) - z)
    errors = np.array(errors)
    values = found.to_dict()["nva"]
    rmse = np.sqrt(np.mean(errors**2))
    assert values["n"] == 40
    assert values["rmse_v1"] == pytest.approx(rmse)
    assert values["rmse_v"] == pytest.approx(np.hypot(rmse, 0.02))
    assert values["bias"] == pytest.approx(errors.mean())
    assert values["std"] == pytest.approx(errors.std(ddof=1))
    assert values["p95"] == pytest.approx(np.quantile(abs(errors), 0.95))
    worst = np.argmax(abs(errors))
    assert values["worst"][0] == {"id": str(worst + 2), "error": pytest.approx(errors[worst])}
    assert found.status == "reported"
    assert "edition 2 (2023)" in accuracy.summary(found)


def test_points_off_the_dem_void_and_filled_are_counted_apart(dem):
    """Outside and void don't enter the errors; filled ones do, and are shown alone too."""
    text = surveyed() + "-5,10,100\n55,55,100\n20.2,20.1,102\n"
    found = accuracy.assess(dem, parse(text, "p"))
    assert (found.n_outside, found.n_void) == (1, 1)
    assert len(found.nva.errors) == 41
    assert found.filled is not None
    assert "43" not in found.filled.ids
    assert "44" in found.filled.ids
    values = raster.read_values_at(dem, np.array([0.0, 59.99]), np.array([30.0, 3.0]))
    assert np.isfinite(values).all()


def test_checkpoints_of_which_none_lies_on_the_dem_are_an_error(dem):
    """Swapped or in another CRS: said so, not a report of nothing."""
    points = parse("x,y,z\n5000,10,100\n6000,20,100\n", "p")
    with pytest.raises(InputError, match=r"none of the 2 checkpoints .*2 lie off") as caught:
        accuracy.assess(dem, points)
    assert caught.value.code == "E_CHECKPOINTS"


@pytest.mark.parametrize(
    ("n", "rmse", "required", "status", "holds"),
    [
        (40, 0.02, None, "reported", True),
        (40, 0.02, 0.2, "met", True),
        (40, 0.02, 0.01, "not met", False),
        (40, None, 0.01, "not met", False),
        (40, None, 0.2, "not reportable", False),
        (29, 0.02, None, "not reportable", True),
        (29, 0.02, 0.2, "not reportable", False),
        (30, 0.02, 0.2, "met", True),
    ],
)
def test_nothing_passes_that_is_not_shown(dem, n, rmse, required, status, holds):
    """Fewer than 30 checkpoints, or an unknown error of theirs: never a bare pass."""
    found = accuracy.assess(
        dem, parse(surveyed(n), "p"), checkpoint_rmse=rmse, required=required
    )  # fmt: skip
    assert (found.status, found.holds) == (status, holds)
    assert ("not reportable" in accuracy.summary(found)) == bool(found.nva.reasons)


def test_vegetated_points_are_reported_but_not_held_against_the_requirement(dem):
    """VVA has no part in the status."""
    lines = surveyed(80).splitlines()
    text = f"{lines[0]},cover\n" + "".join(
        f"{line},{'VVA' if k % 2 else 'NVA'}\n" for k, line in enumerate(lines[1:])
    )
    points = parse(text, "p")
    points.z[points.vegetated] += 5
    found = accuracy.assess(dem, points, checkpoint_rmse=0.02, required=0.2)
    assert found.status == "met"
    assert found.vva.rmse_v > 4


def test_the_sigma_layer_gives_coverage(dem, tmp_path):
    """Parts of the errors inside 1 and 1.96 standard errors with the checkpoints' own."""
    file = raster.read_dem(dem)
    made = make_dem(ground(*hills(500)), METRES, 1.0)
    from dataclasses import replace

    layer = replace(made, grid=file.grid, sigma=np.full(file.z.shape, 0.05, np.float32))
    geotiff.write_layer(tmp_path / "s.tif", layer, "sigma")
    points = parse(surveyed(), "p")
    found = accuracy.assess(dem, points, checkpoint_rmse=0.02, sigma=tmp_path / "s.tif")
    ratio = abs(found.nva.errors) / np.hypot(0.05, 0.02)
    assert found.coverage["coverage_68"] == pytest.approx(np.mean(ratio < 1))
    assert found.coverage["coverage_95"] == pytest.approx(np.mean(ratio < 1.96))


def test_units_and_crs_of_checkpoints():
    """Feet to the DEM's metres; UTM from geographic; a DEM without a CRS refuses."""
    from volatool.points.crs import crs_from_user

    points = parse("x,y,z\n9,48,100\n", "p")
    assert accuracy.in_unit(points, "ft", Fraction(1)).z[0] == pytest.approx(30.48)
    with pytest.raises(CRSError, match="--points-unit"):
        accuracy.in_unit(points, "ft", None)
    moved = accuracy.moved(points, "EPSG:4326", crs_from_user("EPSG:32632"), "d")
    assert moved.x[0] == pytest.approx(500000)
    with pytest.raises(CRSError, match="has no CRS"):
        accuracy.moved(points, "EPSG:4326", CrsInfo(), "d")
