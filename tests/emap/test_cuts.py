"""Springs that are cut: the operator, the solve, and what a point sees across a line."""

from __future__ import annotations

import naive_dem
import numpy as np
import pytest
from scipy import sparse

from volatool.emap.cuts import Cuts
from volatool.emap.lines import Lines
from volatool.emap.multigrid import Hierarchy
from volatool.emap.solve import solve
from volatool.emap.system import Evidence, Springs, apply
from volatool.scratch import Scratch

SPRINGS = Springs(0.7, 0.05)


def random_cuts(shape, rng, part=0.3):
    """Factors of which a part is 0 and a part between."""
    cuts = Cuts.none(*shape)
    factors = rng.random(cuts.edges.shape).astype(np.float32)
    factors[rng.random(factors.shape) < part] = 0.0
    factors[:, 0, -1] = factors[-1, 1, :] = 1.0  # edges that would leave the grid
    cuts.edges[:] = np.where(rng.random(factors.shape) < part, 1.0, factors)
    cuts.edges[:, 0, -1] = cuts.edges[-1, 1, :] = 1.0
    return cuts


def surface_matrix(edges, kb, km):
    """Sparse stiffness, a row of second or first differences for each spring that is left."""
    h, _, w = edges.shape
    rows = []

    def add(stiffness, *terms):
        if stiffness > 0:
            row = np.zeros(h * w)
            for r, q, value in terms:
                row[r * w + q] += value
            rows.append(np.sqrt(stiffness) * row)

    east, south = edges[:, 0].astype(float), edges[:, 1].astype(float)
    for r in range(h):
        for q in range(w):
            if q + 1 < w:
                add(km * east[r, q], (r, q, 1), (r, q + 1, -1))
            if r + 1 < h:
                add(km * south[r, q], (r, q, 1), (r + 1, q, -1))
            if 0 < q < w - 1:
                factor = min(east[r, q - 1], east[r, q])
                add(kb * factor, (r, q - 1, 1), (r, q, -2), (r, q + 1, 1))
            if 0 < r < h - 1:
                factor = min(south[r - 1, q], south[r, q])
                add(kb * factor, (r - 1, q, 1), (r, q, -2), (r + 1, q, 1))
            if q + 1 < w and r + 1 < h:
                factor = min(east[r, q], east[r + 1, q], south[r, q], south[r, q + 1])
                around = (r, q, 1), (r, q + 1, -1), (r + 1, q, -1), (r + 1, q + 1, 1)
                add(2 * kb * factor, *around)
    b = sparse.csr_array(np.array(rows))
    return (b.T @ b).tocsr()


def random_evidence(shape, rng, n=60, lines=None, springs=SPRINGS):
    evidence = Evidence(*shape)
    col, row = rng.uniform(0, shape[1], n), rng.uniform(0, shape[0], n)
    evidence.add(col, row, rng.normal(size=n), springs, lines=lines)
    return evidence


@pytest.mark.parametrize("shape", [(9, 7), (2, 6), (6, 2), (13, 14)])
def test_operator_equals_the_assembled_one_and_is_symmetric(shape):
    """To 1e-12 of the product's size; u . H v = v . H u."""
    rng = np.random.default_rng(4)
    cuts = random_cuts(shape, rng)
    evidence = random_evidence(shape, rng)
    matrix = surface_matrix(cuts.edges, SPRINGS.kb, SPRINGS.km)
    matrix = matrix + sparse.csr_array(naive_dem.dense_stencil(evidence.data))
    u, v = rng.normal(size=(2, *shape))
    found = apply(evidence.data, u, SPRINGS, cuts)
    wanted = (matrix @ u.ravel()).reshape(shape)
    assert np.abs(found - wanted).max() < 1e-12 * np.abs(wanted).max()
    across = np.sum(v * found), np.sum(u * apply(evidence.data, v, SPRINGS, cuts))
    assert abs(across[0] - across[1]) < 1e-9 * abs(across[0])


