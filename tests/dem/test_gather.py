"""Which points make the surface, under which name, and the cell they get."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from making_dems import chunk, gather, ground, hills

from volatool.dem.cell import choose_cell, mean_spacing
from volatool.dem.gather import SURFACES, SurfaceGatherer
from volatool.emap.ground import GroundFilter
from volatool.errors import InputError, OptionError
from volatool.model import CrsInfo
from volatool.scratch import Scratch

X, Y, Z = np.arange(6.0), np.zeros(6), np.arange(6.0) * 2


def heights(points):
    return np.concatenate([np.empty(0, int), *(rows[:, 2] for rows in points.pieces())]) / 100


def test_auto_takes_ground_once_it_is_seen():
    """Points before the first ground point are kept only until it comes."""
    first = chunk(X, Y, Z, classification=1)
    mixed = chunk(X, Y, Z + 100, classification=[1, 2, 2, 1, 2, 6])
    points = gather(first, mixed, first)
    assert (points.name, points.ground_source) == ("dtm", "class 2")
    assert heights(points).tolist() == [102, 104, 108]
    assert points.z_range == (10200, 10800)
    assert points.extent == (0, 0, 500, 0)
    assert points.warnings == ()


@pytest.mark.parametrize("surface", ["auto", "dtm"])
def test_without_a_ground_class_the_ground_filter_chooses(surface):
    """Hills under a roof: the roof's points go, and the warning says what was done."""
    x, y, z = hills(8000)
    roof = (x > 20) & (x < 35) & (y > 20) & (y < 40)
    z[roof] = 115.0
    points = gather(chunk(x, y, z, classification=1), surface=surface)
    assert (points.name, points.ground_source) == ("dtm", "ground filter")
    assert sorted(heights(points)) == sorted(z[~roof])
    assert points.z_range[1] < 11500
    assert points.extent == gather(chunk(x, y, z), surface="min").extent
    (warning,) = points.warnings
    assert warning.code == "W_NO_GROUND_CLASS"
    assert f"the {np.count_nonzero(~roof)} of 8000 points that the ground filter kept" in (
        warning.message
    )
    assert len(gather(chunk(x, y, z), dimensions=(), surface=surface)) == len(points)


def test_the_ground_filter_works_in_metres():
    """In feet the same points are kept."""
    foot = Fraction("0.3048")
    crs = CrsInfo(metres_per_unit_xy=foot, metres_per_unit_z=foot)
    x, y, z = hills(8000)
    x, y, z = x / 0.3048, y / 0.3048, z / 0.3048
    gatherer = SurfaceGatherer("auto", Scratch(), ())
    gatherer.add(chunk(x, y, z))
    assert len(gatherer.result(crs)) > 7990


def test_no_ground_at_all_is_an_error(monkeypatch):
    """When the filter keeps nothing, --surface min is what is left."""
    monkeypatch.setattr(GroundFilter, "keeps", lambda self, rows: np.zeros(len(rows), bool))
    for surface in ("auto", "dtm"):
        with pytest.raises(InputError, match="--surface min") as error:
            gather(chunk(X, Y, Z, classification=1), surface=surface)
        assert error.value.code == "E_NO_GROUND"
        assert len(gather(surface=surface)) == 0  # no points at all is not about ground
        assert gather(surface=surface).warnings == ()


def test_dsm_takes_first_returns():
    """Return 1; 0 stands for formats without returns."""
    points = gather(chunk(X, Y, Z, return_number=[1, 2, 3, 1, 0, 2]), surface="dsm")
    assert heights(points).tolist() == [0, 6, 8]
    assert points.ground_source == "first returns"
    assert len(gather(chunk(X, Y, Z), surface="dsm", dimensions=())) == 6


def test_attributes_are_only_what_the_surface_needs():
    """The statistics need none, ground surfaces the class, dsm the return."""
    classes = {key: {"classification"} for key in ("auto", "dtm", "idw", "tin")}
    for surface in SURFACES:
        gatherer = SurfaceGatherer(surface, Scratch(), {"classification", "return_number", "red"})
        assert gatherer.attributes == {**classes, "dsm": {"return_number"}}.get(surface, set())
    with pytest.raises(OptionError, match="must be one of"):
        SurfaceGatherer("tni", Scratch(), ())


@pytest.mark.parametrize(
    ("per_metre", "cell"), [(0.5, "2"), (1.2, "1"), (2.4, "0.5"), (0.05, "10")]
)
def test_auto_cell_is_the_smallest_that_is_covered(per_metre, cell):
    """60 % of the cells in the footprint hold a point; in feet the same cell in metres."""
    n = round(100 * per_metre)
    x, y = np.meshgrid((np.arange(n) + 0.5) / per_metre, (np.arange(n) + 0.5) / per_metre)
    x, y = x.ravel(), y.ravel()
    choice = choose_cell(ground(x, y, x * 0), None)
    assert choice.cell == choice.cell_m == Fraction(cell)
    feet = choose_cell(ground(x / 0.3048, y / 0.3048, x * 0), Fraction("0.3048"))
    assert feet.cell_m == Fraction(cell)
    assert feet.cell == Fraction(cell) / Fraction("0.3048")


def test_auto_cell_follows_a_scan_from_the_ground():
    """Density that falls with the square of the distance does not end in a coarse cell."""
    rng = np.random.default_rng(0)
    radius, angle = rng.uniform(0.5, 15, 40_000), rng.uniform(0, 2 * np.pi, 40_000)
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    assert choose_cell(ground(x, y, x * 0), None).cell <= Fraction(1, 2)


def test_auto_cell_ignores_voids():
    """A lake of half the tile doesn't coarsen the cell; too few points give the largest."""
    x, y, z = hills(8000)
    full = choose_cell(ground(x, y, z), None)
    dry = x < 30
    assert choose_cell(ground(x[dry], y[dry], z[dry]), None).cell == full.cell == 1
    assert choose_cell(ground([0, 1000], [0, 1000], [0, 0]), None).cell == 10
    assert choose_cell(gather(), None).cell == 1


def test_mean_spacing_counts_where_points_are():
    """s = sqrt(area of occupied cells / n); voids don't count, units do."""
    x, y, z = hills(3600)
    s = mean_spacing(ground(x, y, z), None)
    assert s == pytest.approx(1.0, rel=0.02)
    left = x < 30
    half = mean_spacing(ground(x[left], y[left], z[left]), None)
    assert half == pytest.approx(1.0, rel=0.03)
    assert mean_spacing(ground(x / 0.3048, y / 0.3048, z), Fraction("0.3048")) == pytest.approx(
        s / 0.3048, rel=0.05
    )
    assert mean_spacing(ground([5.0], [5.0], [0.0]), None) == 5.0
