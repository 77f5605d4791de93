"""The documentation: what it tells to type runs, and its generated pages are up to date."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys

import pytest
from running_docs import TOP, blocks, put_command, shell

PAGES = [
    "docs/tutorial.md",
    "docs/how-to/many-tiles.md",
    "docs/how-to/data-sets.md",
    "docs/how-to/dem.md",
    "docs/how-to/uncertainty.md",
    "docs/how-to/check-accuracy.md",
    "docs/how-to/validate.md",
    "docs/how-to/compare.md",
    "docs/how-to/export-3d.md",
    "docs/how-to/export.md",
    "docs/how-to/index.md",
    "docs/how-to/import.md",
    "docs/how-to/query.md",
    "docs/how-to/space.md",
    "docs/reference/manifest.md",
]


@pytest.fixture
def workplace(tmp_path):
    """Folder with what the pages name: the samples, a folder of tiles, a list of them."""
    put_command(tmp_path)
    shutil.copytree(TOP / "data_samples", tmp_path / "data_samples")
    (tmp_path / "tiles").mkdir()
    sample = tmp_path / "data_samples" / "forest.laz"
    for name in ("tiles/a_2024.laz", "tiles/b.laz", "tile.laz"):
        (tmp_path / name).symlink_to(sample)
    (tmp_path / "tiles.txt").write_text("tiles/a_2024.laz\ntiles/b.laz\n")
    return tmp_path


@pytest.mark.parametrize("page", PAGES)
def test_the_commands_of_a_page_run(page, workplace):
    installing = ("python3", ".venv/bin/pip", ".")  # what .ci/run does
    missing = [tool for tool in ("jq", "gdaldem", "gdalbuildvrt") if not shutil.which(tool)]
    for line in "".join(blocks(page, "sh")).splitlines():
        if line.startswith(installing) or any(tool in line for tool in missing):
            continue
        # the lines of a page stand side by side: each may write the same names
        line = re.sub(r"volatool (convert|dem|export|index) ", r"volatool \1 --overwrite ", line)
        done = shell(line, workplace)
        assert done.returncode == 0, f"{line}\n{done.stderr}"


def test_the_python_of_the_tutorial_runs(workplace):
    assert shell("volatool convert data_samples/town.laz -o out", workplace).returncode == 0
    for block in blocks("docs/tutorial.md", "python"):
        done = subprocess.run(
            [sys.executable, "-c", block],
            cwd=workplace,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        assert "Volume depth 4" in done.stdout


@pytest.mark.parametrize("page", ["docs/how-to/query.md", "docs/how-to/space.md"])
def test_the_python_of_the_pages_on_queries_runs(page, workplace):
    made = shell("volatool convert data_samples/town.laz --no-dem -o out", workplace)
    assert made.returncode == 0
    (code,) = blocks(page, "python")
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=workplace, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


def test_generated_pages_links_and_codes_are_up_to_date():
    done = subprocess.run(
        [sys.executable, "docs/check.py"], cwd=TOP, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


def test_the_python_of_the_page_on_live_scans_runs():
    """All of it that needs no ROS bag."""
    own = [code for code in blocks("docs/how-to/live.md", "python") if "rosbags" not in code]
    assert len(own) == 1
    done = subprocess.run([sys.executable, "-c", own[0]], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("(40, 40) ")
