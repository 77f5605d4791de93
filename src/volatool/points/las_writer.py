"""Write points as LAS 1.4 or LAZ, piece by piece, by laspy: point format 6, or 7 with colours."""

from __future__ import annotations

from typing import Any, BinaryIO

import laspy
import lazrs
import numpy as np
from laspy.vlrs.known import WktCoordinateSystemVlr
from numpy.typing import NDArray

from volatool._version import __version__
from volatool.errors import OutputError
from volatool.points.relay import Relay, uninterrupted

_I32 = np.iinfo(np.int32)
_DATE_AT = 90
_LONGEST_RECORD = 65535


class LasWriter:
    """
    A LAS or LAZ file that is written piece by piece.

    Parameters
    ----------
    out : binary file
        Empty, seekable; it stays open.
    scale, offset : tuple of 3 float
        ``coordinate = stored * scale + offset``.
    has_colours : bool
        Point format 7 instead of 6.
    is_compressed : bool
        LAZ.
    wkt : str, optional
        CRS.

    Raises
    ------
    OutputError
        The CRS does not fit a record.
    """

    def __init__(
        self,
        out: BinaryIO,
        scale: tuple[float, float, float],
        offset: tuple[float, float, float],
        *,
        has_colours: bool,
        is_compressed: bool,
        wkt: str | None = None,
    ) -> None:
        self._out = Relay(out)
        header = laspy.LasHeader(point_format=7 if has_colours else 6, version="1.4")
        header.scales, header.offsets = np.array(scale), np.array(offset)
        header.generating_software = f"volatool {__version__}"
        if wkt is not None:
            if len(wkt.encode()) >= _LONGEST_RECORD:
                raise OutputError("the CRS is too long for a record of a LAS file")
            header.vlrs.append(WktCoordinateSystemVlr(wkt))
            header.global_encoding.wkt = True
        self._header = header
        backend = laspy.LazBackend.LazrsParallel if is_compressed else None
        self._writer = laspy.LasWriter(
            self._out, header, do_compress=is_compressed, laz_backend=backend, closefd=False
        )

    def write(self, stored: NDArray[Any], **attributes: Any) -> None:
        """
        Append points.

        Parameters
        ----------
        stored : (n, 3) array of int
            x, y, z as they are stored.
        **attributes : (n,) arrays or scalars
            ``intensity``, ``classification``, ``red``, ``green``, ``blue``, and
            ``number_of_returns`` (1 to 15, 1 if not given); each is the first return.

        Raises
        ------
        OutputError
            A coordinate does not fit 32 bits, or the points can't be compressed.
        """
        if not len(stored):
            return
        if stored.min() < _I32.min or stored.max() > _I32.max:
            raise OutputError("coordinates don't fit the 32 bits of a LAS file at this scale")
        points = laspy.ScaleAwarePointRecord.zeros(len(stored), header=self._header)
        for axis, name in enumerate("XYZ"):
            points[name] = stored[:, axis]
        for name, values in {"return_number": 1, "number_of_returns": 1, **attributes}.items():
            # laspy packs bits of whole numbers only
            points[name] = np.broadcast_to(values, len(stored)).astype(np.uint16)
        try:
            with uninterrupted():
                self._writer.write_points(points)
        except (laspy.errors.LaspyException, lazrs.LazrsError) as error:
            raise self._out.cause(error, "the points can't be written") from error

    def finish(self) -> None:
        """Write what waits, and the header."""
        try:
            with uninterrupted():
                self._writer.close()
        except (laspy.errors.LaspyException, lazrs.LazrsError) as error:
            raise self._out.cause(error, "the points can't be written") from error
        # laspy writes today's date: the same points are to be the same bytes
        self._out.seek(_DATE_AT)
        self._out.write(bytes(4))
