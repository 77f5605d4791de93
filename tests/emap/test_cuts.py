"""Cut springs in depth: naive twins, transfer between grids, exact rings, islands, solves."""

from __future__ import annotations

import naive_cuts
import naive_dem
import numpy as np
import pytest

from volatool.emap import system
from volatool.emap.cuts import Cuts
from volatool.emap.lines import Lines
from volatool.emap.multigrid import Hierarchy
from volatool.emap.solve import solve
from volatool.emap.system import Evidence, Springs, apply
from volatool.errors import OptionError
from volatool.scratch import Scratch

SHAPES = [(2, 2), (2, 7), (7, 2), (3, 3), (9, 6), (12, 17)]


def random_cuts(shape, seed=0, choices=(0.0, 0.3, 1.0, 1.0)):
    cuts = Cuts.none(*shape)
    inner = np.random.default_rng(seed).choice(choices, cuts.edges.shape)
    cuts.edges[:, 0, :-1], cuts.edges[:-1, 1] = inner[:, 0, :-1], inner[:-1, 1]
    return cuts


def scatter(shape, n, seed=0):
    rng = np.random.default_rng(seed)
    return rng.uniform(0, shape[1], n), rng.uniform(0, shape[0], n), rng.normal(size=n)


def polyline(*corners, closed=False):
    places = np.array([*corners, *corners[: 1 if closed else 0]], float)
    return np.hstack([places[:-1], places[1:]])


def hills(n, density=0.3, seed=0):
    rng = np.random.default_rng(seed)
    col, row = rng.uniform(1, n - 1, (2, int(n * n * density)))
    return col, row, 10 * np.sin(col / 23) * np.cos(row / 31) + rng.normal(0, 0.05, len(col))


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("springs", [Springs(1.3, 0.2), Springs(0, 1), Springs(1, 0)])
def test_operator_equals_the_assembled_matrix(shape, springs):
    """Matrix-free equals the sparse sum over the springs left to 1e-12, diagonal included."""
    from volatool.kernels import cut_spring

    cuts = random_cuts(shape)
    matrix = naive_cuts.surface_matrix(springs.kb, springs.km, cuts.edges)
    z = np.random.default_rng(1).normal(size=shape)
    product = apply(np.zeros((shape[0], 5, shape[1])), z, springs, cuts)
    np.testing.assert_allclose(product.ravel(), matrix @ z.ravel(), rtol=1e-12, atol=1e-12)
    edges = np.zeros((shape[0], 3, shape[1]), np.float32)
    edges[:, :2] = cuts.edges
    cut_spring.cut_stiffness(edges, springs.kb, springs.km, 0, shape[0])
    np.testing.assert_allclose(edges[:, 2].ravel(), matrix.diagonal(), rtol=1e-6, atol=1e-6)


def test_operator_is_symmetric():
    """|u . H v - v . H u| < 1e-9 relative."""
    shape, springs = (40, 33), Springs(3.0, 0.1)
    cuts = random_cuts(shape)
    evidence = Evidence(*shape)
    evidence.add(*scatter(shape, 500), springs)
    u, v = np.random.default_rng(2).normal(size=(2, *shape))
    a = np.sum(u * apply(evidence.data, v, springs, cuts))
    b = np.sum(v * apply(evidence.data, u, springs, cuts))
    assert abs(a - b) < 1e-9 * abs(a)


def test_whole_edges_change_nothing():
    """Cuts without a cut give the same product to rounding, and the same surface."""
    shape, springs = (40, 33), Springs(0.3, 0.01)
    evidence = Evidence(*shape)
    evidence.add(*scatter(shape, 300), springs)
    cuts = Cuts.none(*shape)
    z = np.random.default_rng(0).normal(size=shape)
    plain, cut = (apply(evidence.data, z, springs, c) for c in (None, cuts))
    np.testing.assert_allclose(plain, cut, atol=1e-12)
    (z0, i0), (z1, i1) = (solve(evidence, springs, cuts=c, tol=1e-9) for c in (None, cuts))
    assert abs(i0.iterations - i1.iterations) <= 1
    np.testing.assert_allclose(z0, z1, atol=1e-8)


