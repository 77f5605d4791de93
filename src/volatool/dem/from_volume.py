"""An elevation model from a VOLA file: each voxel is a point at its centre.

A voxel says that there was a point somewhere inside it, so its height is known to the edge of a
voxel over the root of 12 (evenly spread inside).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from volatool import resources
from volatool.dem.cell import choose_cell
from volatool.dem.gather import SurfaceGatherer, SurfacePoints
from volatool.dem.grid import Grid, grid_for
from volatool.dem.neighbours import Box
from volatool.errors import CodedWarning, CRSError, OptionError, ResourceError
from volatool.model import I32, CrsInfo, PointChunk, as_fraction
from volatool.outputs import OutputSet
from volatool.report import Report
from volatool.scratch import Scratch
from volatool.units import format_size
from volatool.vola.volume import Volume

if TYPE_CHECKING:
    from volatool.options import ConvertOptions

VOXEL_BYTES = 48
"""Peak per voxel: indices twice, sorted keys, attributes."""

MOST_LEVELS = 14
"""Half voxels of more don't fit int32."""

PART_OF_VOXEL, LEAST_TOL_M = 0.01, 1e-4
"""Accuracy of a ground that voxels are held against: they are no points to a tenth of a millimetre.
"""

CHUNK = 1 << 18

_SOURCES = {
    "class 2": "voxels (class 2)",
    "ground filter": "ground filter on voxels",
    "first returns": "top voxels",
    "lowest point per cell": "lowest voxel per cell",
    "highest point per cell": "highest voxel per cell",
    "mean of the points per cell": "mean of the voxels per cell",
}

_OF_POINTS = (
    "classes", "exclude_classes", "returns", "keep_withheld", "keep_noise", "bounds", "thin",
    "robust_z", "to_crs", "neighbours", "salvage",
)  # fmt: skip


def volume_dem(
    path: Path,
    options: ConvertOptions,
    outputs: OutputSet,
    target: Callable[[str], Path],
    scratch: Scratch,
) -> Report:
    """
    Make and write the elevation model of a VOLA file.

    Parameters
    ----------
    path : pathlib.Path
        Sparse or dense, gzip or not.
    options : ConvertOptions
        Those of the elevation model, `crs` and `crs_default`.
    outputs : OutputSet
        Takes the files.
    target : callable
        Gives the path of an output for its suffix.
    scratch : Scratch
        Memory budget.

    Returns
    -------
    report : Report
        With `input`, `cube` and `dem`.

    Raises
    ------
    OptionError
        Options that select or move points.
    ResourceError
        ``E_MEMORY``: the voxels don't fit the budget.
    """
    from volatool.dem.placing import own_grid, shared_parameters
    from volatool.elevation import dem_of, judge, solver_warnings, write_elevation
    from volatool.formats.registry import open_volume
    from volatool.volume_stats import volume_cube, volume_input

    _check(options)
    volume = open_volume(path)
    warnings = list(volume.info.warnings)
    crs = _crs(volume, options, warnings)
    report = Report(
        status="ok",
        input=volume_input(path, volume, crs),
        cube=volume_cube(volume),
        options=options.given(),
    )
    if not len(volume):
        warnings.append(CodedWarning("W_EMPTY", "the volume has no voxels; no DEM is written"))
        return replace(report, status="empty", warnings=tuple(warnings))
    source = _VolumeSource(path.name, crs)
    springs = shared_parameters(options, crs)
    gatherer = gather_voxels(volume, options.surface, scratch)
    points = gatherer.result(crs, threads=resources.n_threads())
    points = replace(
        points,
        ground_source=_SOURCES[points.ground_source],
        warnings=tuple(replace(w, message=_of_voxels(w.message)) for w in points.warnings),
    )
    box, edge = _box(volume, points), voxel_edge(volume)
    own = own_grid(box, source, options)
    if own is None:
        own = grid_for(box, choose_cell(points, crs.metres_per_unit_xy, least=edge).cell)
    dem = dem_of(points, source, options, scratch, springs, own)
    sigma = float(edge) / float(volume.crs.z_ratio) / math.sqrt(12)
    dem, judged = judge(points, dem, source, options, springs, sigma)
    if options.sigma is None:
        dem = replace(dem, noise_sigma=sigma)  # plain surfaces too
    points.close()
    resources.drop_library_code()
    document = write_elevation(dem, path.name, options, outputs, target) | judged
    warnings += [*points.warnings, *solver_warnings(dem)]
    return replace(report, dem=document, warnings=tuple(warnings))


@dataclass(frozen=True, slots=True)
class _VolumeSource:
    """What an elevation model needs of its input beside the points."""

    name: str
    crs: CrsInfo


def _check(options: ConvertOptions) -> None:
    """Refuse options that choose or move points: a volume has none any more."""
    flags = {"classes": "class", "exclude_classes": "exclude-class"}
    given = options.given()
    named = ["--" + flags.get(name, name).replace("_", "-") for name in _OF_POINTS if name in given]
    if named:
        raise OptionError(
            f"{', '.join(named)}: a volume has no points to choose or to move; give the file that "
            "it was made from"
        )


