"""Arrays of the wrong width are refused by every query, not read across their rows."""

from __future__ import annotations

import making_volumes as making
import numpy as np
import pytest

from volatool.errors import OptionError
from volatool.vola.rows import rows_of

VOLUME = making.random_volume()
QUERIES = {
    "contains": VOLUME.contains,
    "contains, rounded": making.random_volume(
        info=making.INFO.__class__(quantizer="toolkit")
    ).contains,
    "contains_cells": VOLUME.contains_cells,
    "find": VOLUME.find,
    "cell_indices": VOLUME.cell_indices,
    "neighbours": VOLUME.neighbours,
    "clearance": VOLUME.clearance,
    "ray": lambda rows: VOLUME.ray(rows, np.ones_like(rows)),
    "sight": lambda rows: VOLUME.sight(rows, rows),
}


@pytest.mark.parametrize("name", QUERIES)
def test_pairs_are_not_triples(name):
    """Three pairs are six numbers, and so are two triples."""
    for bad in (np.ones((3, 2)), np.ones((3, 4)), np.ones(6), np.ones((2, 3, 1))):
        with pytest.raises(OptionError, match=r"\(n, 3\) array, not one of shape"):
            QUERIES[name](bad)


def test_places_are_pairs():
    with pytest.raises(
        OptionError, match=r"places are an \(n, 2\) array, not one of shape \(2, 3\)"
    ):
        VOLUME.columns(np.ones((2, 3)))


def test_one_row_many_rows_and_none():
    assert rows_of([1, 2, 3]).tolist() == [[1.0, 2.0, 3.0]]
    assert rows_of(np.zeros((2, 5, 3))).shape == (10, 3)
    assert rows_of([]).shape == rows_of(np.empty((0, 3))).shape == (0, 3)
    with pytest.raises(OptionError, match="shape"):
        rows_of(5.0)
    assert VOLUME.contains([]).shape == (0,)
