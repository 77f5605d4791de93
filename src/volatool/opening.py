"""Opening what a tile is read from: points of a file or URL, imported formats, reprojected."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import astuple
from pathlib import Path
from typing import TYPE_CHECKING

from volatool.errors import CRSError, FormatError
from volatool.model import Bounds
from volatool.naming import VOLUME_SUFFIXES
from volatool.options import ConvertOptions
from volatool.remote.path import is_url
from volatool.remote.staging import local_copy

if TYPE_CHECKING:
    from volatool.imports.source import ImportSource
    from volatool.points.reader import PointSource
    from volatool.points.source import Source


def is_volume(path: Path) -> bool:
    """Tell whether a name is a VOLA file's."""
    return path.name.lower().endswith(VOLUME_SUFFIXES)


@contextmanager
def open_source(
    path: Path, options: ConvertOptions, *, allow_degrees: bool = False, kind: str = "convert"
) -> Iterator[Source]:
    """
    Open an input, reprojected if that is asked for.

    Parameters
    ----------
    path : pathlib.Path
        LAS, LAZ or COPC; for the kind ``"import"`` one of the formats of `volatool.imports`.
    options : ConvertOptions
        CRS options, ``salvage`` and ``strict``; those of imports.
    allow_degrees : bool
        Don't refuse coordinates in degrees.
    kind : str
        As in `volatool.tile.convert_tile`.

    Raises
    ------
    CRSError
        ``E_GEOGRAPHIC``: coordinates are degrees and no other CRS is asked for.
    """
    if is_volume(path) and path.is_file():
        raise FormatError(
            f"{path.name}: is a VOLA volume, not points; `volatool dem` makes an elevation model "
            "of it, `volatool stats` its tables",
            "E_NOT_LAS",
        )
    with _opened(path, options, kind) as source:
        if options.to_crs is not None:
            from volatool.points.reproject import Reprojected

            moved = Reprojected(source, options.to_crs)
            if moved.crs.is_geographic:
                raise CRSError(
                    f"--to-crs {options.to_crs}: coordinates would be degrees; give a projected "
                    "CRS, such as utm",
                    "E_GEOGRAPHIC",
                )
            yield moved
            return
        if source.crs.is_geographic and source.n_points and not allow_degrees:
            from volatool.points.crs_places import utm_for

            left, bottom, _, right, top, _ = source.header.box
            zone = None
            if left <= right and bottom <= top:  # a header's box may be anything
                zone = utm_for(source.crs, Bounds(left, bottom, right, top))
            raise CRSError(
                f"{source.name}: coordinates are in degrees; give --to-crs {zone or 'utm'}",
                "E_GEOGRAPHIC",
            )
        yield source


@contextmanager
def _opened(path: Path, options: ConvertOptions, kind: str) -> Iterator[PointSource | ImportSource]:
    if kind == "import":
        from volatool.imports.source import ImportSource

        with local_copy(path) as local, ImportSource(local, options) as imported:
            yield imported
        return
    from volatool.points.reader import open_points

    near = None
    if options.bounds is not None and options.to_crs is None and kind != "classify":
        near = astuple(options.bounds)  # to_crs: they are in another CRS than the file
    with open_points(
        path,
        crs=options.crs,
        crs_default=options.crs_default,
        salvage=options.salvage,
        strict=options.strict,
        near=near if is_url(path) else None,
    ) as source:
        yield source
