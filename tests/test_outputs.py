"""Outputs appear whole or not at all."""

import os
import platform
import re
from pathlib import Path

import pytest

from volatool.errors import OutputError, OutputExistsError
from volatool.outputs import OutputSet, discard_all, sweep


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_nothing_shows_before_commit_and_everything_after(tmp_path):
    with OutputSet() as outputs:
        for name in ("a.vol.gz", "a.dem.tif"):
            temporary = outputs.add(tmp_path / "new" / name)
            temporary.write_text(name)
            assert temporary.suffix == Path(name).suffix
        assert not [name for name in names(tmp_path / "new") if not name.startswith(".")]
        paths = outputs.commit()
    assert names(tmp_path / "new") == ["a.dem.tif", "a.vol.gz"]
    assert [path.read_text() for path in paths] == ["a.vol.gz", "a.dem.tif"]


def test_an_error_leaves_the_old_output_and_nothing_else(tmp_path):
    (tmp_path / "a").write_text("old")
    with OutputSet(overwrite=True) as outputs:
        outputs.add(tmp_path / "a").write_text("new")
        # no commit: what an error in the middle comes to
    assert names(tmp_path) == ["a"]
    assert (tmp_path / "a").read_text() == "old"


def test_a_process_that_ends_at_once_can_remove_all_that_it_was_writing(tmp_path):
    with OutputSet() as done, OutputSet() as one, OutputSet() as other:
        done.add(tmp_path / "a").touch()
        done.commit()
        one.add(tmp_path / "b").touch()
        other.add(tmp_path / "c").touch()
        other.add(tmp_path / "d")  # nothing written yet
        discard_all()
        assert names(tmp_path) == ["a"]


def test_existing_outputs_are_refused_unless_asked(tmp_path):
    (tmp_path / "a").write_text("old")
    with OutputSet() as outputs, pytest.raises(OutputExistsError, match="--overwrite"):
        outputs.add(tmp_path / "a")
    with OutputSet(overwrite=True) as outputs:
        outputs.add(tmp_path / "a").write_text("new")
        outputs.commit()
    assert (tmp_path / "a").read_text() == "new"


def test_a_folder_in_place_of_an_output_is_refused_even_with_overwrite(tmp_path):
    (tmp_path / "a").mkdir()
    with OutputSet(overwrite=True) as outputs, pytest.raises(OutputExistsError, match="folder"):
        outputs.add(tmp_path / "a")


def test_a_pipe_or_device_is_never_replaced(tmp_path):
    os.mkfifo(tmp_path / "a")
    with OutputSet(overwrite=True) as outputs, pytest.raises(OutputExistsError, match="pipe"):
        outputs.add(tmp_path / "a")
    with OutputSet(overwrite=True) as outputs, pytest.raises(OutputExistsError, match="device"):
        outputs.add(Path("/dev/null"))
    assert names(tmp_path) == ["a"]


def test_a_link_counts_as_there_even_if_it_leads_nowhere(tmp_path):
    (tmp_path / "a").symlink_to("nowhere")
    with OutputSet() as outputs, pytest.raises(OutputExistsError, match="--overwrite"):
        outputs.add(tmp_path / "a")
    with OutputSet(overwrite=True) as outputs:
        outputs.add(tmp_path / "a").write_text("new")
        outputs.commit()
    assert names(tmp_path) == ["a"]
    assert not (tmp_path / "a").is_symlink()


def test_errors_tell_the_name_that_was_asked_for(tmp_path):
    with OutputSet() as outputs:
        outputs.add(tmp_path / "a.vol.gz")  # not written
        with pytest.raises(OutputError, match=re.escape(f"{tmp_path}/a.vol.gz: can't")) as caught:
            outputs.commit()
    assert ".tmp" not in str(caught.value)


def test_a_file_in_place_of_the_folder_is_a_write_error(tmp_path):
    (tmp_path / "file").touch()
    with OutputSet() as outputs, pytest.raises(OutputError, match="can't be written"):
        outputs.add(tmp_path / "file" / "a")


def test_leftovers_of_dead_processes_are_swept_and_those_of_others_kept(tmp_path):
    host = re.sub("[^A-Za-z0-9_]", "_", platform.node())
    dead = f".a.vol.volatool-{host}-{2**22 + 1}.tmp.vol"
    alive = f".b.vol.volatool-{host}-{os.getppid()}.tmp.vol"
    elsewhere = f".a.vol.volatool-{host}x-{2**22 + 1}.tmp.vol"
    for name in (dead, alive, elsewhere, "c.vol", ".hidden"):
        (tmp_path / name).touch()
    sweep(tmp_path)
    assert names(tmp_path) == sorted([alive, elsewhere, "c.vol", ".hidden"])


def test_an_output_that_was_never_written_is_an_error(tmp_path):
    with OutputSet() as outputs:
        outputs.add(tmp_path / "a")
        with pytest.raises(OutputError):
            outputs.commit()
