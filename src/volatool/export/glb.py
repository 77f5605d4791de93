"""Volumes as glTF 2.0 in one file: the outside of the voxels as triangles, for browsers."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from volatool.errors import CodedWarning, OptionError
from volatool.export.colours import colours_of, linear
from volatool.export.model import ExportOptions, Target
from volatool.export.placing import shift_of, shifted, with_extent, z_unit
from volatool.export.surface import placed, surface_of
from volatool.formats.origin import origin_lines
from volatool.model import F64
from volatool.vola.volume import Volume
from volatool.vola.window import half_open

_FINEST = 100
"""Steps of single precision that an edge of a cell must have in coordinates of the CRS."""

_GREY = (0.62, 0.64, 0.67, 1.0)


def export(volume: Volume, target: Target, options: ExportOptions) -> list[CodedWarning]:
    """
    Write a ``.glb``.

    Parameters
    ----------
    volume : Volume
        What is written.
    target : Target
        One file.
    options : ExportOptions
        ``colour``: as `colours_of`, of the vertices. ``local`` (the default): from the cube's
        corner; False: in the CRS, where single precision can hold it.

    Returns
    -------
    warnings : list of CodedWarning
        ``W_SHIFTED``, or ``W_Z_UNIT``.

    Raises
    ------
    OptionError
        ``E_OPTION``: ``local`` is False and the coordinates are too large.

    Notes
    -----
    glTF has single precision, y upwards and metres: east is x, up is y, north is -z, and units of
    the CRS become metres where their length is known. ``asset.extras.volatool`` says what undoes
    it, with the cube and the CRS. Vertex colours are linear, as glTF has them.
    """
    volume = half_open(volume)
    with_extent(volume, "a mesh")
    is_local = options.local is not False
    colours = colours_of(volume, options.colour)
    surface = surface_of(volume, colours)
    metres = float(volume.crs.metres_per_unit_xy or 1)
    xyz = placed(volume, surface.points, is_local=is_local, is_world_z=False)
    if not is_local:
        _refuse_large(xyz, volume.cell())
    mesh: Any = trimesh.Trimesh(
        vertices=_y_up(xyz * metres),
        faces=surface.triangles(),
        vertex_colors=None if surface.colours is None else _rgba(linear(surface.colours)),
        process=False,
    )
    extras = _extras(volume, is_local, metres)
    write: Any = trimesh.exchange.gltf.export_glb
    data = write(
        trimesh.Scene({"voxels": mesh}),
        include_normals=False,  # readers then make flat ones, as cubes have them
        tree_postprocessor=lambda tree: _finish(tree, extras, colours is not None),
    )
    with target.stream() as stream:
        stream.write(data)
    return [shifted(volume, (0, 0, 0))] if is_local else z_unit(volume)


def _y_up(xyz: F64) -> F64:
    """Return x, y, z as glTF turns them: x, z, -y."""
    return np.column_stack([xyz[:, 0], xyz[:, 2], 0.0 - xyz[:, 1]])  # no -0.0


def _rgba(colours: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return np.column_stack([colours, np.full(len(colours), 255, np.uint8)])


def _refuse_large(xyz: F64, cell: float) -> None:
    step = float(np.spacing(np.float32(np.abs(xyz).max())))
    if step * _FINEST > cell:
        raise OptionError(
            f"--world: glTF has single precision, in steps of {step:g} at these coordinates, too "
            f"coarse for cells of {cell:g}; leave out --world"
        )


def _extras(volume: Volume, is_local: bool, metres: float) -> dict[str, Any]:
    """Return what undoes the shift, the unit and the turn."""
    (line,) = origin_lines(volume)
    return {
        "axes": "x east, y up, z south",
        "crs": volume.crs.horizontal,
        "metres_per_unit": metres,
        "z_ratio": float(volume.crs.z_ratio),
        "shift": list(shift_of(volume, (0, 0, 0))) if is_local else [0.0, 0.0, 0.0],
        "undo": "x = gx / metres_per_unit + shift[0], y = -gz / metres_per_unit + shift[1], "
        "z = (gy / metres_per_unit + shift[2]) / z_ratio",
        "origin": json.loads(line.removeprefix("volatool ")),
    }


def _finish(tree: dict[str, Any], extras: dict[str, Any], has_colours: bool) -> None:
    """Add what trimesh leaves out: extras of the asset, a material that is no metal."""
    tree["asset"]["extras"] = {"volatool": extras}
    tree["materials"] = [
        {
            "name": "voxels",
            "pbrMetallicRoughness": {
                "baseColorFactor": [1.0] * 4 if has_colours else list(_GREY),
                "metallicFactor": 0.0,
                "roughnessFactor": 1.0,
            },
        }
    ]
    for mesh in tree["meshes"]:
        for primitive in mesh["primitives"]:
            primitive["material"] = 0
