"""What is held out hangs on the points alone: about the share asked for, blocks whole."""

from __future__ import annotations

import numpy as np
from making_dems import ground, hills, with_rows

from volatool.dem.split import part, split


def both(points, chosen):
    return [
        {tuple(row) for rows in part(points, chosen, held=held).pieces() for row in rows.tolist()}
        for held in (False, True)
    ]


def test_held_out_and_others_make_the_whole():
    """No point is lost or in both; the lengths are right; about the part asked for."""
    points = ground(*hills(8000, 100.0))
    chosen = split(points, 0.05, 0.05, 1.0, None)
    train, test = both(points, chosen)
    rows = np.concatenate(list(points.pieces()))
    assert train | test == {tuple(row) for row in rows.tolist()}
    assert not train & test
    assert len(part(points, chosen, held=True)) + len(part(points, chosen, held=False)) == 8000
    assert 0.06 < len(test) / 8000 < 0.14


def test_blocks_are_held_out_whole():
    """Ten spacings a side, at least ten metres, a fifth of the tile at most."""
    points = ground(*hills(8000, 100.0))
    chosen = split(points, 0.0, 0.05, 1.0, None)
    assert chosen.blocks.cell == 10
    assert chosen.chosen.sum() == 5
    rows = np.concatenate(list(points.pieces()))
    held = chosen.held(points, rows)
    top, left = round(100 * chosen.blocks.top), round(100 * chosen.blocks.left)
    row = np.minimum((top - rows[:, 1]) // 1000, chosen.blocks.height - 1)
    col = np.minimum((rows[:, 0] - left) // 1000, chosen.blocks.width - 1)
    np.testing.assert_array_equal(held, chosen.chosen[row, col])
    assert split(points, 0.0, 0.05, 3.0, None).blocks.cell == 19.998  # a fifth of 99.99
    assert split(points, 0.0, 0.05, 1.5, None).blocks.cell == 15


def test_order_does_not_matter_and_salts_do():
    """Shuffled points: the same choice; another salt: another."""
    points = ground(*hills(3000, 100.0))
    rows = np.concatenate(list(points.pieces()))
    mixed = with_rows(points, np.random.default_rng(0).permutation(rows))
    first = both(points, split(points, 0.05, 0.05, 1.0, None))
    assert first == both(mixed, split(mixed, 0.05, 0.05, 1.0, None))
    assert first != both(points, split(points, 0.05, 0.05, 1.0, None, salt=1))


def test_tiny_tiles_keep_a_block():
    """One point is never held out; of equal points neither."""
    for n in (1, 3):
        points = ground(np.full(n, 5.0), np.full(n, 5.0), np.full(n, 1.0))
        chosen = split(points, 0.0, 0.5, 1.0, None)
        assert not chosen.chosen.any()
