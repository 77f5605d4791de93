"""DEMs: what each cell is and says, whatever the chunks, the order and the memory."""

from __future__ import annotations

from fractions import Fraction

import naive_dem
import numpy as np
import pytest
from making_dems import chunk, gather, ground, hills

from volatool.dem.distance import FILLED, MEASURED, VOID, distance_cells, fill_flags, hull_spans
from volatool.dem.surfaces import make_dem
from volatool.errors import OptionError
from volatool.model import CrsInfo
from volatool.scratch import Scratch

METRES = CrsInfo(metres_per_unit_xy=Fraction(1), metres_per_unit_z=Fraction(1))


def check_dem_is_consistent(dem):
    """Assert what holds for every DEM."""
    counts = np.bincount(dem.flag.ravel(), minlength=3)
    assert counts.tolist() == [dem.cells_void, dem.cells_measured, dem.cells_filled]
    assert np.array_equal(np.isnan(dem.z), dem.flag == VOID)
    assert np.array_equal(dem.count > 0, dem.flag == MEASURED)
    if dem.cells_measured:
        assert dem.z_min == np.nanmin(dem.z)
        assert dem.z_max == np.nanmax(dem.z)


def test_dem_follows_the_terrain():
    """Heights are those of the hills to their noise; units and report are filled in."""
    x, y, z = hills()
    dem = make_dem(ground(x, y, z), METRES, 1.0)
    check_dem_is_consistent(dem)
    row, col = np.mgrid[: dem.grid.height, : dem.grid.width]
    cx, cy = dem.grid.left + col + 0.5, dem.grid.top - row - 0.5
    assert np.abs(dem.z - (100 + 3 * np.sin(cx / 9) * np.cos(cy / 7))).max() < 0.15
    assert dem.count.sum() == len(x)
    assert 0.02 < dem.noise_sigma < 0.04
    report = dem.to_dict()
    assert set(report["solver"]) == {
        "method", "iterations", "relative_residual", "converged", "k_surface", "k_point",
        "rule", "nets",
    }  # fmt: skip
    assert report["solver"]["rule"] == "spacing"
    assert report["solver"]["k_surface"] == report["solver"]["nets"][0]["k_surface"]
    assert (report["surface"], report["width"]) == ("dtm", 60)


@pytest.mark.parametrize("surface", ["dtm", "min"])
def test_chunks_memory_and_threads_do_not_change_a_byte(surface):
    """The same bytes for chunks of 1000, 77 and all, in RAM and in files."""
    x, y, z = hills()
    whole = None
    for size, budget in ((4000, None), (1000, None), (77, None), (500, 0), (500, 40_000)):
        threads = 1 if size > 500 else 3
        with Scratch(budget) as scratch:
            chunks = [
                chunk(x[k : k + size], y[k : k + size], z[k : k + size], k, classification=2)
                for k in range(0, len(x), size)
            ]
            points = gather(*chunks, surface=surface, scratch=scratch)
            dem = make_dem(points, METRES, 0.5, scratch=scratch, threads=threads)
            points.close()
            found = (dem.z.tobytes(), dem.flag.tobytes(), dem.count.tobytes(), str(dem.to_dict()))
        whole = whole or found
        assert found == whole


def test_order_of_points_does_not_matter():
    """Shuffled points: equal to 0.1 mm for EMap on all points, the same bytes for min and max."""
    x, y, z = hills()
    mixed = np.random.default_rng(1).permutation(len(x))
    a = make_dem(ground(x, y, z), METRES, 1.0)
    b = make_dem(ground(x[mixed], y[mixed], z[mixed]), METRES, 1.0)
    assert np.abs(a.z - b.z).max() < 1e-4
    for surface in ("min", "max"):
        a, b = (
            make_dem(ground(x[k], y[k], z[k], surface=surface), METRES, 1.0)
            for k in (slice(None), mixed)
        )
        assert a.z.tobytes() == b.z.tobytes()


