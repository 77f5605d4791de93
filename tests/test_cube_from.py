"""``--cube-from``: a second survey on the grid of the first."""

from __future__ import annotations

import gzip
import json
from fractions import Fraction

import jsonschema
import making_volumes as making
import numpy as np
import pytest
from making_tiles import hills, write_las

import volatool as vt
from volatool.errors import CRSError, InputError, OptionError
from volatool.model import CrsInfo
from volatool.points.crs import crs_from_user, difference
from volatool.report import schema

QUIET = {"dem": False, "dense": "never", "resources": False}


@pytest.fixture
def epochs(tmp_path):
    """Two surveys: the second has points beyond the box of the first on every side."""
    first = hills(3000, 1)
    second = hills(3000, 2)
    second[:5] += [-2000, 0, 0]
    second[5:8] += [0, 9000, 0]
    second[8, 2] += 100_000
    a = write_las(tmp_path / "a.las", first, crs="EPSG:25832+7837")
    b = write_las(tmp_path / "b.las", second, crs="EPSG:25832+7837")
    report = vt.convert(a, tmp_path / "out", depth=4, **QUIET)
    return a, b, report.paths[0], second


def test_the_second_survey_gets_cube_and_depth_of_the_first(epochs, tmp_path):
    """Exactly the same grid; points outside are counted and told, the others are all there."""
    _, b, reference, points = epochs
    report = vt.convert(b, tmp_path / "out", cube_from=reference, **QUIET)
    one, other = vt.open(reference), vt.open(report.paths[0])
    assert (other.cube, other.cube.exact, other.depth) == (one.cube, one.cube.exact, one.depth)
    origin = np.round(np.array(one.cube.origin) * 100)
    away = points - origin
    inside = ((away >= 0) & (away <= round(one.cube.side * 100))).all(axis=1)
    outside = int((~inside).sum())
    assert 9 <= outside < 100
    found = {warning.code: warning for warning in report.warnings}["W_OUTSIDE_CUBE"]
    assert found.count == outside
    assert f"{outside} of 3000 points lie outside the cube of --cube-from a.vol.gz" in found.message
    assert other.info.n_points == 3000 - outside
    assert other.contains(points[inside] / 100).all()
    assert report.choice["rule"] == "volume"
    assert report.choice["reason"].startswith("a.vol.gz has 4 levels; occupancy")
    document = json.loads(report.to_json())
    jsonschema.validate(document, schema())
    assert document["tool"]["options"]["cube_from"] == str(reference)
    assert document["input"]["points_used"] == 3000  # the elevation model uses all of them


def test_the_first_survey_itself_gives_the_same_volume_without_a_warning(epochs, tmp_path):
    a, _, reference, _ = epochs
    report = vt.convert(a, tmp_path / "again", cube_from=str(reference), **QUIET)
    assert not report.warnings
    assert making.same(vt.open(report.paths[0]), vt.open(reference))


@pytest.mark.parametrize("form", ["dense", "plain"])
def test_any_form_of_volume_will_do_and_other_options_give_the_depth(epochs, tmp_path, form):
    a, b, reference, _ = epochs
    if form == "dense":
        other = vt.convert(a, tmp_path / "d", depth=4, dem=False, dense="always").paths[1]
        assert other.name == "a.dvol.gz"
    else:
        other = tmp_path / "plain.vol"
        other.write_bytes(gzip.decompress(reference.read_bytes()))
    (report,) = vt.stats(b, cube_from=other, depth=2)
    assert report.cube["origin"] == list(vt.open(reference).cube.origin)
    assert (report.depth, report.choice["rule"]) == (2, "fixed")
    (report,) = vt.stats(b, cube_from=other, resolution="5m")
    assert report.choice["rule"] == "resolution"
    (report,) = vt.stats(b, cube_from=other)
    assert report.depth == 4
    assert "W_OUTSIDE_CUBE" in {warning.code for warning in report.warnings}


def test_a_depth_whose_levels_are_nearly_empty_is_kept(epochs, tmp_path):
    """The reference's depth is built however few points there are."""
    a, _, _, _ = epochs
    deep = vt.convert(a, tmp_path / "deep", depth=9, **QUIET).paths[0]
    few = write_las(tmp_path / "few.las", hills(10, 1), crs="EPSG:25832")
    report = vt.convert(few, tmp_path / "deep", cube_from=deep, max_depth=3, **QUIET)
    assert vt.open(report.paths[0]).depth == 9


