"""The grid of another volume, for ``--cube-from``: its cube, depth and CRS, levels unread."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path

from volatool.cube import MAX_DEPTH, Cube
from volatool.errors import CRSError, OptionError
from volatool.model import CrsInfo


@dataclass(frozen=True, slots=True)
class Reference:
    """
    The grid of a VOLA file.

    Parameters
    ----------
    name : str
        Of the file, without its folder.
    cube : Cube
        The extent, exact if the file has a trailer.
    depth : int
        Number of levels.
    crs : CrsInfo
        Of the file.
    """

    name: str
    cube: Cube
    depth: int
    crs: CrsInfo

    def check_crs(self, crs: CrsInfo, name: str) -> None:
        """
        Raise if the numbers of an input are not in the CRS of the cube.

        Parameters
        ----------
        crs : CrsInfo
            Of the input; an unknown one is taken to be the same.
        name : str
            Of the input.

        Raises
        ------
        CRSError
            ``E_CRS``.
        """
        from volatool.points.crs import difference

        found = difference(crs, self.crs)
        if found is not None:
            raise CRSError(
                f"{name}: is not in the CRS of --cube-from {self.name}: {found}; convert it with "
                "--to-crs, or with --crs where the file is wrong"
            )


def reference(name: str) -> Reference:
    """
    Return the grid of a VOLA file: header and trailer are read, not the levels.

    Parameters
    ----------
    name : str
        Sparse or dense, gzip or not.

    Raises
    ------
    InputError
        ``E_NOT_FOUND``, ``E_NOT_VOLA``, ...: not such a file.
    OptionError
        ``E_CUBE``: more levels than can be built.
    """
    try:
        status = Path(name).stat()
        version = (status.st_mtime_ns, status.st_size)
    except (OSError, ValueError):  # reading it says what is wrong
        version = (0, 0)
    return _reference(name, version)


@functools.lru_cache(maxsize=4)  # each cube of each tile asks
def _reference(name: str, version: tuple[int, int]) -> Reference:
    from volatool.formats.registry import read_info

    found = read_info(name)
    depth = found.header.depth
    if depth > MAX_DEPTH:
        raise OptionError(
            f"--cube-from {name}: has {depth} levels, at most {MAX_DEPTH} can be built", "E_CUBE"
        )
    return Reference(Path(name).name, found.cube, depth, found.info.crs)
