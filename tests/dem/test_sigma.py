"""Standard errors of DEMs: where they are, what they say, and that intervals hold."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from making_dems import ground, hills, with_rows
from making_tiles import write_las

from volatool.dem.distance import VOID
from volatool.dem.grid import Grid
from volatool.dem.raster import read_dem
from volatool.dem.sigma import (
    DOUBT,
    MIDDLES,
    Ensemble,
    Model,
    class_factors,
    coarse_grid,
    distances_at,
    fit,
    scale_at,
    sigma_layer,
    unit_errors_at,
)
from volatool.dem.surfaces import make_dem
from volatool.emap.tuning import choose_springs
from volatool.model import CrsInfo
from volatool.options import ConvertOptions
from volatool.scratch import Scratch
from volatool.tile import convert_tile

METRES = CrsInfo(metres_per_unit_xy=Fraction(1), metres_per_unit_z=Fraction(1))


def hilly(n=6000, seed=0, hole=True):
    x, y, z = hills(n, 80.0, seed)
    keep = (abs(x - 40) > 8) | (abs(y - 40) > 8) if hole else np.ones(n, bool)
    return ground(x[keep], y[keep], z[keep])


def model_of(points, dem, sigma=None):
    return fit(
        points, dem.grid, dem.tuned, dem.noise, dem.spacing, METRES, dem.scratch, sigma
    )  # fmt: skip


def test_the_layer_is_small_at_data_large_in_gaps_and_void_where_the_dem_is():
    """Below the points' noise beside data; several times that in the middle of a hole."""
    points = hilly()
    dem = make_dem(points, METRES, 1.0, max_gap=5.0, with_noise=True)
    layer = sigma_layer(points, dem.grid, dem.flag, model_of(points, dem), dem.scratch)
    np.testing.assert_array_equal(np.isnan(layer), dem.flag == VOID)
    dem = make_dem(points, METRES, 1.0, with_noise=True)
    layer = sigma_layer(points, dem.grid, dem.flag, model_of(points, dem), dem.scratch)
    assert layer.dtype == np.float32
    assert np.median(layer[:20]) < 1.5 * dem.noise_sigma
    assert layer[38:42, 38:42].min() > 3 * np.median(layer[:20])


def test_known_noise_scales_the_layer_and_is_not_calibrated():
    """Twice the noise, twice the standard error; factors stay 1."""
    points = hilly(2000)
    dem = make_dem(points, METRES, 2.0, with_noise=True)
    one, two = (model_of(points, dem, sigma) for sigma in (0.1, 0.2))
    assert (one.factors, one.n_held) == ((1.0,) * len(MIDDLES), 0)
    layers = [sigma_layer(points, dem.grid, dem.flag, m, dem.scratch) for m in (one, two)]
    np.testing.assert_allclose(layers[1], 2 * layers[0], rtol=1e-5)


def test_memory_does_not_change_a_byte():
    """In RAM and in files."""
    found = []
    for budget in (None, 0):
        with Scratch(budget) as scratch:
            points = hilly(1500)
            dem = make_dem(points, METRES, 2.0, scratch=scratch, with_noise=True)
            model = model_of(points, dem)
            layer = sigma_layer(points, dem.grid, dem.flag, model, scratch)
            found.append((layer.tobytes(), model.factors, dem.noise_sigma))
    assert found[0] == found[1]


def test_intervals_hold_at_points_that_were_left_out():
    """95 % intervals of hills with noise hold 91 to 99 % of other points, near and in a gap."""
    train, test = hilly(), hilly(3000, seed=7, hole=False)
    dem = make_dem(train, METRES, 1.0, with_noise=True)
    model = model_of(train, dem)
    ensemble = Ensemble(train, model.tuned, dem.grid, dem.scratch)
    unit = unit_errors_at(ensemble, ensemble.evidence(), test)
    distance = distances_at(train, test, dem.grid, dem.scratch)
    spread = scale_at(model, test, distance) * np.sqrt(1 + unit**2)
    z = np.concatenate(list(test.pieces()))[:, 2] * 0.01
    from volatool.kernels import spring

    found = np.empty(len(z))
    places = dem.grid.places(
        np.concatenate(list(test.pieces())), test.scale, test.offset
    )  # fmt: skip
    spring.interpolate(dem.z.astype(float), *places, False, 0, dem.grid.height, found)
    ratio = abs(found - z) / spread
    assert 0.91 <= np.mean(ratio < 1.96) <= 0.99
    # one gap, wider than the blocks that the factors are from: no more than its share of luck
    assert np.sqrt(np.mean(ratio[distance > 3] ** 2)) < 1.96


