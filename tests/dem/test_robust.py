"""Points far off: found, told, and without harm to the surface."""

from __future__ import annotations

import numpy as np
import pytest
from ground_tiles import holdout_mask, load, tiles
from making_dems import ground, hills

from volatool.dem.surfaces import make_dem
from volatool.model import CrsInfo

PLAIN = CrsInfo()


def with_outliers(z, part, largest, seed=5):
    """A part of the heights off by half the largest error to all of it, up or down."""
    rng = np.random.default_rng(seed)
    off = rng.random(len(z)) < part
    size = rng.uniform(largest / 2, largest, len(z)) * rng.choice([-1, 1], len(z))
    return np.where(off, z + size, z), off


def read(dem, x, y):
    from volatool.kernels import spring

    out = np.empty(len(x))
    col, row = (x - dem.grid.left) / dem.grid.cell, (dem.grid.top - y) / dem.grid.cell
    spring.interpolate(dem.z.astype(float), col, row, False, 0, dem.grid.height, out)
    return out


def test_far_off_points_are_found_and_told():
    x, y, z = hills(6000)
    spoilt, off = with_outliers(z, 0.01, 5.0)
    clean = make_dem(ground(x, y, z), PLAIN, 1.0)
    bent = make_dem(ground(x, y, spoilt), PLAIN, 1.0)
    dem = make_dem(ground(x, y, spoilt), PLAIN, 1.0, robust=True)
    told = dem.solver["robust"]
    assert told["points_down_weighted"] == off.sum()
    assert told["limit"] == pytest.approx(0.3)
    assert np.nanmax(np.abs(bent.z - clean.z)) > 0.5
    assert np.nanmax(np.abs(dem.z - clean.z)) < 0.1
    assert "robust" not in clean.solver


def test_clean_points_are_left_alone():
    x, y, z = hills(6000)
    plain, robust = (make_dem(ground(x, y, z), PLAIN, 1.0, robust=on) for on in (False, True))
    assert robust.solver["robust"]["points_down_weighted"] == 0
    np.testing.assert_array_equal(plain.z, robust.z)


@pytest.mark.shared
@pytest.mark.parametrize("name", ["topo", "ntm46", "autzen"])
def test_one_per_cent_of_5_m_costs_six_per_cent_at_most(shared, name):
    """RMSE at clean points held out, real ground, 1 m cells, over three draws."""
    (tile,) = (tile for tile in tiles(shared) if tile.name == name)
    xyz = load(tile).xyz
    xyz = xyz - np.floor(xyz.min(axis=0))
    out = holdout_mask(xyz[:, :2], "random", 10)
    x, y = xyz[~out, :2].T

    def error(z, robust):
        dem = make_dem(ground(x, y, z), PLAIN, 1.0, max_gap=1000.0, robust=robust)
        return np.nanmean(np.square(read(dem, *xyz[out, :2].T) - xyz[out, 2]))

    clean = error(xyz[~out, 2], robust=False)
    spoilt = [error(with_outliers(xyz[~out, 2], 0.01, 5.0, seed)[0], True) for seed in (5, 6, 7)]
    assert np.sqrt(np.mean(spoilt)) <= 1.06 * np.sqrt(clean)
