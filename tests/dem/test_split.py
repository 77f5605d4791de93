"""What is held out hangs on the points alone: about the share asked for, blocks whole."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from making_dems import ground, hills, with_rows

from volatool.dem.grid import Grid
from volatool.dem.split import part, split, within


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


def test_neighbours_points_are_held_out_once():
    """Points beyond the tile's edge count like its own, in one part each."""
    points = ground(*hills(2000, 100.0))
    rows = np.concatenate(list(points.pieces()))
    spool = with_rows(points, rows[1500:]).spool
    seam = replace(with_rows(points, rows[:1500]), beyond=spool)
    chosen = split(seam, 0.05, 0.05, 1.0, None)
    train, test = (part(seam, chosen, held=held) for held in (False, True))
    assert len(train) + len(test) == 2000
    for some in (train, test):
        assert sum(map(len, some.pieces())) == len(some)
    assert both(seam, chosen) == both(points, chosen)


def test_within_leaves_out_points_off_the_grid():
    """Of a DEM like another raster some points lie outside."""
    x, y, z = hills(2000, 60.0)
    points = ground(x, y, z)
    inside = within(points, Grid(10.0, 50.0, 1.0, 20, 20))
    kept = (x >= 10) & (x <= 30) & (y >= 30) & (y <= 50)
    assert len(inside) == sum(map(len, inside.pieces())) == np.count_nonzero(kept)
    assert within(points, Grid(-5.0, 70.0, 1.0, 80, 80)) is points
