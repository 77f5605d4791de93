"""Chunks of a COPC file that lie outside a rectangle are not decoded, and no point is missed."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from volatool.points.copc import chunks_outside
from volatool.points.laz import LazPoints
from volatool.points.reader import open_points


def inside(chunks, box):
    """Number and stored x, y, z of the points in a rectangle, in file order."""
    rows = []
    for chunk in chunks:
        xyz = chunk.xyz()
        keep = (xyz[:, 0] >= box[0]) & (xyz[:, 0] <= box[2])
        keep &= (xyz[:, 1] >= box[1]) & (xyz[:, 1] <= box[3])
        number = chunk.start + np.arange(len(chunk))
        rows.append(np.column_stack([number, chunk.x, chunk.y, chunk.z])[keep])
    return np.concatenate([np.empty((0, 4), np.int64), *rows])


@pytest.mark.shared
@pytest.mark.parametrize("name", ["tiles/lone-star.copc.laz", "odd/simple_with_page.copc.laz"])
@pytest.mark.parametrize("part", [(0, 0, 0.1, 1), (0.4, 0.4, 0.5, 0.5), (2, 2, 3, 3), (0, 0, 1, 1)])
def test_points_near_are_all_there_and_in_order(shared, name, part, monkeypatch):
    decoded = []
    decode = LazPoints._decode

    def counted(self, group, *rest):
        decoded.extend(chunk.n_points for chunk in group)
        decode(self, group, *rest)

    monkeypatch.setattr(LazPoints, "_decode", counted)
    with open_points(shared / name) as source:
        whole = list(source.chunks())
        xy = np.concatenate([chunk.xyz()[:, :2] for chunk in whole])
        low, high = xy.min(axis=0), xy.max(axis=0)
        box = tuple(np.concatenate([low + (high - low) * part[:2], low + (high - low) * part[2:]]))
        wanted = inside(whole, box)
        decoded.clear()
        np.testing.assert_array_equal(inside(source.chunks(near=box), box), wanted)
        if part[0] == 2:
            assert sum(decoded) == 0
        elif name.startswith("tiles") and part != (0, 0, 1, 1):
            assert sum(decoded) < 0.5 * source.n_points


@pytest.mark.shared
def test_an_octree_that_makes_no_sense_leaves_nothing_out(shared, tmp_path):
    """A page beyond the end of the file, of half an entry, or that names itself."""
    data = (shared / "odd" / "simple_with_page.copc.laz").read_bytes()
    far = (-10.0, -10.0, -9.0, -9.0)
    with open_points(shared / "odd" / "simple_with_page.copc.laz") as source:
        assert chunks_outside(source.header, source.raw, far)
        at = data.index(source.header.find("copc", 1)[0].data)
    root, size = struct.unpack_from("<2Q", data, at + 40)
    loop = struct.pack("<4iQ2i", 0, 0, 0, 0, root, size, -1)
    for where, bad in (
        (at + 40, struct.pack("<2Q", len(data), 32)),
        (at + 40, struct.pack("<2Q", root, size - 1)),
        (root, loop),
        (root, struct.pack("<i", -1)),
    ):
        broken = bytearray(data)
        broken[where : where + len(bad)] = bad
        (tmp_path / "broken.copc.laz").write_bytes(broken)
        with open_points(tmp_path / "broken.copc.laz") as source:
            assert chunks_outside(source.header, source.raw, far) == frozenset()
