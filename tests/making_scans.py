"""Scans and scan files for tests, with writers of their own: PCD of each kind, LZF packing."""

from __future__ import annotations

import io
import struct

import numpy as np


def height(x, y):
    return np.sin(x / np.pi) * np.sin(y / np.pi)


def scan(at=0.0, n=2000, seed=0, noise=0.05, reach=10.0):
    """Returns round a sensor at (at, 0), denser near it, in the world."""
    rng = np.random.default_rng(seed)
    r, a = reach * rng.random(n), 2 * np.pi * rng.random(n)
    x, y = at + r * np.cos(a), r * np.sin(a)
    return np.column_stack([x, y, height(x, y) + noise * rng.normal(size=n)])


def npy_bytes(*arrays):
    """The arrays as a producer would write them to a pipe."""
    stream = io.BytesIO()
    for array in arrays:
        np.save(stream, array)
    return stream.getvalue()


def lzf_pack(data):
    """LZF by the book: greedy references of 3 to 264 bytes, literal runs of up to 32."""
    out, literal, seen, i = bytearray(), bytearray(), {}, 0

    def flush():
        for start in range(0, len(literal), 32):
            part = literal[start : start + 32]
            out.append(len(part) - 1)
            out.extend(part)
        literal.clear()

    while i < len(data):
        key = data[i : i + 3]
        place = seen.get(key)
        seen[key] = i
        if len(key) == 3 and place is not None and i - place <= 8192:
            run = 3
            while run < 264 and i + run < len(data) and data[place + run] == data[i + run]:
                run += 1
            flush()
            back, length = i - place - 1, run - 2
            if length < 7:
                out.append(length << 5 | back >> 8)
            else:
                out += bytes([7 << 5 | back >> 8, length - 7])
            out.append(back & 255)
            i += run
        else:
            literal.append(data[i])
            i += 1
    flush()
    return bytes(out)


def pcd_bytes(xyz, kind="binary", dtype="f4", header=None):
    """A PCD file with an intensity before and a padded normal after the coordinates."""
    letter, size = {"f4": ("F", 4), "f8": ("F", 8), "i4": ("I", 4)}[dtype]
    record = np.dtype(
        [("intensity", "<u2"), *[(axis, f"<{dtype}") for axis in "xyz"], ("normal", "<f4", 3)]
    )
    points = np.zeros(len(xyz), record)
    points["intensity"] = np.arange(len(xyz)) % 1000
    for k, axis in enumerate("xyz"):
        points[axis] = xyz[:, k]
    head = header or (
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\n"
        "FIELDS intensity x y z normal\n"
        f"SIZE 2 {size} {size} {size} 4\nTYPE U {letter} {letter} {letter} F\nCOUNT 1 1 1 1 3\n"
        f"WIDTH {len(xyz)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(xyz)}\nDATA {kind}\n"
    )
    if kind == "ascii":
        lines = [f"{p['intensity']} {p['x']} {p['y']} {p['z']} 0 0 1" for p in points]
        return (head + "\n".join(lines) + "\n").encode()
    if kind == "binary":
        return head.encode() + points.tobytes()
    columns = b"".join(points[name].tobytes() for name in record.names)
    packed = lzf_pack(columns)
    return head.encode() + struct.pack("<II", len(packed), len(columns)) + packed
