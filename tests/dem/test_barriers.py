"""Break lines and water from vector files: what they cut, levels of lakes, and bad files."""

from __future__ import annotations

import json

import numpy as np
import pytest
from making_dems import ground
from pyproj import CRS, Transformer

from volatool.dem.surfaces import make_dem
from volatool.dem.vectors import read_barriers
from volatool.errors import FormatError, InputNotFoundError, OptionError
from volatool.model import CrsInfo
from volatool.options import ConvertOptions
from volatool.points.crs import crs_from_user

SIZE = 60.0
UTM = "EPSG:25832"
PLAIN = CrsInfo()


def layer(path, *features, crs=UTM):
    """Write (geometry type, coordinates, properties) as GeoJSON."""
    document = {
        "type": "FeatureCollection",
        "features": [
            {
                "type": "Feature",
                "properties": properties,
                "geometry": {"type": kind, "coordinates": coordinates},
            }
            for kind, coordinates, properties in features
        ],
    }
    if crs is not None:
        document["crs"] = {"type": "name", "properties": {"name": crs}}
    path.write_text(json.dumps(document), encoding="utf-8")
    return str(path)


def square(left, bottom, side):
    right, top = left + side, bottom + side
    return [[[left, bottom], [right, bottom], [right, top], [left, top], [left, bottom]]]


def quay(n=4000, hole=None, seed=1):
    """Flat ground at 0 west of x = 30.3, at 3 east of it; no points in a square hole."""
    rng = np.random.default_rng(seed)
    x, y = np.round(rng.uniform(0, SIZE, (2, n)), 2)
    if hole is not None:
        left, bottom, side = hole
        away = (x < left) | (x > left + side) | (y < bottom) | (y > bottom + side)
        x, y = x[away], y[away]
    return ground(x, y, np.where(x > 30.3, 3.0, 0.0))


def heights(dem):
    return np.where(dem.flag > 0, dem.z, np.nan)


def test_the_surface_breaks_along_a_line_and_nowhere_else(tmp_path):
    name = layer(tmp_path / "quay.geojson", ("LineString", [[30.3, -5], [30.3, 65]], {}))
    barriers = read_barriers(name, None, PLAIN)
    assert (barriers.n_lines, barriers.lakes) == (1, ())
    smooth = heights(make_dem(quay(), PLAIN, 1.0))
    dem = make_dem(quay(), PLAIN, 1.0, barriers=barriers)
    z = heights(dem)
    west, east = z[:, :30], z[:, 31:]  # column 30's centre, 30.5, lies east of the line
    assert np.nanmax(np.abs(west)) < 1e-3
    assert np.nanmax(np.abs(east - 3)) < 1e-3
    assert np.nanmax(np.abs(smooth[:, 29] - 0)) > 0.1
    assert dem.barriers["cut_edges"] == 62  # a row of cells more on either side is solved
    assert dem.to_dict()["barriers"] == dem.barriers


def test_a_gap_beside_a_quay_does_not_overshoot(tmp_path):
    """A hole that the quay runs through: without the line the step swings on both sides."""
    points = quay(hole=(22, 20, 18))
    name = layer(tmp_path / "quay.geojson", ("LineString", [[30.3, -5], [30.3, 65]], {}))
    z = heights(make_dem(points, PLAIN, 1.0, barriers=read_barriers(name, None, PLAIN)))
    assert np.nanmax(np.abs(z[:, :30])) < 2e-3
    assert np.nanmax(np.abs(z[:, 31:] - 3)) < 2e-3


def test_a_lake_is_one_level_at_or_below_its_shore(tmp_path):
    """On a slope: the tenth percentile of the shore's ground, in every cell inside."""
    rng = np.random.default_rng(2)
    x, y = np.round(rng.uniform(0, SIZE, (2, 4000)), 2)
    dry = (np.abs(x - 30) > 10) | (np.abs(y - 30) > 10)
    points = ground(x[dry], y[dry], 100 + 0.05 * x[dry])
    name = layer(tmp_path / "lake.geojson", ("Polygon", square(20.2, 20.2, 19.6), {}))
    dem = make_dem(points, PLAIN, 1.0, barriers=read_barriers(None, name, PLAIN))
    inside = dem.z[20:40, 20:40]
    (lake,) = dem.barriers["lakes"]
    assert np.unique(inside).tolist() == [np.float32(lake["level"])]
    assert (lake["source"], lake["cells"]) == ("shore", 400)
    band = (np.abs(x - 30) < 12.5) & (np.abs(y - 30) < 12.5) & dry
    assert lake["level"] == pytest.approx(np.percentile(100 + 0.05 * x[band], 10), abs=0.05)
    assert (dem.flag[20:40, 20:40] == 2).all()
    # the ground about it stays the slope: nothing pulls it to the lake
    x_of = np.arange(60) + 0.5
    assert np.nanmax(np.abs(dem.z[:20] - (100 + 0.05 * x_of))) < 0.05


