"""What a command loads: help nothing heavy, facts and errors never the compiler."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
VECTOR = str(ROOT / "docs" / "vectors" / "sparse3-corners.vol")

CODE = """
import atexit, sys
heavy = ("numpy", "numba", "scipy", "rasterio", "pyproj", "laspy", "lazrs")
atexit.register(lambda: print("LOADED", *(set(heavy) & set(sys.modules)), file=sys.stderr))
from volatool_cli.main import main
main()
"""


def loaded(volatool, *arguments):
    """Run a command; return its status, what it wrote to stderr, and the heavy modules it had."""
    done = subprocess.run(
        [sys.executable, "-c", CODE, *arguments],
        cwd=volatool.folder, capture_output=True, text=True, check=False,
    )  # fmt: skip
    *lines, last = done.stderr.splitlines()
    assert last.startswith("LOADED")
    return done.returncode, "\n".join(lines), set(last.split()[1:])


@pytest.fixture
def files(volatool):
    (volatool.folder / "empty.laz").touch()
    (volatool.folder / "page.laz").write_text("<html>not found</html>")
    (volatool.folder / "taken.laz").symlink_to(volatool.folder / "forest.laz")
    (volatool.folder / "taken.dem.tif").touch()
    return volatool


@pytest.mark.parametrize("arguments", [(), ("convert",), ("doctor",), ("query",), ("emap",)])
def test_help_and_usage_errors_load_nothing_heavy(volatool, arguments):
    assert loaded(volatool, *arguments, "--help") == (0, "", set())
    status, error, modules = loaded(volatool, *arguments, "--frobnicate")
    assert (status, modules) == (2, set())
    assert error.startswith("E_OPTION: ")


@pytest.mark.parametrize("name", ["town.laz", VECTOR, "model.tif"])
def test_info_never_loads_the_compiler(volatool, name):
    if name == "model.tif":
        done = volatool("dem", "forest.laz", "-q", "--cell", "5m", "--surface", "mean")
        assert done.returncode == 0, done.stderr
        (volatool.folder / "forest.dem.tif").rename(volatool.folder / name)
    status, _, modules = loaded(volatool, "info", name)
    assert status == 0
    assert not modules & {"numba", "scipy", "laspy"}
    if name != "model.tif":
        assert "rasterio" not in modules


@pytest.mark.parametrize(
    ("code", "arguments"),
    [
        ("E_NOT_FOUND", ("convert", "none.laz")),
        ("E_NOT_FOUND", ("stats", "none.laz")),
        ("E_NOT_FOUND", ("dem", "none.laz")),
        ("E_NOT_FOUND", ("info", "none.laz")),
        ("E_NOT_FOUND", ("query", "none.vol", "components")),
        ("E_NOT_FOUND", ("export", "none.vol", "--to", "ply")),
        ("E_NOT_FOUND", ("diff", "none.vol", VECTOR)),
        ("E_NOT_FOUND", ("check", "none.tif", "--points", "none.csv")),
        ("E_NOT_LAS", ("convert", "page.laz")),
        ("E_NOT_LAS", ("stats", "empty.laz")),
        ("E_NOT_LAS", ("convert", VECTOR)),
        ("E_OUTPUT_EXISTS", ("convert", "taken.laz")),
        ("E_OUTPUT_EXISTS", ("classify", "forest.laz")),
        ("E_OPTION", ("convert", "forest.laz", "--depth-from", "none.json")),
        ("E_OPTION", ("convert", "forest.laz", "--depth", "99")),
    ],
)
def test_errors_that_need_no_points_never_load_the_compiler(files, code, arguments):
    status, error, modules = loaded(files, *arguments)
    assert status != 0
    assert error.startswith(f"{code}: ")
    assert not modules & {"numba", "scipy"}
    assert "rasterio" not in modules or arguments[0] == "check"


@pytest.mark.parametrize("options", [("--no-dem",), ()])
def test_a_conversion_with_a_warm_cache_loads_no_scipy_for_the_compiler(volatool, options):
    """The registries of numba's compiler, SciPy's linear algebra with them, stay out."""
    arguments = ("convert", "forest.laz", "-q", "--overwrite", *options)
    assert volatool(*arguments).returncode == 0  # fills the cache
    code = CODE.replace('"scipy"', '"scipy.linalg", "numba.np.linalg"')
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments],
        cwd=volatool.folder, env=os.environ.copy(), capture_output=True, text=True, check=True,
    )  # fmt: skip
    modules = set(done.stderr.splitlines()[-1].split()[1:])
    assert "numba" in modules
    assert not modules & {"scipy.linalg", "numba.np.linalg"}
