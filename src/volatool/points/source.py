"""What a stream of points is, whether it comes from a file or is reprojected on the way."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Protocol

from volatool.cube import Cube
from volatool.errors import CodedWarning
from volatool.model import CrsInfo, PointChunk
from volatool.points.header import LasHeader


class Named(Protocol):
    """What an elevation model needs of its input beside the points."""

    @property
    def name(self) -> str:
        """File name without folders."""
        ...

    @property
    def crs(self) -> CrsInfo:
        """CRS of the coordinates."""
        ...


class Source(Protocol):
    """
    Points in file order, as often as wanted: `PointSource` and `Reprojected`.

    Attributes
    ----------
    name, path : str
        File name without and with folders.
    header : LasHeader
        What the header claims; scale, offset and box are those of the chunks' CRS.
    crs : CrsInfo
        Of the coordinates.
    warnings : list of CodedWarning
        Grows while reading.
    n_points : int
        Points that can be read, as far as it is known.
    is_partial : bool
        Points were lost (salvage only).
    n_unread : int
        Points that are left out unread, as they lie outside the bounds asked for.
    format : str or None
        Name of an imported format; None of LAS, LAZ and COPC.
    own_grid : (Cube, int) or None
        Cube and depth whose voxels the points are the middles of (imported grids only).
    """

    @property
    def name(self) -> str:
        """File name without folders."""
        ...

    @property
    def path(self) -> str:
        """File name as given."""
        ...

    @property
    def header(self) -> LasHeader:
        """What the header claims."""
        ...

    @property
    def crs(self) -> CrsInfo:
        """CRS of the coordinates."""
        ...

    @property
    def warnings(self) -> list[CodedWarning]:
        """Warnings so far."""
        ...

    @property
    def n_points(self) -> int:
        """Points that can be read."""
        ...

    @property
    def is_partial(self) -> bool:
        """Points were lost."""
        ...

    @property
    def n_unread(self) -> int:
        """Points that are left out unread."""
        ...

    @property
    def format(self) -> str | None:
        """Name of an imported format; None of LAS, LAZ and COPC."""
        ...

    @property
    def own_grid(self) -> tuple[Cube, int] | None:
        """Cube and depth that the points come from."""
        ...

    def chunks(
        self, attributes: Iterable[str] = (), chunk_points: int = ...
    ) -> Iterator[PointChunk]:
        """Stream the points."""
        ...

    def read_all(self) -> None:
        """Leave nothing out from now on."""
        ...

    def close(self) -> None:
        """Close the file."""
        ...
