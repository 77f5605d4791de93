"""Which module reads which format: by suffix, by first bytes, or as ``--from`` says."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from volatool.errors import FormatError, InputError, InputNotFoundError, OptionError, VolatoolError
from volatool.naming import IMPORT_SUFFIXES

if TYPE_CHECKING:
    from volatool.imports.model import ImportedPoints
    from volatool.options import ConvertOptions


@dataclass(frozen=True, slots=True)
class Importer:
    """
    A format that can be imported.

    Parameters
    ----------
    name : str
        For ``--from``.
    suffixes : tuple of str
        Lower case, with the dot.
    title : str
        For people.
    module : str
        Has ``read(path, options) -> ImportedPoints``.
    """

    name: str
    suffixes: tuple[str, ...]
    title: str
    module: str

    def read(self, path: Path, options: ConvertOptions) -> ImportedPoints:
        """Open a file of this format."""
        points: ImportedPoints = import_module(self.module).read(path, options)
        return points


def _importer(name: str, title: str, module: str, *suffixes: str) -> Importer:
    return Importer(name, suffixes or (f".{name}",), title, f"volatool.imports.{module}")


FORMATS: dict[str, Importer] = {
    one.name: one
    for one in (
        _importer("xyz", "columns of numbers", "text", ".xyz", ".pts"),
        _importer("txt", "columns of numbers", "text"),
        _importer("csv", "columns of numbers", "text"),
        _importer("ply", "Stanford PLY, points or mesh", "ply"),
        _importer("pcd", "Point Cloud Data of PCL", "pcd"),
        _importer("npy", "NumPy array", "npy"),
        _importer("npz", "NumPy arrays, as export writes them", "npz"),
        _importer("kitti", "KITTI scan", "kitti", ".bin"),
        _importer("stl", "STL mesh", "mesh"),
        _importer("obj", "Wavefront OBJ mesh", "mesh"),
        _importer("binvox", "binvox grid", "binvox"),
        _importer("bt", "OctoMap binary tree", "octomap"),
        _importer("asc", "ESRI ASCII grid, or columns of numbers", "asc"),
        _importer("tif", "GeoTIFF elevation model", "raster", ".tif", ".tiff"),
    )
}
"""By name; `naming.IMPORT_SUFFIXES` has all their suffixes."""


def importer_of(path: Path, name: str | None) -> Importer:
    """
    Return the importer for a file.

    Parameters
    ----------
    path : pathlib.Path
        Its suffix decides, case does not matter,
    name : str or None
        unless a format is named.

    Raises
    ------
    FormatError
        ``E_NOT_IMPORT``: no format has this suffix.
    """
    if name is not None:
        if name not in FORMATS:
            raise OptionError(f"--from {name}: is not one of {', '.join(FORMATS)}")
        return FORMATS[name]
    suffix = path.suffix.lower()
    for importer in FORMATS.values():
        if suffix in importer.suffixes:
            return importer
    if suffix in (".las", ".laz"):
        raise FormatError(f"{path.name}: `volatool convert` reads LAS and LAZ", "E_NOT_IMPORT")
    raise FormatError(
        f"{path.name}: no importer takes {suffix or 'names without a suffix'}; there are "
        f"{', '.join(IMPORT_SUFFIXES)}, and --from FORMAT for other names",
        "E_NOT_IMPORT",
    )


def read_points(path: Path, options: ConvertOptions) -> ImportedPoints:
    """
    Open a file of any of the formats.

    Parameters
    ----------
    path : pathlib.Path
        The file.
    options : ConvertOptions
        ``from_format``, ``columns``, ``mesh`` and what a mesh needs of cube and depth.

    Returns
    -------
    points : ImportedPoints
        Header and sizes are checked, the points not read yet.

    Raises
    ------
    InputNotFoundError, InputError, FormatError, TruncatedError, OptionError
        With the file's name.
    """
    importer = importer_of(path, options.from_format)
    try:
        if not path.is_file():
            if path.exists():
                raise InputError(f"{path}: is not a file")
            raise InputNotFoundError(f"{path}: no such file")
        if not path.stat().st_size:
            raise FormatError(f"{path}: the file is empty", "E_NOT_IMPORT")
        return importer.read(path, options)
    except VolatoolError as error:
        retell(error, path)
        raise
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: can't be read ({error})") from error


def retell(error: VolatoolError, path: Path) -> None:
    """Put the file's name in front of an error's message, once."""
    text = str(error)
    if error.code not in ("E_OPTION", "E_NO_EXTRA") and not text.startswith(
        (f"{path}:", f"{path.name}:")
    ):
        error.args = (f"{path.name}: {text}",)
