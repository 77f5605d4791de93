"""Accuracy at held-out points: against a TIN on real tiles, and as the report tells it."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from making_dems import from_file, with_rows

from volatool.dem.surfaces import make_dem
from volatool.model import CrsInfo

FEET = Fraction("0.3048")
TILES = {
    "tiles/4_6_crop.las": FEET,
    "tiles/autzen_trim.las": FEET,
    "golden/inputs/lidR-Topography.laz": Fraction(1),
}


def tin(train, test):
    """Linear interpolation on triangles, the nearest point outside their hull."""
    from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator

    middle = train.mean(axis=0)
    train, test = train - middle, test - middle
    z = LinearNDInterpolator(train[:, :2], train[:, 2])(test[:, :2])
    nearest = NearestNDInterpolator(train[:, :2], train[:, 2])(test[:, :2])
    return np.where(np.isnan(z), nearest, z) + middle[2]


@pytest.mark.shared
@pytest.mark.parametrize("tile", TILES)
def test_dem_is_not_worse_than_a_tin(shared, tile):
    """10 % of the ground points held out, 0.5 m cells: RMSE <= 1.0 x that of a linear TIN."""
    from volatool.kernels import spring

    unit = TILES[tile]
    crs = CrsInfo(metres_per_unit_xy=unit, metres_per_unit_z=unit)
    points = from_file(shared / tile)
    rows = np.concatenate(list(points.pieces()))
    xyz = rows * np.array(points.scale) + points.offset
    ours, theirs = [], []
    for seed in range(2):
        out = np.random.default_rng(seed).random(len(rows)) < 0.1
        dem = make_dem(with_rows(points, rows[~out]), crs, Fraction(1, 2) / unit)
        col, row = dem.grid.places(rows[out], points.scale, points.offset)
        found = np.empty(len(col))
        spring.interpolate(dem.z.astype(float), col, row, False, 0, dem.grid.height, found)
        known = ~np.isnan(found)
        assert known.mean() > 0.99
        ours.append(np.square(found - xyz[out, 2])[known])
        theirs.append(np.square(tin(xyz[~out], xyz[out]) - xyz[out, 2])[known])
    rmse, rmse_tin = (np.sqrt(np.concatenate(errors).mean()) for errors in (ours, theirs))
    assert rmse <= 1.0 * rmse_tin


def naive_report(points, percent, make):
    """The report's holdout worked out anew, point by point, without the product's readers."""
    from volatool.dem.split import part, split

    whole = make(points)
    half = percent / 200
    chosen = split(points, half, half, whole.spacing, Fraction(1))
    rows = np.concatenate(list(part(points, chosen, held=True).pieces()))
    dem = make(part(points, chosen, held=False))
    cell, at = dem.grid.cell, np.argwhere(dem.count > 0)
    errors, near, void = [], [], 0
    for x, y, z in rows * np.array(points.scale) + points.offset:
        col, row = (x - dem.grid.left) / cell, (dem.grid.top - y) / cell
        u = min(max(col - 0.5, 0), dem.grid.width - 1)
        v = min(max(row - 0.5, 0), dem.grid.height - 1)
        q, r = min(int(u), dem.grid.width - 2), min(int(v), dem.grid.height - 2)
        u, v = u - q, v - r
        (a, b), (c, d) = dem.z[r : r + 2, q : q + 2].astype(float)
        height = (1 - v) * ((1 - u) * a + u * b) + v * ((1 - u) * c + u * d)
        if np.isnan(height):
            void += 1
            continue
        away = np.hypot(*(at - [int(row), int(col)]).T).min() * cell
        near.append(away <= max(3 * whole.spacing, 1.5 * cell))
        errors.append(height - z)
    errors, near = np.array(errors), np.array(near)
    return len(rows), void, errors[near], errors[~near]


@pytest.mark.parametrize("max_gap", [4.0, None])
def test_the_report_equals_a_naive_one(max_gap):
    """Counts and figures of points near data and in gaps; parts inside the intervals."""
    from making_dems import ground, hills

    from volatool.dem.holdout import assess

    x, y, z = hills(4000, 80.0)
    points = ground(x, y, z)
    metres = CrsInfo(metres_per_unit_xy=Fraction(1), metres_per_unit_z=Fraction(1))

    def make(some):
        return make_dem(some, metres, 1.0, max_gap=max_gap, with_noise=True)

    found = assess(points, make(points), 20, make)
    n, void, near, gaps = naive_report(points, 20, make)
    assert (found["n"], found["void"]) == (n, void)
    for name, errors in (("near", near), ("gaps", gaps)):
        group = found[name]
        assert group["n"] == len(errors)
        if not len(errors):
            continue
        assert group["rmse"] == pytest.approx(np.sqrt(np.mean(errors**2)))
        assert group["mae"] == pytest.approx(np.mean(abs(errors)))
        assert group["bias"] == pytest.approx(np.mean(errors))
        assert group["p95"] == pytest.approx(np.quantile(abs(errors), 0.95))
        assert 0.8 < group["coverage_95"] <= 1
        assert group["coverage_68"] < group["coverage_95"]
    # gaps of twice 4 m are left void, and those of the blocks are wider
    assert (void > 0) == (found["gaps"]["n"] == 0) == (max_gap is not None)


def test_few_points_give_counts_without_figures():
    """One point can't be held out of itself; baselines have no intervals."""
    from making_dems import ground, hills

    from volatool.dem.holdout import assess

    metres = CrsInfo(metres_per_unit_xy=Fraction(1), metres_per_unit_z=Fraction(1))

    def make(some):
        return make_dem(some, metres, 1.0)

    single = ground([1.0], [1.0], [1.0])
    found = assess(single, make(single), 10, make)
    assert (found["n"], found["near"]["n"], found["near"]["rmse"]) == (0, 0, None)
    lowest = ground(*hills(2000), surface="min")
    found = assess(lowest, make(lowest), 10, make)
    assert found["near"]["rmse"] > 0
    assert found["near"]["coverage_95"] is None
