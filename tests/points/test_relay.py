"""What stops a LAZ file from being written reaches the caller through the compressor."""

from __future__ import annotations

import errno
import io
import signal

import numpy as np
import pytest

from volatool.points.las_writer import LasWriter
from volatool.points.laz_encode import PointEncoder

FULL = OSError(errno.ENOSPC, "No space left on device")


class Watched(io.BytesIO):
    """A file of which writes do something else first, once it is told so."""

    before = staticmethod(lambda: None)

    def write(self, data):
        self.before()
        return super().write(data)


def fail():
    raise FULL


def interrupt():
    signal.raise_signal(signal.SIGINT)


def exported(file, before):
    writer = LasWriter(file, (1.0,) * 3, (0.0,) * 3, has_colours=False, is_compressed=True)
    file.before = before
    for _ in range(20):
        writer.write(np.random.default_rng(1).integers(0, 10**9, (50_000, 3)))
    writer.finish()


def rewritten(file, before):
    encoder = PointEncoder(6, 30)
    encoder.begin(file)
    file.before = before
    for _ in range(20):
        encoder.write(np.random.default_rng(1).integers(0, 255, (50_000, 30), np.uint8))
    encoder.end()


@pytest.mark.parametrize("write", [exported, rewritten])
def test_a_full_disk_is_told_as_such(write):
    with pytest.raises(OSError, match="No space left") as caught:
        write(Watched(), fail)
    assert caught.value is FULL


@pytest.mark.parametrize("write", [exported, rewritten])
def test_ctrl_c_is_no_failed_write(write):
    handler = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        write(Watched(), interrupt)
    assert signal.getsignal(signal.SIGINT) is handler
