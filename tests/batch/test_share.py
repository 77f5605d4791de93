"""Cores and memory shared out to processes."""

import logging

import pytest

from volatool.batch import jobs
from volatool.batch.jobs import Share, share_out
from volatool.errors import ResourceError

MIB = 1 << 20


@pytest.fixture(autouse=True)
def eight_cores(monkeypatch):
    monkeypatch.setattr(jobs, "n_cores", lambda: 8)


@pytest.mark.parametrize(
    ("asked", "memory", "n_inputs", "share"),
    [
        (1, 1024, 100, Share(1, 8, 1024 * MIB)),
        (2, 1024, 100, Share(2, 4, 512 * MIB)),
        (3, 1024, 2, Share(2, 4, 512 * MIB)),  # no more than inputs
        (50, 1024, 1, Share(1, 8, 1024 * MIB)),  # this process, with all of the memory
        (16, 8192, 100, Share(16, 1, 512 * MIB)),  # more than cores, if asked for
        (None, 8192, 100, Share(8, 1, 1024 * MIB)),
        (None, 1024, 100, Share(4, 2, 256 * MIB)),  # what the memory is enough for
        (None, 100, 100, Share(1, 8, 100 * MIB)),
        (None, 8192, 3, Share(3, 2, 8192 * MIB // 3)),
    ],
)
def test_shares(asked, memory, n_inputs, share):
    assert share_out(asked, memory * MIB, n_inputs) == share


def test_shares_too_small_to_work_with_are_refused_with_what_is_needed():
    with pytest.raises(ResourceError, match=r"raise it to 2\.0 GiB, or lower --jobs"):
        share_out(8, 1024 * MIB, 100)


def test_auto_says_when_memory_leaves_cores_idle(caplog):
    caplog.set_level(logging.WARNING)
    share_out(None, 1024 * MIB, 4)
    share_out(None, 8192 * MIB, 100)
    assert caplog.text == ""
    share_out(None, 1024 * MIB, 100)
    assert "4 of 8 cores: --memory 1.0 GiB is 256.0 MiB for each" in caplog.text
