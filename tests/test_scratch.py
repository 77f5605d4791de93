"""Working memory under a ceiling."""

from pathlib import Path

import numpy as np
import pytest

from volatool.errors import ResourceError
from volatool.model import PointChunk
from volatool.scratch import Scratch, Spool
from volatool.vola.held import HeldPoints


def test_an_array_over_the_budget_lives_in_a_file_and_holds_the_same():
    with Scratch(1000) as scratch:
        small, large = scratch.zeros((10,), np.float64), scratch.zeros((50, 40), np.float64)
        assert (scratch.used_bytes, scratch.spilled_bytes) == (80, 16000)
        large[:] = np.arange(2000.0).reshape(50, 40)
        small[:] = 1
        scratch.relax(large, 3, 47)
        scratch.relax(large)
        scratch.relax(small)
        assert np.array_equal(large, np.arange(2000.0).reshape(50, 40))
        assert type(large) is np.ndarray
        scratch.free(small, large)
        assert scratch.used_bytes == 0


def test_without_a_budget_everything_stays_in_ram():
    scratch = Scratch()
    scratch.zeros((1000, 1000), np.float32)
    assert scratch.spilled_bytes == 0


def test_a_missing_folder_for_temporary_data_is_told(tmp_path):
    scratch = Scratch(10, directory=tmp_path / "gone")
    with pytest.raises(ResourceError, match="set TMPDIR"):
        scratch.zeros((100,), np.float64)


@pytest.mark.parametrize("budget", [None, 100, 1])
@pytest.mark.parametrize("lengths", [[5, 0, 7, 30], [42], [1] * 42, [4, 4, 16, 3], []])
@pytest.mark.parametrize("block", [4, 8, 64])
def test_a_spool_gives_back_the_rows_in_pieces_that_depend_on_nothing(
    budget, lengths, block, monkeypatch
):
    monkeypatch.setattr("volatool.scratch._BLOCK_ROWS", block)
    rows = np.arange(sum(lengths) * 3, dtype=np.int32).reshape(-1, 3)
    spool = Spool(Scratch(budget), np.dtype((np.int32, (3,))))
    start = 0
    for length in lengths:
        passed = rows[start : start + length].copy()
        spool.append(passed)
        passed[:] = -1  # it was copied
        start += length
    assert len(spool) == len(rows)
    for _ in range(2):  # readable again
        pieces = list(spool.pieces(8))
        assert [len(piece) for piece in pieces] == [8] * (len(rows) // 8) + (
            [len(rows) % 8] if len(rows) % 8 else []
        )
        assert np.array_equal(np.concatenate([*pieces, rows[:0]]), rows)
    spool.close()
    assert spool.scratch.used_bytes == 0


class Full(Scratch):
    """All its files are on a full disk: a real one, whose writes fail when they are flushed."""

    def file(self):
        return Path("/dev/full").open("w+b")


def waiting(n):
    """Return a spool and held points on a full disk, and what puts n rows into them and back."""
    spool, held = Spool(Full(0), np.dtype((np.int32, (3,)))), HeldPoints(Full(0), 1.0, [])
    x = np.zeros(n, np.int32)
    points = PointChunk(0, x, x, x, (1.0, 1.0, 1.0), (0.0, 0.0, 0.0))
    rows = np.zeros((n, 3), np.int32)
    return [
        (spool, lambda: spool.append(rows), lambda: list(spool.pieces())),
        (held, lambda: held.add(points), lambda: list(held.taken())),
    ]


needs_full = pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")


@needs_full
@pytest.mark.parametrize("n", [100, 50_000])
def test_a_full_disk_is_an_error_of_ours_at_the_write_or_at_the_flush(n):
    for store, put, get in waiting(n):
        with pytest.raises(ResourceError, match=r"No space left on device.*TMPDIR"):  # noqa: PT012
            put()
            get()
        store.close()


@needs_full
def test_what_nobody_wants_any_more_is_dropped_without_a_word():
    for store, put, _ in waiting(100):
        put()
        store.close()
