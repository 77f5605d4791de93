"""
OpenVDB grids (``.vdb``) [Museth2013]_, objects -> bytes, without OpenVDB.

What is written is a float grid as version 224 of the file has it (OpenVDB 6.2 to 13), with all
active voxels at 1 and the rest at 0, compressed by leaving out inactive values:

============= ================================================================================
part          content
============= ================================================================================
header        int64 magic ``0x56444220``, u32 file version, u32 x 2 library version, u8 1 (grids
              have offsets), 36 characters of a UUID
metadata      u32 n of the file; here 0
grids         i32 number; here 1
descriptor    text name, text type, text parent, int64 x 3: offsets of grid, buffers, end
grid          u32 compression (2: active values only), u32 n, then n x (text name, text type,
              u32 size, value)
transform     text map type, then its doubles: translation, scale, voxel size, 1/scale,
              1/scale**2, 1/(2 scale), three each
topology      u32 1, f32 background, u32 tiles, u32 children; then each child, in order of place
upper node    i32 x 3 origin, child mask of 32768 bits, value mask of as many, i8 0; then its
              children, by bit
lower node    child mask of 4096 bits, value mask, i8 0; then its children: leaf masks of 512 bits
buffers       each leaf again in the same order: mask, i8 0, f32 for each bit set
============= ================================================================================

A text is a u32 length and the characters. A bit of a mask is ``(x << 2 b) | (y << b) | z``.
"""

from __future__ import annotations

import hashlib
import math
import struct
import uuid
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from volatool.errors import OptionError, ResourceError
from volatool.model import U64

MAX_SIDE = 1 << 20
"""Voxels along an axis."""

_MAGIC, _FILE_VERSION, _LIBRARY = 0x56444220, 224, (10, 0)
_HEADER = struct.Struct("<qIIIB")
_ACTIVE_ONLY = 2
_INACTIVE_ARE_BACKGROUND = 0


def encode_vdb(
    cells: ArrayLike,
    scale: Sequence[float],
    translation: Sequence[float],
    *,
    name: str = "density",
    metadata: Mapping[str, str] | None = None,
) -> bytes:
    """
    Return the file of a set of voxels.

    Parameters
    ----------
    cells : (n, 3) array of int
        x, y, z, 0 to ``2**20 - 1``. Repeats are fine.
    scale : sequence of 3 float
        Edges of a voxel, greater than zero.
    translation : sequence of 3 float
        Where the *middle* of voxel 0, 0, 0 is.
    name : str
        Of the grid; programs that render volumes look for ``density``.
    metadata : mapping of str to str, optional
        Texts of the grid.

    Returns
    -------
    data : bytes
        The UUID is made from the rest: same voxels, same bytes.

    Raises
    ------
    OptionError
        ``E_OPTION``: an edge or a place that is not a number, or an edge not above zero.
    ResourceError
        ``E_SIZE``: a voxel outside.
    """
    numbers = [float(value) for value in (*scale, *translation)]
    if not all(map(math.isfinite, numbers)) or min(numbers[:3]) <= 0:
        raise OptionError(f"no grid has voxels of {scale} at {translation}")
    places = np.asarray(cells, np.int64).reshape(-1, 3)
    if len(places) and (places.min() < 0 or places.max() >= MAX_SIDE):
        raise ResourceError(
            f"voxels must be 0 to {MAX_SIDE - 1}, not {places.min()} to {places.max()}", "E_SIZE"
        )
    topology, buffers, n_voxels = _tree(places)
    described = _metadata(places, n_voxels, name, metadata or {})
    before = struct.pack("<I", _ACTIVE_ONLY) + described + _transform(numbers[:3], numbers[3:])
    descriptor = _text(name) + _text("Tree_float_5_4_3") + _text("")
    rest = struct.pack("<Ii", 0, 1) + descriptor
    start = _HEADER.size + 36 + len(rest) + 24
    block = start + len(before) + len(topology)
    offsets = struct.pack("<3q", start, block, block + len(buffers))
    body = rest + offsets + before + topology + buffers
    digest = hashlib.sha256(body).digest()[:16]
    name_of_file = str(uuid.UUID(bytes=digest, version=4)).encode()
    head = _HEADER.pack(_MAGIC, _FILE_VERSION, *_LIBRARY, 1)
    return head + name_of_file + body


def _text(text: str) -> bytes:
    data = text.encode()
    return struct.pack("<I", len(data)) + data