def _crs(volume: Volume, options: ConvertOptions, warnings: list[CodedWarning]) -> CrsInfo:
    """Return the CRS of the options or of the file."""
    from volatool.points.crs import crs_from_user

    crs = volume.crs
    if options.crs is not None:
        crs = crs_from_user(options.crs, "override")
    elif crs.wkt2 is None and options.crs_default is not None:
        crs = crs_from_user(options.crs_default, "default")
    elif crs.wkt2 is None:
        text = "the file names no CRS (--crs or --crs-default gives one); lengths are in file units"
        warnings.append(CodedWarning("W_NO_CRS", text))
    if crs.is_geographic:
        raise CRSError(
            "coordinates are in degrees; make the volume with --to-crs utm", "E_GEOGRAPHIC"
        )
    return crs


def _of_voxels(message: str) -> str:
    return message.replace("points", "voxels").replace("no point", "no voxel")


def voxel_edge(volume: Volume) -> Fraction:
    """
    Return the edge of a voxel, in the horizontal unit.

    Parameters
    ----------
    volume : Volume
        Those of the original toolkit have their points at the corners of 4**depth - 1 cells.
    """
    steps = 4**volume.depth - (volume.info.quantizer != "floor")
    edge: Fraction = volume.cube.exact[3] / steps
    return edge


def _box(volume: Volume, points: SurfacePoints) -> Box:
    """Return the rectangle of the points that made the volume, else of its columns of voxels."""
    known = volume.info.box
    if known is not None:
        left, bottom, right, top = (as_fraction(known[k]) for k in (0, 1, 3, 4))
        return (left, bottom, right, top)
    box, half = points.box, voxel_edge(volume) / 2
    assert box is not None
    return (box[0] - half, box[1] - half, box[2] + half, box[3] + half)


def gather_voxels(volume: Volume, surface: str, scratch: Scratch) -> SurfaceGatherer:
    """
    Return the voxels of a surface as points at their centres.

    Parameters
    ----------
    volume : Volume
        At least one voxel.
    surface : str
        One of `volatool.dem.gather.SURFACES`. ``dsm`` takes the top voxel of each column; a ground
        surface the voxels of blocks whose class is 2 when there are any, else those that the
        ground filter keeps; the others take all.
    scratch : Scratch
        Where points wait.

    Raises
    ------
    ResourceError
        ``E_MEMORY``: the voxels don't fit the budget; ``E_SIZE``: more than 14 levels.
    """
    if volume.depth > MOST_LEVELS:
        raise ResourceError(f"a volume of {volume.depth} levels is too deep for a DEM", "E_SIZE")
    needed = VOXEL_BYTES * len(volume)
    if scratch.budget_bytes is not None and needed > scratch.budget_bytes - scratch.used_bytes:
        raise ResourceError(
            f"{len(volume)} voxels take about {format_size(needed)}, more than --memory leaves; "
            "raise it, or make the volume with a smaller --depth"
        )
    gatherer = SurfaceGatherer(surface, scratch, {"classification"})
    voxels = volume.voxels()
    classes: NDArray[np.uint8] | None = None
    names = [channel["name"] for channel in volume.info.channels]
    if gatherer.is_bare and volume.has_metadata and "class" in names:
        classes = volume.channel("class").astype(np.uint8)
    if surface == "dsm":
        voxels = _tops(voxels)
    exact, ratio = volume.cube.exact, volume.crs.z_ratio
    step = voxel_edge(volume) / 2
    # in halves of a voxel, centres are odd; the toolkit's points are even
    odd = 1 if volume.info.quantizer == "floor" else 0
    scale = (float(step), float(step), float(step / ratio))
    offset = (float(exact[0]), float(exact[1]), float(exact[2] / ratio))
    for start in range(0, len(voxels), CHUNK):
        part = slice(start, start + CHUNK)
        x, y, z = (np.ascontiguousarray(voxels[part, axis] * 2 + odd) for axis in range(3))
        attributes = {} if classes is None else {"classification": classes[part]}
        gatherer.add(PointChunk(start, x, y, z, scale, offset, attributes))
    return gatherer


def _tops(voxels: I32) -> I32:
    """Return the highest voxel of each column, by columns."""
    keys = voxels[:, 0].astype(np.uint64) << np.uint64(42)
    keys |= voxels[:, 1].astype(np.uint64) << np.uint64(21)
    keys |= voxels[:, 2].astype(np.uint64)
    keys.sort()
    column = keys >> np.uint64(21)
    keys = keys[np.append(column[1:] != column[:-1], True)]
    mask = np.uint64((1 << 21) - 1)
    shifts = (np.uint64(shift) for shift in (42, 21, 0))
    return np.column_stack([((keys >> shift) & mask).astype(np.int32) for shift in shifts])


def ground_under(volume: Volume, grid: Grid) -> NDArray[np.float64]:
    """
    Return the bare earth of a volume: what ``dem --surface dtm`` makes of it, on cells given.

    Parameters
    ----------
    volume : Volume
        With at least one voxel.
    grid : Grid
        The cells.

    Returns
    -------
    heights : (h, w) array of float64
        Of the cells' centres in the vertical unit, row 0 at the top; NaN where void.

    Raises
    ------
    InputError
        ``E_NO_GROUND``: the ground filter keeps no voxel.
    """
    from volatool.dem.surfaces import make_dem

    edge = float(voxel_edge(volume) * (volume.crs.metres_per_unit_xy or 1))
    tol = max(edge * PART_OF_VOXEL, LEAST_TOL_M)
    with Scratch() as scratch:
        points = gather_voxels(volume, "dtm", scratch).result(volume.crs)
        try:
            cell = grid.exact[2]
            dem = make_dem(points, volume.crs, cell, grid=grid, tol_m=tol, scratch=scratch)
        finally:
            points.close()
    return dem.z.astype(np.float64)
