"""One tile from file to files: read once, build, choose the depth, write, report."""

from __future__ import annotations

import logging
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from volatool import resources
from volatool.beside import Beside
from volatool.census import box_corners
from volatool.cube import Cube
from volatool.elevation import make_elevation
from volatool.encodings import output_stream
from volatool.errors import (
    CodedWarning,
    InputError,
    ResourceError,
    VolatoolError,
)
from volatool.model import Progress, no_progress
from volatool.naming import stem
from volatool.opening import is_volume, open_source
from volatool.options import ConvertOptions
from volatool.outputs import OutputSet, refuse_existing
from volatool.remote.path import is_url
from volatool.report import Report
from volatool.retile import GROUP_SUFFIX, is_group
from volatool.scan import Scan, TileScanner
from volatool.scratch import Scratch
from volatool.volumes import VolumePart, depth_in_advance, make_volumes, own_depth

if TYPE_CHECKING:
    from volatool.dem.gather import SurfaceGatherer
    from volatool.dem.surfaces import Dem
    from volatool.points.source import Source
    from volatool.vola.builder import VolaBuilder
    from volatool.vola.volume import Volume

_WRITERS = ("convert", "import")
"""Kinds that write volumes and a report."""

logger = logging.getLogger(__name__)


def convert_tile(
    path: Path,
    options: ConvertOptions,
    *,
    kind: str = "convert",
    outdir: Path | None = None,
    overwrite: bool = False,
    progress: Progress = no_progress,
) -> Report:
    """
    Work on one input.

    Parameters
    ----------
    path : pathlib.Path
        LAS, LAZ or COPC; for ``"stats"`` and ``"dem"`` also a VOLA file; for ``"import"`` one of
        the formats of `volatool.imports.registry`.
    options : ConvertOptions
        What is asked for.
    kind : str
        ``"convert"`` and ``"import"`` write volume, elevation model and report; ``"dem"`` the
        elevation model; ``"stats"`` nothing; ``"retile"`` the volumes of a group of cubes, which
        `path` names then (`volatool.retile`), and their report.
    outdir : pathlib.Path, optional
        Folder for the outputs; beside the input by default.
    overwrite : bool
        Replace outputs that exist.
    progress : callable
        Called with (points done, points of the file).

    Returns
    -------
    report : Report
        ``paths`` are the files written.

    Raises
    ------
    VolatoolError
        And nothing is left behind.
    """
    if kind == "stats" and is_volume(path):
        from volatool.volume_stats import volume_report

        return volume_report(path, options)
    started = time.perf_counter()
    planned = planned_outputs(path, options, kind, outdir)
    refuse_existing(planned, overwrite)
    if planned and is_url(planned[0]):
        from volatool.remote.uploads import uploaded

        work = partial(convert_tile, path, options, kind=kind, progress=progress)
        return uploaded(work, planned, overwrite)
    if is_group(path) and kind in ("retile", "stats"):
        from volatool.retiling import cut_group

        with OutputSet(overwrite) as outputs:
            takes = outputs if kind == "retile" else None
            report = cut_group(path, options, outdir, takes, progress)
            report = _with_usage(report, options, started)
            for target in planned:
                with output_stream(outputs.add(target)) as stream:
                    stream.write((report.to_json(indent=2) + "\n").encode())
            return replace(report, paths=outputs.commit(planned))
    if kind == "dem" and is_volume(path):
        return _volume_dem(path, options, outdir, overwrite, planned, started)
    with open_source(path, options, kind=kind) as source, OutputSet(overwrite) as outputs:
        budget = resources.working_budget(options.memory, _wants_dem(kind, options))
        with Scratch(budget) as scratch:
            tile = _Tile(path, options, kind, outdir, source, scratch, outputs)
            report = tile.run(progress)
        report = _with_usage(report, options, started)
        if kind in _WRITERS:
            temporary = outputs.add(tile.target(".stats.json"))
            with output_stream(temporary) as stream:
                stream.write((report.to_json(indent=2) + "\n").encode())
        return replace(report, paths=outputs.commit(planned))


def _with_usage(report: Report, options: ConvertOptions, started: float) -> Report:
    """Add time and memory to a report, if they are wanted."""
    if not options.resources:
        return report
    seconds = time.perf_counter() - started
    n_read = (report.input or {}).get("points_read") or 0
    usage = resources.Usage(seconds, n_read / seconds, resources.peak_rss_bytes())
    return replace(report, resources=usage.to_dict())


