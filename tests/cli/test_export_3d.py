"""``volatool export`` to 3-D formats: paths on stdout, what is lost on stderr, statuses."""

from __future__ import annotations

import pytest
from making_volumes import random_volume

import volatool as vt
from volatool.formats.octomap import parse_bt


def test_the_path_is_on_stdout_and_the_shift_on_stderr(volatool):
    vt.export_volume(random_volume(3), volatool.folder / "t.vol")
    done = volatool("export", "t.vol", "--to", "bt", "--free")
    assert (done.returncode, done.stdout) == (0, "t.bt\n")
    assert done.stderr.startswith("W_SHIFTED: t.vol: coordinates are local: add 637000.01")
    tree = parse_bt((volatool.folder / "t.bt").read_bytes())
    assert tree.n_cells == 200
    assert len(tree.free)


@pytest.mark.parametrize(
    ("arguments", "status", "message"),
    [
        (["--to", "bt"], 7, "E_SIZE"),
        (["--to", "bt", "--world", "--level", 2], 2, "E_CUBE"),
        (["--to", "binvox"], 7, "E_SIZE"),
        (["--to", "glb", "--world", "--level", 2], 2, "E_OPTION"),
        (["--to", "ply", "--colour", "class"], 2, "E_NO_METADATA"),
        (["--to", "vdb", "--free"], 2, "--free means nothing for --to vdb"),
    ],
)
def test_what_does_not_fit_is_one_line_with_a_status_and_no_file(
    volatool, arguments, status, message
):
    vt.export_volume(random_volume(9, 50), volatool.folder / "t.vol")
    before = sorted(volatool.folder.iterdir())
    done = volatool("export", "t.vol", *arguments)
    assert (done.returncode, done.stdout) == (status, "")
    assert message in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert sorted(volatool.folder.iterdir()) == before
