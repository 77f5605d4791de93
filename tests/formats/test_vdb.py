"""OpenVDB's file: against a naive reader; the library itself reads exports in tests/export."""

from __future__ import annotations

import uuid

import naive_vdb as naive
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from volatool.errors import OptionError, ResourceError
from volatool.formats.vdb import MAX_SIDE, encode_vdb

ONES = (1.0, 1.0, 1.0)
ZERO = (0.0, 0.0, 0.0)
coordinate = st.one_of(st.integers(0, 20), st.integers(0, MAX_SIDE - 1))


@given(st.lists(st.tuples(coordinate, coordinate, coordinate), max_size=25))
@settings(max_examples=40, deadline=None)
def test_the_voxels_are_those_that_a_naive_reader_finds(cells):
    data = encode_vdb(np.array(cells).reshape(-1, 3), ONES, ZERO)
    _, metadata, _, _, voxels = naive.read(data)
    assert set(voxels) == set(cells)
    assert set(voxels.values()) <= {1.0}
    assert metadata["file_voxel_count"] == (len(set(cells)),)
    if cells:
        assert metadata["file_bbox_min"] == tuple(map(min, zip(*cells, strict=True)))
        assert metadata["file_bbox_max"] == tuple(map(max, zip(*cells, strict=True)))


def test_full_leaves_and_nodes_beside_each_other():
    cells = np.argwhere(np.ones((20, 9, 8))) + np.array([4090, 120, 0])
    assert set(naive.read(encode_vdb(cells, ONES, ZERO))[4]) == set(map(tuple, cells.tolist()))


def test_the_map_holds_scale_and_place():
    data = encode_vdb([[0, 0, 0]], (0.5, 0.5, 0.25), (10.0, 20.0, 1 / 3))
    _, _, kind, numbers, _ = naive.read(data)
    assert kind == "ScaleTranslateMap"
    assert numbers[:6] == (10.0, 20.0, 1 / 3, 0.5, 0.5, 0.25)
    assert numbers[9:] == (2.0, 2.0, 4.0, 4.0, 4.0, 16.0, 1.0, 1.0, 2.0)
    assert naive.read(encode_vdb([[0, 0, 0]], ONES, ZERO))[2] == "UniformScaleTranslateMap"


def test_texts_are_kept_and_the_uuid_is_made_from_the_content():
    first = encode_vdb([[1, 2, 3]], ONES, ZERO, metadata={"crs_wkt": 'PROJCRS["ä"]'})
    told, metadata, *_ = naive.read(first)
    assert metadata["crs_wkt"] == 'PROJCRS["ä"]'
    assert metadata["class"] == "fog volume"
    assert str(uuid.UUID(told)) == told
    assert encode_vdb([[1, 2, 3]], ONES, ZERO, metadata={"crs_wkt": 'PROJCRS["ä"]'}) == first
    assert naive.read(encode_vdb([[1, 2, 4]], ONES, ZERO))[0] != told


@pytest.mark.parametrize("cell", [[-1, 0, 0], [0, MAX_SIDE, 0]])
def test_voxels_outside_are_refused(cell):
    with pytest.raises(ResourceError, match="must be 0 to 1048575") as caught:
        encode_vdb([cell], ONES, ZERO)
    assert caught.value.code == "E_SIZE"


@pytest.mark.parametrize(
    ("scale", "translation"),
    [((0.0, 1.0, 1.0), ZERO), ((1.0, 1.0, -1.0), ZERO), (ONES, (0.0, float("nan"), 0.0))],
)
def test_what_is_no_grid_is_refused(scale, translation):
    with pytest.raises(OptionError, match="no grid"):
        encode_vdb([[0, 0, 0]], scale, translation)
