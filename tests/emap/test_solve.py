"""The multigrid solve: exact on planes, converges in few iterations, independent of strips."""

from __future__ import annotations

import naive_cuts
import naive_dem
import numpy as np
import pytest

from volatool.emap import system, walk
from volatool.emap.cuts import Cuts
from volatool.emap.multigrid import Hierarchy, chebyshev
from volatool.emap.solve import solve
from volatool.emap.system import Evidence, Springs
from volatool.kernels import cut_multigrid
from volatool.scratch import Scratch


def terrain(n, seed=0, density=0.15, gap=20):
    """Points on hills with noise; 5 % of the area in square gaps."""
    rng = np.random.default_rng(seed)
    m = int(n * n * density)
    col, row = rng.uniform(1, n - 1, m), rng.uniform(1, n - 1, m)
    keep = np.ones(m, bool)
    for _ in range(int(0.05 * n * n / gap**2)):
        a, b = rng.uniform(0, n - gap, 2)
        keep &= ~((col > a) & (col < a + gap) & (row > b) & (row < b + gap))
    col, row = col[keep], row[keep]
    return col, row, 10 * np.sin(col / 23) * np.cos(row / 31) + rng.normal(0, 0.05, len(col))


def evidence_of(points, shape, springs, scratch=None):
    evidence = Evidence(*shape, scratch)
    evidence.add(*points, springs)
    return evidence


