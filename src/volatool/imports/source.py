"""An imported file as a source of points: integers with a decimal scale, as LAS files have."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from volatool.cube import Cube
from volatool.errors import CodedWarning, FormatError, InputError, OptionError, VolatoolError
from volatool.imports.attributes import AttributeSurvey, checked, factors, scaling_warnings
from volatool.imports.decimals import Axis, AxisSurvey
from volatool.imports.model import Batch, ImportedPoints
from volatool.imports.registry import read_points, retell
from volatool.model import F64, CrsInfo, PointChunk, as_fraction
from volatool.options import ConvertOptions
from volatool.points.header import LasHeader
from volatool.points.layout import RECORD_BYTES, dimensions_of
from volatool.points.reader import CHUNK_POINTS, MAX_CHUNK_POINTS
from volatool.reference import reference

_LAS_HEADER_BYTES = 375
_SURVEY_ROWS = 1 << 18


class ImportSource:
    """
    The points of one imported file, as often as wanted, in file order.

    The file is read once when it is opened, for the box, the decimals and the ranges; a batch at a
    time is in memory, and of formats that say so the file.

    Parameters
    ----------
    path : pathlib.Path
        The file.
    options : ConvertOptions
        CRS, ``from_format``, ``columns``, ``mesh``, ``swap_yz``.

    Attributes
    ----------
    name, path, header, crs, warnings, n_points, is_partial, own_grid
        As `volatool.points.source.Source` has them. The header is that of a LAS file with these
        points; its box is exact.
    format : str
        Name of the importer.
    """

    is_partial = False
    n_unread = 0

    def __init__(self, path: Path, options: ConvertOptions) -> None:
        self.path, self.name = str(path), path.name
        self._path = path
        self.points: ImportedPoints = read_points(path, options)
        if options.compat is not None:  # it takes the numbers as they are, whatever their range
            self.points.attributes = frozenset()
        elif options.classes is not None and "classification" not in self.points.attributes:
            raise OptionError(
                f"{path.name}: --class can't choose, no column or property of the file is a class; "
                "name it with --columns, or leave --class out"
            )
        self.format: str | None = self.points.format
        self._swap = options.swap_yz and not self.points.is_final
        self.warnings: list[CodedWarning] = []
        self.crs: CrsInfo = self._crs(options)
        self._z_divisor = float(self.crs.z_ratio) if self.points.is_cubic else 1.0
        self.own_grid: tuple[Cube, int] | None = self._own_grid(options)
        self._n_missing = 0
        self._surveys = {name: AttributeSurvey(name) for name in sorted(self.points.attributes)}
        self._axes: tuple[Axis, Axis, Axis] = self._survey()
        self._check_grid()
        self._factors = factors(self._surveys)
        self.warnings += scaling_warnings(self._factors, self._surveys)
        self.warnings += self.points.warnings
        if self._n_missing:
            text = f"{self._n_missing} points without coordinates (NaN) were left out"
            self.warnings.append(CodedWarning("W_NO_COORDINATES", text, self._n_missing))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def read_all(self) -> None:
        """Nothing is left out."""

    def close(self) -> None:
        """Let go of the file."""

    def chunks(
        self, attributes: Iterable[str] = (), chunk_points: int = CHUNK_POINTS
    ) -> Iterator[PointChunk]:
        """
        Stream the points in file order.

        Parameters
        ----------
        attributes : iterable of str
            Names of `PointChunk.attributes`; those that the file lacks are left out.
        chunk_points : int
            At most as many points a chunk.

        Yields
        ------
        chunk : PointChunk
            Never empty.

        Raises
        ------
        FormatError
            ``E_RANGE``, with the line or point: an attribute that does not fit.
        InputError
            The file is another one than when it was opened.
        """
        names = sorted(frozenset(attributes) & self.points.attributes)
        scale = tuple(axis.scale for axis in self._axes)
        offset = tuple(axis.offset for axis in self._axes)
        start = 0
        for batch in self._batches(min(chunk_points, MAX_CHUNK_POINTS)):
            x, y, z = (axis.stored(batch.xyz[:, a]) for a, axis in enumerate(self._axes))
            try:
                taken = {name: checked(batch, name, self._factors[name]) for name in names}
            except FormatError as error:
                retell(error, self._path)
                raise
            yield PointChunk(start, x, y, z, scale, offset, taken)  # type: ignore[arg-type]
            start += len(x)
        if start != self.n_points:
            raise InputError(
                f"{self.name}: had {self.n_points} points when it was opened and now has {start}; "
                "is it still being written?"
            )

    def _batches(self, n_rows: int) -> Iterator[Batch]:
        """Yield the points that are there, in the axes of the volume; count those that are not."""
        self._n_missing = 0
        try:
            for batch in self.points.batches(n_rows):
                there = self._there(batch)
                self._n_missing += len(batch.xyz) - len(there.xyz)
                if len(there.xyz):
                    yield there
        except VolatoolError as error:
            retell(error, self._path)
            raise
        except OSError as error:
            raise InputError(f"{self.name}: can't be read ({error})") from error

    def _there(self, batch: Batch) -> Batch:
        """Return a batch without the rows of NaN; refuse what is no place."""
        xyz = batch.xyz
        good = np.isfinite(xyz).all(axis=1)
        if not good.all():
            bad = ~good
            if self.points.keeps_nan:
                bad &= np.isinf(xyz).any(axis=1)
            if bad.any():
                row = int(np.flatnonzero(bad)[0])
                x, y, z = xyz[row].tolist()
                raise FormatError(
                    f"{batch.where(batch.start + row)}: coordinates {x!r}, {y!r}, {z!r} are not "
                    "finite",
                    "E_BAD_COORDINATE",
                )
            kept = np.flatnonzero(good)
            batch = Batch(
                batch.start,
                xyz[kept],
                {name: values[kept] for name, values in batch.attributes.items()},
                lambda row, old=batch: old.where(old.start + int(kept[row - old.start])),  # type: ignore[misc]
            )
        return replace(batch, xyz=self._turned(batch.xyz))

    def _turned(self, xyz: F64) -> F64:
        if self._swap:
            xyz = xyz[:, [0, 2, 1]]
        if self._z_divisor != 1:
            xyz = xyz / (1.0, 1.0, self._z_divisor)
        return xyz

    def _survey(self) -> tuple[Axis, Axis, Axis]:
        """Read the file for box, decimals and ranges; make the header."""
        axes = [AxisSurvey() for _ in range(3)]
        self.n_points = 0
        for batch in self._batches(_SURVEY_ROWS):
            self.n_points += len(batch.xyz)
            for a, axis in enumerate(axes):
                axis.add(batch.xyz[:, a])
            for name, survey in self._surveys.items():
                survey.add(batch.attributes[name])
        try:
            x, y, z = (axis.axis(name) for axis, name in zip(axes, "xyz", strict=True))
        except FormatError as error:
            retell(error, self._path)
            raise
        self._make_header(axes, (x, y, z))
        return x, y, z

    def _make_header(self, surveys: list[AxisSurvey], axes: tuple[Axis, Axis, Axis]) -> None:
        """Describe the points as a LAS file would."""
        attributes = self.points.attributes
        point_format = 7 if "red" in attributes else 6
        ends = [
            [float(axis.stored(np.array([end]))[0] * axis.scale + axis.offset) for end in
             (survey.low, survey.high)] if self.n_points else [0.0, 0.0]
            for survey, axis in zip(surveys, axes, strict=True)
        ]  # fmt: skip
        (x0, x1), (y0, y1), (z0, z1) = ends
        size = self._path.stat().st_size
        record = RECORD_BYTES[point_format]
        equivalent = _LAS_HEADER_BYTES + self.n_points * record
        sx, sy, sz = (axis.scale for axis in axes)
        self.header = LasHeader(
            version="1.4",
            point_format=point_format,
            is_compressed=False,
            is_copc=False,
            n_points=self.n_points,
            record_bytes=record,
            scale=(sx, sy, sz),
            offset=(axes[0].offset, axes[1].offset, axes[2].offset),
            box=(x0, y0, z0, x1, y1, z1),
            size_bytes=size,
            las_equivalent_bytes=equivalent,
            dimensions=attributes & dimensions_of(7),
            offset_to_points=_LAS_HEADER_BYTES,
            points_end=equivalent,
            header_bytes=_LAS_HEADER_BYTES,
            has_wkt_flag=True,
            vlrs=(),
            warnings=(),
        )

    def _own_grid(self, options: ConvertOptions) -> tuple[Cube, int] | None:
        """Return the grid that the file has, unless another cube is asked for."""
        is_asked = options.cube != "auto" or options.snap
        is_asked |= options.split is not None or options.cube_from is not None
        if self.points.grid is None or (is_asked and not self.points.is_final):
            return None
        if not self._swap:
            return self.points.grid
        cube, depth = self.points.grid
        x, y, z, side = cube.exact
        return Cube.from_exact((x, z, y), side, cube.is_snapped), depth

    def _check_grid(self) -> None:
        """Forget the grid if points lie outside: a comment in the file may be older than they."""
        if self.own_grid is None or not self.n_points:
            return
        *corner, side = self.own_grid[0].exact
        ratios = (1, 1, self.crs.z_ratio)
        box = [as_fraction(value) * ratios[k % 3] for k, value in enumerate(self.header.box)]
        if any(box[k] < corner[k] or box[3 + k] > corner[k] + side for k in range(3)):
            self.own_grid = None
            text = "points lie outside the cube that the file names; it is not used"
            self.warnings.append(CodedWarning("W_CUBE", text))

    def _crs(self, options: ConvertOptions) -> CrsInfo:
        """Return the CRS: the override, what the file names, the default, that of ``cube_from``."""
        from volatool.points.crs import crs_from_user

        if options.crs is not None:
            return crs_from_user(options.crs)
        if self.points.crs is not None and self.points.crs.wkt2 is not None:
            return self.points.crs
        if options.crs_default is not None:
            return crs_from_user(options.crs_default, "default")
        if options.cube_from is not None:  # numbers for that cube are in its units
            return reference(options.cube_from).crs
        text = "the file names no CRS (--crs gives one); lengths are in file units"
        self.warnings.append(CodedWarning("W_NO_CRS", text))
        return CrsInfo()
