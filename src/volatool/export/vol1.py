"""
VOLA as the original toolkit reads it: header and levels, no trailer, no metadata word of zero.

A file of the toolkit comes out as it was, byte for byte but for latitude and longitude. Of our own
volumes the header's box is the cube, so that the toolkit places the cells right (heights are then
in the horizontal unit). The toolkit knows neither names of channels nor a vertical system.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from volatool.errors import CodedWarning
from volatool.export.model import ExportOptions, Target
from volatool.formats import dense, sparse
from volatool.formats.header import DENSE, HEADER_BYTES, SPARSE, Header
from volatool.formats.registry import opened
from volatool.formats.stream import Body
from volatool.model import as_fraction
from volatool.vola.volume import Volume

if TYPE_CHECKING:
    from volatool.vola.strips import Strips


def export(volume: Volume, target: Target, options: ExportOptions) -> list[CodedWarning]:
    """
    Write the file.

    Parameters
    ----------
    volume : Volume
        What is written.
    target : Target
        One file. With ``dense`` a dense input that is exported whole keeps the metadata of its
        strips, which a volume of blocks does not hold.
    options : ExportOptions
        ``dense``.

    Returns
    -------
    warnings : list of CodedWarning
        ``W_TOOLKIT_READER``: a dense file of more than one level, which the toolkit writes but
        does not read; ``W_UNITS``: heights scaled to the horizontal unit.

    Raises
    ------
    ResourceError
        ``E_SIZE``: a dense file that is too large.
    """
    warnings = []
    if volume.crs.z_ratio != 1:
        told = f"heights are in {volume.crs.unit_xy}, as x and y are; the toolkit knows one unit"
        warnings.append(CodedWarning("W_UNITS", told))
    if not options.dense:
        with target.stream() as stream:
            body = Body(stream)
            body.write(header_of(volume, SPARSE).to_bytes())
            sparse.write_levels(body, volume)
        return warnings
    dense.refuse_size(volume.depth, volume.has_metadata)
    levels = None if options.has_selection else _stored(target.source)
    with target.stream() as stream:
        if levels is None:
            dense.write(stream, volume, with_trailer=False, header=header_of(volume, DENSE))
        else:
            body = Body(stream)
            body.write(header_of(volume, DENSE).to_bytes())
            for level, strips in enumerate(levels, 1):
                dense.write_strips(body, strips, level)
    if volume.depth > 1:
        told = "the toolkit writes dense files, but reads them wrong; without --dense it is sparse"
        warnings.append(CodedWarning("W_TOOLKIT_READER", told))
    return warnings


def _stored(source: Path | None) -> list[Strips] | None:
    """Return the levels of a dense file as they are stored; None of any other."""
    if source is None:
        return None
    with opened(source) as (_, stream):
        header = Header.from_bytes(stream.read(HEADER_BYTES))
        return dense.read_strips(stream, header) if header.mode == DENSE else None


def header_of(volume: Volume, mode: int) -> Header:
    """
    Return the header: the box that was read, if that is still the volume's cube.

    Parameters
    ----------
    volume : Volume
        The volume.
    mode : int
        0 sparse, 1 dense.
    """
    header = Header.of(volume, mode)
    box = volume.info.box
    if box is None or volume.info.quantizer == "floor":
        return header
    corner = tuple(map(as_fraction, box[:3]))
    longest = max(as_fraction(box[3 + k]) - corner[k] for k in range(3))
    if (*corner, longest) != volume.cube.exact:
        return header
    return replace(header, box=box)