def test_whole_springs_are_the_plain_operator():
    rng = np.random.default_rng(0)
    evidence, u = random_evidence((20, 17), rng), rng.normal(size=(20, 17))
    plain, cut = (apply(evidence.data, u, SPRINGS, cuts) for cuts in (None, Cuts.none(20, 17)))
    np.testing.assert_allclose(cut, plain, rtol=0, atol=1e-12)


@pytest.mark.parametrize("n", [33, 46])
def test_preconditioner_with_cuts_is_symmetric(n):
    """The V-cycle is a symmetric operator to float32 rounding, and positive."""
    rng = np.random.default_rng(1)
    cuts = Cuts.along(Lines.place(np.array([[3.2, -1.0, 0.7 * n, n + 1.0]]), (n, n)))
    hierarchy = Hierarchy(random_evidence((n, n), rng, n * n), SPRINGS, Scratch(), cuts)

    def cycle(force):
        hierarchy.levels[0].right[:] = force
        hierarchy.cycle()
        return hierarchy.levels[0].x.astype(float)

    u, v = rng.normal(size=(2, n, n)).astype(np.float32)
    a, b = np.sum(v * cycle(u)), np.sum(u * cycle(v))
    assert abs(a - b) < 1e-4 * np.sqrt(np.sum(u * cycle(u)) * np.sum(v * cycle(v)))
    assert np.sum(u * cycle(u)) > 0


def test_nothing_passes_a_line():
    """A step along a line: each side is the surface of its own points alone."""
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
        evidence.add(col[of], row[of], heights[of], SPRINGS, lines=lines)
        evidence.data[:, 0] += 1e-9  # the empty side has no point
        z, info = solve(evidence, SPRINGS, tol=1e-8, cuts=cuts)
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
    evidence.add(col, row, heights, SPRINGS)
    smooth, _ = solve(evidence, SPRINGS, tol=1e-8)
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


def test_islands_are_the_parts_without_points():
    """A ring round nothing, a ring round a point."""
    rings = []
    for left in (3.2, 13.2):
        x = np.array([left, left + 6, left + 6, left, left])
        y = np.array([3.2, 3.2, 9.2, 9.2, 3.2])
        rings.append(np.column_stack([x[:-1], y[:-1], x[1:], y[1:]]))
    lines = Lines.place(np.concatenate(rings), (13, 23))
    cuts = Cuts.along(lines)
    evidence = Evidence(13, 23)
    col, row = np.array([1.0, 22.0, 11.0, 16.5]), np.array([1.0, 12.0, 6.0, 6.5])
    evidence.add(col, row, np.zeros(4), SPRINGS, lines=lines)
    islands = cuts.islands(evidence)
    assert islands.sum() == 36
    assert islands[3:9, 3:9].all()


def test_long_lines_are_solved_to_the_tolerance():
    """Eight lines right across the grid: more iterations, but not many, and the error told."""
    rng = np.random.default_rng(7)
    n = 257
    col, row = rng.uniform(0, n, (2, n * n // 4))
    ends = np.column_stack([rng.uniform(0, n, 8), np.full(8, -2.0)] * 2)
    ends[:, 2:] = np.column_stack([rng.uniform(0, n, 8), np.full(8, n + 2.0)])
    lines = Lines.place(ends, (n, n))
    heights = np.sin(col / 20) + 5 * (col > n / 2)

    def evidence(of=None):
        made = Evidence(n, n)
        made.add(col, row, heights, SPRINGS, lines=of)
        return made

    _, plain = solve(evidence(), SPRINGS)
    z, cut = solve(evidence(lines), SPRINGS, cuts=Cuts.along(lines))
    exact, _ = solve(evidence(lines), SPRINGS, cuts=Cuts.along(lines), tol=1e-8)
    assert plain.iterations < cut.iterations <= 35
    assert cut.converged
    assert np.abs(z - exact).max() < 5e-4
