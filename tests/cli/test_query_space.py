"""``volatool query FILE components|clearance|path``."""

from __future__ import annotations

import json

import making_volumes as making
import numpy as np
import pytest
from click.testing import CliRunner

from volatool.cube import Cube
from volatool.formats import sparse
from volatool.vola.volume import VolumeInfo
from volatool_cli.main import cli

WALL = [(7, y, z) for y in range(16) for z in range(16) if (y, z) != (8, 8)]
"""A wall across the middle of the cube, with a hole of one cell."""


@pytest.fixture
def asked(tmp_path):
    """Run ``volatool query`` in this process, on the wall: cells of 2 units, corner 0, no CRS."""
    cube = Cube((0.0, 0.0, 0.0), 32.0)
    volume = making.volume_of([*WALL, (0, 0, 0)], 2, cube=cube, info=VolumeInfo())
    with (tmp_path / "v.vol").open("wb") as file:
        sparse.write(file, volume)
    feet = making.volume_of([(0, 0, 0)], 2)
    with (tmp_path / "feet.vol").open("wb") as file:
        sparse.write(file, feet)

    def run(*arguments, file="v.vol", **options):
        words = ["query", str(tmp_path / file), *map(str, arguments)]
        return CliRunner().invoke(cli, words, **options)

    run.volume, run.feet = volume, feet
    return run


def test_components_are_a_table_or_an_object(asked):
    done = asked("components")
    assert (done.exit_code, done.stderr) == (0, "")
    head, names, *rows = done.stdout.splitlines()
    assert head == "2 components of 256 voxels"
    assert names.split() == ["rank", "voxels", "volume", "x0", "y0", "z0", "x1", "y1", "z1"]
    assert [row.split() for row in rows] == [
        ["1", "255", "2040", "14", "0", "0", "16", "32", "32"],
        ["2", "1", "8", "0", "0", "0", "2", "2", "2"],
    ]
    assert len({len(line) for line in [names, *rows]}) == 1
    found = json.loads(asked("components", "--json", "--connectivity", 6, "--top", 1).stdout)
    assert {key: found[key] for key in found if key != "components"} == {
        "answer": 2, "connectivity": 6, "level": 2, "voxels": 256,
    }  # fmt: skip
    assert found["components"] == asked.volume.components(6).rows(1)
    coarse = json.loads(asked("components", "--level", 1, "--json", "--top", 0).stdout)
    assert (coarse["level"], coarse["answer"], len(coarse["components"])) == (1, 1, 1)


def test_clearances_are_the_librarys(asked):
    xyz = np.random.default_rng(3).uniform(-10, 40, (20, 3))
    text = "".join(" ".join(map(repr, row)) + "\n" for row in xyz.tolist())
    for options, keywords in (((), {}), (("--to", "centre", "--level", 1), {"to": "centre"})):
        done = asked("clearance", "--json", *options, input=text)
        answers = [json.loads(line)["answer"] for line in done.stdout.splitlines()]
        assert answers == asked.volume.clearance(xyz, 1 if options else None, **keywords).tolist()
    assert asked("clearance", 15, 1, 1, 17.25, 1, 1).stdout == "0\n1.25\n"


def test_a_path_is_told_with_length_and_clearance(asked):
    ends = [3.0, 17.0, 17.0, 27.0, 17.0, 17.0]
    done = asked("path", *ends)
    assert (done.exit_code, done.stderr) == (0, "")
    assert done.stdout == "length 24 clearance 1\n"  # straight through the hole
    found = json.loads(asked("path", 3, 3, 17, 27, 3, 17, "--json", "--factor", 1).stdout)
    path = asked.volume.path([3, 3, 17], [27, 3, 17], factor=1.0)
    assert (found["answer"], found["query"]) == ("path", [3, 3, 17, 27, 3, 17])
    assert {key: found[key] for key in path.to_dict()} == path.to_dict()
    assert len(found["points"]) > 2
    # a path across the foot of the wall has to go up to the hole
    assert asked("path", *ends, "--z", 10, 20).stdout == done.stdout
    assert asked("path", 3, 3, 3, 27, 3, 3, "--z", 0, 10).stdout == "no path\n"
    done = asked("path", *ends, "--z", 0, 10)
    assert done.stdout == "no path: start outside: not between the heights\n"


