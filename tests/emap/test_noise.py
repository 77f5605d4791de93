"""Noise of the points: from residuals and degrees of freedom, as a whole and by region."""

from __future__ import annotations

import naive_dem
import numpy as np
import pytest
from making_dems import from_file

from volatool.emap import noise
from volatool.emap.solve import solve
from volatool.emap.system import Evidence, Springs

FOOT = 0.3048
TILES = {  # file, metres per unit, range of the fixed point in metres (emap.md, acceptance 6)
    "topo": ("golden/inputs/lidR-Topography.laz", 1.0, 0.07, 0.09),
    "ntm46": ("tiles/4_6_crop.las", 1200 / 3937, 0.019, 0.024),
    "autzen": ("tiles/autzen_trim.las", FOOT, 0.021, 0.028),
    "ahn2": ("tiles/ahn3_cropped_2.laz", 1.0, 0.031, 0.037),
}


def hills(n=3000, side=60.0, sigma=0.05, seed=0):
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(1, side - 1, (2, n))
    z = np.sin(x / 9) * np.cos(y / 7) + rng.normal(0, 1, n) * sigma
    rows = np.round(1000 * np.column_stack([x, y, z])).astype(np.int32)
    return rows, x, y, z


def fitted(points, shape, springs):
    _, col, row, z = points
    evidence = Evidence(*shape)
    evidence.add(col, row, z, springs)
    surface, _ = solve(evidence, springs)
    freedom = noise.answer(shape, springs, lambda: [points])
    return noise.measure(springs, lambda: [points], surface, freedom, 8)


def test_degrees_of_freedom_are_the_trace_of_the_smoother():
    """The one random vector is near ``sum phi' H^-1 phi`` of the dense system."""
    shape, springs = (20, 20), Springs(0.5, 0.01)
    rows, col, row, z = hills(400, 20.0)
    data, _ = naive_dem.data_matrix(col, row, z, 1.0, shape)
    matrix = naive_dem.surface_matrix(*shape, springs.kb, springs.km) + data
    trace = np.trace(np.linalg.solve(matrix, data))
    found = fitted((rows, col, row, z), shape, springs)
    assert found.freedom * 400 == pytest.approx(trace, rel=0.15)
    assert found.n_points == 400


def test_sigma_is_the_noise_that_was_put_in():
    """Within 10 %, whatever the stiffness lets the surface follow."""
    for springs in (Springs(0.05, 0.001), Springs(1.0, 0.001)):
        found = fitted(hills(), (60, 60), springs)
        assert found.sigma == pytest.approx(0.05, rel=0.1)
        assert found.residual_rms < found.sigma


def test_regions_have_their_own_noise():
    """Three times the noise in the right half shows there, drawn a little to the whole."""
    rng = np.random.default_rng(1)
    rows, x, y, z = hills(6000, sigma=0.0)
    z = z + rng.normal(0, 1, len(z)) * np.where(x > 30, 0.09, 0.03)
    found = fitted((rows, x, y, z), (60, 60), Springs(1.0, 0.001))
    by_block = found.map()
    # 50 points' worth of the whole's 0.067 beside some 100 a block
    assert 0.03 < by_block[:, :2].mean() < 0.055
    assert 0.075 < by_block[:, -2:].mean() < 0.095


def test_a_surface_through_all_points_leaves_no_noise_to_tell():
    """Softer than the grid can show: None, not a number out of rounding."""
    rows = np.array([[k, k * k % 7, 0] for k in range(6)], np.int32)
    points = (rows, np.arange(6) * 3 + 2.0, np.arange(6) * 3 + 2.0, np.arange(6.0) ** 2)
    found = fitted(points, (20, 20), Springs(1e-4, 1e-6))
    assert found.sigma is None
    assert np.isnan(found.map()).all()


@pytest.mark.shared
@pytest.mark.parametrize("tile", TILES)
def test_the_fixed_point_of_real_tiles(shared, tile):
    """emap.md, acceptance 6: kappa 15, ell 10 m, 1 m cells."""
    path, unit, low, high = TILES[tile]
    points = from_file(shared / path)
    rows = np.concatenate(list(points.pieces()))
    x, y, z = ((rows * np.array(points.scale) + points.offset) * unit).T
    x, y, z = x - x.min() + 1, y.max() - y + 1, z - z.mean()
    shape = int(y.max()) + 2, int(x.max()) + 2
    sigma, springs = noise.fixed_point(lambda: [(rows, x, y, z)], shape, 1.0)
    assert low <= sigma <= high
    assert springs.kb == pytest.approx(15 * sigma**2, rel=0.1)
