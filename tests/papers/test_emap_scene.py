"""The simulated drive: rays, returns, windows."""

from __future__ import annotations

import numpy as np
import pytest

from volatool.errors import OptionError
from volatool.kernels import raycast
from volatool.papers.emap_scene import Drive, Nodes, beams, scans, terrain


def march(origin, directions, max_range, step=2e-3):
    """First crossing by fine marching and bisection: the naive twin of the kernel."""
    t = np.arange(0, max_range + step, step)
    out = np.full(len(directions), np.inf)

    def above(s, d):
        x, y, z = (origin[k] + s * d[k] for k in range(3))
        return z - np.sin(x / np.pi) * np.sin(y / np.pi)

    for i, d in enumerate(directions):
        below = np.flatnonzero(above(t, d) <= 0)
        if len(below):
            lower, upper = t[max(below[0] - 1, 0)], t[below[0]]
            for _ in range(60):
                middle = (lower + upper) / 2
                lower, upper = (middle, upper) if above(middle, d) > 0 else (lower, middle)
            out[i] = upper
    out[out > max_range] = np.inf
    return out


@pytest.mark.parametrize("origin", [(0, 0, 2.0), (3.3, 7.1, 1.2), (14.0, 4.9, -0.6), (5, 5, 30)])
def test_rays_end_where_fine_marching_ends(origin):
    rng = np.random.default_rng(5)
    directions = rng.normal(size=(400, 3)) * [1, 1, 0.3]
    directions = np.vstack([directions, [[0, 0, -1], [0, 0, 1], [1, 0, 0], [0.6, 0.8, 0]]])
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    origin = np.array(origin, float)
    ranges = np.empty(len(directions))
    raycast.cast(origin, directions, 40.0, ranges)
    expected = march(origin, directions, 40.0)
    np.testing.assert_array_equal(np.isfinite(ranges), np.isfinite(expected))
    hit = np.isfinite(ranges)
    np.testing.assert_allclose(ranges[hit], expected[hit], atol=1e-9)
    assert 5 < np.count_nonzero(hit) < len(hit)


def test_a_ray_does_not_pass_a_crest():
    """From behind a crest at 1 the trough beyond is out of sight, though it is in range."""
    crest = np.pi**2 / 2
    origin = np.array([crest - 3, crest, 1.05])
    down = np.array([[7.0, 0.0, -0.4]])
    ranges = np.empty(1)
    raycast.cast(origin, down / np.linalg.norm(down), 50.0, ranges)
    assert origin[0] + ranges[0] < crest


def test_an_origin_below_the_surface_is_a_hit_at_once():
    ranges = np.empty(1)
    raycast.cast(np.array([4.9, 4.9, 0.0]), np.array([[1.0, 0, 0]]), 10.0, ranges)
    assert ranges[0] == 0


def test_a_turn_has_the_beams_of_the_sensor():
    directions = beams(Drive())
    assert directions.shape == (64 * 512, 3)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1)
    up = np.degrees(np.arcsin(directions[:, 2]))
    assert len(np.unique(up.round(6))) == 64
    assert (up.min(), up.max()) == pytest.approx((-22.5, 22.5))


def test_scans_move_with_the_sensor_and_repeat_for_a_seed():
    drive = Drive(duration_s=2)
    first, again = list(scans(drive, 3)), list(scans(drive, 3))
    assert [scan.evaluated for scan in first] == [False] * 4 + [True] + [False] * 4 + [True]
    np.testing.assert_allclose([scan.sensor for scan in first][5], [1.0, 3.0, 2.0])
    for one, two in zip(first, again, strict=True):
        np.testing.assert_array_equal(one.points, two.points)
    other = next(iter(scans(Drive(duration_s=2, seed=7), 3)))
    assert other.points.shape != first[0].points.shape or (other.points != first[0].points).any()


def test_returns_lie_on_the_terrain_but_for_the_noise_along_the_ray():
    drive = Drive(duration_s=1)
    for scan in scans(drive, 0):
        ranges = np.linalg.norm(scan.points - scan.sensor, axis=1)
        assert ranges.max() <= drive.max_range
        assert 7000 < len(ranges) < 9000
    true = np.empty(len(scan.points))
    raycast.cast(scan.sensor, (scan.points - scan.sensor) / ranges[:, None], 12.0, true)
    noise = (ranges - true)[true < 9.5]  # farther ones are cut on one side
    assert noise.std() == pytest.approx(0.05, rel=0.05)
    assert abs(noise.mean()) < 0.003


def test_a_window_is_centred_on_the_sensor_and_anchored_in_the_world():
    nodes = Nodes.around(np.array([7.8, 3.0, 2.0]))
    x, y = nodes.places()
    assert x.shape == (40, 40)
    np.testing.assert_allclose((x / 0.25) % 1, 0.5)
    assert abs(nodes.centre[0] - 7.8) <= 0.125
    assert nodes.centre[1] == 3.0
    assert y[0, 0] > y[-1, 0]
    assert np.count_nonzero(nodes.distance(np.array([7.8, 3.0, 2.0])) < 0.25) == 4
    row, col = nodes.indices(x, y)
    np.testing.assert_array_equal(row, np.indices(x.shape)[0])
    np.testing.assert_array_equal(col, np.indices(x.shape)[1])
    inside = np.column_stack([x.ravel(), y.ravel(), terrain(x, y).ravel()])
    assert nodes.holds(inside).all()
    assert not nodes.holds(inside + np.array([10.0, 0, 0])).any()


def test_a_drive_without_a_scan_to_evaluate_is_refused():
    with pytest.raises(OptionError, match="no scan to evaluate"):
        Drive(duration_s=0.5)
    with pytest.raises(OptionError, match="negative"):
        Drive(seed=-1)