def test_abutting_tiles_mesh():
    """Neighbours' grids share lines and corners; their union is a grid of the same cells."""
    x, y, z = hills()
    west, east = x < 29.37, x >= 29.37
    a, b = (make_dem(ground(x[k], y[k], z[k]), METRES, 0.5).grid for k in (west, east))
    shift = (b.exact[0] - a.exact[0]) / a.exact[2]
    assert shift.denominator == 1
    assert ((b.exact[1] - a.exact[1]) / a.exact[2]).denominator == 1


@pytest.mark.parametrize(
    ("x", "y", "z"),
    [
        ([3.0], [4.0], [5.0]),
        ([3.0] * 5, [4.0] * 5, [5.0, 6, 5, 6, 5]),
        (np.arange(50.0), np.zeros(50), np.arange(50.0)),
        (np.zeros(50), np.arange(50.0), np.zeros(50)),
        (np.arange(20.0), np.arange(20.0), np.arange(20.0)),
        (np.repeat(np.arange(9.0), 9), np.tile(np.arange(9.0), 9), np.full(81, -7.0)),
    ],
    ids=["one point", "equal", "row", "column", "diagonal", "flat"],
)
@pytest.mark.parametrize("cell", ["auto", 1.0, 100.0])
@pytest.mark.parametrize("surface", ["dtm", "min"])
@pytest.mark.parametrize("preset", ["emap", "paper"])
def test_degenerate_points_give_valid_dems(x, y, z, cell, surface, preset):
    """One point, equal points, collinear, one column, flat: finite heights within the points'."""
    dem = make_dem(ground(x, y, z, surface=surface), METRES, cell, preset=preset)
    check_dem_is_consistent(dem)
    assert dem.cells_measured >= 1
    # the centre of a cell of 100 may lie beyond all points, where the slope goes on
    beyond = 3 if cell != 100.0 else 100
    assert min(z) - beyond <= dem.z_min <= dem.z_max <= max(z) + beyond
    if min(z) == max(z):
        assert dem.z_min == dem.z_max == z[0]


def test_no_points_give_a_void_dem():
    """Nothing at all, or nothing of the surface: all void, no error."""
    dem = make_dem(gather(), METRES)
    assert (dem.grid.width, dem.grid.height, dem.cells_void) == (1, 1, 1)
    check_dem_is_consistent(dem)
    x, y, z = hills(100)
    points = gather(chunk(x, y, z, return_number=2), surface="dsm")
    dem = make_dem(points, METRES, 1.0)
    check_dem_is_consistent(dem)
    assert dem.cells_void == dem.grid.width * dem.grid.height > 1000
    assert np.isinf(dem.distance).all()


def test_feet_give_the_same_surface():
    """Units change numbers, not the DEM: feet on all axes, and heights in metres over feet."""
    x, y, z = hills(1500)
    scale = 0.01 * 0.5  # so that stored integers can be the same
    metre = make_dem(gather(chunk(x, y, z, scale=scale, classification=2)), METRES, 1.0)
    half = CrsInfo(metres_per_unit_xy=Fraction(1, 2), metres_per_unit_z=Fraction(1, 2))
    twice = chunk(2 * x, 2 * y, 2 * z, scale=0.01, classification=2)
    both = make_dem(gather(twice), half, 2.0)
    np.testing.assert_allclose(both.z / 2, metre.z, atol=2e-5)
    mixed = CrsInfo(metres_per_unit_xy=Fraction(1, 2), metres_per_unit_z=Fraction(1))
    points = gather(chunk(2 * x, 2 * y, z, scale=0.01, classification=2))
    np.testing.assert_allclose(make_dem(points, mixed, 2.0).z, metre.z, atol=2e-4)
    assert (
        make_dem(gather(twice), half).choice.cell
        == 2 * make_dem(gather(chunk(x, y, z, classification=2)), METRES).choice.cell
    )


