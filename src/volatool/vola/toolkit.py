"""
Volumes as the original toolkit makes them, byte for byte, its defects included.

It rounds to ``4**depth`` points a side instead of taking cells, lets the last point of a voxel give
its metadata and the last voxel of a block (by x, then y, then z) that of the block, and scales the
channels its own way. Bytes 16 to 31 of its header (lat, lon) depend on its PROJ version.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from volatool.cube import MAX_DEPTH, Cube
from volatool.errors import InputError, OptionError, ResourceError
from volatool.model import F64, I64, U64, PointChunk, as_fraction
from volatool.vola.info import VolumeInfo
from volatool.vola.strips import Strips, bit_of, group_starts, linear_numbers
from volatool.vola.volume import Volume

Box = tuple[float, float, float, float, float, float]

ATTRIBUTES = (
    "classification",
    "intensity",
    "number_of_returns",
    "red",
    "green",
    "blue",
    "synthetic",
    "key_point",
    "withheld",
)
"""What `las_words` uses of a chunk, as far as the point format has it."""

_GREY = 200


def las_words(chunk: PointChunk, header_zmax: float) -> U64:
    """
    Metadata word of each point of a LAS file, by the toolkit's scaling.

    Parameters
    ----------
    chunk : PointChunk
        With `ATTRIBUTES`, as far as they exist.
    header_zmax : float
        Largest z of the LAS header, scaled.

    Returns
    -------
    words : (n,) array of uint64
        Bytes red, green, blue, height, returns, intensity, class, 0.

    Raises
    ------
    InputError
        ``E_TOOLKIT``: `header_zmax` is 0, by which the toolkit would divide.

    Notes
    -----
    The height divides the *stored* integer by the *scaled* maximum: with a scale of 0.01 nearly
    everything becomes 255. For point formats 6 to 10, where the toolkit stops, the class and its
    flags are put together as formats 0 to 5 store them.
    """
    if header_zmax == 0:
        raise InputError(
            "the header's largest z is 0 and the toolkit's height channel divides by it; "
            "convert without metadata, or without toolkit compatibility",
            "E_TOOLKIT",
        )
    n = len(chunk)

    def attribute(name: str) -> NDArray[np.int64]:
        values = chunk.attributes.get(name)
        return np.zeros(n, np.int64) if values is None else values.astype(np.int64)

    colour = [attribute(name) >> 8 for name in ("red", "green", "blue")]
    black = (colour[0] | colour[1] | colour[2]) == 0
    raw_class = attribute("classification")
    for bit, name in ((5, "synthetic"), (6, "key_point"), (7, "withheld")):
        raw_class |= attribute(name) << bit
    channels = [
        *(np.where(black, _GREY, values) for values in colour),
        _unit_byte(chunk.z / header_zmax),
        _unit_byte((attribute("number_of_returns") - 1) / 6),
        _unit_byte(attribute("intensity") / 1000),
        _unit_byte(raw_class / 31),
    ]
    words = np.zeros(n, np.uint64)
    for byte, values in enumerate(channels):
        words |= values.astype(np.uint64) << np.uint64(8 * byte)
    return words


def _unit_byte(values: F64) -> I64:
    return np.trunc(255 * np.clip(values, 0.0, 1.0)).astype(np.int64)


def rounded_cells(xyz: F64, box: Box, depth: int) -> tuple[NDArray[np.int32], bool]:
    """
    Cell of each point by the toolkit's rounding.

    Parameters
    ----------
    xyz : (n, 3) array of float64
        Coordinates.
    box : tuple of 6 float
        Tight box of all points; its longest extent is the cube's side.
    depth : int
        Level of the cells.

    Returns
    -------
    cells : (n, 3) array of int32
        ``round_half_to_even((S - 1) * clip((p - min) / ((min + L) - min), 0, 1))`` in float64, in
        this order of operations.
    is_exact : bool
        False: a side of nothing was divided by; 0 stands for the result, as in the toolkit's
        sparse files (its dense writer stops).
    """
    low = np.asarray(box[:3])
    side = max(np.asarray(box[3:]) - low)
    with np.errstate(divide="ignore", invalid="ignore"):
        place = np.clip((xyz - low) / ((low + side) - low), 0.0, 1.0)
    nowhere = np.isnan(place)
    rounded = np.rint((4**depth - 1) * np.where(nowhere, 0.0, place))
    return rounded.astype(np.int32), not nowhere.any()


@dataclass(frozen=True, slots=True)
class _Cells:
    """Cells of one level, by path key: the winning voxel's place and word for each."""

    keys: U64
    places: U64
    words: U64

    def above(self) -> _Cells:
        """Return the cells one level up; the greatest place with a word that is not zero wins."""
        parents = self.keys >> np.uint64(6)
        starts, winners = _last_by_place(parents, self.places, self.words)
        return _Cells(parents[starts], self.places[winners], self.words[winners])


