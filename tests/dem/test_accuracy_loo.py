"""Accuracy at held-out ground points, random and in gaps, against a TIN: benchmarks/dem_loo.py."""

from __future__ import annotations

import dem_loo
import ground_tiles
import numpy as np
import pytest

TILES = ("topo", "ntm46", "autzen", "samp12", "samp21", "samp24")
"""The smaller ones of the benchmark: its time is mostly the TIN's."""


@pytest.fixture(scope="module")
def records(shared, tmp_path_factory):
    """Return the benchmark's records of one hold-out of each kind."""
    cache = tmp_path_factory.mktemp("tin")
    tiles = [tile for tile in ground_tiles.tiles(shared) if tile.name in TILES]
    assert len(tiles) == len(TILES)
    return [record for tile in tiles for record in dem_loo.judge(tile, 1, "1", ["product"], cache)]


@pytest.mark.shared
def test_dem_has_less_error_than_a_tin(records):
    """At most 0.90 of a TIN's RMSE in the geometric mean, and nowhere more than 1.10."""
    ratios = [record["ratio"] for record in records]
    assert len(ratios) == len(TILES) * len(ground_tiles.KINDS)
    assert np.exp(np.mean(np.log(ratios))) <= 0.90
    assert max(ratios) <= 1.10
    assert all(record["void"] < 0.03 for record in records)


@pytest.mark.shared
@pytest.mark.parametrize(
    ("kind", "bound"), [("random", 0.155), ("5 m", 0.225), ("10 m", 0.29), ("20 m", 0.43)]
)
def test_error_on_hills(records, kind, bound):
    """lidR's Topography at 1 m: RMSE in metres, a TIN's is 0.17, 0.35, 0.35, 0.54."""
    (topo,) = (r for r in records if (r["tile"], r["kind"]) == ("topo", kind))
    assert topo["rmse"] <= bound


@pytest.mark.shared
def test_error_does_not_depend_on_the_cell(shared, records, tmp_path):
    """Cells of 0.5 m: within 3 % of those of 1 m, where points are farther apart than both."""
    (tile,) = (tile for tile in ground_tiles.tiles(shared) if tile.name == "topo")
    fine = dem_loo.judge(tile, 1, "0.5", ["product"], tmp_path)
    coarse = [record for record in records if record["tile"] == "topo"]
    for a, b in zip(fine, coarse, strict=True):
        assert a["rmse"] == pytest.approx(b["rmse"], rel=0.03)
