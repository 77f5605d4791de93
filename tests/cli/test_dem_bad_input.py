"""Elevation models of bad input: a code, a status, one line, and nothing half-written."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys

import numpy as np
import pytest
from making_tiles import hills, write_las

from volatool.emap.ground import GroundFilter
from volatool.errors import InputError
from volatool.options import ConvertOptions
from volatool.tile import convert_tile


def tile(folder, xyz, code=2, **options):
    codes = np.full(len(xyz), code, np.uint8)
    return write_las(folder / "t.las", np.asarray(xyz), classification=codes, **options)


def refused(done, status, code, folder):
    """Assert a failure: status, code, one line, no output."""
    errors = [line for line in done.stderr.splitlines() if line.startswith("E_")]
    assert (done.returncode, len(errors)) == (status, 1), done.stderr
    assert errors[0].startswith(f"{code}: "), done.stderr
    assert "Traceback" not in done.stderr
    assert not (folder / "out").exists() or not list((folder / "out").iterdir())
    return errors[0]


def test_no_ground_left(tmp_path, monkeypatch):
    """The filter keeps nothing: no model, and of `convert` no volume either."""
    monkeypatch.setattr(GroundFilter, "keeps", lambda self, rows: np.zeros(len(rows), bool))
    path = tile(tmp_path, hills(300), code=1)
    for kind, hint in (("dem", "--surface min"), ("convert", "--no-dem")):
        with pytest.raises(InputError, match=hint) as error:
            convert_tile(path, ConvertOptions(), kind=kind, outdir=tmp_path / "out")
        assert error.value.code == "E_NO_GROUND"
        assert not list((tmp_path / "out").glob("*"))


def test_no_point_left(volatool, tmp_path):
    """Nothing of the class asked for: a void model and a warning."""
    heights = [[100, 100, 0]] * 2 + [[100, 100, 10_000]] * 2
    path = tile(tmp_path, heights, code=1)
    done = volatool("dem", path, "-o", "out", "--class", "2")
    assert done.returncode == 0, done.stderr
    assert "W_ALL_FILTERED" in done.stderr
    done = volatool("dem", path, "-o", "empty", "--exclude-class", "1", "--json")
    dem = json.loads(done.stdout)["dem"]
    assert (dem["cells_measured"], dem["z_min"], dem["solver"]) == (0, None, None)


@pytest.mark.parametrize("points", [[[5, 5, 5]], [[k, 2 * k, k] for k in range(0, 900, 30)]])
@pytest.mark.parametrize("surface", ["auto", "dsm", "min", "max", "mean", "idw"])
def test_one_point_and_points_on_a_line_are_models(volatool, tmp_path, points, surface):
    done = volatool("dem", tile(tmp_path, points), "-o", "out", "--json", "--surface", surface)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["dem"]["cells_measured"] >= 1


@pytest.mark.parametrize("points", [[[5, 5, 5]], [[k, 2 * k, k] for k in range(0, 900, 30)]])
def test_a_tin_of_a_line_does_not_exist(volatool, tmp_path, points):
    path = tile(tmp_path, points)
    done = volatool("dem", path, "-o", "out", "--surface", "tin")
    refused(done, 4, "E_NO_TRIANGLE", tmp_path)
    done = volatool("convert", path, "-o", "out", "--surface", "tin")
    assert "--no-dem" in refused(done, 4, "E_NO_TRIANGLE", tmp_path)


@pytest.mark.parametrize("cell", ["0", "0m", "-1", "nan", "1e-300m", "inf"])
def test_cells_that_are_no_length(volatool, tmp_path, cell):
    done = volatool(
        "dem", tile(tmp_path, hills(100), crs="EPSG:25832"), "-o", "out", "--cell", cell
    )
    if cell == "1e-300m":
        refused(done, 7, "E_SIZE", tmp_path)
    else:
        refused(done, 2, "E_OPTION", tmp_path)


def test_a_grid_over_the_ceiling(volatool, tmp_path):
    """Too many cells: before anything is allocated; `convert` says how to get the volume."""
    path = tile(tmp_path, hills(100, extent=5_000_000), crs="EPSG:25832")
    refused(volatool("dem", path, "-o", "out", "--cell", "1cm"), 7, "E_SIZE", tmp_path)
    done = volatool("convert", path, "-o", "out", "--cell", "1cm")
    assert "--no-dem" in refused(done, 7, "E_SIZE", tmp_path)
    done = volatool("dem", path, "-o", "out", "--memory", "1M")
    refused(done, 7, "E_MEMORY", tmp_path)


def test_heights_that_are_not_numbers(volatool, tmp_path):
    """Scale or offset of z is NaN: no height is a number."""
    path = tile(tmp_path, hills(100))
    data = bytearray(path.read_bytes())
    for at in (131 + 16, 155 + 16):
        bad = data.copy()
        bad[at : at + 8] = np.float64(np.nan).tobytes()
        path.write_bytes(bad)
        refused(volatool("dem", path, "-o", "out"), 4, "E_BAD_SCALE", tmp_path)


def test_tins_memory_is_refused_in_advance(volatool, tmp_path):
    path = tile(tmp_path, hills(200_000))
    done = volatool("dem", path, "-o", "out", "--surface", "tin", "--memory", "256M")
    assert "--surface auto" in refused(done, 7, "E_MEMORY", tmp_path)


def test_classes_add_up(volatool, tmp_path):
    """``--class`` twice is both, not the last."""
    path = tile(tmp_path, hills(300))
    done = volatool("dem", path, "-o", "out", "--class", "9", "--class", "2,3", "--json")
    report = json.loads(done.stdout)
    assert report["tool"]["options"]["classes"] == [9, 2, 3]
    assert report["input"]["points_used"] == 300
    done = volatool(
        "dem", path, "-o", "b", "--exclude-class", "2", "--exclude-class", "9", "--json"
    )
    assert json.loads(done.stdout)["input"]["points_used"] == 0


def test_a_list_may_begin_with_a_byte_order_mark(volatool, tmp_path):
    tile(tmp_path, hills(300))
    (tmp_path / "list.txt").write_bytes(b"\xef\xbb\xbft.las\r\n")
    done = volatool("dem", "@list.txt", "-o", "out")
    assert (done.returncode, done.stdout) == (0, "out/t.dem.tif\n"), done.stderr


def small_disk(folder, kilobytes, command, **environment):
    """Run a command with a file system of a few kB on a folder, in a mount namespace of its own."""
    if shutil.which("unshare") is None:
        pytest.skip("unshare is not installed")
    folder.mkdir(exist_ok=True)
    inside = 'mount -t tmpfs -o size="$1"k tmpfs "$2" || exit 99; shift 2; exec "$@"'
    done = subprocess.run(
        ["unshare", "-rm", "bash", "-c", inside, str(folder), str(kilobytes), str(folder),
         "env", *(f"{key}={value}" for key, value in environment.items()),
         sys.executable, "-m", "volatool_cli", *map(str, command)],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    if done.returncode == 99 or "unshare" in done.stderr:
        pytest.skip("no mount namespaces here")
    return done


@pytest.mark.parametrize("kilobytes", [60, 200, 300])
def test_a_full_temporary_folder_is_named(tmp_path, kilobytes):
    """Not the output's folder: E_MEMORY, status 7, TMPDIR."""
    path = tile(tmp_path, hills(20_000))
    small = tmp_path / "small"
    command = ["dem", path, "-o", tmp_path / "out", "--cell", "0.1", "-q"]
    done = small_disk(small, kilobytes, command, TMPDIR=small)
    line = refused(done, 7, "E_MEMORY", tmp_path)
    assert f"in {small}" in line
    assert "TMPDIR" in line


@pytest.mark.parametrize("kilobytes", [40, 200, 480])
def test_a_full_output_folder_leaves_nothing(tmp_path, kilobytes):
    """GDAL may take a full disk for success: what does not read back is no output."""
    path = tile(tmp_path, hills(20_000))
    small = tmp_path / "small"
    done = small_disk(small, kilobytes, ["dem", path, "-o", small, "--cell", "0.1", "-q"])
    assert refused(done, 5, "E_WRITE", tmp_path)
    assert done.stdout == ""
