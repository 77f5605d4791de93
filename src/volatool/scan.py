"""One read of a tile for all products: census, volume builders and surface points."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from volatool.ahead import ahead
from volatool.census import (
    Census,
    HeightLimits,
    StoredBox,
    area_cell_for,
    box_corners,
    header_box,
)
from volatool.cube import Cube
from volatool.errors import CodedWarning, InputError, OptionError, ResourceError
from volatool.model import Bool, PointChunk, Progress
from volatool.options import ConvertOptions
from volatool.points.select import selection_for
from volatool.reference import reference
from volatool.snapped import CubeIndex, by_cube, snapped_cube

if TYPE_CHECKING:
    from volatool.dem.gather import SurfaceGatherer
    from volatool.points.source import Source
    from volatool.vola.builder import VolaBuilder

BuilderMaker = Callable[[Cube], "VolaBuilder"]

MAX_CUBES = 2048
"""Volumes that ``--split`` makes of one tile: each keeps a builder, and files when it spills."""

_CENSUS_ATTRIBUTES = frozenset({"classification", "return_number"})


@dataclass(slots=True)
class Scan:
    """
    What one read of a tile has gathered.

    Parameters
    ----------
    census : Census
        Counts and boxes of the points.
    builders : dict of cube index to VolaBuilder
        One with the index (0, 0, 0), or one per snapped cube with ``--split``.
    box : tuple of 6 int or None
        The box that the cube was made for: all points read, or with ``--robust-z`` those used.
    n_passes : int
        Reads of the file: 1 unless the header's box was of no use.
    warnings : list of CodedWarning
        What came up.
    """

    census: Census
    builders: dict[CubeIndex, VolaBuilder]
    box: StoredBox | None
    n_passes: int
    warnings: list[CodedWarning] = field(default_factory=list)


class TileScanner:
    """
    Reads a tile, as often as its header forces it to, which is once if the header is right.

    Parameters
    ----------
    source : Source
        The open file.
    options : ConvertOptions
        Selection and cube.
    make_builder : callable
        Gives the builder for a cube.
    channel_attributes : frozenset of str
        Attributes that the builders need.
    surface : SurfaceGatherer or None
        Takes the points of the elevation model.
    progress : callable
        Called with (points done, points of the file), in the thread that reads.
    with_volume : bool
        Build volumes; without them the box does not matter.
    """

    def __init__(
        self,
        source: Source,
        options: ConvertOptions,
        make_builder: BuilderMaker,
        channel_attributes: frozenset[str],
        surface: SurfaceGatherer | None,
        progress: Progress,
        with_volume: bool = True,
    ) -> None:
        self.source = source
        self.with_volume = with_volume
        self.options = options
        self.make_builder = make_builder
        self.surface = surface
        self.progress = progress
        self.selection = selection_for(options)
        header = source.header
        self.attributes = (
            self.selection.attributes(header)
            | channel_attributes
            | (_CENSUS_ATTRIBUTES & header.dimensions)
        )
        # four chunks (in the making, waiting, in use), decoded records and keys must fit beside
        # everything else
        room = max(1000, (options.memory // 8) // (header.record_bytes + 200))
        self.chunk_points = min(options.chunk_points, room)
        self.limits: HeightLimits | None = None
        self.n_passes = 0
        self.n_outside = 0
        self.given_cube: Cube | None = None
        if options.cube_from is not None and with_volume:
            found = reference(options.cube_from)
            found.check_crs(source.crs, source.name)
            self.given_cube = found.cube

    def run(self) -> Scan:
        """Read the tile and return what was gathered."""
        expected = self._expected_box()
        census, builders = self._pass(expected, self.surface)
        box = census.box_used if self.options.robust_z else census.box
        if box != expected and self.source.n_unread and not self.options.robust_z:
            self.source.read_all()  # the header's box is wrong: those unread may lie anywhere
            box = self._survey(expected).box
        if box is not None and box != expected:
            if self.with_volume and (builders is None or self._cube(box) != self._cube(expected)):
                for builder in (builders or {}).values():
                    builder.close()
                census, builders = self._pass(box, None)
                assert builders is not None, "a point outside the box of all points"
            else:
                census = self._survey(box)  # heights and area are counted over the box
        warnings = self._box_warnings(census.box) + self._outside_warnings(census)
        return Scan(census, builders or {}, box, self.n_passes, warnings)

    def visit(self, take: Callable[[PointChunk, Bool | None], None]) -> Scan:
        """
        Read the tile for a taker of one's own, without builders.

        Parameters
        ----------
        take : callable
            Given each chunk and the mask of the points to use, None for all.
        """
        expected = self._expected_box()
        census = self._census(expected)
        with ahead(self._counted(census)) as chunks:
            for chunk, mask in chunks:
                take(chunk, mask)
        if census.box is not None and census.box != expected and self.limits is None:
            census = self._survey(census.box)
        return Scan(census, {}, census.box, self.n_passes, self._box_warnings(census.box))

    def _expected_box(self) -> StoredBox:
        """Return the box to make the cube for, from the header if it can be trusted so far."""
        header = self.source.header
        box = header_box(header.box, header.scale, header.offset)
        if box is None:
            box = self._survey((0, 0, 0, 0, 0, 0)).box or (0, 0, 0, 0, 0, 0)
        if self.options.robust_z:
            census = self._survey(box)
            if census.box is not None and census.box != box:
                census = self._survey(census.box)
            self.limits = census.isolated(of_used=True)
            if self.limits is not None:
                census = self._survey(census.box or box)
            box = census.box_used or box
        try:
            self._cube(box)
        except OptionError:
            # refuse the points for not fitting a cube, not the header's word on them
            box = self._survey(box).box or box
        return box

    def _survey(self, box: StoredBox) -> Census:
        """Read the tile for its census only."""
        census = self._census(box)
        with ahead(self._counted(census)) as chunks:
            for _ in chunks:
                pass
        return census

    def _census(self, box: StoredBox) -> Census:
        scale = self.source.header.scale
        unit = self.source.crs.metres_per_unit_xy
        return Census(box, area_cell_for(box, scale, unit), self.source.n_unread)

    def _counted(self, census: Census) -> Generator[tuple[PointChunk, Bool | None]]:
        """Yield the chunks of one pass, added to the census, with the mask of the points to use."""
        self.n_passes += 1
        done = 0
        for chunk in self.source.chunks(self.attributes, self.chunk_points):
            mask = self.selection.mask(chunk, census.dropped)
            if self.limits is not None:
                mask = self._within_limits(chunk, mask, census.dropped)
            census.add(chunk, mask)
            yield chunk, mask
            done += len(chunk)
            # here and not by who asks for the chunks: stderr is shut while LAZ is decoded
            self.progress(done, self.source.n_points)

    def _used(self, census: Census, surface: SurfaceGatherer | None) -> Generator[PointChunk]:
        """Yield what is used of the chunks of one pass, given to the surface already."""
        for chunk, mask in self._counted(census):
            used = chunk if mask is None else chunk.take(mask)
            if surface is not None:
                surface.add(used)
            yield used

    def _within_limits(self, chunk: PointChunk, mask: Bool | None, dropped: dict[str, int]) -> Bool:
        assert self.limits is not None
        inside: Bool = (chunk.z >= self.limits.low) & (chunk.z <= self.limits.high)
        if mask is None:
            mask = np.ones(len(chunk), np.bool_)
        dropped["z_outlier"] = dropped.get("z_outlier", 0) + int(np.count_nonzero(mask & ~inside))
        return mask & inside

    def _pass(
        self, box: StoredBox, surface: SurfaceGatherer | None
    ) -> tuple[Census, dict[CubeIndex, VolaBuilder] | None]:
        """Read the tile for all products; builders are None if a point lay outside the box."""
        census = self._census(box)
        builders: dict[CubeIndex, VolaBuilder] | None = {} if self.with_volume else None
        cube = self._cube(box)
        # all but the builders' work is done in the reader's thread: see `ahead`
        with ahead(self._used(census, surface)) as chunks:
            for used in chunks:
                if builders is not None and len(used) and not self._build(used, builders, cube):
                    for builder in builders.values():
                        builder.close()
                    builders = None
        return census, builders

    def _build(
        self, used: PointChunk, builders: dict[CubeIndex, VolaBuilder], cube: Cube | None
    ) -> bool:
        """Give points to the builders; False if one lies outside the cube."""
        if cube is not None:
            builder = builders.get((0, 0, 0))
            if builder is None:
                builder = builders[0, 0, 0] = self.make_builder(cube)
            n_outside = builder.add(used)
            if self.given_cube is not None:  # no other cube would do: they are left out, and told
                self.n_outside += n_outside
                return True
            return n_outside == 0
        for index, part in self._split(used):
            builder = builders.get(index)
            if builder is None:
                if len(builders) == MAX_CUBES:
                    raise self._too_many_cubes()
                builder = builders[index] = self.make_builder(self._split_cube(index))
            outside = builder.add(part)
            assert outside == 0, "a point outside the snapped cube that it was sorted into"
        return True

    def _cube(self, box: StoredBox) -> Cube | None:
        """Return the cube for a box; None if there is none or, with ``--split``, many."""
        if self.options.split is not None or not self.with_volume:
            return None
        if self.given_cube is not None:
            return self.given_cube
        header, crs = self.source.header, self.source.crs
        if self.source.own_grid is not None:
            return self.source.own_grid[0]
        corners = box_corners(box, header.scale, header.offset, crs.z_ratio)
        side = None
        if self.options.cube != "auto":
            side = self.options.cube.in_units(crs.metres_per_unit_xy)  # type: ignore[union-attr]
        return Cube.snapped(corners, side) if self.options.snap else Cube.around(corners, side)

    @property
    def split_side(self) -> Fraction:
        """Side of the snapped cubes, in the horizontal unit."""
        assert self.options.split is not None
        return self.options.split.in_units(self.source.crs.metres_per_unit_xy)

    def _split_cube(self, index: CubeIndex) -> Cube:
        return snapped_cube(index, self.split_side)

    def _split(self, chunk: PointChunk) -> Iterator[tuple[CubeIndex, PointChunk]]:
        """Yield the points of a chunk by snapped cube."""
        try:
            yield from by_cube(chunk, self.split_side, self.source.crs.z_ratio)
        except OverflowError as error:
            raise self._too_many_cubes() from error

    def _too_many_cubes(self) -> ResourceError:
        return ResourceError(
            f"--split {self.options.split} cuts this tile into more than {MAX_CUBES} cubes; give "
            "a longer side",
            "E_SIZE",
        )

    def _outside_warnings(self, census: Census) -> list[CodedWarning]:
        """Say how many points the cube of ``--cube-from`` leaves out; all of them is an error."""
        cube = self.given_cube
        if cube is None or not self.n_outside:
            return []
        name = Path(self.options.cube_from or "").name
        if self.n_outside == census.n_used:
            raise InputError(
                f"{self.source.name}: no point lies in the cube of --cube-from {name} (corner "
                f"{cube.origin}, side {cube.side:g}); is it of the same place and in the same CRS?",
                "E_GRID",
            )
        return [
            CodedWarning(
                "W_OUTSIDE_CUBE",
                f"{self.n_outside} of {census.n_used} points lie outside the cube of --cube-from "
                f"{name}; they are not in the volume",
                self.n_outside,
            )
        ]

    def _box_warnings(self, box: StoredBox | None) -> list[CodedWarning]:
        """Say when the header's box is not that of the points (by more than its last digit)."""
        header = self.source.header
        if box is None:
            return []
        claimed = header_box(header.box, header.scale, header.offset)
        if claimed is not None and all(
            abs(one - other) <= 1 for one, other in zip(claimed, box, strict=True)
        ):
            return []
        found = [float(value) for value in box_corners(box, header.scale, header.offset)]
        return [
            CodedWarning(
                "W_HEADER_BBOX",
                f"the header's box is {list(header.box)}, the points' is {found}; the points' box "
                f"was used, the points were read {self.n_passes} times",
            )
        ]