def _last_by_place(groups: U64, places: U64, words: U64) -> tuple[I64, I64]:
    """Return where each group begins, and which of its members writes last and not zero."""
    starts = group_starts(groups)
    if not len(groups):
        return starts, starts
    rank = np.where(words == 0, np.uint64(0), places + np.uint64(1))
    best = np.maximum.reduceat(rank, starts)
    per_member = np.repeat(best, np.diff(starts, append=len(groups)))
    hits = np.flatnonzero(rank == per_member)
    # a group without any word has several hits: the first of each group will do
    return starts, hits[np.searchsorted(hits, starts)]


class ToolkitBuilder:
    """
    Add points in file order, get the toolkit's file.

    Parameters
    ----------
    depth : int
        Number of levels, 1 to 10.
    box : tuple of 6 float
        Minimum x, y, z, then maximum, of all points that will come, as float64 after scaling.
    with_metadata : bool
        Give each block its metadata word.
    header_zmax : float
        Largest z of the LAS header, scaled; for the height channel.
    epsg : int, optional
        For the header.
    lat, lon : float
        For the header.
    """

    def __init__(
        self,
        depth: int,
        box: Box,
        *,
        with_metadata: bool = True,
        header_zmax: float = 0.0,
        epsg: int | None = None,
        lat: float = 0.0,
        lon: float = 0.0,
    ) -> None:
        if not 1 <= depth <= MAX_DEPTH:
            raise ResourceError(f"depth must be 1 to {MAX_DEPTH}, got {depth}", "E_SIZE")
        self.with_metadata = with_metadata
        self.header_zmax = header_zmax
        self.depth = depth
        self.info = VolumeInfo(box=box, quantizer="toolkit", lat=lat, lon=lon, epsg=epsg)
        self._box = box
        self._is_exact = True
        self._runs: list[tuple[U64, U64]] = []

    @property
    def attributes(self) -> tuple[str, ...]:
        """Attributes that the chunks should have."""
        return ATTRIBUTES if self.with_metadata else ()

    def add(self, chunk: PointChunk) -> None:
        """Add the points of a LAS file that follow those added before."""
        words = las_words(chunk, self.header_zmax) if self.with_metadata else None
        self.add_points(chunk.xyz(), words)

    def add_points(self, xyz: F64, words: U64 | None = None) -> None:
        """
        Add points with metadata words of the caller's making.

        Parameters
        ----------
        xyz : (n, 3) array of float64
            Coordinates.
        words : (n,) array of uint64, optional
            Needed with metadata.
        """
        if not len(xyz):
            return
        from volatool.kernels.quantize import cell_keys

        cells, is_exact = rounded_cells(xyz, self._box, self.depth)
        self._is_exact &= is_exact
        if words is None:
            if self.with_metadata:
                raise OptionError("metadata was asked for and no words are given")
            words = np.zeros(len(cells), np.uint64)
        self._runs.append(_last_of_each(cell_keys(cells), words))
        # like a carry: each point is merged about log2(n) times
        while len(self._runs) > 1 and 2 * len(self._runs[-1][0]) >= len(self._runs[-2][0]):
            new, old = self._runs.pop(), self._runs.pop()
            self._runs.append(_merged(old, new))

    def finish(self) -> ToolkitVolume:
        """
        Return what the toolkit would write.

        Raises
        ------
        InputError
            ``E_TOOLKIT``: there are no points.
        """
        while len(self._runs) > 1:
            new, old = self._runs.pop(), self._runs.pop()
            self._runs.append(_merged(old, new))
        if not self._runs:
            raise InputError(
                "there are no points, for which the toolkit writes no file", "E_TOOLKIT"
            )
        keys, words = self._runs[0]
        return ToolkitVolume(
            self.info,
            self.depth,
            _Cells(keys, _places(keys), words),
            has_metadata=self.with_metadata,
            has_extent=self._is_exact,
        )


def _last_of_each(keys: U64, words: U64) -> tuple[U64, U64]:
    order = np.argsort(keys, kind="stable")
    keys, words = keys[order], words[order]
    last = np.append(group_starts(keys)[1:], len(keys)) - 1
    return keys[last], words[last]


def _merged(old: tuple[U64, U64], new: tuple[U64, U64]) -> tuple[U64, U64]:
    return _last_of_each(np.concatenate([old[0], new[0]]), np.concatenate([old[1], new[1]]))


