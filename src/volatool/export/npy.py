"""
NumPy arrays: a dense window, or the coordinates of the voxels.

======== ====================================================================================
dense    bool, axes x, y, z (C order): the whole cube, or the cells of ``--bounds`` and ``--z``;
         ``[i, j, k]`` is the cell i to the east, j to the north, k up from the window's corner
sparse   ``(n, 3)`` int32: x, y, z of each voxel from the cube's corner, in VOLA order
======== ====================================================================================

An ``.npy`` has no place for corner, cell and CRS; ``.npz`` keeps them.
"""

from __future__ import annotations

from typing import Any, BinaryIO

import numpy as np
from numpy.lib import format as npy_format

from volatool.errors import CodedWarning
from volatool.export.cells import cell_chunks
from volatool.export.model import ExportOptions, Target
from volatool.vola.volume import Volume
from volatool.vola.window import WINDOW_LIMIT_BYTES, window_of


def export(volume: Volume, target: Target, options: ExportOptions) -> list[CodedWarning]:
    """
    Write an array.

    Parameters
    ----------
    volume : Volume
        What is written.
    target : Target
        One file.
    options : ExportOptions
        ``sparse``, ``limit``; ``bounds`` and ``z`` are the dense window's.

    Returns
    -------
    warnings : list of CodedWarning

    Raises
    ------
    ResourceError
        ``E_SIZE``: the dense window is larger than the limit (1 GiB).
    """
    if options.sparse:
        with target.stream() as stream:
            write_header(stream, (len(volume), 3), np.dtype("<i4"))
            for chunk in cell_chunks(volume):
                stream.write(np.ascontiguousarray(chunk.cells, "<i4").tobytes())
        return []
    window = window_of(volume, options.bounds, z=options.z)
    window.refuse_size(
        options.limit or WINDOW_LIMIT_BYTES,
        "give --bounds, --z, a coarser --level, a larger --limit, or --sparse",
    )
    with target.stream() as stream:
        write_header(stream, window.shape, np.dtype(np.bool_))
        for slab in window.slabs():
            stream.write(slab.tobytes())
    return []


def write_header(stream: BinaryIO, shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
    """Write the head of an ``.npy`` whose data follow in C order."""
    description = {
        "descr": npy_format.dtype_to_descr(dtype),
        "fortran_order": False,
        "shape": shape,
    }
    npy_format.write_array_header_1_0(stream, description)
