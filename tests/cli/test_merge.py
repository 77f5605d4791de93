"""``volatool merge``."""

from __future__ import annotations

from pathlib import Path

import making_volumes as making
import numpy as np
import pytest
import toolkit_reader as toolkit
from click.testing import CliRunner
from making_tiles import hills, write_las

import volatool as vt
from volatool.cube import Cube
from volatool.encodings import Encoding, write_volume
from volatool.errors import OptionError
from volatool.validate import validate_file
from volatool.vola.volume import VolumeInfo
from volatool_cli.main import cli

QUIET = {"dem": False, "dense": "never", "resources": False}


def run(*arguments):
    return CliRunner().invoke(cli, ["merge", *map(str, arguments)])


@pytest.fixture
def points(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return write_las(tmp_path / "p.las", hills(4000, 3), crs="EPSG:25832")


def test_a_folder_of_split_cubes_becomes_the_volume_of_the_tile(points, tmp_path):
    """Voxel by voxel that of one snapped cube; blocks keep the words of their points."""
    vt.convert(points, tmp_path / "cubes", split="16m", depth=3, **QUIET)
    whole = vt.convert(points, tmp_path, cube="64m", snap=True, depth=4, **QUIET).paths[0]
    done = run("cubes", "-o", "merged.vol.gz")
    assert (done.exit_code, done.stdout, done.stderr) == (0, "merged.vol.gz\n", "")
    merged, expected = vt.open("merged.vol.gz"), vt.open(whole)
    assert merged.cube.exact == expected.cube.exact
    assert merged.cube.is_snapped
    assert making.same(merged, expected, metadata=False)
    assert merged.info.n_points == 4000
    assert merged.info.box == expected.info.box
    assert merged.crs.horizontal == "EPSG:25832"
    assert (merged.info.lat, merged.info.lon) == pytest.approx(
        (expected.info.lat, expected.info.lon)
    )
    assert merged.info.source_name == "p.las"
    assert merged.info.source_bytes == expected.info.source_bytes
    heights = [volume.channel("height") for volume in (merged, expected)]
    steps = [v.info.channels[0]["scale"] for v in (merged, expected)]
    assert np.abs(heights[0] - heights[1]).max() <= sum(steps)
    assert validate_file("merged.vol.gz").ok


@pytest.mark.parametrize("suffix", [".vol", ".vol.gz", ".dvol", ".dvol.gz"])
def test_the_suffix_says_what_is_written_and_the_same_bytes_every_time(points, suffix):
    vt.convert(points, "a", depth=2, **QUIET)
    for name in ("x", "y"):
        assert run("a/p.vol.gz", "-o", name + suffix).exit_code == 0
    assert Path("x" + suffix).read_bytes() == Path("y" + suffix).read_bytes()
    report = validate_file("x" + suffix)
    assert report.ok
    assert report.kind == ("dense" if "dvol" in suffix else "sparse")
    assert making.same(vt.open("x" + suffix), vt.open("a/p.vol.gz"), metadata="dvol" not in suffix)


def test_operations(points):
    """Two halves of a tile on one grid; the last level of the result may be dropped."""
    reference = vt.convert(points, "all", depth=3, **QUIET).paths[0]
    for name, bounds in (("west", (0, 0, 30, 50)), ("east", (20, 0, 50, 50))):
        vt.convert(points, name, cube_from=reference, bounds=bounds, **QUIET)
    west, east, whole = (vt.open(f"{name}/p.vol.gz") for name in ("west", "east", "all"))
    for op, expected in (("or", whole), ("and", west & east), ("xor", west ^ east),
                         ("sub", west - east)):  # fmt: skip
        done = run("west/p.vol.gz", "east/p.vol.gz", "--op", op, "-o", f"{op}.vol.gz")
        assert done.exit_code == 0, done.stderr
        assert making.same(vt.open(f"{op}.vol.gz"), expected, metadata=False)
        assert validate_file(f"{op}.vol.gz").ok
    assert run("or.vol.gz", "--depth", 2, "-o", "two.vol.gz").exit_code == 0
    assert making.same(vt.open("two.vol.gz"), whole.truncated(2), metadata=False)
    done = run("all/p.vol.gz", "all/p.vol.gz", "--op", "sub", "-o", "none.vol.gz")
    assert done.exit_code == 0
    assert len(vt.open("none.vol.gz")) == 0
    done = run("all/p.vol.gz", "--op", "sub", "-o", "no.vol.gz")
    assert (done.exit_code, done.stderr.split(":")[0]) == (2, "E_OPTION")
    done = run("all/p.vol.gz", "all/p.vol.gz", "-o", "once.vol.gz")
    assert vt.open("once.vol.gz").info.n_points == 4000
    done = run("west/p.vol.gz", "all/p.vol.gz", "--op", "sub", "-o", "nothing.vol.gz")
    assert done.exit_code == 0, done.stderr
    assert len(vt.open("nothing.vol.gz")) == 0
    assert validate_file("nothing.vol.gz").ok


def test_another_grid_is_refused_resampled_or_given(points):
    vt.convert(points, "a", depth=3, **QUIET)
    vt.convert(points, "b", depth=3, cube="60m", **QUIET)
    done = run("a/p.vol.gz", "b/p.vol.gz", "-o", "c.vol.gz")
    assert (done.exit_code, done.stderr.split(":")[0]) == (4, "E_GRID")
    assert "a/p.vol.gz and b/p.vol.gz" in done.stderr
    assert not Path("c.vol.gz").exists()
    done = run("a/p.vol.gz", "b/p.vol.gz", "--resample", "-o", "c.vol.gz")
    assert done.exit_code == 0, done.stderr
    done = run("b/p.vol.gz", "--cube-from", "a/p.vol.gz", "-o", "d.vol.gz")
    assert (done.exit_code, done.stderr.split(":")[0]) == (4, "E_GRID")
    done = run("b/p.vol.gz", "--cube-from", "a/p.vol.gz", "--resample", "-o", "d.vol.gz")
    assert done.exit_code == 0, done.stderr
    one, other = vt.open("a/p.vol.gz"), vt.open("d.vol.gz")
    assert one.cube.exact == other.cube.exact
    assert len(one & other) > len(one) / 2
    assert other.has_metadata


def test_what_is_lost_is_told(points, tmp_path):
    """Metadata that not all have, voxels outside, levels that not all have."""
    vt.convert(points, "a", depth=3, **QUIET)
    vt.convert(points, "b", depth=2, meta=(), **QUIET)
    done = run("a/p.vol.gz", "b/p.vol.gz", "-o", "c.vol.gz")
    assert done.exit_code == 0
    codes = [line.split(":")[0] for line in done.stderr.splitlines()]
    assert codes == ["W_DEPTH", "W_METADATA_LOST"]
    assert not vt.open("c.vol.gz").has_metadata
    vt.convert(points, "d", depth=3, meta=("height",), **QUIET)
    done = run("a/p.vol.gz", "d/p.vol.gz", "-o", "e.vol.gz")
    assert "W_METADATA_LOST" in done.stderr
    assert "class" in done.stderr
    volume = making.volume_of({(0, 0, 0), (15, 0, 0)}, 2, cube=Cube((0.0, 0.0, 0.0), 8.0),
                              info=VolumeInfo())  # fmt: skip
    small = making.volume_of({(0, 0, 0)}, 2, cube=Cube((0.0, 0.0, 0.0), 3.0), info=VolumeInfo())
    for name, one in (("large.vol", volume), ("small.vol", small)):
        with (tmp_path / name).open("wb") as stream:
            write_volume(stream, one, Encoding("sparse", 2, "none"))
    done = run("large.vol", "--cube-from", "small.vol", "--resample", "-o", "f.vol")
    assert done.exit_code == 0
    assert done.stderr.startswith("W_OUTSIDE_CUBE: f.vol: 1 voxels")
    assert (
        run("large.vol", "--cube-from", "small.vol", "--resample", "-q", "-o", "g.vol").stderr == ""
    )


def test_outputs_and_inputs_are_checked_before_any_work(points):
    vt.convert(points, "a", depth=2, **QUIET)
    for name, told in (("c.laz", "must end in"), ("a/p.vol.gz", "is an input")):
        done = run("a/p.vol.gz", "-o", name, "--overwrite")
        assert (done.exit_code, told in done.stderr) == (2, True)
    assert run("a/p.vol.gz", "-o", "c.vol").exit_code == 0
    done = run("a/p.vol.gz", "-o", "c.vol")
    assert (done.exit_code, done.stderr.split(":")[0]) == (2, "E_OUTPUT_EXISTS")
    done = run("a/p.vol.gz", "-o", "/proc/none/d.vol")
    assert (done.exit_code, done.stderr.split(":")[0]) == (5, "E_WRITE")
    done = run("none.vol", "-o", "d.vol")
    assert (done.exit_code, done.stderr.split(":")[0]) == (4, "E_NOT_FOUND")
    done = run("a/p.vol.gz", "--depth", 9, "-o", "d.vol")
    assert (done.exit_code, done.stderr.split(":")[0]) == (2, "E_OPTION")
    done = run("a/p.vol.gz", "--cube-from", "c.vol", "-o", "c.vol", "--overwrite")
    assert "is an input" in done.stderr
    assert vt.merge("a/p.vol.gz", "e.vol").volume.depth == 2  # not a path a letter
    with pytest.raises(OptionError, match="nothing to merge"):
        vt.merge([], "f.vol")


def test_the_original_toolkit_reads_what_is_merged(points):
    """By its own rules: voxels and words of a union, of what is left, and of nothing."""
    reference = vt.convert(points, "all", depth=3, **QUIET).paths[0]
    vt.convert(points, "part", cube_from=reference, bounds=(0, 0, 30, 50), **QUIET)
    for op, name in (("or", "part/p.vol.gz"), ("sub", "part/p.vol.gz"), ("sub", "all/p.vol.gz")):
        done = run("all/p.vol.gz", name, "--op", op, "-o", "m.vol", "--overwrite")
        assert done.exit_code == 0, done.stderr
        volume, reading = vt.open("m.vol"), toolkit.read(Path("m.vol").read_bytes())
        assert (reading.depth, reading.nbits, reading.crs) == (3, 1, 25832)
        assert [tuple(cell) for cell in reading.voxels] == [
            tuple(row) for row in volume.voxels().tolist()
        ]
        assert reading.words == volume.metadata().tolist()
        assert all(reading.metadata_words)
