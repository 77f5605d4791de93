"""Plain surfaces: each is what its name says, void where it says nothing."""

from __future__ import annotations

from fractions import Fraction

import naive_dem
import numpy as np
import pytest
from making_dems import chunk, gather, ground, hills

from volatool.dem import baselines
from volatool.dem.baselines import BASELINES
from volatool.dem.distance import FILLED, MEASURED, VOID
from volatool.dem.surfaces import make_dem
from volatool.errors import InputError, ResourceError
from volatool.model import CrsInfo
from volatool.scratch import Scratch

METRES = CrsInfo(metres_per_unit_xy=Fraction(1), metres_per_unit_z=Fraction(1))


def by_cell(points, grid):
    """Stored heights of the points of each cell."""
    cells = {}
    for rows in points.pieces():
        col, row = grid.places(rows, points.scale, points.offset)
        for c, r, z in zip(col, row, rows[:, 2].tolist(), strict=True):
            cells.setdefault(
                (min(int(r), grid.height - 1), min(int(c), grid.width - 1)), []
            ).append(z)
    return cells


@pytest.mark.parametrize("surface", ["min", "max", "mean"])
def test_a_statistic_of_each_cell_and_nothing_else(surface):
    """Heights equal the naive statistic; cells without points are void whatever the gap."""
    rng = np.random.default_rng(0)
    x, y, z = rng.integers(0, 30, 300), rng.integers(0, 20, 300), rng.integers(-9, 9, 300)
    points = gather(chunk(x, y, z, classification=5), surface=surface)
    dem = make_dem(points, METRES, 2.5)
    wanted = np.full(dem.z.shape, np.nan)
    for cell, heights in by_cell(points, dem.grid).items():
        wanted[cell] = getattr(np, surface)(np.array(heights) * 0.01)
    np.testing.assert_allclose(dem.z, wanted, atol=1e-6)
    assert dem.count.sum() == 300
    assert dem.cells_filled == 0
    assert np.array_equal(dem.flag == MEASURED, dem.count > 0)
    report = dem.to_dict()
    assert report["surface"] == surface
    assert report["solver"]["method"].endswith("per cell")
    assert report["solver"]["k_surface"] is None
    assert report["ground_source"] == f"{report['solver']['method']}".replace(
        " per", " point per" if surface != "mean" else " of the points per"
    )


def test_the_means_residual_is_the_points_spread_in_cells():
    x, y, z = hills()
    points = gather(chunk(x, y, z), surface="mean")
    dem = make_dem(points, METRES, 5.0)
    spread = [np.array(c) * 0.01 - np.mean(c) * 0.01 for c in by_cell(points, dem.grid).values()]
    assert dem.residual_rmse == pytest.approx(np.sqrt(np.mean(np.concatenate(spread) ** 2)), 1e-4)
    assert make_dem(gather(chunk(x, y, z), surface="min"), METRES, 5.0).residual_rmse is None


def test_idw_is_the_weighted_mean_of_the_twelve_nearest():
    x, y, z = hills(500)
    dem = make_dem(ground(x, y, z, surface="idw"), METRES, 1.0)
    row, col = np.mgrid[: dem.grid.height, : dem.grid.width]
    cx, cy = dem.grid.left + col + 0.5, dem.grid.top - row - 0.5
    wanted = naive_dem.idw(x, y, z, cx.ravel(), cy.ravel()).reshape(cx.shape)
    known = dem.flag != VOID
    assert (dem.flag == FILLED).any()
    np.testing.assert_allclose(dem.z[known], wanted[known], atol=1e-4)
    facts = dem.to_dict()["solver"]
    assert (facts["method"], facts["points"], facts["power"], facts["radius"]) == ("idw", 12, 2, 20)
    assert dem.ground_source == "class 2"


def test_idw_takes_a_point_at_the_centre_as_it_is():
    dem = make_dem(ground([0.5, 3.5, 3.2], [0.5, 0.5, 0.7], [1, 5, 9], surface="idw"), METRES, 1.0)
    np.testing.assert_allclose(dem.z[0, [0, 3]], [1, 5], atol=1e-6)


