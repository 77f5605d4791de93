"""Points that are put by."""

import numpy as np
import pytest

from volatool.errors import ResourceError
from volatool.model import PointChunk
from volatool.scratch import Scratch
from volatool.vola.held import HeldPoints


def chunks(seed=0):
    rng = np.random.default_rng(seed)
    for start, n in ((0, 40), (40, 1), (41, 300), (341, 7)):
        x, y, z = rng.integers(-(2**31), 2**31, (3, n)).astype(np.int32)
        attributes = {
            "intensity": rng.integers(0, 65536, n).astype(np.uint16),
            "classification": rng.integers(0, 256, n).astype(np.uint8),
            "withheld": np.zeros(n, np.bool_),
        }
        yield PointChunk(start, x, y, z, (0.01, 0.01, start + 1.0), (0.0, 1.0, 2.0), attributes)


@pytest.mark.parametrize("budget", [None, 0, 2000, 10**6])
def test_points_come_back_in_order_wherever_they_were(budget):
    scratch = Scratch(budget)
    held = HeldPoints(scratch, 0.5, ["intensity", "classification"])
    for chunk in chunks():
        held.add(chunk)
    assert len(held) == 348
    assert (scratch.spilled_bytes > 0) == (budget in (0, 2000))
    back = list(held.taken())
    assert len(held) == 0 == scratch.used_bytes
    assert list(held.taken()) == []
    for one, other in zip(chunks(), back, strict=True):
        assert (one.start, one.scale, one.offset) == (other.start, other.scale, other.offset)
        assert sorted(other.attributes) == ["classification", "intensity"]
        for axis in "xyz":
            assert np.array_equal(getattr(one, axis), getattr(other, axis))
        for name, values in other.attributes.items():
            assert values.dtype == one.attributes[name].dtype
            assert np.array_equal(values, one.attributes[name])


def test_what_is_held_is_a_copy():
    held = HeldPoints(Scratch(), 1.0, [])
    chunk = next(chunks())
    before = chunk.x.copy()
    held.add(chunk)
    chunk.x[:] = 0
    assert np.array_equal(next(held.taken()).x, before)


def test_without_a_folder_for_files_it_says_what_to_do(tmp_path):
    held = HeldPoints(Scratch(0, tmp_path / "gone"), 1.0, [])
    with pytest.raises(ResourceError, match="TMPDIR"):
        held.add(next(chunks()))
