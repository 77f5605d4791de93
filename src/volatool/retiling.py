"""The work on a group of cubes: the points of every file that lie in them, to volumes."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from volatool import resources
from volatool.batch.identity import identify
from volatool.census import Census, StoredBox, area_cell_for, box_corners
from volatool.cube import Cube
from volatool.encodings import resized
from volatool.errors import CodedWarning, FormatError, InputError, ResourceError
from volatool.model import I32, CrsInfo, PointChunk, Progress, as_fraction
from volatool.opening import open_source
from volatool.options import ConvertOptions
from volatool.outputs import OutputSet
from volatool.points.header import LasHeader
from volatool.points.reader import PointSource
from volatool.points.select import Selection, selection_for
from volatool.remote.path import path_of
from volatool.report import Report
from volatool.retile import Columns, Frame, Group, Piece, read_group
from volatool.scan import MAX_CUBES
from volatool.scratch import Scratch
from volatool.snapped import CubeIndex, by_cube, cube_numbers, snapped_cube
from volatool.summary import summed_inputs
from volatool.vola.builder import VolaBuilder
from volatool.vola.metadata import attributes_for
from volatool.volumes import depth_in_advance, make_volumes

logger = logging.getLogger(__name__)

_STORED = 2**31


@dataclass(frozen=True, slots=True)
class _Set:
    """What volumes say of where their points come from: a `Source` that is read no more."""

    name: str
    crs: CrsInfo
    header: LasHeader
    own_grid: None = None


def cut_group(
    path: Path,
    options: ConvertOptions,
    outdir: Path | None,
    outputs: OutputSet | None,
    progress: Progress,
) -> Report:
    """
    Make the volumes of a group of cubes.

    Parameters
    ----------
    path : pathlib.Path
        Names the group: see `volatool.retile`.
    options : ConvertOptions
        As for one tile; ``split`` is the side.
    outdir : pathlib.Path or None
        Folder for the volumes; beside `path` by default.
    outputs : OutputSet or None
        Takes them; None counts only.
    progress : callable
        Called with (points done, points of all files of the group).

    Returns
    -------
    report : Report
        Its ``input`` is about the points inside the group, so that groups add up to the set:
        bytes of files are shared out by points.

    Raises
    ------
    InputError
        A file has changed since the groups were planned; ``E_HEADER_BBOX``: a file's points lie in
        cubes that its header's box does not tell of.
    """
    group = read_group(path)
    with Scratch(resources.working_budget(options.memory)) as scratch:
        work = _Work(group, options, scratch, progress, with_metadata=outputs is not None)
        try:
            return work.run(path, outdir, outputs)
        finally:
            for builder in work.builders.values():
                builder.close()


class _Work:
    """The steps of one group; what they share."""

    def __init__(
        self,
        group: Group,
        options: ConvertOptions,
        scratch: Scratch,
        progress: Progress,
        with_metadata: bool,
    ) -> None:
        self.group = group
        self.frame: Frame = group.frame
        self.options = options
        self.scratch = scratch
        self.progress = progress
        self.channels = group.frame.channels if with_metadata else ()
        self.scale, self.offset = _stored_frame(group)
        self.builders: dict[CubeIndex, VolaBuilder] = {}
        self.documents: list[dict[str, Any]] = []
        self.warnings: list[CodedWarning] = []
        self.header: LasHeader | None = None
        self.is_partial = False
        self.n_done = 0

    def run(self, path: Path, outdir: Path | None, outputs: OutputSet | None) -> Report:
        """Read all files, build and write."""
        for piece in self.group.pieces:
            self._read(piece)
        name = self.group.name
        document = {**summed_inputs(self.documents), "name": name, "format": "LAS"}
        document["bbox"] = document["bbox"] or None
        report = Report(
            status="partial" if self.is_partial else "ok",
            input=document,
            options=self.options.given(),
        )
        if not self.builders:
            text = "no point to use lies in these cubes; no volume is written"
            self.warnings.append(CodedWarning("W_EMPTY", text))
            return replace(report, status="empty", warnings=tuple(self.warnings))
        base = None
        if outputs is not None:
            base = (path.parent if outdir is None else outdir) / self.frame.name
        part = make_volumes(
            self.builders,
            self._source(),  # type: ignore[arg-type]
            self.options,
            outputs or OutputSet(),
            base,
            document["bbox"],
        )
        logger.info("%s: %d cubes, %s", name, len(self.builders), part.choice["reason"])
        return replace(
            report,
            cube=part.cube,
            levels=part.levels,
            choice=part.choice,
            encodings=resized(
                part.encodings(), document["las_equivalent_bytes"], document["bytes"]
            ),
            warnings=(*self.warnings, *part.warnings),
        )

    def _source(self) -> _Set:
        """Return the set as the volumes name it: the same in every group."""
        assert self.header is not None, "volumes without a file that was read"
        header = replace(
            self.header,
            size_bytes=self.frame.total_bytes,
            las_equivalent_bytes=self.frame.las_bytes,
        )
        return _Set(self.frame.name, self.frame.crs, header)

    def _read(self, piece: Piece) -> None:
        """Take the points of a file that lie in the group."""
        path = path_of(piece.path)
        is_same = identify(path) == piece.identity
        with open_source(path, self.options) as source:
            header = source.header
            self.header = self.header or header
            if not is_same or source.n_points != piece.n_points:
                raise InputError(f"{path.name}: has changed since the cubes were planned")
            selection = selection_for(self.options)
            names = (
                selection.attributes(header)
                | attributes_for(self.channels)
                | ({"classification", "return_number"} & header.dimensions)
            )
            census = self._census(header)
            seen: list[tuple[int, int]] = []
            room = max(1000, (self.options.memory // 8) // (header.record_bytes + 100))
            size = min(self.options.chunk_points, room)
            # of a COPC file the chunks elsewhere are skipped
            where = {"near": self._sides()} if isinstance(source, PointSource) else {}
            for chunk in source.chunks(names, size, **where):
                self._take(chunk, census, selection, seen)
                self.n_done += len(chunk)
                self.progress(self.n_done, sum(one.n_points for one in self.group.pieces))
            self._check_columns(piece, seen)
            self.is_partial |= source.is_partial
            self.warnings += [
                replace(warning, message=f"{path.name}: {warning.message}")
                for warning in source.warnings
            ]
            if census.n_read:
                self.documents.append(self._document(path, piece, header, census))

    def _census(self, header: LasHeader) -> Census:
        """Return a count of points stored as those of the whole group are."""
        sides = [self.frame.side * number for number in self.group.columns]
        box = [self._place(sides[k], k % 2) for k in range(4)]
        low, high = header.box[2], header.box[5]
        z = [self._place(as_fraction(value), 2) for value in (low, high)]
        expected: StoredBox = (box[0], box[1], z[0], box[2], box[3], z[1])
        scale = self._floats(self.scale)
        return Census(expected, area_cell_for(expected, scale, self.frame.crs.metres_per_unit_xy))

    def _place(self, value: Fraction, axis: int) -> int:
        steps: Fraction = (value - self.offset[axis]) / self.scale[axis]
        return round(steps)

    def _take(
        self,
        chunk: PointChunk,
        census: Census,
        selection: Selection,
        seen: list[tuple[int, int]],
    ) -> None:
        side, z_ratio = self.frame.side, self.frame.crs.z_ratio
        x0, y0, x1, y1 = self.group.columns
        x, y = (cube_numbers(chunk, axis, side, z_ratio) for axis in (0, 1))
        seen += [(int(x.min()), int(y.min())), (int(x.max()), int(y.max()))]
        inside = (x >= x0) & (x < x1) & (y >= y0) & (y < y1)
        if not inside.any():
            return
        part = self._restored(chunk if inside.all() else chunk.take(inside))
        mask = selection.mask(part, census.dropped)
        census.add(part, mask)
        used = part if mask is None else part.take(mask)
        if not len(used):
            return
        try:
            for index, points in by_cube(used, side, z_ratio):
                builder = self.builders.get(index)
                if builder is None:
                    builder = self.builders[index] = self._builder(snapped_cube(index, side))
                outside = builder.add(points)
                assert outside == 0, "a point outside the snapped cube that it was sorted into"
        except OverflowError as error:
            raise self._too_many() from error

    def _builder(self, cube: Cube) -> VolaBuilder:
        if len(self.builders) == MAX_CUBES:
            raise self._too_many()
        options = self.options
        fixed = depth_in_advance(options, self.frame.crs, cube)
        return VolaBuilder(
            cube,
            max(options.max_depth, fixed or 0),
            channels=self.channels,
            min_occupancy=options.min_occupancy,
            scratch=self.scratch,
            z_ratio=self.frame.crs.z_ratio,
            keep_depth=fixed,
            crs=self.frame.crs,
        )

    def _too_many(self) -> ResourceError:
        return ResourceError(
            f"{self.group.name}: more than {MAX_CUBES} cubes; points stand far above each other "
            "there (--exclude-class leaves classes out), or give a longer --split",
            "E_SIZE",
        )

    def _restored(self, chunk: PointChunk) -> PointChunk:
        """Return a chunk in the integers that all files share, exactly."""
        columns: list[I32] = []
        for axis, stored in enumerate((chunk.x, chunk.y, chunk.z)):
            factor = as_fraction(chunk.scale[axis]) / self.scale[axis]
            shift = (as_fraction(chunk.offset[axis]) - self.offset[axis]) / self.scale[axis]
            if factor == 1 and shift == 0:
                columns.append(stored)
                continue
            moved = stored.astype(np.int64) * int(factor) + int(shift)
            if max(-int(moved.min()), int(moved.max())) >= _STORED:
                raise FormatError(
                    f"{self.group.name}: the files' scales and offsets differ so that their "
                    f"{'xyz'[axis]} don't fit 32 bits together",
                    "E_BAD_SCALE",
                )
            columns.append(moved.astype(np.int32))
        x, y, z = columns
        scale, offset = self._floats(self.scale), self._floats(self.offset)
        return replace(chunk, x=x, y=y, z=z, scale=scale, offset=offset)

    @staticmethod
    def _floats(values: tuple[Fraction, Fraction, Fraction]) -> tuple[float, float, float]:
        return (float(values[0]), float(values[1]), float(values[2]))

    def _sides(self) -> tuple[float, float, float, float]:
        x0, y0, x1, y1 = (float(number * self.frame.side) for number in self.group.columns)
        return (x0, y0, x1, y1)

    def _check_columns(self, piece: Piece, seen: list[tuple[int, int]]) -> None:
        """Refuse a file with points where its header doesn't say: another group misses them."""
        if not seen:
            return
        x, y = zip(*seen, strict=True)
        found: Columns = (min(x), min(y), max(x) + 1, max(y) + 1)
        told = piece.columns
        if found[0] < told[0] or found[1] < told[1] or found[2] > told[2] or found[3] > told[3]:
            raise InputError(
                f"{Path(piece.path).name}: has points outside the box of its header, in columns "
                f"{found[:2]} to {found[2:]} of cubes, told {told[:2]} to {told[2:]}; have the "
                "header repaired (lasinfo -repair, pdal translate)",
                "E_HEADER_BBOX",
            )

    def _document(
        self, path: Path, piece: Piece, header: LasHeader, census: Census
    ) -> dict[str, Any]:
        """Return what the report says of one file's points inside the group."""
        assert census.box is not None
        scale = self._floats(self.scale)
        corners = box_corners(census.box, scale, self._floats(self.offset))
        return {
            "name": path.name,
            "bytes": round(piece.size_bytes * census.n_read / piece.n_points),
            "las_version": header.version,
            "point_format": header.point_format,
            "compressed": header.is_compressed,
            "las_equivalent_bytes": census.n_read * piece.record_bytes,
            "points_header": None,
            "bbox": [float(value) for value in corners],
            "crs": self.frame.crs.to_dict(),
            **census.to_dict(scale),
        }


def _stored_frame(group: Group) -> tuple[Any, Any]:
    """Return scale and offset of the group's points: the set's, moved near the group."""
    frame = group.frame
    offset = list(frame.offset)
    for axis in (0, 1):
        middle = (group.columns[axis] + group.columns[axis + 2]) * frame.side / 2
        if abs(middle - offset[axis]) / frame.scale[axis] >= _STORED / 2:
            steps = round((middle - offset[axis]) / frame.scale[axis])
            offset[axis] += steps * frame.scale[axis]
    return frame.scale, tuple(offset)