def test_factors_are_quantiles_by_class_of_distance():
    """Exact for many blocks; drawn to 1 for few; neighbours' where a class is empty."""
    rng = np.random.default_rng(0)
    ratio = np.abs(rng.normal(0, 2, 4000))
    distance = np.repeat([1.0, 2.0, 4.0, 8.0], 1000)
    many = np.tile(np.arange(1000), 4)
    found = class_factors(ratio, distance, many)
    assert found[0] == pytest.approx(np.quantile(ratio[:1000], 0.95) / 1.96, rel=1e-3)
    assert found[2] == pytest.approx(np.quantile(ratio[2000:3000], 0.975) / 1.96, rel=1e-3)
    assert found[4] == found[3]  # above 1: holds on
    assert class_factors(ratio / 8, distance, many)[4] == 1.0
    few = class_factors(ratio / 8, distance, np.zeros(4000, np.int64))
    narrow = class_factors(ratio / 8, distance, many)
    assert np.log(few[1]) == pytest.approx(np.log(narrow[1]) * 1005 / 1000 / (1 + DOUBT), rel=1e-6)
    assert class_factors(ratio[:5], distance[:5], many[:5]) == (1.0,) * 5


def test_the_factor_is_continuous_in_distance():
    """At a class's middle its own factor; between, between."""
    tuned = choose_springs(1.0, 1.0)
    grid = Grid(0.0, 10.0, 1.0, 10, 10)
    model = Model(tuned, 2.0, np.ones((1, 1)), 20.0, grid, (1.0, 2.0, 3.0, 4.0, 5.0), 100)
    np.testing.assert_allclose(model.factor(2 * np.array(MIDDLES)), [1, 2, 3, 4, 5])
    values = model.factor(np.linspace(0, 60, 500))
    assert (np.diff(values) >= 0).all()
    assert np.diff(values).max() < 0.1
    assert model.factor(np.array([np.inf]))[0] == pytest.approx(5.0)


def test_the_coarse_grid_meshes_with_the_cells():
    """Whole cells make a coarse one, from the same origin; larger grids are coarser."""
    for side, step in ((100, 1), (1000, 2), (3000, 4)):
        coarse, found = coarse_grid(Grid(3.0, 50.0, 1.0, side, side))
        assert found == step
        assert (coarse.exact[0] / step).denominator == 1
        assert coarse.left <= 3.0
        assert coarse.top >= 50.0


def test_few_points_give_an_uncalibrated_model_and_equal_ones_none():
    """Forty points: factors of 1; one point: nothing tells the noise."""
    points = ground(*hills(40, 30.0))
    dem = make_dem(points, METRES, 2.0, with_noise=True)
    model = model_of(points, dem)
    assert model is None or model.n_held == 0
    single = with_rows(points, next(iter(points.pieces()))[:1])
    dem = make_dem(single, METRES, 2.0, with_noise=True)
    layer_model = model_of(single, dem)
    assert layer_model is None or np.isfinite(layer_model.sigma).all()


def test_a_layer_that_cannot_be_told_is_void_and_a_warning_says_so(tmp_path):
    """Points of one height have no noise to see: W_NO_SIGMA; known noise gives the layer."""
    tile = write_las(
        tmp_path / "flat.las",
        [[0, 0, 100], [500, 0, 100], [0, 500, 100], [500, 500, 100]],
        classification=np.full(4, 2, np.uint8),
    )

    def codes(**options):
        given = ConvertOptions(cell=1, layers=("sigma",), **options)
        report = convert_tile(tile, given, kind="dem", overwrite=True)
        return [warning.code for warning in report.warnings]

    assert "W_NO_SIGMA" in codes()
    assert np.isnan(read_dem(tmp_path / "flat.dem.sigma.tif").z).all()
    assert "W_NO_SIGMA" not in codes(sigma="0.1")
    assert np.isfinite(read_dem(tmp_path / "flat.dem.sigma.tif").z).any()
