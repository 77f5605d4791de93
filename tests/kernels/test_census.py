"""The census kernel against plain Python."""

from __future__ import annotations

import numpy as np
import pytest

from volatool.kernels.census import count_points


def naive(xyz, used, codes, numbers, low, edges, shift, shape, n_bins):
    """Count point by point with Python's own integers."""
    counts = {
        "classes": [0] * 256,
        "returns": [0] * 256,
        "heights": [[0] * n_bins, [0] * n_bins],
        "covered": [[False] * shape[1] for _ in range(shape[0])],
        "totals": [0, 0],
    }
    kept = [[], []]
    for i, (x, y, z) in enumerate(xyz.tolist()):
        height = min(max((z - low[2]) >> shift, 0), n_bins - 1)
        counts["heights"][0][height] += 1
        kept[0].append((x, y, z))
        if len(codes):
            counts["classes"][codes[i]] += 1
        if len(numbers):
            counts["returns"][numbers[i]] += 1
        if len(used) and not used[i]:
            continue
        kept[1].append((x, y, z))
        counts["heights"][1][height] += 1
        counts["totals"][0] += 1
        counts["totals"][1] += not len(numbers) or numbers[i] <= 1
        column = min(max((x - low[0]) // edges[0], 0), shape[1] - 1)
        row = min(max((y - low[1]) // edges[1], 0), shape[0] - 1)
        counts["covered"][row][column] = True
    boxes = [[*map(min, *points), *map(max, *points)] for points in kept]
    return counts, boxes


@pytest.mark.parametrize("has_attributes", [True, False])
@pytest.mark.parametrize("spread", [50, 2**31 - 1])
def test_counts_equal_plain_ones(has_attributes, spread):
    """All and used points, points outside the box, cells' edges, the whole range of int32."""
    rng = np.random.default_rng(spread)
    xyz = rng.integers(-spread, spread + 1, (500, 3)).astype(np.int32)
    empty = np.empty(0, np.uint8)
    codes = rng.integers(0, 256, 500).astype(np.uint8) if has_attributes else empty
    numbers = rng.integers(0, 16, 500).astype(np.uint8) if has_attributes else empty
    used = rng.random(500) < 0.5 if has_attributes else np.empty(0, np.bool_)
    low, edges, shift = [-40, -45, -20], [7, 3], 2
    far = np.iinfo(np.int64)
    extremes = np.repeat([[far.max, far.min]] * 2, 3, axis=1)
    found = {
        "classes": np.zeros(256, np.int64),
        "returns": np.zeros(256, np.int64),
        "heights": np.zeros((2, 16), np.int64),
        "covered": np.zeros((11, 13), np.bool_),
        "totals": np.zeros(2, np.int64),
    }
    x, y, z = (np.ascontiguousarray(column) for column in xyz.T)
    count_points(
        x, y, z, used, codes, numbers, np.array(low), np.array(edges), shift, extremes,
        *found.values(),
    )  # fmt: skip
    expected, boxes = naive(xyz, used, codes, numbers, low, edges, shift, (11, 13), 16)
    for name, values in expected.items():
        assert found[name].tolist() == values, name
    assert extremes.tolist() == boxes
