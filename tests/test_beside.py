"""Volumes written beside the elevation model: the same errors, nothing left, memory kept."""

from __future__ import annotations

import errno
import threading
import time
from pathlib import Path

import pytest

import volatool as vt
from volatool import tile, volumes
from volatool.beside import Beside, StoppedError
from volatool.encodings import Encoding, written_bytes
from volatool.errors import FormatError, OutputError
from volatool.options import ConvertOptions
from volatool.units import Length

FOREST = Path(__file__).resolve().parents[1] / "data_samples" / "forest.laz"
OPTIONS = ConvertOptions(cell=Length.parse("5m"), resources=False)


def convert(folder, options=OPTIONS):
    return tile.convert_tile(FOREST, options, outdir=folder)


def full_disk(*arguments):
    raise OSError(errno.ENOSPC, "No space left on device")


def test_a_full_disk_in_the_thread_is_the_same_error(tmp_path, monkeypatch):
    monkeypatch.setattr(volumes, "write_volume", full_disk)
    with pytest.raises(OutputError, match=r"forest\.vol\.gz: can't be written") as raised:
        convert(tmp_path)
    assert raised.value.code == "E_WRITE"
    assert list(tmp_path.iterdir()) == []


def test_of_two_errors_the_volume_s_is_told(tmp_path, monkeypatch):
    def no_model(*arguments):
        raise FormatError("no model")

    monkeypatch.setattr(tile, "make_elevation", no_model)
    with pytest.raises(FormatError, match="no model; --no-dem leaves"):
        convert(tmp_path)
    monkeypatch.setattr(volumes, "write_volume", full_disk)
    with pytest.raises(OutputError, match=r"forest\.vol\.gz"):
        convert(tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_an_interrupt_stops_the_thread_before_files_are_removed(tmp_path, monkeypatch):
    stopped = threading.Event()
    started = threading.Event()

    def slow(stream, volume, encoding, is_stopped):
        started.set()
        while not is_stopped():
            time.sleep(0.01)
        stopped.set()
        raise StoppedError

    def interrupted(*arguments):
        assert started.wait(60)
        raise KeyboardInterrupt

    monkeypatch.setattr(volumes, "write_volume", slow)
    monkeypatch.setattr(tile, "make_elevation", interrupted)
    with pytest.raises(KeyboardInterrupt):
        convert(tmp_path)
    assert stopped.is_set()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("is_short", [False, True])
def test_where_memory_is_short_the_volume_is_written_first(tmp_path, monkeypatch, is_short):
    write, threads = volumes.write_volume, set()

    def noted(*arguments):
        threads.add(threading.current_thread() is threading.main_thread())
        write(*arguments)

    monkeypatch.setattr(volumes, "write_volume", noted)
    if is_short:
        monkeypatch.setattr(volumes, "_SHARE_OF_BUDGET", 0.0)
    assert len(convert(tmp_path).paths) == 4
    assert threads == {is_short}


def test_a_volume_that_is_not_wanted_any_more_is_not_packed():
    volume = vt.open(FOREST.parents[1] / "docs" / "vectors" / "sparse3-corners.vol")
    with pytest.raises(StoppedError):
        written_bytes(volume, Encoding("sparse", 1, "gzip"), lambda: True)
    assert written_bytes(volume, Encoding("sparse", 1, "gzip"), lambda: False) == written_bytes(
        volume, Encoding("sparse", 1, "gzip")
    )


def test_what_was_started_is_waited_for():
    done = []
    with Beside() as beside:
        result = beside.start(lambda is_stopped: (time.sleep(0.05), done.append(1), 7)[2])
    assert done == [1]
    assert result() == 7
