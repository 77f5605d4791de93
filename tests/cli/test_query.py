"""``volatool query``: one answer line for each query, from arguments or stdin, as it comes."""

from __future__ import annotations

import json
import shlex
import subprocess
import sys
from pathlib import Path

import click
import numpy as np
import pytest
from click.testing import CliRunner
from making_volumes import random_volume

from volatool.errors import OptionError
from volatool_cli.main import cli

KINDS = cli.commands["query"].commands


@pytest.fixture
def asked(volatool):
    """Run ``volatool query`` on a small volume in feet; ``.volume`` is what it asks."""
    from volatool.formats import sparse

    volume = random_volume()
    with (volatool.folder / "v.vol").open("wb") as file:
        sparse.write(file, volume)

    def run(*arguments, **options):
        return volatool("query", "v.vol", *arguments, **options)

    run.volume = volume
    run.folder = volatool.folder
    return run


def lines_of(xyz):
    return "".join(f"{x!r} {y!r} {z!r}\n" for x, y, z in np.asarray(xyz).tolist())


def test_the_examples_of_each_kind_run(volatool, monkeypatch):
    monkeypatch.chdir(volatool.folder)
    Path("tile.laz").symlink_to("forest.laz")
    assert volatool("convert", "tile.laz", "-q", "--no-dem").returncode == 0
    Path("points.txt").write_text("6181200 2301150 3990\n6181300 2301150 3990\n")
    for name, kind in KINDS.items():
        text = kind.get_help(click.Context(kind, info_name=name))
        examples = text.split("Examples:")[1].split("Options:")[0].strip().splitlines()
        assert examples
        for example in map(str.strip, examples):
            if set(example) & set("|<"):
                command = f"{shlex.quote(sys.executable)} -m volatool_cli "
                line = example.replace("volatool ", command)
                done = subprocess.run(["bash", "-c", line], capture_output=True, text=True)
                assert (done.returncode, done.stderr) == (0, ""), example
            else:
                done = CliRunner().invoke(cli, shlex.split(example)[1:])
                assert (done.exit_code, done.stderr) == (0, ""), example
            assert done.stdout, example


def test_points_from_stdin_are_answered_as_the_library_answers(asked):
    centers = asked.volume.centers()
    corner = np.array(asked.volume.cube.origin)
    xyz = np.vstack([centers[:50], corner + 10.01 * np.random.default_rng(1).random((50, 3))])
    text = "# x y z\n\n" + lines_of(xyz).replace(" ", ", ") + "0 0 0 # far away\nnan 1 -inf\n"
    done = asked("point", input=text)
    assert (done.returncode, done.stderr) == (0, "")
    answers = done.stdout.split()
    assert [word == "occupied" for word in answers[:-2]] == asked.volume.contains(xyz).tolist()
    assert answers[-2:] == ["outside", "outside"]
    assert {"occupied", "free"} <= set(answers)


def test_negative_numbers_are_numbers_and_unknown_options_are_not(asked):
    done = asked("point", "-120.5", "-1e3", "-.5", "--json")
    assert json.loads(done.stdout) == {"answer": "outside", "query": [-120.5, -1000.0, -0.5]}
    assert asked("point", "-1,-2,-3", "4", "5", "-inf").stdout == "outside\noutside\n"
    done = asked("point", "--jsno", "1", "2", "3")
    assert (done.returncode, done.stdout) == (2, "")
    assert "No such option '--jsno'" in done.stderr


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("1 2", "line 4 of stdin: expected 3 numbers, X Y Z; got 2"),
        ("1 2 3 4", "line 4 of stdin: expected 3 numbers, X Y Z; got 4"),
        ("1 2 east", "line 4 of stdin: 'east' is not a number"),
        ("1 2 1_0", "line 4 of stdin: '1_0' is not a number"),
        ("\xff 2 3", "line 4 of stdin: '\xff' is not a number"),
    ],
)
def test_a_line_that_is_no_query_ends_the_run_after_the_answers_before_it(asked, line, message):
    done = asked("point", "-", input=f"1 2 3\n#\n4 5 6\r\n{line}\n7 8 9\n")
    assert (done.returncode, done.stdout) == (2, "outside\noutside\n")
    assert done.stderr == f"E_OPTION: {message}\n"


def test_wrong_arguments_and_files_are_told(asked, volatool):
    assert "expected 3 numbers, X Y Z; got 4" in asked("point", 1, 2, 3, 4).stderr
    done = volatool("query", "gone.vol", "point", 1, 2, 3)
    assert (done.returncode, done.stderr) == (4, "E_NOT_FOUND: gone.vol: no such file\n")
    assert volatool("query", "v.vol").returncode == 2
    assert volatool("query").stderr.startswith("E_OPTION: Missing argument 'FILE'")
    done = volatool("query", "point", "--help")
    assert done.stdout.startswith("Usage: volatool query FILE point")


def test_an_answer_comes_when_its_line_has_come(asked):
    """A program at the other end of two pipes can ask, wait for the answer, and ask again."""
    command = [sys.executable, "-m", "volatool_cli", "query", "v.vol", "point"]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=asked.folder
    ) as process:
        for xyz in (*asked.volume.centers()[:2], (0, 0, 0)):
            process.stdin.write(lines_of([np.asarray(xyz, float)]).encode())
            process.stdin.flush()
            answer = process.stdout.readline()
            assert answer == (b"occupied\n" if np.any(xyz) else b"outside\n")
        process.stdin.write(b"0 0 0")  # the last line needs no end
        process.stdin.close()
        assert process.stdout.read() == b"outside\n"
    assert process.returncode == 0


def test_stdin_that_is_closed_or_empty(asked):
    command = f"{shlex.quote(sys.executable)} -m volatool_cli query v.vol point"
    for end, status, start in (("<&-", 2, "E_OPTION: stdin is closed"), ("</dev/null", 0, "")):
        done = subprocess.run(
            ["bash", "-c", f"{command} {end}"], cwd=asked.folder, capture_output=True, text=True
        )
        assert (done.returncode, done.stdout) == (status, "")
        assert done.stderr.startswith(start)


def test_a_line_without_end_is_refused(monkeypatch):
    from volatool_cli.queries import _batches_of_stdin

    class Endless:
        def read1(self, size):
            return b"1" * size

    monkeypatch.setattr("sys.stdin", type("Stdin", (), {"buffer": Endless()})())
    with pytest.raises(OptionError, match="line 1 of stdin"):
        list(_batches_of_stdin())


def test_a_reader_that_goes_away_is_no_error(asked):
    line = f"yes 0 0 0 | {shlex.quote(sys.executable)} -m volatool_cli query v.vol point | head -1"
    done = subprocess.run(
        ["bash", "-c", f"{line}; echo ${{PIPESTATUS[1]}}"],
        cwd=asked.folder, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert (done.stdout, done.stderr) == ("outside\n141\n", "")