@pytest.mark.parametrize("shape", [(10, 11), (13, 2), (2, 12), (17, 18)])
def test_transfer_and_coarse_data(shape):
    """Restriction is the transpose of interpolation; coarse data are the Galerkin product."""
    from volatool.kernels import cut_multigrid, multigrid

    h, w = shape
    m, n = h // 2 + 1, w // 2 + 1
    edges = np.ones((h, 3, w), np.float32)
    edges[:, :2] = random_cuts(shape, 4).edges
    transfer = np.zeros((h * w, m * n))
    for k in range(m * n):
        unit, out = np.zeros((m, n), np.float32), np.zeros(shape, np.float32)
        unit.flat[k] = 1
        for r in range(h):
            cut_multigrid.cut_prolong_row(unit, r, edges, out[r])
        transfer[:, k] = out.ravel()
    total = transfer.sum(axis=1)
    np.testing.assert_allclose(total[total > 0.5], 1, atol=1e-6)
    assert (np.abs(total) < 1e-6).sum() + (total > 0.5).sum() == h * w
    force = np.random.default_rng(0).normal(size=shape).astype(np.float32)
    coarse = np.full((m, n), 7, np.float32)
    multigrid.restrict_rows(force, coarse, 0, h, edges)
    np.testing.assert_allclose(coarse.ravel(), transfer.T @ force.ravel(), atol=1e-5)
    evidence = Evidence(*shape)
    evidence.add(*scatter(shape, 60), Springs(1, 1))
    data = np.zeros((m, 5, n), np.float32)
    whole = np.ones((m, 3, n), np.float32)  # nothing leaks where the coarse edges are whole
    fine = evidence.data.astype(np.float32)
    cut_multigrid.cut_coarsen_data(fine, edges, whole, np.float32(0), data, 0, h)
    wanted = transfer.T @ naive_dem.dense_stencil(evidence.data) @ transfer
    np.testing.assert_allclose(naive_dem.dense_stencil(data), wanted, atol=1e-5)
    plain = np.kron(naive_dem.prolongation(h), naive_dem.prolongation(w))
    edges[:] = 1
    for k in range(m * n):
        unit, out = np.zeros((m, n), np.float32), np.zeros(shape, np.float32)
        unit.flat[k] = 1
        for r in range(h):
            cut_multigrid.cut_prolong_row(unit, r, edges, out[r])
        np.testing.assert_array_equal(out.ravel(), plain[:, k])


@pytest.mark.parametrize("n", [14, 40])
def test_preconditioner_is_symmetric(n):
    """The V-cycle across lines is symmetric to float32 rounding, and positive."""
    springs = Springs(0.4, 0.02)
    lines = Lines.place(polyline((-1, 3), (n, n - 2)), (n, n))
    evidence = Evidence(n, n)
    evidence.add(*hills(n, 1.0), springs, lines=lines)
    hierarchy = Hierarchy(evidence, springs, Scratch(), Cuts.along(lines))
    rng = np.random.default_rng(0)

    def cycle(force):
        hierarchy.levels[0].right[:] = force
        hierarchy.cycle()
        return hierarchy.levels[0].x.astype(float)

    u, v = rng.normal(size=(2, n, n)).astype(np.float32)
    a, b = np.sum(v * cycle(u)), np.sum(u * cycle(v))
    assert abs(a - b) < 1e-4 * np.sqrt(np.sum(u * cycle(u)) * np.sum(v * cycle(v)))
    assert np.sum(u * cycle(u)) > 0


@pytest.mark.parametrize("springs", [Springs(0.3, 0.01), Springs(0.0, 0.1)])
def test_solution_equals_the_dense_one(springs):
    """Heights with random weaker springs, and along lines, equal those of a dense solve."""
    shape = (22, 25)
    points = scatter(shape, 200)
    lines = Lines.place(polyline((-1, 4.2), (12.1, 9.3), (26, 8)), shape)
    for cuts in (random_cuts(shape, 1, (0.05, 0.5, 1.0)), Cuts.along(lines)):
        evidence = Evidence(*shape)
        evidence.add(*points, springs, lines=cuts.lines)
        matrix = naive_cuts.surface_matrix(springs.kb, springs.km, cuts.edges).toarray()
        matrix += naive_dem.dense_stencil(evidence.data)
        z, info = solve(evidence, springs, tol=1e-9, cuts=cuts)
        assert info.converged
        wanted = np.linalg.solve(matrix, evidence.right.ravel())
        np.testing.assert_allclose(z.ravel(), wanted, atol=1e-7)


