"""Scans to a surface: the sum of all evidence, wherever the window and however it was split."""

from __future__ import annotations

import time

import naive_dem
import numpy as np
import pytest
from making_scans import height, scan

import volatool as vt
from volatool.emap.blocks import SIDE
from volatool.emap.solve import solve
from volatool.emap.system import Evidence, Springs
from volatool.errors import OptionError, ResourceError
from volatool.kernels import quads


def drive(n=20):
    return [scan(0.2 * k, seed=k) for k in range(n)]


def test_incremental_equals_batch():
    """Acceptance 1: 20 scans in any order and split, with windows between: 1e-6 m."""
    scans = drive()
    batch = vt.EMap(tol=1e-8)
    batch.update(np.concatenate(scans))
    expected, _, _ = batch.solve_window((2, 0), 40)
    rng = np.random.default_rng(3)
    shuffled = np.concatenate(scans)[rng.permutation(sum(map(len, scans)))]
    for parts in (scans, [scans[k] for k in rng.permutation(20)], np.array_split(shuffled, 7)):
        m = vt.EMap(tol=1e-8)
        for k, part in enumerate(parts):
            m.update(part)
            m.solve_window((0.2 * k, 0), 40)
        z, _, _ = m.solve_window((2, 0), 40)
        assert np.abs(z - expected).max() < 1e-6


def test_the_surface_is_that_of_the_batch_solver():
    """On a window that holds all points the equations are those of `Evidence` and `solve`."""
    points = scan(reach=3.0)
    m = vt.EMap((-4, -4, 4, 4), cell=0.25, tol=1e-9)
    m.update(points)
    evidence = Evidence(72, 72)  # 32 cells and 20 all round
    x, y, z = points.T
    evidence.add((x + 9) / 0.25, (9 - y) / 0.25, z, m.springs)
    expected, _ = solve(evidence, m.springs, tol=1e-9)
    np.testing.assert_allclose(m.z, expected[20:-20, 20:-20], atol=1e-8)
    assert m.count.sum() == len(points)
    rows, cols = np.floor((4 - y) / 0.25).astype(int), np.floor((x + 4) / 0.25).astype(int)
    expected_count = np.zeros((32, 32), int)
    np.add.at(expected_count, (rows, cols), 1)
    np.testing.assert_array_equal(m.count, expected_count)
    np.testing.assert_array_equal(m.measured, expected_count > 0)


def test_rows_run_south_and_columns_east():
    m = vt.EMap((10, 20, 12, 21), cell=0.5)
    m.update([[x, y, 2 * x + y] for x in np.arange(9, 13, 0.1) for y in np.arange(19, 22, 0.1)])
    surface = m.surface
    np.testing.assert_allclose(surface.x, [10.25, 10.75, 11.25, 11.75])
    np.testing.assert_allclose(surface.y, [20.75, 20.25])
    np.testing.assert_allclose(m.z, 2 * surface.x + surface.y[:, None], atol=0.05)
    assert m.bounds == vt.Bounds(10, 20, 12, 21)
    np.testing.assert_allclose(m.heights_at([[10.75, 20.25]]), m.z[1, 1])


@pytest.mark.parametrize("attach", ["bilinear", "nearest"])
@pytest.mark.parametrize("shape", [(5, 7), (1, 1), (2, 9), (26, 20)])
def test_couplings_cut_by_the_window_are_lumped(attach, shape):
    """Trap (i): a cut spring leaves its row sum, so that the outside node is no longer at zero."""
    rng = np.random.default_rng(1)
    m = vt.EMap(cell=1.0, attach=attach)
    points = np.column_stack([rng.uniform(-12, 12, (150, 2)), rng.normal(size=150)])
    m.update(points)
    height_cells, width_cells = (max(2, n) for n in shape)
    left, top = -width_cells // 2, -height_cells // 2
    evidence = m._blocks.evidence(top, left, height_cells, width_cells)
    big = 30  # all points are inside
    col, row = points[:, 0] + big // 2, big // 2 - points[:, 1]
    if attach == "nearest":
        col, row = np.floor(col) + 0.5, np.floor(row) + 0.5
    heights = points[:, 2] - m._zero
    matrix, right = naive_dem.data_matrix(col, row, heights, 1.0, (big, big))
    nodes = np.arange(big * big).reshape(big, big)
    rows, cols = top + big // 2, left + big // 2
    inside = nodes[rows : rows + height_cells, cols : cols + width_cells].ravel()
    expected = matrix[np.ix_(inside, inside)]
    expected += np.diag(matrix[inside].sum(1) - expected.sum(1))
    np.testing.assert_allclose(naive_dem.dense_stencil(evidence.data), expected, atol=1e-12)
    np.testing.assert_allclose(evidence.right.ravel(), right[inside], atol=1e-12)


