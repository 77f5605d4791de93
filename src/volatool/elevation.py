"""The elevation part of a tile: surface points to a model, its files, and what the report says."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from volatool import resources
from volatool.census import StoredBox
from volatool.errors import CodedWarning
from volatool.options import ConvertOptions
from volatool.outputs import OutputSet
from volatool.report import dumps, readable
from volatool.scratch import Scratch

if TYPE_CHECKING:
    from volatool.dem.gather import SurfaceGatherer, SurfacePoints
    from volatool.dem.geotiff import Layer
    from volatool.dem.surfaces import Dem
    from volatool.points.source import Source

logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class ElevationPart:
    """
    What the elevation model of a tile adds to the report.

    Parameters
    ----------
    dem : Dem
        The model.
    document : dict
        The report's ``dem``.
    warnings : tuple of CodedWarning
        What came up.
    """

    dem: Dem
    document: dict[str, Any]
    warnings: tuple[CodedWarning, ...]


def make_elevation(
    surface: SurfaceGatherer,
    box: StoredBox,
    source: Source,
    options: ConvertOptions,
    scratch: Scratch,
    outputs: OutputSet,
    target: Callable[[str], Path],
) -> ElevationPart:
    """
    Make the elevation model and write it with its layers.

    Parameters
    ----------
    surface : SurfaceGatherer
        Has seen all points.
    box : tuple of 6 int
        Stored box of all points read: the model's extent when none of them is left to use.
    source : Source
        For CRS and name.
    options : ConvertOptions
        What is asked for.
    scratch : Scratch
        Memory budget.
    outputs : OutputSet
        Takes the files.
    target : callable
        Gives the path of an output for its suffix.
    """
    from volatool.dem import geotiff

    points = surface.result(source.crs)
    if points.extent is None:
        header, extent = source.header, (box[0], box[1], box[3], box[4])
        points = replace(points, extent=extent, scale=header.scale, offset=header.offset)
    dem = _dem(points, source, options, scratch)
    holdout = _holdout(points, dem, source, options)
    dem, uncertainty = _with_sigma(points, dem, source, options)
    points.close()
    resources.drop_library_code()
    tags = {"SOURCE": readable(source.name), "OPTIONS": dumps(options.given())}
    path = target(".dem.tif")
    geotiff.write_dem(outputs.add(path), dem, tags=tags)
    layers = {}
    for layer in options.layers:
        layer_path = target(f".dem.{layer}.tif")
        geotiff.write_layer(outputs.add(layer_path), dem, cast("Layer", layer), tags=tags)
        layers[layer] = layer_path.name
    document = {"path": path.name, **dem.to_dict(), "holdout": holdout, "layers": layers}
    if uncertainty is not None:
        document["sigma"] = uncertainty
    document["solver"] = document["solver"] or None  # no points: nothing was solved
    return ElevationPart(dem, document, (*points.warnings, *_solver_warnings(dem)))


def _solver_warnings(dem: Dem) -> list[CodedWarning]:
    """Say when the solver gave up before its tolerance was met."""
    if dem.solver.get("converged", True):
        return []
    return [
        CodedWarning(
            "W_NOT_CONVERGED",
            f"the solver stopped after {dem.solver['iterations']} iterations short of --tol; the "
            "surface is too soft or too stiff for the points: leave out --k-surface and --k-point",
        )
    ]


def _known_noise(source: Source, options: ConvertOptions) -> float | None:
    """Return ``--sigma`` in the vertical unit."""
    sigma = options.sigma
    return None if sigma is None else float(sigma.in_units(source.crs.metres_per_unit_z))


def _holdout(
    points: SurfacePoints, dem: Dem, source: Source, options: ConvertOptions
) -> dict[str, Any] | None:
    """Return the report's ``dem.holdout``, if it is asked for."""
    if options.holdout is None:
        return None
    from volatool.dem.holdout import assess

    def again(train: SurfacePoints) -> Dem:
        return _dem(train, source, options, dem.scratch, dem.grid.exact[2])

    return assess(points, dem, options.holdout, again, _known_noise(source, options))


def _with_sigma(
    points: SurfacePoints, dem: Dem, source: Source, options: ConvertOptions
) -> tuple[Dem, dict[str, Any] | None]:
    """Return the model with its standard errors and the report's ``dem.sigma``, if asked for."""
    known = _known_noise(source, options)
    if known is not None and dem.springs is not None:
        dem = replace(dem, noise_sigma=known)
    if "sigma" not in options.layers or dem.springs is None or dem.spacing is None:
        return dem, None
    from volatool.dem.sigma import fit, sigma_layer

    scratch = dem.scratch
    model = fit(points, dem.grid, dem.springs, dem.noise, dem.spacing, dem.crs, scratch, known)
    if model is None:
        return dem, None
    return replace(dem, sigma=sigma_layer(points, dem.grid, dem.flag, model, scratch)), (
        model.to_dict()
    )


def _dem(
    points: SurfacePoints,
    source: Source,
    options: ConvertOptions,
    scratch: Scratch,
    edge: Fraction | None = None,
) -> Dem:
    """Return the model, lengths converted to the unit of the CRS; of cells of a given edge."""
    from volatool.dem.surfaces import make_dem

    unit = source.crs.metres_per_unit_xy
    cell, gap = options.cell, options.max_gap
    if edge is None and not isinstance(cell, str):
        edge = cell.in_units(unit)
    dem = make_dem(
        points,
        source.crs,
        "auto" if edge is None else edge,
        max_gap=None if gap is None else float(gap.in_units(unit)),
        fill=options.fill,
        k_surface=options.k_surface,
        k_point=options.k_point,
        tol_m=float(options.tol.in_units(Fraction(1))),  # a bare number is in metres
        scratch=scratch,
        preset=options.preset,
    )
    logger.info(
        "%s: %s of %d x %d cells of %g, %s iterations",
        source.name,
        dem.surface,
        dem.grid.width,
        dem.grid.height,
        dem.grid.cell,
        dem.solver.get("iterations"),
    )
    return dem
