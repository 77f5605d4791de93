"""Columns of numbers: what a table may look like, and what is told of one that can't be read."""

from __future__ import annotations

import numpy as np
import pytest
from making_imports import opened, points_of

from volatool.errors import FormatError, InputError, OptionError, VolatoolError
from volatool.imports import text

ROWS = [(1.25, 2.5, 3.0, 7, 10, 20, 30, 2), (-1.5, 100.125, 0.0, 0, 255, 0, 1, 9)]
XYZ = np.array([row[:3] for row in ROWS])


def table(rows=ROWS, separator=" ", n=8, end="\n"):
    return "".join(separator.join(str(v) for v in row[:n]) + end for row in rows)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.xyz", table()),
        ("a.xyz", table(end="\r\n")),
        ("a.xyz", table(separator="\t")),
        ("a.xyz", table(separator="  ").rstrip("\n")),
        ("a.csv", "\ufeffX,Y,Z,Intensity,Red,Green,Blue,Classification\n" + table(separator=",")),
        ("a.csv", '"x";"y";"z";"i";"r";"g";"b";"c"\n' + table(separator=" ; ")),
        ("a.txt", "# a comment\n\n" + table(separator=", ") + "\n  \n# the end\n"),
        ("a.txt", "//X Y Z Intensity R G B Class\n2\n" + table()),
        ("a.pts", "2\n" + table()),
        ("a.xyz", table().replace("\n", "\r")),
        ("a.xyz", table(separator=",", end=",\n")),
    ],
)
def test_a_table_is_read_whatever_separates_it(tmp_path, name, content):
    (tmp_path / name).write_text(content, encoding="utf-8", newline="")
    if "2\n1.25" in content and not name.endswith("pts"):
        content = content.replace("\n2\n", "\n")
        (tmp_path / name).write_text(content, encoding="utf-8", newline="")
    xyz, attributes = points_of(tmp_path / name)
    assert np.array_equal(xyz, XYZ)
    assert attributes["intensity"].tolist() == [7, 0]
    assert attributes["red"].tolist() == [10, 255]
    assert attributes["blue"].tolist() == [30, 1]
    assert attributes["classification"].tolist() == [2, 9]


@pytest.mark.parametrize(
    ("n", "names"),
    [(3, ""), (4, "intensity"), (6, "red green blue"), (7, "intensity red green blue")],
)
def test_the_number_of_columns_tells_what_they_are(tmp_path, n, names):
    (tmp_path / "a.xyz").write_text(table(n=n))
    assert opened(tmp_path / "a.xyz").header.dimensions == set(names.split())


def test_columns_without_names_are_left_out_and_told(tmp_path):
    (tmp_path / "a.xyz").write_text(table(n=5))
    source = opened(tmp_path / "a.xyz")
    assert not source.header.dimensions
    assert "W_COLUMNS" in [warning.code for warning in source.warnings]


def test_columns_go_before_names_and_may_be_left_out(tmp_path):
    (tmp_path / "a.csv").write_text("x,y,z,intensity\n1,2,3,4\n")
    xyz, attributes = points_of(tmp_path / "a.csv", columns=("z", "-", "y", "x"))
    assert xyz.tolist() == [[4.0, 3.0, 1.0]]
    assert not attributes
    (tmp_path / "b.xyz").write_text("1 2 3 5 6 4\n")
    _, found = points_of(tmp_path / "b.xyz", columns="x,y,z,return_number,number of returns")
    assert {name: v.tolist() for name, v in found.items()} == {
        "return_number": [5],
        "number_of_returns": [6],
    }


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ("x,y", "no column is called z"),
        ("x,y,z,zz", "'zz' is not one of"),
        ("x,y,z,i,intensity", "comes twice"),
        ("x,y,z,-,-,-,-,-,-", "names 9 columns; the file has 8"),
    ],
)
def test_columns_that_make_no_sense_are_refused(tmp_path, columns, message):
    (tmp_path / "a.xyz").write_text(table())
    with pytest.raises(OptionError, match=message):
        opened(tmp_path / "a.xyz", columns=columns)