def test_a_window_far_above_zero_stays_there():
    """Lumping in effect: a level plane 800 m up is level to the rim of the smallest window."""
    m = vt.EMap(cell=0.5)
    x, y = np.random.default_rng(0).uniform(-5, 5, (2, 3000))
    m.update(np.column_stack([x, y, np.full(3000, 812.4)]))
    m._zero = 0.0  # as if the first scan had been at sea level
    m._blocks = type(m._blocks)(m.springs, 1.0, np.inf, 1 << 30)
    m.update(np.column_stack([x, y, np.full(3000, 812.4)]))
    z, _, _ = m.solve_window((0, 0), 4, margin=0)
    np.testing.assert_allclose(z, 812.4, atol=1e-3)


def test_margin_brings_in_the_returns_around():
    points = scan(n=4000)
    m = vt.EMap()
    m.update(points)
    z, x, y = m.solve_window((0, 0), 40)
    narrow, _, _ = m.solve_window((0, 0), 40, margin=0)
    rms = [np.sqrt(np.mean((h - height(x, y[:, None])) ** 2)) for h in (z, narrow)]
    assert rms[0] < rms[1]


def test_windows_roll_by_whole_cells():
    m = vt.EMap(cell=0.25)
    for points in drive(3):
        m.update(points)
    first = m.window((0.0, 0.0), 10.0)
    second = m.window((0.26, 0.0), 10.0)
    assert first.z.shape == (40, 40)
    np.testing.assert_allclose(second.x[:-1], first.x[1:])
    np.testing.assert_allclose(second.z[:, :-1], first.z[:, 1:], atol=2e-3)  # another margin
    assert m.grid == second.grid
    assert m.z.shape == (40, 40)


def test_warm_start_keeps_the_solution():
    """After rolling from far and near the window is what a new map would give."""
    scans = drive(6)
    m, fresh = vt.EMap(tol=1e-8), vt.EMap(tol=1e-8)
    for k, points in enumerate(scans):
        m.update(points)
        m.solve_window((0.2 * k, 0.1 * k), 40)
    fresh.update(np.concatenate(scans))
    for centre in ((1.0, 0.5), (1.0, 8.0), (30.0, 0.0)):
        z, _, _ = m.solve_window(centre, 40)
        np.testing.assert_allclose(z, fresh.solve_window(centre, 40)[0], atol=1e-6)


def test_forgetting_is_the_weighted_sum():
    """After n scans, scan k counts f^(n - k), in blocks touched or not."""
    scans = [scan(40.0 * (k % 2), seed=k) for k in range(6)]
    m = vt.EMap(forget=0.6, tol=1e-9)
    twin = vt.EMap(tol=1e-9)
    for k, points in enumerate(scans):
        m.update(points)
        twin.update(points, weights=0.6 ** (5 - k))
    for centre in ((0, 0), (40, 0)):
        z, _, _ = m.solve_window(centre, 30)
        np.testing.assert_allclose(z, twin.solve_window(centre, 30)[0], atol=1e-7)


def test_a_faded_surface_stays():
    """Thousands of scans elsewhere: what was seen keeps its shape, without overflow or drift."""
    m = vt.EMap(forget=0.5)
    m.update(scan(n=20000))
    before, _, _ = m.solve_window((0, 0), 20)
    for _ in range(3000):
        m.update(np.empty((0, 3)))
    after, _, _ = m.solve_window((0, 0), 20)
    assert np.abs(after - before).max() < 0.3
    m.update(scan() + np.array([0, 0, 5]))
    assert abs(float(np.mean(m.solve_window((0, 0), 20)[0] - before)) - 5) < 0.05


def test_a_bounded_weight_follows_a_changed_place():
    """Forgetting by place: 50 old scans weigh no more than the bound."""
    old = scan(noise=0)
    new = old + np.array([0, 0, 1.0])
    errors = []
    for max_weight in (None, 2.0):
        m = vt.EMap(max_weight=max_weight)
        for _ in range(50):
            m.update(old)
        for _ in range(9):
            m.update(new)
        z, x, y = m.solve_window((0, 0), 20)
        errors.append(float(np.abs(z - height(x, y[:, None]) - 1).mean()))
    assert errors[0] > 0.8
    assert errors[1] < 0.2


