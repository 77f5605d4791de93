"""The formats that volumes are exported to; imports none of their modules."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from volatool.errors import OptionError
from volatool.export.model import Exporter, ExportOptions, Target

if TYPE_CHECKING:
    from volatool.errors import CodedWarning
    from volatool.vola.volume import Volume

_ALL = (
    # not plain .laz: that is the tile which the volume was made from
    Exporter(
        "laz", ".voxels.laz", "voxel centres as compressed LAS 1.4", "las", suffixes=(".laz",)
    ),
    Exporter("las", ".voxels.las", "voxel centres as LAS 1.4", "las", suffixes=(".las",)),
    Exporter(
        "ply",
        ".ply",
        "points, or cubes as a mesh: CloudCompare, MeshLab, Blender",
        "ply",
        ("shape", "colour", "local"),
        "mesh",
    ),
    Exporter("glb", ".glb", "a mesh for browsers: glTF 2.0", "glb", ("colour", "local"), "mesh"),
    Exporter("xyz", ".xyz", "text: x y z, and r g b if known", "text", suffixes=(".txt",)),
    Exporter("csv", ".csv", "text with a header row and all metadata", "text"),
    Exporter("npy", ".npy", "NumPy: a dense window, or coordinates", "npy", ("sparse", "limit")),
    Exporter("npz", ".npz", "NumPy: coordinates, metadata, CRS; nothing is lost", "npz"),
    Exporter("bt", ".bt", "OctoMap binary tree", "bt", ("local", "free")),
    Exporter("binvox", ".binvox", "binvox run-length grid", "binvox", ("local", "limit")),
    Exporter("vdb", ".vdb", "OpenVDB grid: Blender, Houdini", "vdb", ("local",)),
    Exporter(
        "png",
        ".png",
        "pictures of the layers, placed for GIS",
        "png",
        ("slices", "limit"),
        has_main=False,
    ),
    Exporter(
        "nav2",
        ".yaml",
        "ROS 2 map_server occupancy map (pgm + yaml)",
        "nav2",
        ("above", "ground", "near", "local"),
    ),
    Exporter("c-array", ".h", "C header for a microcontroller", "c_array", ("name", "limit")),
    Exporter("vol1", ".vol1.vol", "VOLA for the original toolkit", "vol1", ("dense",)),
    Exporter("vol", ".vol", "VOLA, sparse, not compressed", "vola"),
    Exporter("vol.gz", ".vol.gz", "VOLA, sparse, gzip", "vola"),
    Exporter("dvol", ".dvol", "VOLA, dense, not compressed", "vola"),
    Exporter("dvol.gz", ".dvol.gz", "VOLA, dense, gzip", "vola"),
)

FORMATS: dict[str, Exporter] = {exporter.name: exporter for exporter in _ALL}
"""By name, in the order of ``--help``."""

SUFFIXES: dict[str, Exporter] = {
    suffix: exporter for exporter in _ALL for suffix in (exporter.suffix, *exporter.suffixes)
}
"""By suffix, for outputs that are named without ``--to``."""


def exporter_of(name: str) -> Exporter:
    """
    Return a format by its name.

    Raises
    ------
    OptionError
        There is none.
    """
    if name not in FORMATS:
        raise OptionError(f"no format is called {name!r}; there are {', '.join(FORMATS)}")
    return FORMATS[name]


def exporter_for(path: Path) -> Exporter:
    """
    Return the format that an output's name ends with.

    Raises
    ------
    OptionError
        None does.

    Examples
    --------
    >>> exporter_for(Path("a.b.vol.gz")).name
    'vol.gz'
    """
    name = path.name.lower()
    matches = [suffix for suffix in SUFFIXES if name.endswith(suffix)]
    if not matches:
        raise OptionError(
            f"{path}: its name tells no format; give --to with one of {', '.join(FORMATS)}"
        )
    return SUFFIXES[max(matches, key=len)]


def run(
    exporter: Exporter, volume: Volume, target: Target, options: ExportOptions
) -> list[CodedWarning]:
    """
    Write a volume in a format.

    Parameters
    ----------
    exporter : Exporter
        The format.
    volume : Volume
        What is written; level and crop are done.
    target : Target
        Where it goes.
    options : ExportOptions
        The rest of the options.

    Raises
    ------
    OptionError
        ``E_NO_EXTRA``: a package that the format needs is not installed.
    """
    try:
        module = import_module(f"volatool.export.{exporter.module}")
        warnings: list[CodedWarning] = module.export(volume, target, options)
        return warnings
    except ModuleNotFoundError as error:
        if exporter.extra is None or (error.name or "").startswith("volatool"):
            raise
        raise OptionError(
            f"--to {exporter.name} needs {error.name}: pip install 'volatool[{exporter.extra}]'",
            "E_NO_EXTRA",
        ) from error