@pytest.mark.parametrize(
    ("properties", "lift"), [({"level": 97.5}, None), ({"Elev": "97.5"}, None), ({}, 97.5)]
)
def test_a_lake_has_the_level_that_its_file_says(tmp_path, properties, lift):
    ring = square(20.2, 20.2, 9.6)
    if lift is not None:
        ring = [[[*place, lift] for place in ring[0]]]
    name = layer(tmp_path / "lake.geojson", ("Polygon", ring, properties))
    dem = make_dem(quay(), PLAIN, 1.0, barriers=read_barriers(None, name, PLAIN))
    assert dem.barriers["lakes"][0] == {
        "level": 97.5, "source": "file", "points": 0, "cells": 100,
    }  # fmt: skip
    assert (dem.z[30:40, 20:30] == 97.5).all()


def test_points_in_a_lake_are_not_used(tmp_path):
    """Boats and divers on the water: the ground about it is as if they were not there."""
    rng = np.random.default_rng(3)
    x, y = np.round(rng.uniform(0, SIZE, (2, 4000)), 2)
    wet = (x >= 20) & (x < 40) & (y > 20) & (y <= 40)
    z = np.where(wet, rng.choice([-40.0, 60.0], len(x)), 3.0)
    name = layer(tmp_path / "lake.geojson", ("Polygon", square(20, 20, 20), {"level": 1}))
    barriers = read_barriers(None, name, PLAIN)
    dem = make_dem(ground(x, y, z), PLAIN, 1.0, barriers=barriers)
    lake = np.zeros(dem.z.shape, bool)
    lake[20:40, 20:40] = True
    assert (dem.z[lake] == 1).all()
    assert np.abs(dem.z[~lake] - 3).max() < 1e-3
    assert dem.residual_rmse < 1e-3
    assert (dem.flag[lake] == 2).all()
    assert not dem.count[lake].any()
    assert dem.count.sum() == np.count_nonzero(~wet)


def test_a_tile_under_water_is_level(tmp_path):
    """All points in the lake: nothing else to make a surface of."""
    name = layer(tmp_path / "lake.geojson", ("Polygon", square(-10, -10, 90), {"level": 1}))
    dem = make_dem(quay(), PLAIN, 1.0, barriers=read_barriers(None, name, PLAIN))
    assert (dem.z == 1).all()
    assert (dem.flag == 2).all()


@pytest.mark.parametrize("left", [-20.2, 39.8])
@pytest.mark.parametrize("bottom", [-20.2, 39.8])
def test_a_lake_may_go_on_beyond_the_tile(tmp_path, left, bottom):
    """Over each edge: the cells inside are the lake's, no others."""
    ring = square(left, bottom, 40.4)
    name = layer(tmp_path / "lake.geojson", ("Polygon", ring, {"level": 1}))
    dem = make_dem(quay(), PLAIN, 1.0, barriers=read_barriers(None, name, PLAIN))
    middle = np.arange(60) + 0.5
    cols, rows = (middle > left) & (middle < left + 40.4), middle[::-1]
    rows = (rows > bottom) & (rows < bottom + 40.4)
    np.testing.assert_array_equal(dem.z == 1, rows[:, None] & cols)
    assert dem.barriers["lakes"][0]["cells"] == rows.sum() * cols.sum()


def test_a_long_shore_does_not_slow_the_solver(tmp_path):
    """Docks like the teeth of a comb: as many iterations as without them, and the tolerance met."""
    teeth = [[2.3, 2.3], [2.3, 57.6]]
    for k in range(2, 56, 4):
        teeth += [[k + 0.4, 57.6], [k + 0.4, 5.4], [k + 2.4, 5.4], [k + 2.4, 57.6]]
    ring = [*teeth, [58.7, 57.6], [58.7, 2.3], [2.3, 2.3]]
    name = layer(tmp_path / "docks.geojson", ("Polygon", [ring], {}))
    plain = make_dem(quay(), PLAIN, 0.5)
    dem = make_dem(quay(), PLAIN, 0.5, barriers=read_barriers(None, name, PLAIN))
    assert dem.barriers["cut_edges"] == 0
    assert dem.solver["converged"]
    assert dem.solver["iterations"] <= plain.solver["iterations"] + 2


