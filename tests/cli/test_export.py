"""``volatool export``: what it prints, where files go, and how it fails."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import laspy
import numpy as np
import pytest
from click.testing import CliRunner

import volatool as vt
from volatool.export.registry import FORMATS
from volatool_cli.main import cli

SAMPLES = Path(__file__).resolve().parents[2] / "data_samples"

OWN = ["laz", "las", "xyz", "csv", "npy", "npz", "c-array", "vol1", "vol", "dvol", "dvol.gz"]


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    """Path of a volume of the town, made once."""
    folder = tmp_path_factory.mktemp("town")
    report = vt.convert(SAMPLES / "town.laz", folder, dem=False, dense="never")
    return next(path for path in report.paths if path.name == "town.vol.gz")


@pytest.fixture
def town(volatool, stored):
    """The command, in a folder that has the town's points and its volume."""
    shutil.copy(stored, volatool.folder)
    return volatool


def in_process(folder, monkeypatch, *arguments):
    """Run the command without a process of its own; errors of the library are raised."""
    monkeypatch.chdir(folder)
    return CliRunner().invoke(cli, ["export", *arguments], catch_exceptions=False)


def test_each_format_is_written_beside_the_input_and_told(town, monkeypatch):
    for name in OWN:
        done = in_process(
            town.folder, monkeypatch, "town.vol.gz", "--to", name, "--level", "3", "-q"
        )
        assert (done.exit_code, done.stderr) == (0, "")
        assert done.stdout == f"town{FORMATS[name].suffix}\n"
        assert (town.folder / done.stdout.strip()).stat().st_size > 80


def test_the_help_lists_every_format(volatool):
    text = volatool("export", "--help").stdout
    for name, exporter in FORMATS.items():
        assert f"  {name} " in text
        assert exporter.title in text


def test_points_of_a_part_of_the_town(town, monkeypatch):
    bounds, z = "523500,5398250,523550,5398300", "300,310"
    done = in_process(
        town.folder, monkeypatch, "town.vol.gz", "-o", "part.laz", "--bounds", bounds, "--z", z
    )
    assert done.exit_code == 0, done.stderr
    las = laspy.read(town.folder / "part.laz")
    volume = vt.open(town.folder / "town.vol.gz")
    half = volume.cell() / 2
    xyz = volume.centers()
    low, high = np.array([523500, 5398250, 300]) - half, np.array([523550, 5398300, 310]) + half
    inside = np.all((xyz > low) & (xyz <= high), axis=1)
    assert 0 < len(las) == inside.sum()
    assert np.allclose(np.sort(las.xyz, axis=0), np.sort(xyz[inside], axis=0))
    assert las.header.parse_crs().sub_crs_list[0].to_epsg() == 25832


def test_several_files_are_listed_one_a_line(town, monkeypatch):
    done = in_process(
        town.folder, monkeypatch, "town.vol.gz", "--to", "png", "--level", "2", "-o", "pictures.png"
    )
    assert done.exit_code == 0, done.stderr
    names = done.stdout.splitlines()
    assert names[0].startswith("pictures.z0")
    assert len(names) % 3 == 0
    assert all((town.folder / name).exists() for name in names)
    again = in_process(
        town.folder, monkeypatch, "town.vol.gz", "--to", "png", "--level", "2", "-o", "pictures.png"
    )
    assert again.exit_code == 2
    assert "--overwrite" in again.stderr


def test_a_map_from_the_command_line(town, monkeypatch):
    arguments = ["--level", "3", "--above", "4m,8m", "--near", "0", "--local"]
    done = in_process(town.folder, monkeypatch, "town.vol.gz", "--to", "nav2", *arguments)
    assert done.exit_code == 0, done.stderr
    assert done.stdout.splitlines() == ["town.yaml", "town.pgm"]
    text = (town.folder / "town.yaml").read_text()
    assert "resolution: 3.75\n" in text
    assert "origin: [0.0, 0.0, 0.0]\n" in text
    assert json.loads(text.split("image: ")[1].splitlines()[0]) == "town.pgm"


@pytest.mark.parametrize(
    ("arguments", "status", "told"),
    [
        (["town.vol.gz"], 2, "give --to FORMAT"),
        (["town.vol.gz", "--to", "docx"], 2, "'docx'"),
        (["town.vol.gz", "--to", "vol.gz"], 2, "is the input"),
        (["town.vol.gz", "--overwrite", "-o", "town.laz"], 2, "was made from"),
        (["town.vol.gz", "--to", "laz", "-o", ""], 2, "empty name"),
        (["town.vol.gz", "--to", "laz", "--level", "9"], 2, "level 9"),
        (["town.vol.gz", "--to", "laz", "--slices", "top"], 2, "means nothing"),
        (["town.vol.gz", "--to", "laz", "--z", "2,1"], 2, "LOW,HIGH"),
        (["town.vol.gz", "--to", "nav2", "--above", "2m"], 2, "two lengths"),
        (["town.vol.gz", "--to", "nav2", "--near", "x"], 2, "not a length"),
        (["town.vol.gz", "--to", "laz", "--bounds", "0,0,1,1"], 4, "no voxel is selected"),
        (["gone.vol", "--to", "laz"], 4, "no such file"),
        (["town.laz", "--to", "npy"], 4, "not a VOLA file"),
        (["town.vol.gz", "--to", "npy", "--limit", "1k"], 7, "--sparse"),
        (["town.vol.gz", "--to", "laz", "-o", "town.vol.gz/t.laz"], 5, "can't be written"),
    ],
)
def test_what_can_t_be_done_is_told(town, monkeypatch, arguments, status, told):
    before = sorted(town.folder.iterdir())
    done = in_process(town.folder, monkeypatch, *arguments)
    assert (done.exit_code, done.stdout) == (status, ""), done.stderr
    assert told in done.stderr
    assert sorted(town.folder.iterdir()) == before


def test_an_error_is_one_coded_line(town):
    done = town("export", "town.vol.gz", "--to", "npy", "--limit", "1k")
    assert (done.returncode, done.stdout) == (7, "")
    assert len(done.stderr.splitlines()) == 1
    assert done.stderr.startswith("E_SIZE: ")


def test_the_help_loads_nothing_heavy():
    import subprocess
    import sys

    code = (
        "import sys\nfrom volatool_cli.main import cli\n"
        "try: cli(['export', '--help'])\nexcept SystemExit: pass\n"
        "heavy = {'numpy', 'numba', 'rasterio', 'PIL', 'pyproj'} & set(sys.modules)\n"
        "sys.exit(f'loaded {heavy}' if heavy else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_the_python_of_the_page_runs(volatool, monkeypatch):
    """Its bounds are those of the forest."""
    page = (SAMPLES.parent / "docs" / "how-to" / "export.md").read_text()
    blocks = re.findall(r"^```python\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    assert len(blocks) == 2
    monkeypatch.chdir(volatool.folder)
    vt.convert("forest.laz", dem=False, dense="never", depth=4, resources=False)
    Path("forest.vol.gz").rename("tile.vol.gz")
    for block in blocks:
        block = block.replace('("0.2m", "2m")', '("1m", "5m")')
        exec(block, {"vt": vt})
    assert Path("tile.yaml").exists()
    assert laspy.read("part.laz").header.point_count > 100