@pytest.mark.parametrize("shape", [(2, 2), (3, 8), (8, 3), (2, 30), (13, 11), (31, 24)])
@pytest.mark.parametrize("springs", [Springs(0.5, 0.05), Springs(0.0, 0.1)])
def test_solution_equals_the_dense_one(shape, springs):
    """Heights equal those of a dense solve."""
    rng = np.random.default_rng(3)
    n = max(4, shape[0] * shape[1] // 6)
    points = rng.uniform(0, shape[1], n), rng.uniform(0, shape[0], n), rng.normal(size=n)
    data, right = naive_dem.data_matrix(*points, springs.weight, shape)
    matrix = naive_dem.surface_matrix(*shape, springs.kb, springs.km) + data
    z, info = solve(evidence_of(points, shape, springs), springs, tol=1e-9)
    assert info.converged
    np.testing.assert_allclose(z.ravel(), np.linalg.solve(matrix, right), atol=1e-7)


def test_bending_reproduces_a_plane():
    """Acceptance 2: 500 points of a plane, 101 x 101, bending only: error below 1e-5."""
    rng = np.random.default_rng(0)
    col, row = rng.uniform(0.5, 100.5, (2, 500))
    plane = 0.3 * col - 0.2 * row + 5
    springs = Springs(0.1, 0.0)
    z, _ = solve(evidence_of((col, row, plane), (101, 101), springs), springs, tol=1e-7)
    r, q = np.mgrid[:101, :101] + 0.5
    assert np.abs(z - (0.3 * q - 0.2 * r + 5)).max() < 1e-5


def test_incremental_equals_batch():
    """Acceptance 1: 20 scans in another order, warm-started, equal one batch to 1e-6 m."""
    springs = Springs(10.0, 1e-4)
    points = terrain(60, density=2.0)
    batch, _ = solve(evidence_of(points, (60, 60), springs), springs, tol=1e-8)
    evidence, z = Evidence(60, 60), None
    scans = np.array_split(np.random.default_rng(1).permutation(len(points[0])), 20)
    for scan in scans:
        evidence.add(*(values[scan] for values in points), springs)
        z, _ = solve(evidence, springs, tol=1e-8, start=z)
    assert np.abs(z - batch).max() < 1e-6


@pytest.mark.parametrize("springs", [Springs(0.1, 0.001), Springs(0.1, 0.0), Springs(0.0, 0.1)])
def test_iterations_do_not_grow_with_the_grid(springs):
    """Acceptance 9: 1025 x 1025, <= 9 iterations, error < 0.5 mm, <= 2.5 times those of 65."""
    counts = {}
    for n in (65, 1025):
        points = terrain(n)
        evidence = evidence_of(points, (n, n), springs)
        z, info = solve(evidence, springs)
        counts[n] = info.iterations
        exact, _ = solve(evidence, springs, tol=1e-8, start=z.copy())
        assert np.abs(z - exact).max() < 5e-4
    assert counts[1025] <= 9
    assert counts[1025] <= 2.5 * max(counts[65], 1)


@pytest.mark.parametrize("n", [14, 40])
def test_preconditioner_is_symmetric(n):
    """The V-cycle is a symmetric operator to float32 rounding, and positive."""
    springs = Springs(0.4, 0.02)
    evidence = evidence_of(terrain(n, density=1.0), (n, n), springs)
    hierarchy = Hierarchy(evidence, springs, Scratch())
    rng = np.random.default_rng(0)

    def cycle(force):
        hierarchy.levels[0].right[:] = force
        hierarchy.cycle()
        return hierarchy.levels[0].x.astype(float)

    u, v = rng.normal(size=(2, n, n)).astype(np.float32)
    a, b = np.sum(v * cycle(u)), np.sum(u * cycle(v))
    assert abs(a - b) < 1e-4 * np.sqrt(np.sum(u * cycle(u)) * np.sum(v * cycle(v)))
    assert np.sum(u * cycle(u)) > 0


@pytest.mark.parametrize("shape", [(10, 11), (13, 2), (2, 12), (17, 18)])
def test_coarse_data_is_the_galerkin_product(shape):
    """P^T D P of the naive dense matrices, and the coarse grid's own transfer, agree."""
    springs = Springs(1.0, 0.1)
    rng = np.random.default_rng(5)
    points = rng.uniform(0, shape[1], 60), rng.uniform(0, shape[0], 60), rng.normal(size=60)
    evidence = evidence_of(points, shape, springs)
    fine, coarse = Hierarchy(evidence, springs, Scratch()).levels[:2]
    transfer = np.kron(naive_dem.prolongation(shape[0]), naive_dem.prolongation(shape[1]))
    wanted = transfer.T @ naive_dem.dense_stencil(evidence.data) @ transfer
    np.testing.assert_allclose(naive_dem.dense_stencil(coarse.data), wanted, atol=1e-5)
    assert coarse.kb == fine.kb / 4
    assert coarse.km == fine.km


def test_full_start_restricts_and_prolongs():
    """Transfers equal the naive matrices: restriction is the transpose of interpolation."""
    from volatool.kernels import multigrid

    rng = np.random.default_rng(0)
    for h, w in ((10, 11), (11, 10), (1, 9), (2, 5)):
        rows, cols = naive_dem.prolongation(h), naive_dem.prolongation(w)
        fine = rng.normal(size=(h, w)).astype(np.float32)
        coarse = np.full((h // 2 + 1, w // 2 + 1), 7, np.float32)
        for start, stop in system.strips(h, w, cells=3 * w):
            multigrid.restrict_rows(fine, coarse, start, stop)
        np.testing.assert_allclose(coarse, rows.T @ fine @ cols, atol=1e-5)
        out, work = np.empty_like(fine), np.zeros(coarse.shape[1] + 1, np.float32)
        for r in range(h):
            multigrid.prolong_row(coarse, r, work, out[r])
        np.testing.assert_allclose(out, rows @ coarse @ cols.T, atol=1e-5)


@pytest.mark.parametrize("shape", [(10, 11), (12, 3), (3, 12), (31, 24)])
@pytest.mark.parametrize("has_cuts", [False, True])
@pytest.mark.parametrize("start", ["zero", "set", "add"])
def test_a_sweep_is_its_stages(shape, has_cuts, start):
    """One walk equals interpolation, three steps and restriction by dense matrices."""
    from volatool.emap.multigrid import NOTHING

    springs, (h, w) = Springs(0.7, 0.03), shape
    rng = np.random.default_rng(4)
    points = rng.uniform(0, w, 40), rng.uniform(0, h, 40), rng.normal(size=40)
    evidence = evidence_of(points, shape, springs)
    cuts = Cuts.none(h, w)
    if has_cuts:
        cuts.edges[:, 0, 1:-1] = rng.choice([0.3, 1.0], (h, w - 2))
    hierarchy = Hierarchy(evidence, springs, Scratch(), cuts if has_cuts else None)
    level, below = hierarchy.levels[:2]
    surface = naive_cuts.surface_matrix(springs.kb, springs.km, cuts.edges).toarray()
    matrix = surface + naive_dem.dense_stencil(evidence.data)
    level.right[:], below.x[:], level.x[:] = (
        rng.normal(size=a.shape) for a in (level.x, below.x, level.x)
    )
    transfer = np.zeros((h * w, below.x.size))
    for k in range(below.x.size):
        unit, out = np.zeros(below.x.shape, np.float32), np.zeros(shape, np.float32)
        unit.flat[k] = 1
        edges = np.ones((h, 3, w), np.float32)
        edges[:, :2] = cuts.edges
        for r in range(h):
            cut_multigrid.cut_prolong_row(unit, r, edges, out[r])
        transfer[:, k] = out.ravel()
    x = np.zeros(h * w) if start == "zero" else transfer @ below.x.ravel()
    if start == "add":
        x += level.x.ravel()
    step = np.zeros(h * w)
    for alpha, beta in chebyshev():
        step = alpha * step + beta * (level.right.ravel() - matrix @ x) / matrix.diagonal()
        x = x + step
    wanted = transfer.T @ (level.right.ravel() - matrix @ x)
    hierarchy._sweep(
        0, source=NOTHING if start == "zero" else below.x, adds=start == "add", target=below.right
    )
    np.testing.assert_allclose(level.x.ravel(), x, atol=2e-5)
    np.testing.assert_allclose(below.right.ravel(), wanted, atol=1e-4)


def test_strips_and_files_do_not_change_a_byte(monkeypatch):
    """The same bytes for strips of any height, in RAM and in files, evidence consumed or kept."""
    springs, n = Springs(0.1, 0.001), 130
    points = terrain(n)
    z, _ = solve(evidence_of(points, (n, n), springs), springs)
    whole = z.tobytes()
    for strip in (1, 7 * n, 1 << 20):
        monkeypatch.setattr(system.strips, "__defaults__", (strip,))
        with Scratch(0) as scratch:
            evidence = evidence_of(points, (n, n), springs, scratch)
            z, _ = solve(evidence, springs, consume=True)
            assert z.tobytes() == whole


@pytest.mark.parametrize("shape", [(130, 97), (9, 40), (64, 130)])
@pytest.mark.parametrize("has_cuts", [False, True])
def test_threads_do_not_change_a_byte(shape, has_cuts, monkeypatch):
    """The same bytes for any number of threads, from nothing and from heights."""
    monkeypatch.setattr(walk, "BAND_CELLS", 1)
    springs, rng = Springs(0.1, 0.001), np.random.default_rng(6)
    n = shape[0] * shape[1] // 5
    points = rng.uniform(0, shape[1], n), rng.uniform(0, shape[0], n), rng.normal(size=n)
    cuts = None
    if has_cuts:
        cuts = Cuts.none(*shape)
        cuts.edges[:, 0, 5] = 0
    for start in (None, rng.normal(size=shape)):
        evidence = evidence_of(points, shape, springs)
        whole, info = solve(evidence, springs, start=start, cuts=cuts)
        for threads in (2, 3, 7):
            z, same = solve(evidence, springs, start=start, cuts=cuts, threads=threads)
            assert z.tobytes() == whole.tobytes()
            assert same == info
        monkeypatch.setattr(system.strips, "__defaults__", (3 * shape[1],))
        with Scratch(0) as scratch:  # bands of strips, in files
            filed = evidence_of(points, shape, springs, scratch)
            z, same = solve(filed, springs, start=start, cuts=cuts, threads=3)
            assert z.tobytes() == whole.tobytes()
            assert same == info


def test_memory_is_given_back(monkeypatch):
    """After a solve only the heights are left in the budget."""
    monkeypatch.setattr(walk, "BAND_CELLS", 1)
    springs = Springs(0.1, 0.001)
    for threads in (1, 2):
        scratch = Scratch()
        evidence = evidence_of(terrain(70), (70, 70), springs, scratch)
        z, _ = solve(evidence, springs, consume=True, threads=threads)
        assert scratch.used_bytes == z.nbytes


def test_no_data_gives_zero():
    """Without evidence the surface stays where it is."""
    z, info = solve(Evidence(12, 12), Springs(1.0, 0.1))
    assert not z.any()
    assert info.iterations == 0
    assert info.relative_residual == 0


def test_chebyshev_is_small_on_its_interval():
    """The polynomial of the steps damps what the coarse grid doesn't see, and never grows."""
    from volatool.emap.multigrid import BOTTOM, TOP

    values = np.linspace(0, TOP, 200)
    x, d = np.zeros_like(values), np.zeros_like(values)
    for alpha, beta in chebyshev():
        d = alpha * d + beta * (1 - values * x)
        x = x + d
    error = np.abs(1 - values * x)
    assert error.max() <= 1 + 1e-12
    assert error[values >= BOTTOM].max() < 0.45
