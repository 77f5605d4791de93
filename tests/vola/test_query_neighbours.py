"""Counts of neighbours against every voxel looked at."""

from __future__ import annotations

import making_volumes as making
import naive_queries as naive
import numpy as np
import pytest

from volatool.errors import OptionError
from volatool.vola.neighbours import count_cells


@pytest.mark.parametrize(
    ("options", "square"),
    [
        ({"connectivity": 6}, 1),
        ({"connectivity": 18}, 2),
        ({"connectivity": 26}, 3),
        ({"radius": 0}, 0),
        ({"radius": 1.5}, 2.25),
        ({"radius": 5}, 25),
        ({"radius": 9.5}, 90.25),
    ],
)
@pytest.mark.parametrize("exact", [True, False])
def test_neighbours_are_counted(options, square, exact):
    volume = making.random_volume(2, 600)
    voxels = [tuple(row) for row in volume.voxels().tolist()]
    rng = np.random.default_rng(1)
    cells = rng.integers(0, 16, (60, 3))
    cells[:20] = voxels[:20]
    cells[20:22] = [0, 0, 0], [15, 15, 15]
    expected = [naive.neighbours(voxels, tuple(c), square, in_block=not exact) for c in cells]
    middles = (cells + 0.5) * volume.cell() + volume.cube.origin
    middles[:, 2] /= float(volume.crs.z_ratio)
    found = volume.neighbours(middles, exact=exact, **options)
    assert found.tolist() == expected
    assert count_cells(volume, cells, exact=exact, **options).tolist() == expected


def test_places_that_are_nowhere_have_no_count():
    volume = making.random_volume(2, 100)
    nowhere = [[0, 0, 0], [np.nan, 0, 0], [np.inf] * 3]
    assert volume.neighbours(nowhere).tolist() == [-1, -1, -1]


def test_the_error_of_counting_inside_blocks_is_measured():
    volume = making.random_volume(2, 400)
    voxels = [tuple(row) for row in volume.voxels().tolist()]
    for connectivity, square in ((6, 1), (26, 3)):
        exact = np.array([naive.neighbours(voxels, v, square) for v in voxels])
        inside = np.array([naive.neighbours(voxels, v, square, in_block=True) for v in voxels])
        error = volume.neighbour_error(connectivity)
        assert error.voxels == len(voxels)
        assert error.mean_exact == pytest.approx(exact.mean())
        assert error.mean_by_block == pytest.approx(inside.mean())
        assert error.share == pytest.approx(inside.sum() / exact.sum())
        assert error.right == pytest.approx((exact == inside).mean())
        assert error.rmse == pytest.approx(np.sqrt(((exact - inside) ** 2).mean()))


def test_a_full_volume_shows_three_quarters_of_its_faces():
    """144 of the 192 faces of a block's cells are inside; what is outside the cube is not set."""
    full = {(x, y, z) for x in range(16) for y in range(16) for z in range(16)}
    volume = making.volume_of(full, 2)
    error = volume.neighbour_error(6)
    assert (error.share_if_full, error.mean_by_block) == (0.75, 4.5)
    assert error.mean_exact == 6 - 6 / 16
    assert volume.neighbour_error(26).share_if_full == 0.5625
    lone = making.volume_of([(3, 3, 3)], 2).neighbour_error(26)
    assert (lone.share, lone.right, lone.rmse) == (1.0, 1.0, 0.0)


def test_what_can_not_be_counted_is_refused():
    volume = making.random_volume(2, 10)
    for options in ({"connectivity": 8}, {"radius": 17}, {"radius": -1}, {"radius": np.nan}):
        with pytest.raises(OptionError, match=r"neighbours|radius"):
            volume.neighbours([[0, 0, 0]], **options)
    with pytest.raises(OptionError, match="not 7"):
        volume.neighbour_error(7)