def _volume_dem(
    path: Path,
    options: ConvertOptions,
    outdir: Path | None,
    overwrite: bool,
    planned: list[Path],
    started: float,
) -> Report:
    """Make the elevation model of a VOLA file."""
    from volatool.dem.from_volume import volume_dem

    folder = path.parent if outdir is None else outdir
    with OutputSet(overwrite) as outputs:
        with Scratch(resources.working_budget(options.memory)) as scratch:
            report = volume_dem(
                path, options, outputs, lambda suffix: folder / (stem(path) + suffix), scratch
            )
        report = _with_usage(report, options, started)
        return replace(report, paths=outputs.commit(planned))


def planned_outputs(
    path: Path, options: ConvertOptions, kind: str, outdir: Path | None
) -> list[Path]:
    """
    Return the files that an input may give, as far as that is known before it is read.

    Parameters
    ----------
    path, options, kind, outdir
        As in `convert_tile`; the kind may also be ``"classify"``.
    """
    suffixes = []
    if kind == "retile":  # the cubes are known when the points are
        return [(outdir or path.parent) / (path.name.removesuffix(GROUP_SUFFIX) + ".stats.json")]
    if kind in _WRITERS:
        packed = ".gz" if options.gzip else ""
        if options.split is None:
            suffixes.append(".vol" + packed)
            if options.dense != "never":
                suffixes.append(".dvol" + packed)
        suffixes.append(".stats.json")
        if options.preview:
            suffixes.append(".preview.png")
    if kind == "classify":
        suffixes.append(".laz")
    if _wants_dem(kind, options):
        suffixes += [".dem.tif", *(f".dem.{layer}.tif" for layer in options.layers)]
    folder = path.parent if outdir is None else outdir
    return [folder / (stem(path) + suffix) for suffix in suffixes]


def _wants_dem(kind: str, options: ConvertOptions) -> bool:
    return kind == "dem" or (kind in _WRITERS and options.dem)


def input_document(path: Path, source: Source, scan: Scan) -> dict[str, Any]:
    """Return the report's ``input``."""
    header = source.header
    return {
        "name": path.name,
        "bytes": header.size_bytes,
        **_format_of(source),
        "las_equivalent_bytes": header.las_equivalent_bytes,
        "points_header": header.n_points,
        "bbox": corners_of(source, scan) or None,
        "crs": source.crs.to_dict(),
        "passes": scan.n_passes,
        **scan.census.to_dict(header.scale),
    }


def _format_of(source: Source) -> dict[str, Any]:
    """Return what the report says of the file's format."""
    if source.format is not None:
        nothing = dict.fromkeys(("las_version", "point_format", "compressed"))
        return {**nothing, "format": source.format}
    header = source.header
    return {
        "las_version": header.version,
        "point_format": header.point_format,
        "compressed": header.is_compressed,
    }


def corners_of(source: Source, scan: Scan) -> list[float]:
    """Return the box of all points read, in units of the CRS; empty without points."""
    header, box = source.header, scan.census.box
    if box is None:
        return []
    return [float(value) for value in box_corners(box, header.scale, header.offset)]


def all_filtered(scan: Scan) -> str:
    """Say why no point is left to use."""
    reasons = ", ".join(f"{n} {reason}" for reason, n in scan.census.dropped.items() if n)
    return f"no point is left to use: {reasons}"


