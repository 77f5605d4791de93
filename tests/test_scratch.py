"""Working memory under a ceiling."""

import numpy as np
import pytest

from volatool.errors import ResourceError
from volatool.scratch import Scratch, Spool


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
@pytest.mark.parametrize("lengths", [[5, 0, 7, 30], [42], [1] * 42, []])
def test_a_spool_gives_back_the_rows_in_pieces_that_depend_on_nothing(budget, lengths):
    rows = np.arange(sum(lengths) * 3, dtype=np.int32).reshape(-1, 3)
    spool = Spool(Scratch(budget), np.dtype((np.int32, (3,))))
    start = 0
    for length in lengths:
        spool.append(rows[start : start + length])
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
