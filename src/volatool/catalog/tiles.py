"""The tiles of a folder: each volume's header, and what was written beside it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from volatool.errors import InputError, InputNotFoundError
from volatool.formats.header import SPARSE, Header
from volatool.formats.registry import FileInfo, open_volume, read_info
from volatool.model import Bounds
from volatool.naming import stem

_VOLUMES = (".vol", ".vol.gz")  # in this order: the plain one is what the original reads
_BESIDE = {
    "dense": (".dvol.gz", ".dvol"),
    "dem": (".dem.tif",),
    "report": (".stats.json",),
    "preview": (".preview.png",),
}


@dataclass(frozen=True, slots=True)
class Tile:
    """
    One sparse volume of a data set.

    Parameters
    ----------
    path : pathlib.Path
        The file.
    facts : FileInfo
        Its header and trailer.
    beside : dict of str to pathlib.Path
        What stands beside it: ``"dense"``, ``"dem"``, ``"report"``, ``"preview"``.
    """

    path: Path
    facts: FileInfo
    beside: dict[str, Path]

    @property
    def name(self) -> str:
        """The name without suffixes."""
        return stem(self.path)

    @property
    def header(self) -> Header:
        """The 80 bytes."""
        return self.facts.header

    @property
    def box(self) -> tuple[float, float, float, float, float, float]:
        """Tight box of the points if known, else the header's, which may be the whole cube."""
        return self.facts.info.box or self.header.box

    @property
    def n_voxels(self) -> int:
        """Voxels; a file without a trailer is read for it."""
        told = (self.facts.trailer or {}).get("voxels")
        return told if isinstance(told, int) else len(open_volume(self.path))

    @property
    def bounds(self) -> Bounds:
        """The box seen from above."""
        left, bottom, _, right, top, _ = self.box
        return Bounds(left, bottom, right, top)


def tiles_of(folder: Path) -> list[Tile]:
    """
    Return the sparse volumes of a folder, sorted by name.

    Parameters
    ----------
    folder : pathlib.Path
        Searched for ``*.vol`` and ``*.vol.gz``, without the folders in it; of a tile that is there
        as both, the plain file is taken.

    Raises
    ------
    InputNotFoundError
        No such folder.
    InputError
        ``E_INPUT``: there is no volume in it.
    FormatError, TruncatedError, ResourceError
        One of them is not what its name says; it is named.
    """
    if not folder.is_dir():
        found = "is not a folder" if folder.exists() else "no such folder"
        raise InputNotFoundError(f"{folder}: {found}")
    try:
        names = sorted(path.name for path in folder.iterdir() if not path.name.startswith("."))
    except OSError as error:
        raise InputError(f"{folder}: can't be read ({error.strerror})") from error
    paths: dict[str, Path] = {}
    for suffix in _VOLUMES:
        for name in names:
            if name.lower().endswith(suffix):
                paths.setdefault(stem(Path(name)), folder / name)
    if not paths:
        raise InputError(f"{folder}: holds no .vol or .vol.gz files; make some with convert")
    tiles = []
    for key in sorted(paths):
        facts = read_info(paths[key])
        if facts.header.mode != SPARSE:
            raise InputError(f"{paths[key]}: is a dense volume, its name says it is sparse")
        tiles.append(Tile(paths[key], facts, _beside(paths[key])))
    return tiles


def _beside(path: Path) -> dict[str, Path]:
    found: dict[str, Path] = {}
    for kind, suffixes in _BESIDE.items():
        for suffix in suffixes:
            candidate = path.with_name(stem(path) + suffix)
            if candidate.is_file():
                found.setdefault(kind, candidate)
    return found
