"""File names: what an input is by its suffix, and what its outputs begin with."""

from __future__ import annotations

from pathlib import Path

POINT_SUFFIXES = (".las", ".laz")
"""What a folder is searched for; COPC files end in ``.copc.laz``."""

IMPORT_SUFFIXES = (
    ".xyz", ".txt", ".csv", ".pts", ".ply", ".pcd", ".npy", ".npz", ".bin", ".stl", ".obj",
    ".binvox", ".bt", ".asc", ".tif", ".tiff",
)  # fmt: skip
"""What `import` takes by itself, and searches a folder for."""

VOLUME_SUFFIXES = (".vol.gz", ".dvol.gz", ".vol", ".dvol")
"""What counts as a VOLA file where points and volumes are both taken."""

LAYERS = ("count", "flag", "distance", "sigma")
"""Rasters that may stand beside an elevation model: ``NAME.dem.LAYER.tif``."""

SET_SUFFIX = ".set.json"
"""What the index of headers ends in that the tiles of a mosaic share."""

OUTPUT_SUFFIXES = (
    *VOLUME_SUFFIXES,
    ".stats.json",
    ".dem.tif",
    *(f".dem.{layer}.tif" for layer in LAYERS),
)
"""What the outputs of a tile end in, pictures apart."""

_STEM_SUFFIXES = (".copc.laz", *POINT_SUFFIXES, *VOLUME_SUFFIXES, *IMPORT_SUFFIXES)


def stem(path: Path) -> str:
    """
    Return the name that outputs of an input begin with.

    Examples
    --------
    >>> stem(Path("a/tile.1.copc.laz"))
    'tile.1'
    """
    name = path.name
    for suffix in _STEM_SUFFIXES:
        if name.lower().endswith(suffix) and len(name) > len(suffix):
            return name[: -len(suffix)]
    return name
