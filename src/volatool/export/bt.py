"""Volumes as OctoMap's binary trees."""

from __future__ import annotations

from volatool.cube import Cube
from volatool.errors import CodedWarning, OptionError, ResourceError
from volatool.export.model import ExportOptions, Target
from volatool.export.placing import shift_of, shifted, with_extent, z_told, z_unit
from volatool.formats.octomap import HALF, encode_bt
from volatool.formats.origin import origin_lines
from volatool.vola.volume import Volume
from volatool.vola.window import half_open

MAX_LEVEL = 8
"""Deepest level: 4**8 cells a side are the 65536 that OctoMap has."""


def export(volume: Volume, target: Target, options: ExportOptions) -> list[CodedWarning]:
    """
    Write a ``.bt``.

    Parameters
    ----------
    volume : Volume
        What is written: its voxels, occupied. Nothing else is known, unless ``options.free``.
    target : Target
        One file.
    options : ExportOptions
        ``local`` (the default): the cube's corner is at 0, at level 8 its middle; False: where the
        CRS has it. ``free``: what of the cube is not occupied is free.

    Returns
    -------
    warnings : list of CodedWarning
        ``W_SHIFTED``, or ``W_Z_UNIT``.

    Raises
    ------
    ResourceError
        ``E_SIZE``: more than 65536 voxels a side.
    OptionError
        ``E_CUBE``: ``local`` is False and the cube does not lie on OctoMap's grid.

    Notes
    -----
    OctoMap's voxels lie on multiples of their edge, at most 32768 from 0 on either side. A comment
    line says what the coordinates were; OctoMap skips it, `import` puts it back.
    """
    if volume.depth > MAX_LEVEL:
        raise ResourceError(
            f"level {volume.depth} has {4**volume.depth} cells a side, OctoMap has {2 * HALF}; "
            f"give --level {MAX_LEVEL}, or less",
            "E_SIZE",
        )
    volume = half_open(volume)
    cube = with_extent(volume, "OctoMap")
    n_cells = 4**volume.depth
    if options.local is False:
        corner = aligned_corner(cube, n_cells)
    else:
        corner = (-HALF,) * 3 if n_cells > HALF else (0, 0, 0)
    cells = volume.voxels()
    cells += corner
    data = encode_bt(
        cells,
        cube.cell(volume.depth),
        comments=[*_told(volume, corner, bool(options.free)), *origin_lines(volume, corner)],
        free_cube=(corner, n_cells) if options.free else None,
    )
    with target.stream() as stream:
        stream.write(data)
    return z_unit(volume) if options.local is False else [shifted(volume, corner)]


def aligned_corner(cube: Cube, n_cells: int) -> tuple[int, int, int]:
    """
    Return the voxel of OctoMap that a cube begins with, in coordinates of the CRS.

    Parameters
    ----------
    cube : Cube
        Exact.
    n_cells : int
        Cells a side.

    Raises
    ------
    OptionError
        ``E_CUBE``: its corner is no multiple of a cell, or too far from 0.
    """
    places = [value * n_cells / cube.exact[3] for value in cube.exact[:3]]
    if any(place.denominator != 1 for place in places):
        raise OptionError(
            "--world: the cube's corner is not on a multiple of its cells, where OctoMap has its "
            "voxels; leave out --world, or convert with --snap",
            "E_CUBE",
        )
    x, y, z = map(int, places)
    if min(x, y, z) < -HALF or max(x, y, z) + n_cells > HALF:
        raise OptionError(
            f"--world: the cube lies {max(map(abs, (x, y, z)))} cells from 0, OctoMap has {HALF} "
            "on either side; leave out --world, or give a coarser --level",
            "E_CUBE",
        )
    return x, y, z


def _told(volume: Volume, corner: tuple[int, int, int], is_free: bool) -> list[str]:
    """Return the lines for people."""
    x, y, z = shift_of(volume, corner)
    unit = volume.crs.unit_xy or "unit unknown"
    rest = "taken to be free" if is_free else "unknown"
    return [
        f"voxels of level {volume.depth} of a VOLA volume, {unit}; what is not occupied is {rest}",
        f"coordinates of {volume.crs.horizontal or 'the source'}: add {x!r} {y!r} {z!r}"
        f"{z_told(volume)}",
    ]
