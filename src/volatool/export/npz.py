"""
NumPy arrays that keep all of a volume, in one ``.npz``.

============= ============ ==========================================================
name          type         meaning
============= ============ ==========================================================
coords        (n, 3) i4    x, y, z of each voxel from the cube's corner, VOLA order
metadata      (n,) u8      metadata word of each one's block; absent without metadata
level_1 ...   (b,) u8      occupancy words of each level, as in a ``.vol``
metadata_1 .. (b,) u8      their metadata words; absent without metadata
origin        (3,) f8      corner of the cube, in units of the CRS (z in the vertical unit)
cell          f8           edge of a voxel, horizontal unit
depth         i8           number of levels
crs           text         WKT 2, or empty
trailer       text         JSON of the trailer of a ``.vol``: exact cube, channels, units, ...
============= ============ ==========================================================

u8 and i4 are NumPy's 64-bit unsigned and 32-bit signed integers.
"""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, BinaryIO, cast

import numpy as np

from volatool.errors import CodedWarning
from volatool.export.cells import Places, cell_chunks
from volatool.export.model import ExportOptions, Target
from volatool.export.npy import write_header
from volatool.formats import trailer
from volatool.vola.volume import Volume


def export(volume: Volume, target: Target, options: ExportOptions) -> list[CodedWarning]:
    """
    Write the arrays of the table above, compressed.

    Parameters
    ----------
    volume : Volume
        What is written.
    target : Target
        One file.
    options : ExportOptions
        Nothing of it.

    Returns
    -------
    warnings : list of CodedWarning
        None: nothing is lost.
    """
    del options
    with target.stream() as stream, zipfile.ZipFile(stream, "w") as archive:
        with _member(archive, "coords") as member:
            write_header(member, (len(volume), 3), np.dtype("<i4"))
            for chunk in cell_chunks(volume):
                member.write(np.ascontiguousarray(chunk.cells, "<i4").tobytes())
        if volume.has_metadata:
            with _member(archive, "metadata") as member:
                write_header(member, (len(volume),), np.dtype("<u8"))
                for chunk in cell_chunks(volume):
                    member.write(np.ascontiguousarray(chunk.words, "<u8").tobytes())
        for name, array in _small(volume):
            with _member(archive, name) as member:
                write_header(member, array.shape, array.dtype)
                member.write(array.tobytes())
    return []


def _small(volume: Volume) -> Iterator[tuple[str, np.ndarray[Any, Any]]]:
    """Yield all arrays but those of the voxels."""
    for level, words in enumerate(volume.levels, 1):
        yield f"level_{level}", words.astype("<u8")
    for level, words in enumerate(volume.metadata_levels or (), 1):
        yield f"metadata_{level}", words.astype("<u8")
    text = trailer.describe(volume, [len(words) for words in volume.levels])
    yield "origin", np.array(Places.of(volume).origin, "<f8")
    yield "cell", np.array(volume.cell(), "<f8")
    yield "depth", np.array(volume.depth, "<i8")
    yield "crs", np.array(volume.crs.wkt2 or "", np.str_)
    yield "trailer", np.array(text.decode("utf-8", "replace"), np.str_)


@contextmanager
def _member(archive: zipfile.ZipFile, name: str) -> Iterator[BinaryIO]:
    """Open an array of the archive for writing, with a fixed time."""
    entry = zipfile.ZipInfo(f"{name}.npy")  # of 1980
    entry.compress_type = zipfile.ZIP_DEFLATED
    with archive.open(entry, "w", force_zip64=True) as member:
        yield cast(BinaryIO, member)