def _metadata(
    places: NDArray[np.int64], n_voxels: int, name: str, texts: Mapping[str, str]
) -> bytes:
    """Return the grid's metadata, by name."""
    low = places.min(axis=0) if len(places) else np.zeros(3, np.int64)
    high = places.max(axis=0) if len(places) else np.full(3, -1, np.int64)
    entries = {key: ("string", value.encode()) for key, value in texts.items()}
    entries |= {
        "class": ("string", b"fog volume"),
        "creator": ("string", b"volatool"),
        "file_bbox_max": ("vec3i", high.astype("<i4").tobytes()),
        "file_bbox_min": ("vec3i", low.astype("<i4").tobytes()),
        "file_compression": ("string", b"active values"),
        "file_voxel_count": ("int64", struct.pack("<q", n_voxels)),
        "name": ("string", name.encode()),
    }
    parts = [struct.pack("<I", len(entries))]
    for key in sorted(entries):
        kind, value = entries[key]
        parts += [_text(key), _text(kind), struct.pack("<I", len(value)), value]
    return b"".join(parts)


def _transform(scale: list[float], translation: list[float]) -> bytes:
    """Return the map from voxels to the world."""
    is_uniform = len(set(scale)) == 1
    kind = "UniformScaleTranslateMap" if is_uniform else "ScaleTranslateMap"
    inverse = [1 / value for value in scale]
    doubles = [*translation, *scale, *scale, *inverse]
    doubles += [value * value for value in inverse] + [value / 2 for value in inverse]
    return _text(kind) + struct.pack("<18d", *doubles)


def _tree(places: NDArray[np.int64]) -> tuple[bytes, bytes, int]:
    """Return topology, buffers and the number of voxels."""
    from volatool.kernels import vdb as kernels

    keys = np.unique(kernels.tree_keys(places.astype(np.int32)))
    leaf_of, leaf_keys = _parents(keys, kernels.LEAF_BITS)
    lower_of, lower_keys = _parents(leaf_keys, kernels.LOWER_BITS)
    upper_of, upper_keys = _parents(lower_keys, kernels.UPPER_BITS)
    leaves = _bits(keys, leaf_of, kernels.LEAF_BITS, len(leaf_keys))
    lowers = _bits(leaf_keys, lower_of, kernels.LOWER_BITS, len(lower_keys))
    uppers = _bits(lower_keys, upper_of, kernels.UPPER_BITS, len(upper_keys))
    no_tiles = {bits: bytes((1 << bits) // 8) + b"\0" for bits in (12, 15)}

    parts = [struct.pack("<IfII", 1, 0.0, 0, len(upper_keys))]
    leaf_ends = np.searchsorted(lower_of, np.arange(len(lower_keys)), side="right").tolist()
    lower_ends = np.searchsorted(upper_of, np.arange(len(upper_keys)), side="right").tolist()
    lower = leaf = 0
    for upper, key in enumerate(upper_keys.tolist()):
        origin = [(key >> shift & 0xFF) << 12 for shift in (16, 8, 0)]
        parts += [struct.pack("<3i", *origin), uppers[upper].tobytes(), no_tiles[15]]
        while lower < lower_ends[upper]:
            parts += [lowers[lower].tobytes(), no_tiles[12]]
            parts.append(leaves[leaf : leaf_ends[lower]].tobytes())
            leaf = leaf_ends[lower]
            lower += 1
    counts = np.bitwise_count(leaves).sum(axis=1, dtype=np.int64)
    one = np.frombuffer(struct.pack("<f", 1.0), np.uint8)
    as_bytes = leaves.view(np.uint8).reshape(-1, 64)
    buffers = kernels.leaf_buffers(as_bytes, counts, _INACTIVE_ARE_BACKGROUND, one)
    return b"".join(parts), buffers.tobytes(), len(keys)


def _parents(keys: U64, bits: int) -> tuple[NDArray[np.int64], U64]:
    """Return which node each key is in, and the keys of those nodes; ascending as `keys` are."""
    above = keys >> np.uint64(bits)
    is_first = np.ones(len(above), np.bool_)
    is_first[1:] = above[1:] != above[:-1]
    return np.cumsum(is_first) - 1, above[is_first]


def _bits(keys: U64, parents: NDArray[np.int64], bits: int, n_parents: int) -> NDArray[np.uint64]:
    """Return the masks of nodes, little-endian."""
    from volatool.kernels import vdb as kernels

    places = (keys & np.uint64((1 << bits) - 1)).astype(np.int64)
    found = kernels.masks(places, parents, (1 << bits) // 64, n_parents)
    return np.asarray(found).astype("<u8")
