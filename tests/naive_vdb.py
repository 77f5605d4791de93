"""OpenVDB's file read value by value: one float grid, active values only."""

from __future__ import annotations

import struct


class Reader:
    def __init__(self, data):
        self.data, self.at = data, 0

    def take(self, layout):
        values = struct.unpack_from(f"<{layout}", self.data, self.at)
        self.at += struct.calcsize(f"<{layout}")
        return values if len(values) > 1 else values[0]

    def text(self):
        n = self.take("I")
        return self.raw(n).decode()

    def raw(self, n):
        self.at += n
        assert self.at <= len(self.data)
        return self.data[self.at - n : self.at]

    def bits(self, n):
        """Places of the bits set in a mask of n bits, ascending."""
        data = self.raw(n // 8)
        return [8 * i + k for i, byte in enumerate(data) if byte for k in range(8) if byte >> k & 1]


def place(bit, bits):
    """x, y, z of a bit in a node with 2**bits children a side."""
    low = (1 << bits) - 1
    return bit >> (2 * bits), bit >> bits & low, bit & low


def read(data):
    """Return uuid, metadata, map type, its doubles and the active voxels with their values."""
    r = Reader(data)
    assert r.take("q") == 0x56444220
    assert r.take("III") == (224, 10, 0)
    assert r.take("B") == 1
    uuid = r.raw(36).decode()
    assert r.take("Ii") == (0, 1)
    name, kind, parent = r.text(), r.text(), r.text()
    assert (kind, parent) == ("Tree_float_5_4_3", "")
    start, block, end = r.take("3q")
    assert start == r.at
    assert r.take("I") == 2
    metadata = {}
    for _ in range(r.take("I")):
        key, form = r.text(), r.text()
        value = r.raw(r.take("I"))
        layout = {"vec3i": "<3i", "int64": "<q"}.get(form)
        metadata[key] = value.decode() if layout is None else struct.unpack(layout, value)
    assert metadata["name"] == name
    kind, numbers = r.text(), r.take("18d")
    assert r.take("IfI") == (1, 0.0, 0)
    leaves = []
    for _ in range(r.take("I")):
        root = r.take("3i")
        uppers = r.bits(32768)
        assert r.bits(32768) == []
        assert r.take("b") == 0
        for upper in uppers:
            lowers = r.bits(4096)
            assert r.bits(4096) == []
            assert r.take("b") == 0
            for lower in lowers:
                corner = [
                    a + 128 * b + 8 * c
                    for a, b, c in zip(root, place(upper, 5), place(lower, 4), strict=True)
                ]
                leaves.append((corner, r.bits(512)))
    assert r.at == block
    voxels = {}
    for corner, expected in leaves:
        bits = r.bits(512)
        assert bits == expected != []
        assert r.take("b") == 0
        for bit in bits:
            cell = tuple(a + b for a, b in zip(corner, place(bit, 3), strict=True))
            voxels[cell] = r.take("f")
    assert r.at == end == len(data)
    return uuid, metadata, kind, numbers, voxels
