"""The manual pages: one for each command, and readable."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import click
import pytest

from volatool_cli.main import cli

TOP = Path(__file__).resolve().parents[1]


def names(command, name):
    yield name
    for key, below in getattr(command, "commands", {}).items():
        yield from names(below, f"{name}-{key}")


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    folder = tmp_path_factory.mktemp("man") / "man1"
    done = subprocess.run(
        [sys.executable, TOP / "docs" / "man.py", folder],
        env={**os.environ, "SOURCE_DATE_EPOCH": "0"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == [str(folder / f"{name}.1") for name in names(cli, "volatool")]
    return sorted(folder.iterdir())


def test_each_command_has_a_page_that_says_what_its_help_says(pages):
    by_name = {page.stem: page.read_text(encoding="utf-8") for page in pages}
    assert sorted(by_name) == sorted(names(cli, "volatool"))
    assert "volatool\\-query\\-box \\- What is in a box?" in by_name["volatool-query-box"]
    assert "1970-01-01" in by_name["volatool"]
    stats = by_name["volatool-stats"].replace("\\-", "-")
    context = click.Context(cli.commands["stats"])
    for option in cli.commands["stats"].params:
        record = option.get_help_record(context)
        assert record is None or record[1].split("  [")[0] in stats, option.name
    assert "volatool stats tile.vol.gz --format json\n" in stats


@pytest.mark.skipif(shutil.which("groff") is None, reason="groff is not installed")
def test_the_pages_are_clean_troff(pages):
    for page in pages:
        done = subprocess.run(
            ["groff", "-ww", "-man", "-Tutf8", page], capture_output=True, text=True, check=False
        )
        assert (done.returncode, done.stderr) == (0, ""), page.name
        assert "volatool" in done.stdout


@pytest.mark.skipif(shutil.which("lexgrog") is None, reason="man-db is not installed")
def test_apropos_finds_each_page(pages):
    done = subprocess.run(["lexgrog", *pages], capture_output=True, text=True, check=False)
    assert done.returncode == 0
    for page in pages:
        assert f'{page}: "{page.stem} - ' in done.stdout
