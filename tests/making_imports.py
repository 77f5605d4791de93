"""Small files of foreign formats, and an imported file as arrays."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from volatool.imports.source import ImportSource
from volatool.model import as_fraction
from volatool.options import ConvertOptions


def opened(path, **options):
    """Return the source of a file."""
    return ImportSource(Path(path), ConvertOptions(**options))


def points_of(path, chunk_points=100_000, **options):
    """Return xyz (the floats nearest to the exact decimals) and attributes of all points."""
    source = opened(path, **options)
    chunks = list(source.chunks(source.header.dimensions, chunk_points))
    assert [chunk.start for chunk in chunks] == list(
        np.cumsum([0, *map(len, chunks[:-1])]) if chunks else []
    )
    assert sum(map(len, chunks)) == source.n_points
    if not chunks:
        return np.empty((0, 3)), {}
    names = chunks[0].attributes
    return np.concatenate([_exact(chunk) for chunk in chunks]), {
        name: np.concatenate([chunk.attributes[name] for chunk in chunks]) for name in names
    }


def _exact(chunk):
    pairs = [
        (as_fraction(s), as_fraction(o)) for s, o in zip(chunk.scale, chunk.offset, strict=True)
    ]
    columns = zip((chunk.x, chunk.y, chunk.z), pairs, strict=True)
    return np.array([[float(int(v) * s + o) for v in stored] for stored, (s, o) in columns]).T


def pcd(xyz, kind="binary", fields=(), height=1):
    """Return the bytes of a PCD file; fields: (name, array) beside x, y, z."""
    named = [*zip("xyz", np.asarray(xyz, np.float32).T, strict=True), *fields]
    letters = {"f": "F", "u": "U", "i": "I"}
    n = len(xyz)
    head = "\n".join(
        [
            "# .PCD v0.7 - Point Cloud Data file format",
            "VERSION 0.7",
            "FIELDS " + " ".join(name for name, _ in named),
            "SIZE " + " ".join(str(v.dtype.itemsize) for _, v in named),
            "TYPE " + " ".join(letters[v.dtype.kind] for _, v in named),
            "COUNT " + " ".join("1" for _ in named),
            f"WIDTH {n // height}",
            f"HEIGHT {height}",
            "VIEWPOINT 0 0 0 1 0 0 0",
            f"POINTS {n}",
            f"DATA {kind}\n",
        ]
    ).encode()
    if kind == "ascii":
        rows = [" ".join(str(v[k]) for _, v in named) for k in range(n)]
        return head + "\n".join(rows).encode() + b"\n"
    if kind == "binary":
        records = np.zeros(n, [(str(k), v.dtype) for k, (_, v) in enumerate(named)])
        for k, (_, v) in enumerate(named):
            records[str(k)] = v
        return head + records.tobytes()
    raw = b"".join(v.tobytes() for _, v in named)
    # LZF literals only: a length byte and up to 32 bytes
    parts = [raw[at : at + 32] for at in range(0, len(raw), 32)]
    packed = b"".join(bytes([len(part) - 1]) + part for part in parts)
    return head + np.array([len(packed), len(raw)], "<u4").tobytes() + packed


def ply(columns, order="binary_little_endian", faces=(), before=b""):
    """Return the bytes of a PLY file; columns: dict of name to array, faces: lists of vertices."""
    kinds = {"f4": "float", "f8": "double", "u1": "uchar", "u2": "ushort", "i4": "int"}
    n = len(columns["x"])
    head = ["ply", f"format {order} 1.0", "comment made by a test", f"element vertex {n}"]
    head += [f"property {kinds[v.dtype.str[1:]]} {name}" for name, v in columns.items()]
    if faces:
        head += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
    data = ("\n".join(head) + "\nend_header\n").encode()
    if order == "ascii":
        rows = [" ".join(str(v[k]) for v in columns.values()) for k in range(n)]
        rows += [" ".join(map(str, [len(face), *face])) for face in faces]
        return data + "\n".join(rows).encode() + b"\n"
    sign = "<" if "little" in order else ">"
    records = np.zeros(n, [(name, v.dtype.newbyteorder(sign)) for name, v in columns.items()])
    for name, v in columns.items():
        records[name] = v
    for face in faces:
        before += bytes([len(face)]) + np.array(face, f"{sign}i4").tobytes()
    return data + records.tobytes() + before


def stl(triangles):
    """Return the bytes of a binary STL file."""
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("rest", "<u2")])
    records = np.zeros(len(triangles), record)
    records["corners"] = triangles
    return bytes(80) + len(triangles).to_bytes(4, "little") + records.tobytes()


def box_triangles(low, high):
    """Return the 12 triangles of a box's surface."""
    corner = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    corner = np.asarray(low) + corner * (np.asarray(high) - np.asarray(low))
    quads = [(0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)]
    return np.array([corner[list(t)] for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