def test_a_river_only_breaks_at_its_banks(tmp_path):
    name = layer(
        tmp_path / "river.geojson", ("Polygon", square(30.3, -10, 80), {"waterway": "river"})
    )
    barriers = read_barriers(None, name, PLAIN)
    assert (barriers.lakes, barriers.n_rivers) == ((), 1)
    z = heights(make_dem(quay(), PLAIN, 1.0, barriers=barriers))
    assert np.nanmax(np.abs(z[:, :30])) < 1e-3
    assert np.nanmax(np.abs(z[:, 31:] - 3)) < 1e-3


def test_what_lines_close_off_without_a_point_is_void(tmp_path):
    points = quay(hole=(10, 10, 10))
    name = layer(tmp_path / "ring.geojson", ("Polygon", square(10.2, 10.2, 9.6), {}))
    dem = make_dem(points, PLAIN, 1.0, barriers=read_barriers(name, None, PLAIN))
    assert (dem.flag[40:50, 10:20] == 0).all()
    assert np.isnan(dem.z[40:50, 10:20]).all()
    assert [note.code for note in dem.notes] == ["W_VECTOR_CRS", "W_ISLAND"]
    assert np.isfinite(dem.z[39]).all()


def test_a_lake_far_from_any_ground_is_void(tmp_path, monkeypatch):
    monkeypatch.setattr("volatool.dem.barriers.WIDENINGS", 1)
    rng = np.random.default_rng(0)
    x, y = np.round(rng.uniform(0, 8, (2, 300)), 2)
    points = ground(np.append(x, 700.0), np.append(y, 700.0), np.zeros(301))
    name = layer(tmp_path / "lake.geojson", ("Polygon", square(400, 400, 20), {}))
    barriers = read_barriers(None, name, PLAIN)
    dem = make_dem(points, PLAIN, 1.0, max_gap=2000.0, barriers=barriers)
    assert [note.code for note in dem.notes] == ["W_VECTOR_CRS", "W_LAKE_LEVEL"]
    assert dem.barriers["lakes"][0]["level"] is None
    assert np.isnan(dem.z[290:300, 405:415]).all()


def test_layers_come_into_the_tiles_crs(tmp_path):
    """WGS 84 places are moved; projected numbers without a CRS are taken as they are, and told."""
    utm = crs_from_user(UTM)
    to_degrees = Transformer.from_crs(CRS(UTM), CRS("EPSG:4326"), always_xy=True)
    line = [[500030.3, 5.3e6], [500030.3, 5.31e6]]
    degrees = [list(to_degrees.transform(*place)) for place in line]
    moved = read_barriers(
        layer(tmp_path / "a.geojson", ("LineString", degrees, {}), crs=None), None, utm
    )
    np.testing.assert_allclose(np.array(moved.lines[0].coords), line, atol=1e-3)
    assert moved.warnings == ()
    taken = read_barriers(
        layer(tmp_path / "b.geojson", ("LineString", line, {}), crs=None), None, utm
    )
    np.testing.assert_array_equal(np.array(taken.lines[0].coords), line)
    assert [warning.code for warning in taken.warnings] == ["W_VECTOR_CRS"]


def test_bad_vector_files_are_told(tmp_path):
    with pytest.raises(InputNotFoundError, match="no such file"):
        read_barriers(str(tmp_path / "none.geojson"), None, PLAIN)
    (tmp_path / "text.geojson").write_text("hello", encoding="utf-8")
    points = layer(tmp_path / "points.geojson", ("Point", [1.0, 2.0], {}))
    empty = layer(tmp_path / "empty.geojson")
    for name in (str(tmp_path / "text.geojson"), points, empty):
        with pytest.raises(FormatError) as error:
            read_barriers(name, None, PLAIN)
        assert error.value.code == "E_NOT_VECTOR"
    with pytest.raises(OptionError, match="--water is for EMap surfaces"):
        ConvertOptions(water="x", surface="tin")


def test_lines_far_off_and_crossed_rings_do_no_harm(tmp_path):
    bow_tie = [[[10, 10], [20, 20], [20, 10], [10, 20], [10, 10]]]
    far = ("LineString", [[1e6, 1e6], [1.1e6, 1e6]], {})
    name = layer(tmp_path / "odd.geojson", far, ("Polygon", bow_tie, {}))
    dem = make_dem(quay(), PLAIN, 1.0, barriers=read_barriers(name, None, PLAIN))
    assert dem.solver["converged"]
    assert dem.barriers["lines"] == 2
    only = layer(tmp_path / "far.geojson", far)
    none = make_dem(quay(), PLAIN, 1.0, barriers=read_barriers(only, None, PLAIN))
    assert none.barriers["cut_edges"] == 0
    assert [note.code for note in none.notes] == ["W_VECTOR_CRS", "W_VECTOR_OUTSIDE"]