def test_fill_and_gap():
    """--no-fill leaves measured cells only; a gap wider than twice max_gap stays void whole."""
    x, y, z = hills(6000, 100.0)
    lake = (abs(x - 50) < 20) & (abs(y - 50) < 20)
    hole = (abs(x - 10) < 3) & (abs(y - 10) < 3)
    keep = ~(lake | hole)
    points = ground(x[keep], y[keep], z[keep])
    bare = make_dem(points, METRES, 1.0, fill=False)
    assert bare.cells_filled == 0
    check_dem_is_consistent(bare)
    dem = make_dem(points, METRES, 1.0, max_gap=8.0)
    check_dem_is_consistent(dem)
    assert (dem.flag[-14:-6, 6:14] != VOID).all()
    assert (dem.flag[33:67, 33:67] == VOID).all()
    assert dem.distance[dem.flag == FILLED].max() <= 8.0
    assert make_dem(points, METRES, 1.0, max_gap=30.0).cells_void == 0
    np.testing.assert_array_equal(bare.z[bare.flag == MEASURED], dem.z[bare.flag == MEASURED])


def test_nothing_is_made_up_outside_the_hull():
    """A triangle of points leaves the other corner of its box void."""
    x, y, z = hills(8000)
    inside = x + y < 60
    dem = make_dem(ground(x[inside], y[inside], z[inside]), METRES, 1.0)
    row, col = np.mgrid[: dem.grid.height, : dem.grid.width]
    beyond = col + (dem.grid.height - row) > 60 + 8
    assert beyond.sum() > 1000
    assert (dem.flag[beyond] == VOID).all()


@pytest.mark.parametrize("seed", range(4))
def test_distances_equal_the_naive_ones(seed):
    """The exact distance transform, on dense, sparse, single and empty masks."""
    rng = np.random.default_rng(seed)
    shape = tuple(rng.integers(1, 25, 2))
    for density in (0.5, 0.05, 0.0):
        cells = (rng.random(shape) < density).astype(np.uint8)
        found = distance_cells(cells, 1, Scratch(0))
        np.testing.assert_allclose(found, naive_dem.distances(cells, 1), rtol=1e-6)


def test_filling_is_a_closing():
    """Every filled cell has a measured one in every disc that covers it, and none else is."""
    rng = np.random.default_rng(3)
    cells = (rng.random((40, 37)) < 0.01).astype(np.uint8)
    cells[0, [0, -1]] = cells[-1, [0, -1]] = MEASURED  # the hull is everything
    far = naive_dem.distances(cells, 1) > 6
    wanted = (naive_dem.distances(far, True) > 6) | (cells == 1)
    flag = cells.copy()
    fill_flags(flag, 6.0, 1.0, Scratch())
    np.testing.assert_array_equal(flag != VOID, wanted)


def test_hull_equals_scipy():
    """Row spans are those of the convex hull of the cells' centres."""
    from scipy.spatial import Delaunay

    rng = np.random.default_rng(0)
    cells = np.zeros((30, 40), np.uint8)
    cells[rng.integers(4, 25, 25), rng.integers(3, 36, 25)] = MEASURED
    spans = hull_spans(cells, 0)
    row, col = np.mgrid[:30, :40]
    inside = Delaunay(np.argwhere(cells == 1)).find_simplex(np.column_stack([row.flat, col.flat]))
    inside = inside.reshape(cells.shape) >= 0
    found = (col >= spans[:, :1]) & (col <= spans[:, 1:])
    assert (found | ~inside).all()
    assert (found & ~inside).sum() <= 2 * 30  # cells that the hull's edge cuts


def test_wrong_options_are_refused():
    """Presets and lengths that make no sense are usage errors."""
    points = ground(*hills(10))
    with pytest.raises(OptionError, match="preset"):
        make_dem(points, METRES, 1.0, preset="tin")
    with pytest.raises(OptionError, match="--max-gap"):
        make_dem(points, METRES, 1.0, max_gap=0.0)
    with pytest.raises(OptionError, match="--tol"):
        make_dem(points, METRES, 1.0, tol_m=float("nan"))
    with pytest.raises(OptionError, match="greater than zero"):
        make_dem(points, METRES, -1.0)
