"""``volatool retile``: one depth for the set, reports by group, failures told."""

from __future__ import annotations

import json

import numpy as np
import pytest
from making_tiles import hills, write_las

import volatool as vt


@pytest.fixture
def tiles(volatool):
    """Two tiles side by side that both touch the cube column at x = 40."""
    folder = volatool.folder / "tiles"
    folder.mkdir()
    for k in (0, 1):
        xyz = hills(6000, k, extent=4500) + np.array((4300 * k, 0, 0))
        write_las(folder / f"t{k}.las", xyz, crs="EPSG:25832")
    return folder


def test_cubes_on_one_grid_with_one_depth(volatool, tiles):
    asked = ("retile", "tiles", "-o", "out", "--split", "20m")
    planned = volatool(*asked, "--dry-run")
    assert planned.returncode == 0, planned.stderr
    assert "2 files" in planned.stderr
    assert not (volatool.folder / "out").exists()
    done = volatool(*asked)
    assert done.returncode == 0, done.stderr
    written = done.stdout.splitlines()
    assert planned.stdout.splitlines()[0] in written
    cubes = [name for name in written if name.endswith(".vol.gz")]
    assert "out/tile_x2_y0_z0.vol.gz" in cubes
    assert len(cubes) == len(set(cubes)) == len(list((volatool.folder / "out").glob("*.vol.gz")))
    depths = {vt.open(volatool.folder / name).depth for name in cubes}
    assert len(depths) == 1
    said = json.loads((volatool.folder / "out/tile.cubes/dataset.json").read_text("utf-8"))
    assert {said["choice"]["depth"]} == depths
    again = volatool(*asked)
    assert again.returncode == 2
    assert again.stderr.startswith("E_OUTPUT_EXISTS")
    index = volatool("index", "out", "--author", "A", "--license", "CC0-1.0")
    assert index.returncode == 0, index.stderr


def test_a_bad_file_fails_what_it_touches_and_is_told(volatool, tiles):
    """A header that can't be read: the others are cut, status 3. All bad: status 4."""
    (tiles / "bad.las").write_bytes(b"no points")
    done = volatool("retile", "tiles", "-o", "out", "--depth", "2", "--split", "20m")
    assert done.returncode == 3
    assert done.stderr.startswith("E_NOT_LAS: bad.las")
    assert (volatool.folder / "out" / "tile_x0_y0_z0.vol.gz").exists()
    done = volatool("retile", "tiles/bad.las", "-o", "out2")
    assert done.returncode == 4
    assert not (volatool.folder / "out2").exists()


def test_a_truncated_file_leaves_no_half_cubes(volatool, tiles):
    path = tiles / "t1.las"
    path.write_bytes(path.read_bytes()[:-50_000])
    done = volatool("retile", "tiles", "-o", "out", "--depth", "2", "--split", "20m")
    assert done.returncode == 3  # its header says more points than it has
    assert "E_TRUNCATED: t1.las" in done.stderr


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ((), "needs a folder"),
        (("-o", "out", "--name", "a/b"), "without folders"),
        (("-o", "out", "--depth-from", "none.json"), "can't be read"),
    ],
)
def test_usage(volatool, tiles, options, message):
    done = volatool("retile", "tiles", *options)
    assert done.returncode == 2
    assert message in done.stderr
    assert not (volatool.folder / "out").exists()