@pytest.mark.parametrize(
    ("content", "message", "code"),
    [
        ("1 2 3\n4 5", "line 2: 2 values, expected 3", "E_TRUNCATED"),
        ("1 2 3\n4 5\n", "line 2: 2 values, expected 3", "E_CORRUPT"),
        ("1 2 3\n\n# x\n4 five 6\n", "line 4: '4 five 6'", "E_CORRUPT"),
        ("1 2 3\n4 1_0 6\n", "line 2: '4 1_0 6'", "E_CORRUPT"),
        ("1 2 3\n\n4 nan 6\n", "line 3: coordinates 4.0, nan, 6.0", "E_BAD_COORDINATE"),
        ("# c\n1 2 3\n4 5 inf\n", "line 3: coordinates", "E_BAD_COORDINATE"),
        ("1 2\n", "2 columns; points need three", "E_NOT_IMPORT"),
        ("x,y,z,i\n1,2,3\n", "line 2: 3 values, the header names 4", "E_CORRUPT"),
        ("hello world\n1 2 3\n", "line 1: 'hello world' is neither", "E_NOT_IMPORT"),
        ("x y\n1 2 3\n", "line 1: 'x y' is neither", "E_NOT_IMPORT"),
        ("# only a comment\n", "no line of numbers", "E_NOT_IMPORT"),
        ("1\0 2 3\n", "NUL bytes", "E_NOT_IMPORT"),
        ("", "the file is empty", "E_NOT_IMPORT"),
        ("1 2 3\n" + "4" * 5000, "line 2", "E_CORRUPT"),
    ],
)
def test_a_fault_is_told_with_its_line(tmp_path, monkeypatch, content, message, code):
    monkeypatch.setattr(text, "BLOCK_BYTES", 1000)
    (tmp_path / "a.xyz").write_text(content)
    with pytest.raises(FormatError, match=message) as caught:
        opened(tmp_path / "a.xyz")
    assert caught.value.code == code
    assert str(caught.value).startswith(("a.xyz: ", str(tmp_path / "a.xyz")))


def test_columns_that_are_not_cut_say_what_to_do(tmp_path):
    path = tmp_path / "a.txt"
    commas, cut = "; decimal commas are not read", "; columns are separated by commas, semicolons"
    for rows, advice in (
        (("1,5;2,5;3,5", "1,5 2,5 3,5", "1,5\t2,5\t3"), commas),
        (("1|2|3", "1:2:3"), cut),
        (("east,north,up",), "$"),
    ):
        for row in rows:
            path.write_text(row + "\n")
            with pytest.raises(FormatError, match=f"names x, y and z{advice}"):
                opened(path)


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("1 2 3 70000 0 0 0 2", "line 4: intensity is 70000, not in 0 to 65535"),
        ("1 2 3 -1 0 0 0 2", "line 4: intensity is -1, not in"),
        ("1 2 3 1 0 0 0 256", "line 4: classification is 256, not in 0 to 255"),
        ("1 2 3 1 0 nan 0 2", "line 4: green is nan"),
    ],
)
def test_numbers_out_of_range_are_refused_with_their_line(tmp_path, row, message):
    (tmp_path / "a.xyz").write_text("1 2 3 1 0 0 0 2\n# c\n\n" + row + "\n")
    with pytest.raises(FormatError, match=message) as caught:
        points_of(tmp_path / "a.xyz")
    assert caught.value.code == "E_RANGE"


@pytest.mark.parametrize("size", [64, 100, 1 << 22])
@pytest.mark.parametrize("marks", ["", "# between\n"])
def test_blocks_and_chunks_do_not_matter(tmp_path, monkeypatch, size, marks):
    """However the text is cut, all rows come, in order, and a fault has its line."""
    monkeypatch.setattr(text, "BLOCK_BYTES", size)
    rows = [(k, k / 4, -k, k % 200, 1, 2, 3, 2) for k in range(101)]
    (tmp_path / "a.xyz").write_text(marks.join(table([row]) for row in rows))
    for chunk in (1, 7, 1000):
        xyz, attributes = points_of(tmp_path / "a.xyz", chunk)
        assert np.array_equal(xyz, np.array(rows)[:, :3])
        assert attributes["intensity"].tolist() == [row[3] for row in rows]
    with (tmp_path / "a.xyz").open("a") as file:
        file.write("0 0\n")
    with pytest.raises(VolatoolError, match=f"line {202 - (not marks) * 100 if marks else 102}"):
        opened(tmp_path / "a.xyz")


def test_a_folder_and_a_missing_file_are_told(tmp_path):
    (tmp_path / "a.xyz").mkdir()
    with pytest.raises(InputError, match="is not a file"):
        opened(tmp_path / "a.xyz")
    with pytest.raises(FileNotFoundError, match="no such file"):
        opened(tmp_path / "b.xyz")


def test_a_file_that_grows_meanwhile_is_told(tmp_path):
    (tmp_path / "a.xyz").write_text("1 2 3\n4 5 6\n")
    source = opened(tmp_path / "a.xyz")
    with (tmp_path / "a.xyz").open("a") as file:
        file.write("1e9 1e9 1e9\n")
    with pytest.raises(InputError, match="had 2 points when it was opened and now has 3"):
        list(source.chunks())