def test_tin_is_linear_and_ends_at_the_hull():
    """On a plane it is the plane; cells whose centre no triangle covers are void."""
    x, y, _ = hills(3000)
    inside = x + y < 60
    x, y = x[inside], y[inside]
    dem = make_dem(ground(x, y, np.round(0.3 * x - 0.2 * y, 2), surface="tin"), METRES, 1.0)
    row, col = np.mgrid[: dem.grid.height, : dem.grid.width]
    cx, cy = dem.grid.left + col + 0.5, dem.grid.top - row - 0.5
    known = dem.flag != VOID
    assert np.array_equal(known, ~np.isnan(dem.z))
    assert np.abs(dem.z - (0.3 * cx - 0.2 * cy))[known].max() < 0.02
    assert not known[cx + cy > 60].any()
    assert known[cx + cy < 50].mean() > 0.95
    assert dem.to_dict()["solver"]["triangles"] > 2000


@pytest.mark.parametrize("surface", ["idw", "tin"])
def test_filling_follows_max_gap(surface):
    x, y, z = hills(6000, 100.0)
    keep = (abs(x - 50) >= 20) | (abs(y - 50) >= 20)
    dem = make_dem(ground(x[keep], y[keep], z[keep], surface=surface), METRES, 1.0, max_gap=8.0)
    assert (dem.flag[33:67, 33:67] == VOID).all()
    assert dem.cells_filled > 100
    bare = make_dem(ground(x[keep], y[keep], z[keep], surface=surface), METRES, 1.0, fill=False)
    assert bare.cells_filled == 0


@pytest.mark.parametrize("surface", BASELINES)
def test_chunks_order_and_memory_do_not_change_a_byte(surface):
    x, y, z = hills()
    mixed = np.random.default_rng(1).permutation(len(x))
    found = set()
    for size, budget, order in (
        (4000, None, slice(None)), (77, None, slice(None)), (500, 70 << 20, slice(None)),
        (4000, None, mixed),
    ):  # fmt: skip
        if surface in ("tin", "idw") and order is mixed:
            continue  # sums and triangles follow the order of the points
        with Scratch(budget) as scratch:
            a, b, c = x[order], y[order], z[order]
            chunks = [
                chunk(a[k : k + size], b[k : k + size], c[k : k + size], k, classification=2)
                for k in range(0, len(x), size)
            ]
            points = gather(*chunks, surface=surface, scratch=scratch)
            dem = make_dem(points, METRES, 0.5, scratch=scratch)
            points.close()
            found.add((dem.z.tobytes(), dem.flag.tobytes(), dem.count.tobytes()))
    assert len(found) == 1


@pytest.mark.parametrize("surface", ["min", "max", "mean"])
def test_bins_spill(surface):
    """In files: the same bytes."""
    x, y, z = hills()
    with Scratch(0) as scratch:
        points = gather(chunk(x, y, z), surface=surface, scratch=scratch)
        spilled = make_dem(points, METRES, 0.25, scratch=scratch)
        points.close()
        plain = make_dem(gather(chunk(x, y, z), surface=surface), METRES, 0.25)
        assert spilled.z.tobytes() == plain.z.tobytes()
        assert str(spilled.to_dict()) == str(plain.to_dict())


@pytest.mark.parametrize("surface", ["idw", "tin"])
def test_scipys_memory_is_asked_for_in_advance(surface, monkeypatch):
    """Too many points for the ceiling: E_MEMORY with what helps, before a tree is built."""
    monkeypatch.setattr(baselines, f"_{surface}", lambda *_: pytest.fail("built"))
    points = ground(*hills(), surface=surface)
    with Scratch(1 << 20) as scratch, pytest.raises(ResourceError, match="--surface auto") as error:
        make_dem(points, METRES, 1.0, scratch=scratch)
    assert error.value.code == "E_MEMORY"


@pytest.mark.parametrize(
    ("x", "y"),
    [([3.0], [4.0]), ([3.0] * 5, [4.0] * 5), (range(20), range(20)), (range(9), [0] * 9)],
    ids=["one", "equal", "diagonal", "row"],
)
def test_degenerate_points(x, y):
    """A TIN of points on a line does not exist and says so; the others are flat."""
    z = np.full(len(x), 7.0)
    with pytest.raises(InputError, match="three points") as error:
        make_dem(ground(x, y, z, surface="tin"), METRES, 1.0)
    assert error.value.code == "E_NO_TRIANGLE"
    for surface in ("min", "max", "mean", "idw"):
        dem = make_dem(ground(x, y, z, surface=surface), METRES, 1.0)
        assert dem.z_min == dem.z_max == 7
