"""The boundary: each face once, by a naive twin; volume, area, closedness and colours."""

from __future__ import annotations

from collections import Counter

import naive_faces as naive
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from volatool.errors import ResourceError
from volatool.vola.faces import boundary, shared_corners

cell_sets = st.sets(st.tuples(*[st.integers(0, 4)] * 3), min_size=1, max_size=90)


def array(cells):
    return np.array(sorted(cells), np.int32).reshape(-1, 3)


def volume_of(corners):
    """By the divergence theorem."""
    q = corners.astype(np.float64)
    normal = np.cross(q[:, 1] - q[:, 0], q[:, 2] - q[:, 0])
    return (q[:, 0] * normal).sum() / 3


@given(cell_sets)
@settings(max_examples=60, deadline=None)
def test_every_face_of_the_boundary_is_covered_once(cells):
    faces = boundary(array(cells))
    covered = naive.covered(faces.corners)
    assert len(covered) == len(set(covered))
    assert set(covered) == naive.boundary(cells)
    assert volume_of(faces.corners) == pytest.approx(len(cells))


@given(cell_sets, st.data())
@settings(max_examples=60, deadline=None)
def test_only_equal_labels_are_joined_and_each_face_has_its_own(cells, data):
    rows = array(cells)
    labels = np.array(
        data.draw(st.lists(st.integers(0, 2), min_size=len(rows), max_size=len(rows)))
    )
    faces = boundary(rows, labels)
    label_of = dict(zip(map(tuple, rows.tolist()), labels.tolist(), strict=True))
    n_covered = 0
    for corners, cell in zip(faces.corners, faces.cells, strict=True):
        covered = naive.covered(corners[None])
        n_covered += len(covered)
        assert {label_of[face[2]] for face in covered} == {labels[cell]}
    assert n_covered == len(naive.boundary(cells))


@given(cell_sets)
@settings(max_examples=30, deadline=None)
def test_the_surface_is_closed(cells):
    """Each unit piece of an edge is run through as often one way as the other."""
    runs: Counter = Counter()
    for quad in boundary(array(cells)).corners.tolist():
        for p, q in zip(quad, quad[1:] + quad[:1], strict=True):
            axis = next(k for k in range(3) if p[k] != q[k])
            sign = 1 if q[axis] > p[axis] else -1
            for place in range(min(p[axis], q[axis]), max(p[axis], q[axis])):
                piece = tuple(place if k == axis else p[k] for k in range(3))
                runs[axis, piece] += sign
    assert not any(runs.values())


def test_a_box_has_six_rectangles():
    faces = boundary(np.argwhere(np.ones((5, 3, 2))).astype(np.int32) + np.int32(7))
    assert len(faces) == 6
    assert volume_of(faces.corners) == 30
    points, indices, _ = shared_corners(faces.corners)
    assert len(points) == 8
    np.testing.assert_array_equal(points[indices], faces.corners)


def test_real_shapes_become_few_rectangles():
    """A wall with a window: four pieces around it on each side, not one for each face."""
    wall = np.ones((1, 20, 20), bool)
    wall[0, 5:10, 5:10] = False
    faces = boundary(np.argwhere(wall).astype(np.int32))
    assert len(faces) == 4 + 4 + 4 + 4
    assert volume_of(faces.corners) == 375


def test_both_ends_of_the_space_are_kept():
    last = 2**20 - 1
    for cells in ([[0, 0, 0], [0, 0, last], [0, 1, 0]], [[last] * 3, [last, last, 0]]):
        rows = np.array(cells, np.int32)
        faces = boundary(rows)
        assert set(naive.covered(faces.corners)) == naive.boundary(cells)


@pytest.mark.parametrize("cell", [[0, 0, 2**20], [-1, 0, 0]])
def test_cells_outside_the_space_are_refused(cell):
    with pytest.raises(ResourceError, match="coarser level") as caught:
        boundary(np.array([cell], np.int32))
    assert caught.value.code == "E_SIZE"


def test_no_cells_have_no_boundary():
    faces = boundary(np.empty((0, 3), np.int32))
    assert len(faces) == 0
    assert shared_corners(faces.corners)[1].shape == (0, 4)


def test_corners_are_shared_among_rectangles_of_a_label_only():
    rows = np.array([[0, 0, 0], [1, 0, 0]], np.int32)
    labels = np.array([4, 9])
    faces = boundary(rows, labels)
    assert len(faces) == 10
    points, indices, firsts = shared_corners(faces.corners, labels[faces.cells])
    assert len(points) == 16
    np.testing.assert_array_equal(points[indices], faces.corners)
    owner = labels[faces.cells][firsts]
    for quad, label in zip(indices, labels[faces.cells], strict=True):
        assert (owner[quad] == label).all()
    assert len(shared_corners(faces.corners)[0]) == 12
