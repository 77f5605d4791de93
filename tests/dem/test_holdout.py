"""Accuracy at held-out ground points of real tiles, against a TIN."""

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