def _places(keys: U64) -> U64:
    """Return x, y, z of cells as one number, x most significant."""
    from volatool.kernels.quantize import key_cells

    x, y, z = key_cells(keys, MAX_DEPTH).T.astype(np.uint64)
    places: U64 = x << np.uint64(40) | y << np.uint64(20) | z
    return places


class ToolkitVolume:
    """
    The content of a file of the toolkit, to be written sparse or dense by `formats.toolkit`.

    Made by `ToolkitBuilder.finish`.

    Attributes
    ----------
    info : VolumeInfo
        Box, EPSG code, lat and lon of the header.
    depth : int
        Number of levels.
    has_metadata : bool
        With metadata words.
    has_extent : bool
        False: all points are in one place, where the toolkit's dense writer stops.
    """

    def __init__(
        self, info: VolumeInfo, depth: int, voxels: _Cells, *, has_metadata: bool, has_extent: bool
    ) -> None:
        self.info = info
        self.depth = depth
        self.has_metadata = has_metadata
        self.has_extent = has_extent
        self._cells = [voxels]  # by level, the root's cells first
        for _ in range(depth - 1):
            self._cells.insert(0, self._cells[0].above())

    def volume(self) -> Volume:
        """
        Return the sparse content as a volume.

        Raises
        ------
        InputError
            ``E_TOOLKIT``: a block's metadata word is zero, which the toolkit leaves out so that
            its file can't be read.
        """
        levels, metadata = [], []
        for cells in self._cells:
            starts = group_starts(cells.keys >> np.uint64(6))
            levels.append(np.bitwise_or.reduceat(bit_of(cells.keys), starts))
            metadata.append(cells.above().words)
        n_zero = sum(len(words) - int(np.count_nonzero(words)) for words in metadata)
        if self.has_metadata and n_zero:
            raise InputError(
                f"{n_zero} blocks have a metadata word of zero; the toolkit would leave them out "
                "and no reader could read the file; convert without metadata, or without toolkit "
                "compatibility",
                "E_TOOLKIT",
            )
        words = tuple(metadata) if self.has_metadata else None
        return Volume(tuple(levels), words, self._cube(), self.info)

    def _cube(self) -> Cube:
        assert self.info.box is not None
        exact = [as_fraction(value) for value in self.info.box]
        return Cube.from_exact(exact[:3], max(exact[3 + a] - exact[a] for a in range(3)))

    def strips(self, level: int) -> Strips:
        """Return one level as the toolkit's dense files have it, root is level 1."""
        from volatool.kernels.quantize import key_cells

        cells = self._cells[level - 1]
        linear = linear_numbers(key_cells(cells.keys, level), level)
        order = np.argsort(linear)
        linear = linear[order]
        numbers = linear >> np.uint64(6)
        starts, winners = _last_by_place(numbers, cells.places[order], cells.words[order])
        words = np.bitwise_or.reduceat(bit_of(linear), starts)
        metadata = cells.words[order][winners] if self.has_metadata else None
        return Strips(numbers[starts], words, metadata)


def build(
    chunks: Callable[[Iterable[str]], Iterable[PointChunk]],
    depth: int,
    *,
    with_metadata: bool = True,
    header_zmax: float = 0.0,
    epsg: int | None = None,
    lat: float = 0.0,
    lon: float = 0.0,
) -> ToolkitVolume:
    """
    Return what the toolkit would write for a LAS file, in two passes.

    Parameters
    ----------
    chunks : callable
        Given attribute names, a new stream of all points in file order (`PointSource.chunks`).
    depth, with_metadata, header_zmax, epsg, lat, lon
        As `ToolkitBuilder` has them.

    Returns
    -------
    volume : ToolkitVolume
        To be written by `formats.toolkit`.
    """
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for chunk in chunks(()):
        if len(chunk):
            # scaling is monotonous: the ends of the stored integers are the ends of the box
            stored = np.array([[v.min(), v.max()] for v in (chunk.x, chunk.y, chunk.z)], np.int64)
            ends = np.sort(stored * np.array(chunk.scale)[:, None], axis=1)
            ends += np.array(chunk.offset)[:, None]
            low, high = np.minimum(low, ends[:, 0]), np.maximum(high, ends[:, 1])
    if not np.isfinite(low).all():
        raise InputError("there are no points, for which the toolkit writes no file", "E_TOOLKIT")
    box = tuple(float(value) for value in (*low, *high))
    builder = ToolkitBuilder(
        depth,
        box,  # type: ignore[arg-type]
        with_metadata=with_metadata,
        header_zmax=header_zmax,
        epsg=epsg,
        lat=lat,
        lon=lon,
    )
    for chunk in chunks(builder.attributes):
        builder.add(chunk)
    return builder.finish()
