"""The comment by which a file remembers its cube: kept exactly, or refused."""

from __future__ import annotations

import json

import pytest
from making_volumes import random_volume

from volatool.errors import FormatError
from volatool.formats.origin import find_origin, origin_lines

(LINE,) = origin_lines(random_volume(3), (1, -2, 3))


def changed(**values):
    content = json.loads(LINE.removeprefix("volatool "))
    return "volatool " + json.dumps(content | values)


def test_cube_depth_corner_and_crs_are_kept():
    volume = random_volume(3)
    origin = find_origin(["other", LINE])
    assert LINE.isascii()
    assert "\n" not in LINE
    assert origin.cube == volume.cube
    assert origin.cube.exact == volume.cube.exact
    assert (origin.depth, origin.corner) == (3, (1, -2, 3))
    assert origin.info.crs == volume.info.crs
    assert origin.info.channels == volume.info.channels


def test_files_of_others_have_none():
    assert find_origin([]) is None
    assert find_origin(["made by volatool on Monday", "volatool 3"]) is None


@pytest.mark.parametrize(
    "line",
    [
        "volatool {",
        "volatool {}",
        "volatool {" + '"a":[' * 100_000,
        changed(depth=0),
        changed(depth=11),
        changed(depth=2.0),
        changed(depth=True),
        changed(corner=[0, 0]),
        changed(corner=[0, 0, 1 << 50]),
        changed(corner=None),
        changed(cube=None),
        changed(cube={"origin": ["0/1"] * 3, "side": "0/1", "snapped": False}),
        changed(cube={"origin": ["1e9"] * 3, "side": "1/1", "snapped": False}),
        changed(crs={}),
        changed(crs=[]),
        changed(quantizer="x"),
    ],
    ids=range(16),
)
def test_a_line_that_makes_no_sense_is_refused(line):
    with pytest.raises(FormatError, match="line of volatool makes no sense") as caught:
        find_origin([line])
    assert len(str(caught.value)) < 400


def test_long_comments_are_cut_and_put_together_again():
    lines = origin_lines(random_volume(3), (1, -2, 3), width=99)
    assert len(lines) > 5
    assert max(map(len, lines)) == 99
    origin = find_origin(["first", *lines, "more", "volatool+ignored"])
    assert origin == find_origin([LINE])
    with pytest.raises(FormatError, match="no sense"):
        find_origin([*lines[:3], *lines[4:]])
