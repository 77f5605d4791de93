"""Arguments to inputs, inputs to names."""

from pathlib import Path

import pytest

from volatool.batch.plan import expand, refuse_collisions
from volatool.errors import InputNotFoundError, OptionError, OutputExistsError
from volatool.naming import stem


@pytest.fixture
def tiles(tmp_path):
    for name in ("b.laz", "a.LAS", "c.copc.laz", "readme.txt"):
        (tmp_path / name).touch()
    (tmp_path / "deeper.laz").mkdir()
    return tmp_path


def test_a_folder_gives_its_point_files_in_order(tiles):
    assert [path.name for path in expand([str(tiles)])] == ["a.LAS", "b.laz", "c.copc.laz"]


def test_patterns_lists_and_stdin_give_names_each_once(tiles):
    (tiles / "list.txt").write_text(f"{tiles}/b.laz\n\n{tiles}/c.copc.laz\n")
    arguments = [f"{tiles}/*.copc.laz", f"@{tiles}/list.txt", "-", str(tiles / "gone.laz")]
    found = expand(arguments, [str(tiles / "b.laz"), "x.laz"])
    assert [path.name for path in found] == ["c.copc.laz", "b.laz", "x.laz", "gone.laz"]


@pytest.mark.parametrize("name", ["odd[1].laz", "what?.laz"])
def test_a_file_whose_name_looks_like_a_pattern_is_itself(tmp_path, name):
    (tmp_path / name).touch()
    assert expand([str(tmp_path / name)]) == [tmp_path / name]


def test_what_gives_no_input_is_an_error(tiles):
    (tiles / "empty").mkdir()
    for argument in (str(tiles / "empty"), f"{tiles}/*.xyz", "-"):
        with pytest.raises(OptionError):
            expand([argument])
    with pytest.raises(InputNotFoundError, match="gone"):
        expand([f"@{tiles}/gone.txt"])


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("a.laz", "a"),
        ("a.LAZ", "a"),
        ("a.b.copc.laz", "a.b"),
        ("a.vol.gz", "a"),
        (".laz", ".laz"),
        ("noext", "noext"),
    ],
)
def test_stems(name, expected):
    assert stem(Path(name)) == expected


def test_two_inputs_that_would_write_the_same_output_are_refused():
    inputs = [Path("x/a.las"), Path("y/a.laz")]
    refuse_collisions(inputs, None)
    with pytest.raises(OutputExistsError, match="would both write") as caught:
        refuse_collisions(inputs, Path("out"))
    assert caught.value.code == "E_NAME_COLLISION"
