"""Volumes as PLY: a point a voxel, or the outside of the voxels as quads."""

from __future__ import annotations

from typing import Any

import numpy as np
import plyfile
from numpy.typing import NDArray

from volatool.cube import MAX_DEPTH
from volatool.errors import CodedWarning
from volatool.export.cells import Places, channels_by_name
from volatool.export.colours import RGB, Colours, colours_of
from volatool.export.model import ExportOptions, Target
from volatool.export.notes import no_crs, unknown_channels
from volatool.export.placing import placed_locally, with_extent
from volatool.export.surface import placed, surface_of
from volatool.formats.origin import origin_lines
from volatool.vola.volume import Volume
from volatool.vola.window import half_open

_LINE = 240
"""Longest comment: MeshLab refuses headers with lines of 512 characters, rply (CloudCompare,
Open3D) of 1024."""

_ATTRIBUTES = {
    "intensity": ("intensity", 65535, "u2"),
    "class": ("classification", 255, "u1"),
    "returns": ("number_of_returns", 255, "u1"),
}


def export(volume: Volume, target: Target, options: ExportOptions) -> list[CodedWarning]:
    """
    Write a ``.ply``, binary, little-endian.

    Parameters
    ----------
    volume : Volume
        What is written.
    target : Target
        One file.
    options : ExportOptions
        ``shape``: points (the default), in VOLA order, with the metadata of their blocks; or cubes:
        the faces between voxels and what is none, joined to rectangles. ``colour``: as
        `colours_of`; of cubes those of the vertices. ``local``: float32 from the cube's corner in
        place of float64 in the CRS.

    Returns
    -------
    warnings : list of CodedWarning
        ``W_SHIFTED``, ``W_NO_CRS``, ``W_CHANNELS``.

    Notes
    -----
    z is in the vertical unit. Comments tell CRS and shift, and keep the cube for `import`.
    """
    colours = colours_of(volume, options.colour)
    is_local = bool(options.local)
    if options.shape == "cubes":
        with_extent(volume, "--shape cubes")
        elements = _cubes(half_open(volume), colours, is_local)
        warnings: list[CodedWarning] = []
    else:
        elements = [_points(volume, colours, is_local)]
        warnings = unknown_channels(volume) if colours is None else []
    data = plyfile.PlyData(elements, byte_order="<", comments=_comments(volume, is_local))
    with target.stream() as stream:
        data.write(stream)
    if is_local:
        warnings.insert(0, placed_locally(volume))
    return no_crs(volume, volume.crs.horizontal) + warnings


def _vertices(
    xyz: NDArray[np.float64], colours: Colours | None, is_local: bool, **more: Any
) -> Any:
    """Return the element of vertices with these coordinates, colours and other columns."""
    columns: dict[str, NDArray[Any]] = {}
    for axis, name in enumerate("xyz"):
        columns[name] = xyz[:, axis].astype("<f4" if is_local else "<f8")
    if colours is not None:
        columns |= {name: colours[:, band] for band, name in enumerate(RGB)}
    columns |= more
    table = np.empty(len(xyz), [(name, column.dtype) for name, column in columns.items()])
    for name, column in columns.items():
        table[name] = column
    return plyfile.PlyElement.describe(table, "vertex")


def _points(volume: Volume, colours: Colours | None, is_local: bool) -> Any:
    """Return the voxels as points."""
    places = Places.of(volume)
    if is_local:
        places = Places((0.0, 0.0, 0.0), places.step, places.first)
    more = {}
    for name in channels_by_name(volume):
        if name in _ATTRIBUTES:
            called, high, kind = _ATTRIBUTES[name]
            more[called] = np.clip(np.rint(volume.channel(name)), 0, high).astype(f"<{kind}")
    return _vertices(places.centers(volume.voxels()), colours, is_local, **more)


def _cubes(volume: Volume, colours: Colours | None, is_local: bool) -> list[Any]:
    """Return vertices and quads."""
    surface = surface_of(volume, colours)
    vertices = _vertices(
        placed(volume, surface.points, is_local=is_local), surface.colours, is_local
    )
    table = np.empty(len(surface.quads), [("vertex_indices", "<i4", (4,))])
    table["vertex_indices"] = surface.quads
    return [vertices, plyfile.PlyElement.describe(table, "face")]


def _comments(volume: Volume, is_local: bool) -> list[str]:
    """Return the lines for people, then the one for `import`."""
    lines = [f"voxels of level {volume.depth} of a VOLA volume, edge {volume.cell()!r}"]
    name = "+".join(part for part in (volume.crs.horizontal, volume.crs.vertical) if part)
    if name:
        lines.append(f"crs {name}"[:_LINE])
    if is_local:
        lines.append("shift {!r} {!r} {!r}".format(*Places.of(volume).origin))
    # a single place is no grid to come back to, and no import goes deeper
    if volume.cube.side > 0 and volume.depth <= MAX_DEPTH:
        lines += origin_lines(half_open(volume), width=_LINE)
    return [_ascii(line) for line in lines]


def _ascii(line: str) -> str:
    return line.encode("ascii", "backslashreplace").decode()
