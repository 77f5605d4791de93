"""Files of the original toolkit, byte for byte but for lat and lon; no trailer."""

from __future__ import annotations

from typing import BinaryIO

from volatool.errors import InputError
from volatool.formats import dense, sparse
from volatool.formats.header import DENSE, NO_CRS, SPARSE, Header
from volatool.formats.stream import Body
from volatool.vola.toolkit import ToolkitVolume


def _header(content: ToolkitVolume, mode: int) -> Header:
    info = content.info
    assert info.box is not None
    crs = NO_CRS if info.epsg is None else info.epsg
    n_metadata = int(content.has_metadata)
    return Header(mode, content.depth, n_metadata, crs, info.lat or 0.0, info.lon or 0.0, info.box)


def write_sparse(stream: BinaryIO, content: ToolkitVolume) -> int:
    """
    Write a ``.vol``.

    Parameters
    ----------
    stream : binary file
        Where it goes.
    content : ToolkitVolume
        What is written.

    Returns
    -------
    n_bytes : int
        Size of what was written.

    Raises
    ------
    InputError
        ``E_TOOLKIT``: a block's metadata word is zero.
    """
    volume = content.volume()
    body = Body(stream)
    body.write(_header(content, SPARSE).to_bytes())
    sparse.write_levels(body, volume)
    return body.size


def write_dense(stream: BinaryIO, content: ToolkitVolume) -> int:
    """
    Write a ``.dvol``.

    Parameters
    ----------
    stream : binary file
        Where it goes.
    content : ToolkitVolume
        What is written.

    Returns
    -------
    n_bytes : int
        Size of what was written.

    Raises
    ------
    InputError
        ``E_TOOLKIT``: all points are in one place, where the toolkit's dense writer stops.
    ResourceError
        ``E_SIZE``: larger than `dense.MAX_BYTES`.
    """
    if not content.has_extent:
        raise InputError(
            "all points are in one place, where the toolkit's dense writer stops; "
            "write it sparse, or without toolkit compatibility",
            "E_TOOLKIT",
        )
    dense.refuse_size(content.depth, content.has_metadata)
    body = Body(stream)
    body.write(_header(content, DENSE).to_bytes())
    for level in range(1, content.depth + 1):
        dense.write_strips(body, content.strips(level), level)
    return body.size
