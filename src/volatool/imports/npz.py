"""NumPy archives for import: those of our own export with cube, CRS and metadata; else one array.

Of other archives the only array is taken, or the one called ``points``, ``xyz`` or ``coords``, as
an ``.npy`` would be.
"""

from __future__ import annotations

import io
import json
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from volatool.cube import MAX_DEPTH
from volatool.errors import FormatError, ResourceError
from volatool.formats import trailer
from volatool.imports.grid import voxel_points
from volatool.imports.model import ATTRIBUTES, Batch, ImportedPoints
from volatool.imports.npy import points_of
from volatool.model import I32, U64
from volatool.options import ConvertOptions
from volatool.points.frames import Reader, npy_header

_BROKEN = (
    zipfile.BadZipFile, zlib.error, KeyError, EOFError, NotImplementedError, RuntimeError,
)  # fmt: skip
_NAMES = ("points", "xyz", "coords")
_CHANNELS = {
    "red": "red",
    "green": "green",
    "blue": "blue",
    "returns": "number_of_returns",
    "intensity": "intensity",
    "class": "classification",
}


def read(path: Path, options: ConvertOptions) -> ImportedPoints:
    """
    Open an archive; its array of points is held.

    Parameters
    ----------
    path : pathlib.Path
        Written by `volatool export`, ``numpy.savez`` or ``savez_compressed``.
    options : ConvertOptions
        ``columns``, ``memory``.

    Raises
    ------
    FormatError, TruncatedError, ResourceError
        No such archive; an array larger than ``memory`` allows.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            names = {name.removesuffix(".npy") for name in archive.namelist()}
            if {"coords", "depth", "trailer"} <= names:
                return _own(archive, "metadata" in names, options.memory)
            found = [name for name in _NAMES if name in names] or sorted(names)
            if (len(names) > 1 and found[0] not in _NAMES) or not found:
                raise FormatError(
                    f"has {len(names)} arrays, none called {', '.join(_NAMES)}", "E_NOT_IMPORT"
                )
            return points_of(_array(archive, found[0], options.memory), "npz", options)
    except _BROKEN as error:
        raise FormatError(f"is no NumPy archive ({error})", "E_NOT_IMPORT") from error


def _array(archive: zipfile.ZipFile, name: str, limit: int) -> NDArray[Any]:
    """Return an array, not larger than the limit; nothing is unpickled."""
    entry = archive.getinfo(f"{name}.npy")
    if entry.file_size > limit:
        raise ResourceError(
            f"its array {name} takes {entry.file_size} bytes, more than --memory allows", "E_SIZE"
        )
    with archive.open(entry) as member:
        data = member.read(limit + 1)  # what the entry says need not be true
    if len(data) > limit:
        raise ResourceError(f"its array {name} takes more than --memory allows", "E_SIZE")
    stream = io.BytesIO(data)
    shape, is_fortran, dtype = npy_header(Reader(stream, b"", 0, name), f"array {name}")
    count = int(np.prod(shape, dtype=object))
    if dtype.hasobject or count * dtype.itemsize != len(data) - stream.tell():
        raise FormatError(f"its array {name} is not the {shape} {dtype} that it claims")
    return np.frombuffer(data, dtype, count, stream.tell()).reshape(
        shape, order="F" if is_fortran else "C"
    )


def _own(archive: zipfile.ZipFile, has_metadata: bool, limit: int) -> ImportedPoints:
    """Return the voxels of our own export, with their metadata."""
    text, depth = _array(archive, "trailer", limit), _array(archive, "depth", limit)
    coords = _array(archive, "coords", limit)
    if text.dtype.kind != "U" or text.shape or depth.shape or depth.dtype.kind not in "iu":
        raise FormatError("its arrays trailer and depth are not text and a number")
    level = int(depth)
    if not 1 <= level <= MAX_DEPTH:
        raise FormatError(f"depth {level} is not 1 to {MAX_DEPTH}")
    if coords.ndim != 2 or coords.shape[1] != 3 or coords.dtype.kind not in "iu":
        raise FormatError(f"coords are {coords.shape} {coords.dtype}, not rows of x, y, z")
    if len(coords) and (coords.min() < 0 or coords.max() >= 4**level):
        raise FormatError(f"coords are not 0 to {4**level - 1}")
    try:
        content = json.loads(str(text))
        cube, info = trailer.recall(content)
    except (ValueError, TypeError, RecursionError) as error:
        raise FormatError(f"its trailer makes no sense ({error})") from error
    voxels: I32 = coords.astype(np.int32)

    def listed() -> Iterator[I32]:
        yield voxels

    points = voxel_points("npz", listed, cube, level, info.crs)
    if has_metadata:
        words = _array(archive, "metadata", limit)
        if words.shape != (len(coords),) or words.dtype.kind != "u" or words.dtype.itemsize != 8:
            raise FormatError(f"metadata are {words.shape} {words.dtype}, not a word a voxel")
        _add_metadata(points, words.astype(np.uint64), info.channels)
    return points


def _add_metadata(points: ImportedPoints, words: U64, channels: Any) -> None:
    """Give the points the values that their blocks' bytes stand for."""
    known = {_CHANNELS[c["name"]]: c for c in channels if c["name"] in _CHANNELS}
    if not known:
        return
    bare = points.batches

    def batches(n_rows: int) -> Iterator[Batch]:
        for batch in bare(n_rows):
            part = words[batch.start : batch.start + len(batch.xyz)]
            attributes = {}
            for name, channel in known.items():
                largest, dtype = ATTRIBUTES[name]
                byte = (part >> np.uint64(8 * int(channel["byte"]))) & np.uint64(255)
                value = byte * float(channel["scale"]) + float(channel["offset"])
                attributes[name] = np.clip(np.rint(value), 0, largest).astype(dtype)
            yield Batch(batch.start, batch.xyz, attributes)

    points.batches = batches
    points.attributes = frozenset(known)
