"""Random surfaces scatter as the dense inverse says, whatever the windows."""

from __future__ import annotations

import naive_dem
import numpy as np
import pytest

from volatool.emap.system import Evidence, Springs
from volatool.emap.uncertainty import Origin, samples
from volatool.errors import OptionError
from volatool.scratch import Scratch

SHAPE = (26, 30)


def some_points(n=160, seed=0):
    """Return places with a gap and their stored integers."""
    rng = np.random.default_rng(seed)
    col, row = rng.uniform(0, SHAPE[1], n), rng.uniform(0, SHAPE[0], n)
    keep = (abs(col - 18) > 5) | (abs(row - 13) > 5)
    rows = np.column_stack([1000 * col, 1000 * row, np.zeros(n)]).astype(np.int32)
    return rows[keep], col[keep], row[keep]


def evidence_of(col, row, springs, scratch=None):
    evidence = Evidence(*SHAPE, scratch)
    for first, last in evidence.windows():
        evidence.add(col, row, np.zeros(len(col)), springs, (first, last))
    return evidence


def exact(col, row, springs):
    """Dense inverse of H."""
    data, _ = naive_dem.data_matrix(col, row, np.zeros(len(col)), springs.weight, SHAPE)
    return np.linalg.inv(naive_dem.surface_matrix(*SHAPE, springs.kb, springs.km) + data)


@pytest.mark.parametrize(
    "springs", [Springs(0.5, 0.02), Springs(0.0, 0.1), Springs(5.0, 1e-4, 2.0)], ids=str
)
def test_standard_errors_equal_the_dense_inverse(springs):
    """32 samples: within 15 % rms of the exact standard error, and not biased."""
    rows, col, row = some_points()
    evidence = evidence_of(col, row, springs)
    squares = np.zeros(SHAPE)
    for z in samples(evidence, springs, lambda: [(rows, col, row)]):
        squares += z**2
    found = np.sqrt(squares / 32).ravel()
    ratio = found / np.sqrt(np.diag(exact(col, row, springs)))
    assert np.sqrt(np.mean((ratio - 1) ** 2)) < 0.15
    assert abs(ratio.mean() - 1) < 0.05


def test_the_covariance_between_nodes_is_right_too():
    """Products of neighbours, over the grid: what reading between nodes needs."""
    springs = Springs(0.5, 0.02)
    rows, col, row = some_points()
    evidence = evidence_of(col, row, springs)
    products = sum(
        z[:, :-1] * z[:, 1:] for z in samples(evidence, springs, lambda: [(rows, col, row)], 64)
    )
    inverse = exact(col, row, springs).reshape(*SHAPE, *SHAPE)
    wanted = [inverse[r, q, r, q + 1] for r in range(SHAPE[0]) for q in range(SHAPE[1] - 1)]
    assert np.mean(products / 64) == pytest.approx(np.mean(wanted), rel=0.1)


def test_windows_chunks_and_files_do_not_change_a_byte():
    """Point by point and in files: the same surfaces."""
    springs = Springs(0.5, 0.02)
    rows, col, row = some_points()

    def whole():
        return [(rows, col, row)]

    def parts():
        return [(rows[k : k + 7], col[k : k + 7], row[k : k + 7]) for k in range(0, len(col), 7)]

    found = []
    for scratch, places in ((Scratch(), whole), (Scratch(), parts), (Scratch(0), parts)):
        evidence = evidence_of(col, row, springs, scratch)
        found.append([z.tobytes() for z in samples(evidence, springs, places, 10)])
    assert found[0] == found[1] == found[2]


def test_signs_belong_to_absolute_nodes():
    """Forces on surface springs inside two overlapping grids agree."""
    from volatool.kernels import chance

    wide = np.zeros((12, 14, 3), np.float32)
    chance.surface_forces(0.5, 0.1, 5, -3, 0, 0, 12, wide)
    part = np.zeros((8, 9, 3), np.float32)
    chance.surface_forces(0.5, 0.1, 7, 0, 0, 0, 8, part)
    np.testing.assert_array_equal(wide[4:8, 5:10], part[2:6, 2:7])
    assert len(np.unique(wide)) > 100
    springs, (rows, col, row) = Springs(0.5, 0.02), some_points()
    evidence = evidence_of(col, row, springs)
    one, other = (
        next(samples(evidence, springs, lambda: [(rows, col, row)], 1, origin=origin)).copy()
        for origin in (Origin(), Origin(5, 7))
    )
    assert not np.array_equal(one, other)


def test_points_that_are_equal_have_equal_signs():
    """A copy of a point is no new measurement: the hash tells by the stored integers."""
    from volatool.kernels import chance

    rows = np.array([[1, 2, 3], [1, 2, 3], [1, 2, 4], [-1, 2, 3]], np.int32)
    bits = np.empty(4, np.uint64)
    chance.hash_rows(rows, 0, bits)
    assert bits[0] == bits[1]
    assert len(set(bits.tolist())) == 3


def test_the_number_of_samples_has_bounds():
    """64 signs are in a hash."""
    springs, (rows, col, row) = Springs(0.5, 0.02), some_points()
    with pytest.raises(OptionError, match="1 to 64"):
        next(samples(evidence_of(col, row, springs), springs, lambda: [(rows, col, row)], 65))