def test_a_step_stays_sharp():
    """Two planes at a line: each node is on its own plane, also with points close to the line."""
    n, springs = 60, Springs(0.2, 0.0)
    rng = np.random.default_rng(0)
    col, row = rng.uniform(0, n, (2, 6000))
    a, b = np.array([10.25, -1.0]), np.array([47.125, 61.0])
    turn = (b[0] - a[0]) * (row - a[1]) - (b[1] - a[1]) * (col - a[0])
    keep = np.abs(turn) > 0.1  # what is nearer is on the line as far as 1/4096 cell goes
    col, row, turn = col[keep], row[keep], turn[keep]
    heights = np.where(turn > 0, 5.0, 1.0)
    lines = Lines.place(polyline(a, b), (n, n))
    evidence = Evidence(n, n)
    evidence.add(col, row, heights, springs, lines=lines)
    z, _ = solve(evidence, springs, cuts=Cuts.along(lines), tol=1e-8)
    r, q = np.mgrid[:n, :n] + 0.5
    turn = (b[0] - a[0]) * (r - a[1]) - (b[1] - a[1]) * (q - a[0])
    wrong = np.abs(z - np.where(turn > 0, 5.0, 1.0)) > 1e-6
    assert not wrong.any(), np.argwhere(wrong)
    fit = np.empty(len(col))
    from volatool.kernels.lines import cut_interpolate

    cut_interpolate(z, col, row, False, 0, n, *lines.tables, fit)
    assert np.nanmax(np.abs(fit - heights)) < 1e-6


def test_iterations_with_long_break_lines():
    """Some thrice as many iterations as without lines, and hardly more on a larger grid."""
    springs, counts = Springs(0.1, 0.001), {}
    for n in (129, 513):
        ends = np.vstack(
            [polyline((0.1 * n * k, -1), (0.1 * n * k + 0.3 * n, n)) for k in range(8)]
        )
        lines = Lines.place(ends, (n, n))
        evidence = Evidence(n, n)
        evidence.add(*hills(n), springs, lines=lines)
        _, info = solve(evidence, springs, cuts=Cuts.along(lines))
        assert info.converged
        counts[n] = info.iterations
    assert max(counts.values()) <= 25
    assert counts[513] <= 1.5 * counts[129]


def test_rings_close_exactly():
    """Rings with corners and sides on nodes cut every way out; the inside is what they fill."""
    from volatool.kernels import lines as kernels

    rng = np.random.default_rng(0)
    for trial in range(60):
        step = 2048 if trial % 2 else 1000
        corners = [tuple(map(int, c)) for c in rng.integers(-2, 30, (6, 2)) * step]
        places = np.array([*corners, corners[0]], np.int64)
        segments = np.hstack([places[:-1], places[1:]])
        shape = (12, 14)
        edges = np.ones((shape[0], 2, shape[1]), np.float32)
        kernels.cut_edges(segments, edges)
        labels = np.zeros(shape, np.int32)
        n = kernels.fill_rings(segments, 0, 0, 7, labels)
        assert n == np.count_nonzero(labels == 7)
        parts = naive_cuts.parts(edges)
        for part in np.unique(parts):
            assert len(np.unique(labels[parts == part])) == 1
        for r, q in np.ndindex(shape):
            # the ring moves by a vanishing step right and less down: the node left and up
            x, y = q * 4096 + 2048 - naive_cuts.Fraction(1, 10**6), r * 4096 + 2048
            y -= naive_cuts.Fraction(1, 10**20)
            assert naive_cuts.is_inside(corners, x, y) == (labels[r, q] == 7)
        part = np.zeros((5, 6), np.int32)
        kernels.fill_rings(segments, 3, 4, 7, part)
        np.testing.assert_array_equal(part, labels[3:8, 4:10])


def test_islands_are_found_and_stay_put():
    """Parts without a point: found as flooding finds them, zero after a solve, never NaN."""
    shape, springs = (30, 37), Springs(0.1, 0.001)
    cuts = random_cuts(shape, 3, (0.0, 1.0))
    evidence = Evidence(*shape)
    evidence.add(*scatter(shape, 25), springs)
    islands = cuts.islands(evidence)
    parts = naive_cuts.parts(cuts.edges)
    held = np.unique(parts[evidence.data[:, 0] > 0])
    np.testing.assert_array_equal(islands, ~np.isin(parts, held))
    assert 0 < islands.sum() < islands.size
    ring = polyline((10, 10), (20, 10), (20, 20), (10, 20), closed=True)
    lines = Lines.place(ring, (31, 33))
    cuts = Cuts.along(lines)
    assert cuts.count() == 40
    evidence = Evidence(31, 33)
    col, row, heights = scatter((31, 33), 300)
    keep = ~((col > 9) & (col < 21) & (row > 9) & (row < 21))
    evidence.add(col[keep], row[keep], heights[keep] + 9, springs, lines=lines)
    z, info = solve(evidence, springs, cuts=cuts)
    assert info.converged
    islands = cuts.islands(evidence)
    assert islands.sum() == 100
    assert not z[islands].any()
    assert np.isfinite(z).all()