def test_another_place_or_crs_is_refused(epochs, tmp_path):
    _, _, reference, points = epochs
    away = write_las(tmp_path / "away.las", points + 10**7, crs="EPSG:25832")
    with pytest.raises(InputError, match=r"no point lies in the cube of --cube-from a.vol.gz") as e:
        vt.convert(away, tmp_path / "out", cube_from=reference, **QUIET)
    assert e.value.code == "E_GRID"
    assert not list((tmp_path / "out").glob("*away*"))
    for crs, told in (("EPSG:25833", "EPSG:25833 and EPSG:25832"), ("EPSG:2994", "foot")):
        other = write_las(tmp_path / "other.las", points, crs=crs)
        with pytest.raises(CRSError, match=told) as e:
            vt.stats(other, cube_from=reference)
        assert e.value.code == "E_CRS"
    unknown = write_las(tmp_path / "unknown.las", points)
    assert vt.stats(unknown, cube_from=reference)[0].depth == 4


def test_what_does_not_go_with_it_is_refused(epochs, tmp_path):
    _, b, reference, _ = epochs
    for options in ({"cube": "100m"}, {"snap": True}, {"split": "10m"}):
        with pytest.raises(OptionError, match="--cube-from gives the cube"):
            vt.stats(b, cube_from=reference, **options)
    with pytest.raises(OptionError, match="--cube-from"):
        vt.convert(b, compat="toolkit", depth=2, cube_from=reference)
    with pytest.raises(OptionError, match="name of a VOLA file"):
        vt.stats(b, cube_from=3)
    with pytest.raises(InputError) as e:
        vt.stats(b, cube_from=tmp_path / "none.vol")
    assert e.value.code == "E_NOT_FOUND"
    with pytest.raises(InputError) as e:
        vt.stats(b, cube_from=b)
    assert e.value.code == "E_NOT_VOLA"


def test_a_reference_that_changes_is_read_again(epochs, tmp_path):
    """A notebook may write the first epoch anew between two calls."""
    a, b, reference, _ = epochs
    assert vt.stats(b, cube_from=reference)[0].depth == 4
    vt.convert(a, tmp_path / "out", depth=3, overwrite=True, **QUIET)
    assert vt.stats(b, cube_from=reference)[0].depth == 3


def test_differences_of_reference_systems():
    """Codes before texts, vertical parts too; what is unknown is no difference."""
    utm, heights = crs_from_user("EPSG:25832"), crs_from_user("EPSG:25832+7837")
    assert difference(utm, heights) is None
    assert difference(heights, crs_from_user("EPSG:25832+5783")) == "EPSG:7837 and EPSG:5783"
    assert difference(utm, crs_from_user("EPSG:32632")) == "EPSG:25832 and EPSG:32632"
    assert difference(CrsInfo(), utm) is None
    header = CrsInfo(horizontal="EPSG:25833", epsg=25833)  # of a file without a trailer
    assert difference(header, utm) == "EPSG:25833 and EPSG:25832"
    assert difference(CrsInfo(horizontal="EPSG:25832"), utm) is None
    assert difference(CrsInfo(horizontal="local"), utm) is None
    same = CrsInfo(**{**{n: getattr(utm, n) for n in CrsInfo.__dataclass_fields__},
                      "horizontal": "my UTM", "wkt2": utm.wkt2 + " "})  # fmt: skip
    assert difference(same, utm) is None
    broken = CrsInfo(wkt2="nonsense", horizontal="nobody's")
    assert difference(broken, utm) == "nobody's and EPSG:25832"
    feet = CrsInfo(metres_per_unit_xy=Fraction(1), metres_per_unit_z=Fraction(3048, 10000),
                   unit_xy="metre", unit_z="foot")  # fmt: skip
    assert difference(feet, CrsInfo(unit_xy="metre", metres_per_unit_xy=Fraction(1))) == (
        "heights in foot and in metre"
    )


def test_the_command_tells_the_points_left_out(epochs, tmp_path):
    """One line on stderr, exit status 0; a reference that is not there stops before any work."""
    from click.testing import CliRunner

    from volatool_cli.main import cli

    _, b, reference, _ = epochs
    out = tmp_path / "cli"
    arguments = ["convert", str(b), "-o", str(out), "--no-dem", "--cube-from"]
    done = CliRunner().invoke(cli, [*arguments, str(reference)])
    assert done.exit_code == 0, done.output
    assert "W_OUTSIDE_CUBE: b.las: " in done.stderr
    assert str(out / "b.vol.gz") in done.stdout
    done = CliRunner().invoke(cli, [*arguments, "none.vol.gz", "--overwrite"])
    assert done.exit_code == 4
    assert done.stderr.startswith("E_NOT_FOUND: none.vol.gz")