def test_weights_and_sigmas():
    points = scan(n=300)
    twice = vt.EMap(tol=1e-9)
    twice.update(np.concatenate([points, points]))
    for options in ({"weights": 2.0}, {"sigma": np.full(300, 0.05 / np.sqrt(2))}):
        m = vt.EMap(tol=1e-9)
        m.update(points, **options)
        np.testing.assert_allclose(
            m.solve_window((0, 0), 20)[0], twice.solve_window((0, 0), 20)[0], atol=1e-7
        )


def test_points_that_do_not_count_are_counted():
    points = np.array(
        [[0, 0, 1], [np.nan, 0, 1], [0, np.inf, 1], [0, 0, -np.inf], [1.9, 0, 1], [0, 7, 1]], float
    )
    m = vt.EMap((-2, -2, 2, 2), radius=3.0)
    count = m.update(points, origin=(-1.0, 0.0, 2.0))
    assert (count.n_points, count.n_used) == (6, 2)
    assert (count.n_invalid, count.n_far, count.n_outside) == (3, 1, 0)
    assert m.update(points, origin=(0, 6)).n_outside == 1
    plain = vt.EMap()
    assert plain.update([[1e300, 0, 0], [0, -1e200, 0]]).n_outside == 2
    assert plain.update([]).n_points == 0
    assert plain.n_scans == 2


def test_an_empty_map_has_no_heights():
    m = vt.EMap((0, 0, 1, 1))
    assert np.isnan(m.z).all()
    assert not m.count.any()
    assert vt.EMap().bounds is None
    with pytest.raises(OptionError, match="empty"):
        vt.EMap().z  # noqa: B018
    m.update([[0.5, 0.5, 3.0]])
    np.testing.assert_allclose(m.z, 3.0, atol=1e-3)


def test_without_bounds_z_covers_what_was_seen():
    m = vt.EMap(cell=0.5)
    m.update([[0.1, 0.1, 1.0], [40.2, -33.3, 2.0]])
    assert m.bounds == vt.Bounds(0, -33.5, 40.5, 0.5)
    assert m.z.shape == (68, 81)


def test_memory_grows_with_area_alone():
    m = vt.EMap()
    m.update(scan())
    once = m.n_bytes
    for seed in range(5):
        m.update(scan(seed=seed))
    assert m.n_bytes == once
    freed = m.drop_beyond((1e3, 0), 900)
    assert freed == once
    assert m.n_bytes == 0


def test_drop_beyond_keeps_what_is_near():
    m = vt.EMap()
    m.update(np.concatenate([scan(), scan(at=200.0)]))
    near, _, _ = m.solve_window((0, 0), 40)
    assert m.drop_beyond((0, 0), 50) > 0
    np.testing.assert_allclose(m.solve_window((0, 0), 40)[0], near, atol=1e-4)
    assert np.isnan(m.solve_window((200, 0), 40)[0]).all()


def test_a_scan_that_would_not_fit_changes_nothing():
    m = vt.EMap(max_bytes=2 << 20)
    m.update(scan(reach=3.0))
    before, _, _ = m.solve_window((0, 0), 20)
    spread = np.random.default_rng(0).uniform(-1e5, 1e5, (500, 3))
    with pytest.raises(ResourceError, match="MiB") as caught:
        m.update(spread)
    assert caught.value.code == "E_MEMORY"
    np.testing.assert_array_equal(m.solve_window((0, 0), 20)[0], before)


@pytest.mark.parametrize(
    "options",
    [
        {"cell": 0.0},
        {"cell": np.nan},
        {"sigma": -1},
        {"forget": 0.0},
        {"forget": 1.1},
        {"margin": -1},
        {"radius": 0},
        {"max_weight": 0},
        {"preset": "fast"},
        {"attach": "far"},
        {"k_surface": np.inf},
        {"ell": 0.0},
    ],
)
def test_impossible_options(options):
    with pytest.raises(OptionError):
        vt.EMap(**options)


def test_impossible_scans_and_windows():
    m = vt.EMap(radius=5.0)
    with pytest.raises(OptionError, match="origin"):
        m.update([[0, 0, 0]])
    m = vt.EMap()
    for bad in ([[1, 2]], [1, 2, 3], np.zeros((2, 3, 3))):
        with pytest.raises(OptionError, match="scan"):
            m.update(bad)
    with pytest.raises(OptionError, match="weights"):
        m.update([[0, 0, 0], [1, 1, 1]], weights=[1, 2, 3])
    with pytest.raises(OptionError, match="weights"):
        m.update([[0, 0, 0]], sigma=[0.0])
    m.update([[0, 0, 0]])
    with pytest.raises(OptionError, match="centre"):
        m.solve_window((np.nan, 0), 10)
    with pytest.raises(OptionError):
        m.window((0, 0), -1.0)
    with pytest.raises(ResourceError) as caught:
        m.solve_window((0, 0), 1 << 20)
    assert caught.value.code == "E_SIZE"