def test_what_has_no_path_is_an_answer_not_an_error(asked):
    """A program that asks for a hundred paths gets a hundred lines."""
    lines = "3 17 17 27 17 17\n15 1 1 27 17 17\n3 17 17 40 1 1\n3 17 17 3 17 15\n3 17 17 17 17 17\n"
    done = asked("path", "--clearance", 1.5, input=lines)
    assert (done.exit_code, done.stderr) == (0, "")
    assert done.stdout.splitlines() == [
        "no path",
        "no path: start occupied: in a voxel",
        "no path: goal outside: not in the volume's cube",
        "length 2 clearance 11",
        "no path: goal too near: a voxel is 1.41421 away, less than 1.5",
    ]
    answers = [
        json.loads(line)
        for line in asked("path", "--json", "--clearance", 1.5, input=lines).stdout.splitlines()
    ]
    assert [answer["answer"] for answer in answers] == ["no path"] * 3 + ["path", "no path"]
    assert answers[0]["reason"] is None
    assert answers[1]["reason"].startswith("start occupied")


def test_a_clearance_may_have_a_unit(asked):
    """Horizontal feet for the volume in feet; nothing to go by without a CRS."""
    x, y, z = asked.feet.cube.origin
    z /= float(asked.feet.crs.z_ratio)
    ends = [x + 5, y + 5, z + 5, x + 9, y + 9, z + 9]
    assert asked("path", *ends, "--clearance", "1m", file="feet.vol").stdout.startswith("length ")
    done = asked("path", *ends, "--clearance", "5m", file="feet.vol")
    assert "start too near" in done.stdout
    assert "less than 16.4042" in done.stdout
    done = asked("path", 3, 17, 17, 5, 17, 17, "--clearance", "1m")
    assert (done.exit_code, done.stdout) == (2, "")
    assert "the file has no CRS" in done.stderr


def test_limits_and_wrong_options_are_told(asked):
    done = asked("components", "--level", 3)
    assert (done.exit_code, done.stdout) == (2, "")
    assert done.stderr == "E_OPTION: level 3 is not in this volume: it has levels 1 to 2\n"
    assert asked("clearance", 1, 2, 3, "--level", 9).exit_code == 2
    assert asked("path", 1, 2, 3).stderr.startswith("E_OPTION: expected 6 numbers, X0 Y0 Z0")
    assert asked("path", 1, 2, 3, 4, 5, 6, "--factor", 0.5).exit_code == 2
    assert asked("path", 1, 2, 3, 4, 5, 6, "--max-cells", 5).exit_code == 2
    assert asked("components", "--connectivity", 18).exit_code == 2


def test_a_search_that_is_too_large_ends_with_the_status_of_limits(asked, tmp_path):
    """Rubble around two halves: 1,024 cells do not tell."""
    rng = np.random.default_rng(5)
    cells = {tuple(map(int, row)) for row in rng.integers(0, 64, (20000, 3))}
    cells |= {(31, y, z) for y in range(64) for z in range(64)}
    cells -= {(5, 5, 5), (60, 60, 60)}
    volume = making.volume_of(cells, 3, cube=Cube((0.0, 0.0, 0.0), 64.0), info=VolumeInfo())
    with (tmp_path / "rubble.vol").open("wb") as file:
        sparse.write(file, volume)
    done = asked("path", *[5.5] * 3, *[60.5] * 3, "--max-cells", 1024, file="rubble.vol")
    assert (done.exit_code, done.stdout) == (7, "")
    assert done.stderr.startswith("E_SIZE: the arguments: ")
    assert "allow more cells" in done.stderr
    lines = "5.5 5.5 5.5 5.5 5.5 5.5\n" + " ".join(["5.5"] * 3 + ["60.5"] * 3) + "\n"
    done = asked("path", "--max-cells", 1024, file="rubble.vol", input=lines)
    assert (done.exit_code, len(done.stdout.splitlines())) == (7, 1)
    assert done.stderr.startswith("E_SIZE: line 2 of stdin: ")


def test_an_empty_answer_is_no_number_in_json(asked, tmp_path):
    """An infinite clearance is null: JSON has no infinity."""
    from volatool.vola.volume import Volume

    empty = Volume((np.zeros(1, np.uint64),), None, Cube((0.0, 0.0, 0.0), 4.0), VolumeInfo())
    with (tmp_path / "empty.vol").open("wb") as file:
        sparse.write(file, empty)
    found = json.loads(asked("path", 1, 1, 1, 3, 1, 1, "--json", file="empty.vol").stdout)
    assert (found["length"], found["clearance"]) == (2, None)
    assert asked("path", 1, 1, 1, 3, 1, 1, file="empty.vol").stdout == "length 2 clearance inf\n"
    assert asked("clearance", 1, 1, 1, file="empty.vol").stdout == "inf\n"
    line = asked("clearance", 1, 1, 1, "--json", file="empty.vol").stdout
    assert line == '{"answer": null, "query": [1.0, 1.0, 1.0]}\n'
    assert asked("components", file="empty.vol").stdout == "0 components of 0 voxels\n"
