"""
The 80-byte header of a VOLA file.

====== ==== ========== ====================================================================
offset type name       meaning
====== ==== ========== ====================================================================
0      u32  headersize always 80
4      u16  version    always 1
6      u8   mode       0 sparse, 1 dense
7      u8   depth      number of levels; the grid has ``4**depth`` cells a side
8      u32  nbits      metadata words per block: 0 or 1
12     u32  crs        horizontal EPSG code; 2000 means not set
16     f64  lat        latitude of the middle of the box, WGS 84 degrees (information only)
24     f64  lon        longitude of the same
32     f64  minx       bounding box; its minimum is the cube's corner, its longest extent the side
40     f64  miny
48     f64  minz
56     f64  maxx
64     f64  maxy
72     f64  maxz
====== ==== ========== ====================================================================

Little-endian, no magic number, no checksum.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass

from volatool.cube import Cube
from volatool.errors import FormatError, OptionError, ResourceError, TruncatedError
from volatool.model import as_fraction
from volatool.vola.volume import MAX_LEVELS, Volume

HEADER_BYTES = 80
NO_CRS = 2000
SPARSE, DENSE = 0, 1
_LAYOUT = struct.Struct("<IHBBII8d")

_LOOKS = (
    (b"LASF", "a LAS or LAZ file: convert it first"),
    (b"\x1f\x8b", "gzip inside gzip"),
    (b"PK", "a ZIP archive"),
    (b"VOLZ", "a volz file"),
    (b"II*\0", "a TIFF image"),
    (b"MM\0*", "a TIFF image"),
    (b"{", "JSON"),
    (b"<", "HTML or XML"),
    (b"ply", "a PLY file"),
)


@dataclass(frozen=True, slots=True)
class Header:
    """
    The fields of the table above, checked on construction.

    Parameters
    ----------
    mode : int
        0 sparse, 1 dense.
    depth : int
        Number of levels.
    nbits : int
        Metadata words per block, 0 or 1.
    crs : int
        Horizontal EPSG code or 2000.
    lat, lon : float
        Degrees; anything, also NaN and infinity.
    box : tuple of 6 float
        Minimum x, y, z, then maximum; finite, maximum >= minimum.
    """

    mode: int
    depth: int
    nbits: int
    crs: int
    lat: float
    lon: float
    box: tuple[float, float, float, float, float, float]

    def __post_init__(self) -> None:
        if self.mode not in (SPARSE, DENSE):
            raise FormatError(f"mode is {self.mode}, expected 0 (sparse) or 1 (dense) (offset 6)")
        if self.depth < 1:
            raise FormatError(f"depth is {self.depth}, expected at least 1 (offset 7)")
        if self.depth > MAX_LEVELS:
            raise ResourceError(
                f"depth is {self.depth}, at most {MAX_LEVELS} levels can be held (offset 7)",
                "E_SIZE",
            )
        if self.nbits not in (0, 1):
            raise FormatError(
                f"nbits is {self.nbits}, expected 0 or 1 metadata words per block (offset 8)"
            )
        if not all(map(math.isfinite, self.box)):
            raise FormatError(f"bounding box is not finite: {self.box} (offset 32)")
        if any(low > high for low, high in zip(self.box[:3], self.box[3:], strict=True)):
            raise FormatError(
                f"bounding box has its maximum below its minimum: {self.box} (offset 32)"
            )
        if not math.isfinite(self.side):
            raise FormatError(f"bounding box is too large for a float64: {self.box} (offset 32)")

    @property
    def side(self) -> float:
        """Longest extent of the box: the side of the cube."""
        return max(high - low for low, high in zip(self.box[:3], self.box[3:], strict=True))

    @property
    def epsg(self) -> int | None:
        """EPSG code, None when not set."""
        return None if self.crs in (0, NO_CRS) else self.crs

    @property
    def place(self) -> tuple[float, float] | tuple[None, None]:
        """Latitude and longitude, None where they mean nothing."""
        known = self.epsg is not None and (self.lat, self.lon) != (0.0, 0.0)
        if known and math.isfinite(self.lat) and math.isfinite(self.lon):
            return self.lat, self.lon
        return None, None

    @classmethod
    def of(cls, volume: Volume, mode: int) -> Header:
        """
        Return the header of a volume.

        Parameters
        ----------
        volume : Volume
            Its cube becomes the box, so that the original toolkit places the cells right.
        mode : int
            0 sparse, 1 dense.
        """
        x, y, z = volume.cube.origin
        side = volume.cube.side
        info = volume.info
        return cls(
            mode,
            volume.depth,
            int(volume.has_metadata),
            NO_CRS if info.epsg is None else info.epsg,
            _finite(info.lat),
            _finite(info.lon),
            (x, y, z, x + side, y + side, z + side),
        )

    def cube(self) -> Cube:
        """Return the cube: the box's minimum and its longest extent, as exact decimals."""
        exact = [as_fraction(value) for value in self.box]
        side = max(exact[3 + axis] - exact[axis] for axis in range(3))
        return Cube.from_exact(exact[:3], side)

    def to_bytes(self) -> bytes:
        """Return the 80 bytes."""
        try:
            return _LAYOUT.pack(
                HEADER_BYTES,
                1,
                self.mode,
                self.depth,
                self.nbits,
                self.crs,
                self.lat,
                self.lon,
                *self.box,
            )
        except struct.error as error:
            raise OptionError(
                f"the VOLA header can't hold EPSG code {self.crs}: {error}", "E_CRS"
            ) from error

    @classmethod
    def from_bytes(cls, data: bytes) -> Header:
        """
        Return the header at the start of a file.

        Parameters
        ----------
        data : bytes
            The first 80 bytes, or fewer if there are no more.

        Raises
        ------
        FormatError
            ``E_NOT_VOLA``: these are not the first bytes of a VOLA file; ``E_CORRUPT``: they are,
            but a field makes no sense.
        TruncatedError
            ``E_TRUNCATED``: the file ends inside the header.
        ResourceError
            ``E_SIZE``: more levels than can be held.
        """
        if data[:6] != struct.pack("<IH", HEADER_BYTES, 1)[: len(data)] or not data:
            raise FormatError(f"not a VOLA file: {_looks_like(data)} (offset 0)", "E_NOT_VOLA")
        if len(data) < HEADER_BYTES:
            raise TruncatedError(
                f"the file ends inside the header of {HEADER_BYTES} bytes (offset {len(data)})"
            )
        _, _, mode, depth, nbits, crs, lat, lon, *box = _LAYOUT.unpack(data[:HEADER_BYTES])
        return cls(mode, depth, nbits, crs, lat, lon, tuple(box))


def _finite(value: float | None) -> float:
    return value if value is not None and math.isfinite(value) else 0.0


def _looks_like(data: bytes) -> str:
    if not data:
        return "it is empty"
    for start, words in _LOOKS:
        if data.lstrip()[:8].startswith(start):
            return f"it looks like {words}"
    if data[:4] == struct.pack("<I", HEADER_BYTES) and len(data) >= 6:
        return f"its version is {int.from_bytes(data[4:6], 'little')}, expected 1"
    if data[:4] == struct.pack(">I", HEADER_BYTES):
        return "it may be a VOLA file of a big-endian machine"
    return f"it begins with {data[:8]!r}, expected a header size of {HEADER_BYTES} and version 1"