def test_paper_preset():
    """Nearest attachment, membrane, no margin unless asked for."""
    m = vt.EMap(preset="paper")
    assert m.springs == Springs(0.0, 0.1, 1.0, is_nearest=True)
    assert m.margin == 0
    m.update(scan())
    alone, _, _ = m.solve_window((0, 0), 20)
    wide, _, _ = m.solve_window((0, 0), 20, margin=20)
    assert np.abs(alone - wide).max() > 1e-3


def test_points_on_block_borders_are_in_their_cell():
    m = vt.EMap(cell=1.0)
    edge = SIDE + 0.5  # where quads of one block end
    m.update([[x, -y, 1.0] for x in (edge - 1e-9, edge, SIDE, 0.0) for y in (edge, -0.5, 0.5)])
    grid = m.grid
    assert m.count.sum() == 12
    assert m.count[0 - int(-grid.top), 0 - int(grid.left)] == 1
    assert m.count[SIDE - int(-grid.top), SIDE - int(grid.left)] == 3


def test_loop_speed():
    """Acceptance 4, with room for a loaded machine: 1600 nodes and 7500 points, CPU time."""
    m = vt.EMap()
    scans = [scan(0.2 * k, n=7500, seed=k) for k in range(16)]
    for k, points in enumerate(scans):
        if k == 6:
            start = time.process_time()
        m.update(points)
        m.solve_window((0.2 * k, 0), 40)
    assert (time.process_time() - start) / 10 < 0.05


@pytest.mark.parametrize("margin", [0, 4])
@pytest.mark.parametrize("attach", ["bilinear", "nearest"])
def test_random_forces_have_the_covariance_of_the_evidence(margin, attach):
    """The mean of f f^T over all signs is D, with its lumped rim, exactly: by each sign alone."""
    rng = np.random.default_rng(5)
    m = vt.EMap(cell=1.0, attach=attach)
    m.update(np.column_stack([rng.uniform(-6, 6, (60, 2)), rng.normal(size=60)]))
    n = 8 + 2 * margin
    evidence = m._blocks.evidence(-n // 2, -n // 2, n, n)
    forces = np.zeros((n, n, 64), np.float32)
    for start in range(0, 6400, 64):  # other places have other signs
        part = np.zeros((n, n, 64), np.float32)
        for key, block, factor in m._blocks._weighed(-n // 2, -n // 2, n, n):
            row, col = key[0] * SIDE, key[1] * SIDE
            quads.pull(
                block.quads, factor, col + n // 2, row + n // 2, col + start * SIDE, row, 0, part
            )
        forces = part if start == 0 else np.concatenate([forces, part], axis=2)
    flat = forces.reshape(n * n, -1).astype(float)
    found, expected = flat @ flat.T / flat.shape[1], naive_dem.dense_stencil(evidence.data)
    spread = np.sqrt((np.outer(np.diag(expected), np.diag(expected)) + expected**2) / 6400)
    assert (np.abs(found - expected) <= 6 * spread + 1e-6).all()


def test_sigma_is_that_of_the_dense_inverse():
    """32 samples: within 15 % rms of the exact standard error, and larger where nothing is."""
    points = scan(n=600, reach=2.0)
    points = points[~((abs(points[:, 0] - 1) < 0.6) & (abs(points[:, 1]) < 0.6))]
    m = vt.EMap((-2, -2, 2, 2), cell=0.25, margin=2, sigma=0.07)
    m.update(points)
    n = 20
    evidence = m._blocks.evidence(-n // 2, -n // 2, n, n)
    matrix = naive_dem.surface_matrix(n, n, m.springs.kb, m.springs.km)
    matrix = matrix + naive_dem.dense_stencil(evidence.data)
    exact = 0.07 * np.sqrt(np.diag(np.linalg.inv(matrix))).reshape(n, n)[2:-2, 2:-2]
    ratio = m.sigma / exact
    assert np.sqrt(np.mean((ratio - 1) ** 2)) < 0.15
    assert abs(np.mean(m.standard_error(64) / exact) - 1) < 0.06
    np.testing.assert_array_equal(m.sigma, m.sigma)


def test_sigma_needs_points_and_samples():
    m = vt.EMap((0, 0, 1, 1))
    assert np.isnan(m.sigma).all()
    with pytest.raises(OptionError, match="samples"):
        m.standard_error(65)
