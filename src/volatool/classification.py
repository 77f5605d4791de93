"""Ground classification of a tile: the same points as LAZ, class 2 set by the ground filter."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from volatool import resources
from volatool.encodings import output_stream
from volatool.errors import CodedWarning, OutputExistsError
from volatool.model import Bool, PointChunk, Progress, no_progress
from volatool.naming import stem
from volatool.opening import open_source
from volatool.options import ConvertOptions
from volatool.outputs import OutputSet, refuse_existing
from volatool.remote.path import is_url
from volatool.report import Report
from volatool.scan import Scan, TileScanner
from volatool.scratch import Scratch, Spool
from volatool.tile import all_filtered, input_document, planned_outputs

if TYPE_CHECKING:
    from volatool.dem.gather import SurfacePoints
    from volatool.points.reader import PointSource
    from volatool.points.source import Source

GROUND, UNCLASSIFIED = 2, 1


def classify_tile(
    path: Path,
    options: ConvertOptions,
    *,
    outdir: Path | None = None,
    overwrite: bool = False,
    progress: Progress = no_progress,
) -> Report:
    """
    Write a tile's points with the ground class set by the ground filter.

    Points that the filter keeps become class 2; points of class 2 that it does not keep become 1
    (unclassified); all others stay what they are. Points that don't take part (withheld, noise and
    what the selection leaves out) are not touched. Nothing else of the file changes: order,
    attributes, extra bytes, records and header are copied, but for the index of a COPC file.

    Parameters
    ----------
    path : pathlib.Path
        LAS, LAZ or COPC.
    options : ConvertOptions
        Selection, CRS, reading and memory.
    outdir : pathlib.Path, optional
        Folder for ``{stem}.laz``; beside the input by default, which a LAZ input refuses.
    overwrite : bool
        Replace an output that exists; never an input.
    progress : callable
        Called with (points read, points to read): the file is read twice.

    Returns
    -------
    report : Report
        ``paths`` has the file written, ``classification`` says what changed.

    Raises
    ------
    VolatoolError
        And nothing is left behind.
    """
    from volatool.points.reader import PointSource

    started = time.perf_counter()
    refuse_inputs([path], options, outdir)
    planned = planned_outputs(path, options, "classify", outdir)
    refuse_existing(planned, overwrite)
    if is_url(planned[0]):
        from volatool.remote.uploads import uploaded

        work = partial(classify_tile, path, options, progress=progress)
        return uploaded(work, planned, overwrite)
    with (
        open_source(path, options, allow_degrees=True, kind="classify") as source,
        OutputSet(overwrite) as outputs,
        Scratch(resources.working_budget(options.memory)) as scratch,
    ):
        assert isinstance(source, PointSource)  # nothing is reprojected unless we do it
        target = (path.parent if outdir is None else outdir) / (stem(path) + ".laz")
        tile = _Tile(source, options, scratch, progress)
        scan = tile.read()
        with output_stream(outputs.add(target)) as stream:
            tile.write(stream)
        scan.n_passes += 1
        report = Report(
            status="partial" if source.is_partial else "ok" if scan.census.n_used else "empty",
            input=input_document(path, source, scan),
            warnings=tuple([*source.warnings, *scan.warnings, *tile.warnings]),
            options=options.given(),
            classification={"path": target.name, **tile.counts},
        )
        if options.resources:
            seconds = time.perf_counter() - started
            usage = resources.Usage(
                seconds, scan.census.n_read / seconds, resources.peak_rss_bytes()
            )
            report = replace(report, resources=usage.to_dict())
        return replace(report, paths=outputs.commit())


def refuse_inputs(paths: list[Path], options: ConvertOptions, outdir: Path | None) -> None:
    """
    Raise if an output would take the place of an input.

    Raises
    ------
    OutputExistsError
        Naming the input; ``overwrite`` does not help.
    """
    inputs = {path.resolve() for path in paths}
    for path in paths:
        for target in planned_outputs(path, options, "classify", outdir):
            if target.resolve() in inputs:
                raise OutputExistsError(
                    f"{target}: is an input and is not written over; give another --outdir"
                )


class _Tile:
    """Two reads of a tile: one to fit the ground, one to write."""

    def __init__(
        self, source: PointSource, options: ConvertOptions, scratch: Scratch, progress: Progress
    ) -> None:
        self.source = source
        self.options = options
        self.scratch = scratch
        self.progress = progress
        self.warnings: list[CodedWarning] = []
        self.counts = dict.fromkeys(
            ("points_ground", "points_ground_before", "points_to_ground", "points_from_ground"), 0
        )
        self._takes_part = Spool(scratch, np.uint8, share=0.25)
        self._is_ground = Spool(scratch, np.uint8, share=0.25)

    def read(self) -> Scan:
        """Fit the ground to the points that take part; keep a flag for each point."""
        from volatool.dem.gather import SurfaceGatherer

        source = self._in_lengths()
        gatherer = SurfaceGatherer("min", self.scratch, source.header.dimensions)

        def take(chunk: PointChunk, mask: Bool | None) -> None:
            # points that a salvage lost have numbers too
            lost = chunk.start - len(self._takes_part)
            taken = np.ones(len(chunk), np.bool_) if mask is None else mask
            flags = np.zeros(lost + len(chunk), np.uint8)
            flags[lost:] = taken
            self._takes_part.append(flags)
            gatherer.add(chunk if mask is None else chunk.take(mask))

        scanner = TileScanner(
            source,
            self.options,
            _no_builder,
            frozenset(),
            None,
            lambda done, total: self.progress(done, 2 * total),
            with_volume=False,
        )
        scan = scanner.visit(take)
        resources.drop_library_code()
        points = gatherer.result(threads=resources.n_threads())
        if len(points):
            self._fit(points, source)
        points.close()
        self._warn(scan)
        return scan

    def _in_lengths(self) -> Source:
        """Return the points in a CRS with lengths: degrees are taken to their UTM zone."""
        if not (self.source.crs.is_geographic and self.source.n_points):
            return self.source
        from volatool.points.reproject import Reprojected

        return Reprojected(self.source, "utm")

    def _fit(self, points: SurfacePoints, source: Source) -> None:
        from volatool.emap.ground import GroundFilter

        crs = source.crs
        ground = GroundFilter(points, crs.metres_per_unit_xy, crs.metres_per_unit_z, self.scratch)
        for rows in points.pieces():
            self._is_ground.append(ground.keeps(rows).astype(np.uint8))
        ground.free()

    def _warn(self, scan: Scan) -> None:
        census = scan.census
        if census.n_read == 0:
            self._say("W_EMPTY", "the file has no points; the output has none")
        elif census.n_used == 0:
            self._say("W_ALL_FILTERED", all_filtered(scan), census.n_read)
        if self.source.header.is_copc:
            self._say(
                "W_COPC", "the COPC index is left out: the output is plain LAZ in the same order"
            )

    def _say(self, code: str, message: str, count: int = 1) -> None:
        self.warnings.append(CodedWarning(code, message, count))

    def write(self, stream: Any) -> None:
        """Write all points, with their new class, to an empty binary file."""
        from volatool.points.rewrite import Rewriter

        writer = Rewriter(self.source, stream)
        takes_part, is_ground = _Flags(self._takes_part), _Flags(self._is_ground)
        position, total = 0, self.source.n_points
        for start, records in self.source.records(self.options.chunk_points):
            is_ground.next(int(np.count_nonzero(takes_part.next(start - position))))
            taken = takes_part.next(len(records)) != 0
            ground = np.zeros(len(records), np.bool_)
            ground[taken] = is_ground.next(int(np.count_nonzero(taken)))
            self._set(records, taken, ground)
            writer.write(records)
            position = start + len(records)
            self.progress(total + position, 2 * total)
        writer.finish()
        self._takes_part.close()
        self._is_ground.close()

    def _set(self, records: NDArray[np.uint8], taken: Bool, ground: Bool) -> None:
        """Set the class in records, in place, and count."""
        is_legacy = self.source.header.point_format < 6
        column = records[:, 15 if is_legacy else 16]
        bits = np.uint8(0x1F if is_legacy else 0xFF)  # legacy flags share the byte
        before = column & bits
        after = before.copy()
        after[taken & ~ground & (before == GROUND)] = UNCLASSIFIED
        after[ground] = GROUND
        column[:] = (column & ~bits) | after
        was, now = before == GROUND, after == GROUND
        for name, mask in (
            ("points_ground", now),
            ("points_ground_before", was),
            ("points_to_ground", now & ~was),
            ("points_from_ground", was & ~now),
        ):
            self.counts[name] += int(np.count_nonzero(mask))


class _Flags:
    """The flags of a spool in order, so many at a time; zeros past its end."""

    def __init__(self, spool: Spool) -> None:
        self._pieces: Iterator[NDArray[np.uint8]] = iter(spool.pieces())
        self._rest = np.empty(0, np.uint8)

    def next(self, n: int) -> NDArray[np.uint8]:
        """Return the next n flags."""
        parts, missing = [self._rest], n - len(self._rest)
        while missing > 0:
            piece = next(self._pieces, np.zeros(missing, np.uint8))
            parts.append(piece)
            missing -= len(piece)
        whole = np.concatenate(parts)
        self._rest = whole[n:]
        return whole[:n]


def _no_builder(cube: object) -> Any:
    raise AssertionError("classification builds no volume")