def test_strips_and_files_do_not_change_a_byte(monkeypatch):
    """The same bytes with lines for strips of any height, in RAM and in files."""
    springs, n = Springs(0.1, 0.001), 70
    points, ends = hills(n), polyline((-1, 3.3), (40, 50.2), (71, 20))

    def surface(scratch=None):
        lines = Lines.place(ends, (n, n), scratch)
        cuts = Cuts.along(lines)
        evidence = Evidence(n, n, scratch)
        for window in system.strips(n, n, 7 * n):
            evidence.add(*points, springs, window, lines=lines)
        islands = cuts.islands(evidence).tobytes()
        z, _ = solve(evidence, springs, cuts=cuts, consume=True)
        return z.tobytes(), islands

    whole = surface()
    for strip in (1, 7 * n, 1 << 20):
        monkeypatch.setattr(system.strips, "__defaults__", (strip,))
        with Scratch(0) as scratch:
            assert surface(scratch) == whole


def test_memory_is_given_back():
    """After a solve only the heights are left in the budget."""
    scratch, springs, n = Scratch(), Springs(0.1, 0.001), 70
    cuts = Cuts.along(Lines.place(polyline((-1, 3.3), (71, 20)), (n, n), scratch))
    evidence = Evidence(n, n, scratch)
    evidence.add(*hills(n), springs, lines=cuts.lines)
    scratch.free(cuts.islands(evidence))
    z, _ = solve(evidence, springs, cuts=cuts, consume=True)
    cuts.free()
    assert scratch.used_bytes == z.nbytes


def test_cuts_of_another_shape_are_refused():
    with pytest.raises(OptionError, match="cuts need"):
        Cuts(np.ones((4, 4), np.float32))


def test_nothing_passes_a_line():
    """A step along a line: each side is the surface of its own points alone."""
    springs = Springs(0.7, 0.05)
    rng = np.random.default_rng(2)
    n = 40
    col, row = rng.uniform(0, n, (2, 500))
    ends = np.array([[17.3, -2.0, 23.9, n + 2.0]])
    lines = Lines.place(ends, (n, n))
    cuts = Cuts.along(lines)
    right = col > 17.3 + (row + 2) / (n + 4) * 6.6
    heights = np.where(right, 10.0, 0.0) + np.sin(col / 5)

    def surface(of):
        evidence = Evidence(n, n)
        evidence.add(col[of], row[of], heights[of], springs, lines=lines)
        evidence.data[:, 0] += 1e-9  # the empty side has no point
        z, info = solve(evidence, springs, tol=1e-8, cuts=cuts)
        assert info.converged
        return z

    z = surface(np.ones(500, bool))
    x, y = np.meshgrid(np.arange(n) + 0.5, np.arange(n) + 0.5)
    east = x > 17.3 + (y + 2) / (n + 4) * 6.6
    np.testing.assert_allclose(z[east], surface(right)[east], atol=1e-5)
    np.testing.assert_allclose(z[~east], surface(~right)[~east], atol=1e-5)
    assert z[east].min() > 8
    assert z[~east].max() < 2
    # without the line the step is smeared over its neighbours
    evidence = Evidence(n, n)
    evidence.add(col, row, heights, springs)
    smooth, _ = solve(evidence, springs, tol=1e-8)
    assert np.abs(smooth - z).max() > 1


def test_edges_are_cut_where_segments_cross_them():
    """Against the sign of the determinant for each edge; nodes that a line meets are decided."""
    rng = np.random.default_rng(3)
    ends = np.concatenate([rng.uniform(-3, 15, (12, 4)), [[2.5, -1, 2.5, 20], [-1, 4.5, 20, 4.5]]])
    cuts = Cuts.along(Lines.place(ends, (12, 11)))
    for r in range(12):
        for q in range(11):
            for side, (dr, dq) in enumerate(((0, 1), (1, 0))):
                if r + dr >= 12 or q + dq >= 11:
                    continue
                start, stop = (q + 0.5, r + 0.5), (q + dq + 0.5, r + dr + 0.5)
                # the rule for ties: lines lie a hair to the right and less far down
                moved = ends + np.tile([1e-7, 1e-9], 2)
                wanted = any(crosses(line, start, stop) for line in moved)
                assert (cuts.edges[r, side, q] == 0) == wanted


def crosses(line, start, stop):
    def turn(a, b, c):
        return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])

    a, b = line[:2], line[2:]
    return (
        turn(a, b, start) * turn(a, b, stop) < 0 and turn(start, stop, a) * turn(start, stop, b) < 0
    )