class _Tile:
    """The steps of one tile; what they share."""

    def __init__(
        self,
        path: Path,
        options: ConvertOptions,
        kind: str,
        outdir: Path | None,
        source: Source,
        scratch: Scratch,
        outputs: OutputSet,
    ) -> None:
        self.path = path
        self.options = options
        self.kind = kind
        self.folder = path.parent if outdir is None else outdir
        self.source = source
        self.scratch = scratch
        self.outputs = outputs
        self.warnings: list[CodedWarning] = []
        self.wants_dem = _wants_dem(kind, options)
        self.channels = self._channels()

    def target(self, suffix: str) -> Path:
        """Return an output's path."""
        return self.folder / (stem(self.path) + suffix)

    def _channels(self) -> tuple[str, ...]:
        from volatool.vola.metadata import channels_of

        if self.kind == "dem":
            return ()
        have = channels_of(self.source.header.dimensions)
        return tuple(channel for channel in have if channel in self.options.meta)

    def run(self, progress: Progress) -> Report:
        """Read, build and write everything but the report itself."""
        with Beside() as beside:
            return self._run(progress, beside)

    def _run(self, progress: Progress, beside: Beside) -> Report:
        from volatool.vola.metadata import attributes_for

        surface = self._surface() if self.wants_dem else None
        scanner = TileScanner(
            self.source,
            self.options,
            self._builder,
            attributes_for(self.channels) | (surface.attributes if surface else frozenset()),
            surface,
            progress,
            with_volume=self.kind != "dem" and self.options.compat is None,
        )
        started = time.perf_counter()
        scan = scanner.run()
        logger.info(
            "%s: %d points read, %d used, %d pass(es), %.1f s",
            self.source.name,
            scan.census.n_read,
            scan.census.n_used,
            scan.n_passes,
            time.perf_counter() - started,
        )
        self.warnings += [*self.source.warnings, *scan.warnings]
        self._scan_warnings(scan)
        report = Report(
            status="partial" if self.source.is_partial else "ok",
            input=input_document(self.path, self.source, scan),
            options=self.options.given(),
        )
        volume = None
        part = self._volume_part(scan, beside)
        if part is not None:
            volume = part.volume
            logger.info("%s: %s", self.source.name, part.choice["reason"])
            self.warnings += part.warnings
            report = replace(
                report,
                cube=part.cube,
                levels=part.levels,
                choice=part.choice,
            )
        elif scan.census.n_used == 0:
            report = replace(report, status="empty")
        dem = None
        resources.drop_library_code()
        if surface is not None and scan.census.box is not None:
            try:
                made = make_elevation(
                    surface,
                    scan.census.box,
                    self.source,
                    self.options,
                    self.scratch,
                    self.outputs,
                    self.target,
                )
            except VolatoolError as error:
                if part is not None:
                    part.encodings()  # what is wrong with the volume is told first
                is_of_input = isinstance(error, (InputError, ResourceError))
                if is_of_input and self.kind in _WRITERS:  # nothing half-written: the volume goes
                    error.args = (f"{error}; --no-dem leaves the elevation model out",)
                raise
            dem = made.dem
            self.warnings += made.warnings
            report = replace(report, dem=made.document)
        if part is not None:
            report = replace(report, encodings=part.encodings())
        if self.options.preview and self.kind in _WRITERS and volume is not None:
            self._preview(dem, volume)
        return replace(report, warnings=tuple(self.warnings))

    def _volume_part(self, scan: Scan, beside: Beside) -> VolumePart | None:
        """Build the volumes and write them; None if there is none to build."""
        base = self.target("") if self.kind in _WRITERS else None
        corners = self._corners(scan)
        if scan.builders:
            return make_volumes(
                scan.builders,
                self.source,
                self.options,
                self.outputs,
                base,
                corners,
                self.scratch,
                beside,
            )
        if self.options.compat == "toolkit" and self.kind in _WRITERS and corners:
            from volatool.compat import make_toolkit_volume

            return make_toolkit_volume(self.source, self.options, self.outputs, base, corners)
        return None

    # reading

    def _surface(self) -> SurfaceGatherer:
        from volatool.dem.gather import SurfaceGatherer

        return SurfaceGatherer(self.options.surface, self.scratch, self.source.header.dimensions)

    def _builder(self, cube: Cube) -> VolaBuilder:
        from volatool.vola.builder import VolaBuilder

        options = self.options
        fixed = own_depth(options, self.source)
        if fixed is None:
            fixed = depth_in_advance(options, self.source.crs, cube)
        keep = options.max_depth if options.budget is not None else fixed
        return VolaBuilder(
            cube,
            max(options.max_depth, fixed or 0),
            channels=self.channels,
            n_points_hint=self.source.n_points,
            min_occupancy=options.min_occupancy,
            scratch=self.scratch,
            z_ratio=self.source.crs.z_ratio,
            keep_depth=keep,
            crs=self.source.crs,
        )

    def _scan_warnings(self, scan: Scan) -> None:
        census = scan.census
        if census.box is None:
            self._warn("W_EMPTY", "the file has no points; no volume is written")
        elif census.n_used == 0:
            self._warn("W_ALL_FILTERED", all_filtered(scan), census.n_read)
        limits = census.isolated()
        if limits is not None and not self.options.robust_z:
            self._warn(
                "W_Z_OUTLIER",
                f"{limits.n_points} points stand alone far above or below the rest; "
                "--robust-z leaves them out of the cube and the DEM",
                limits.n_points,
            )

    def _warn(self, code: str, message: str, count: int = 1) -> None:
        self.warnings.append(CodedWarning(code, message, count))

    def _corners(self, scan: Scan) -> list[float]:
        """Return the box of all points read, in units of the CRS; empty without points."""
        return corners_of(self.source, scan)

    def _preview(self, dem: Dem | None, volume: Volume) -> None:
        from volatool.preview import render

        with output_stream(self.outputs.add(self.target(".preview.png"))) as stream:
            stream.write(render(dem, volume))
