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
    from volatool.dem.grid import Grid
    from volatool.dem.parameters import Parameters
    from volatool.dem.surfaces import Dem
    from volatool.points.source import Named, Source

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
    from volatool.dem.crop import crop
    from volatool.dem.neighbours import seam_warning
    from volatool.dem.placing import grids_of, seam_of, shared_parameters

    resources.budget_for_rasters(scratch, options.memory)
    shared = shared_parameters(options, source.crs)
    seam = seam_of(surface, source, options, scratch)
    threads = resources.n_threads()
    points = surface.result(source.crs, threads=threads) if seam is None else seam.points
    if points.extent is None:
        header, extent = source.header, (box[0], box[1], box[3], box[4])
        points = replace(points, extent=extent, scale=header.scale, offset=header.offset)
    own, wide = grids_of(points, source, options) if seam is None else (seam.own, seam.grid)
    dem = dem_of(points, source, options, scratch, shared, wide)
    dem, judged = judge(points, dem, source, options, shared)
    points.close()
    if own is not None:
        dem = crop(dem, own)
    resources.drop_library_code()
    document = write_elevation(dem, source.name, options, outputs, target)
    document |= judged
    warnings = [*points.warnings, *solver_warnings(dem)]
    if seam is not None:
        document["buffer"] = seam.document
        warnings += [*seam.warnings, *seam_warning(options, dem.surface, shared is not None)]
    return ElevationPart(dem, document, tuple(warnings))


def write_elevation(
    dem: Dem,
    name: str,
    options: ConvertOptions,
    outputs: OutputSet,
    target: Callable[[str], Path],
) -> dict[str, Any]:
    """
    Write a model with its layers.

    Parameters
    ----------
    dem : Dem
        The model.
    name : str
        Of the input.
    options, outputs, target
        As for `make_elevation`.

    Returns
    -------
    document : dict
        The report's ``dem``.
    """
    from volatool.dem import geotiff

    tags = {"SOURCE": readable(name), "OPTIONS": dumps(options.given())}
    path = target(".dem.tif")
    geotiff.write_dem(outputs.add(path), dem, tags=tags)
    layers = {}
    for layer in options.layers:
        layer_path = target(f".dem.{layer}.tif")
        geotiff.write_layer(outputs.add(layer_path), dem, cast("Layer", layer), tags=tags)
        layers[layer] = layer_path.name
    document = {"path": path.name, **dem.to_dict(), "holdout": None, "layers": layers}
    document["solver"] = document["solver"] or None  # no points: nothing was solved
    return document


def solver_warnings(dem: Dem) -> list[CodedWarning]:
    """Say what came up while the model was made, and when the solver gave up short of --tol."""
    if dem.solver.get("converged", True):
        return list(dem.notes)
    hint = (
        "there are too many break lines for the cells: simplify them, and give lakes as polygons "
        "to --water"
        if dem.barriers is not None and dem.barriers["cut_edges"]
        else "the surface is too soft or too stiff for the points: leave out --k-surface and "
        "--k-point"
    )
    return [
        *dem.notes,
        CodedWarning(
            "W_NOT_CONVERGED",
            f"the solver stopped after {dem.solver['iterations']} iterations short of --tol; "
            + hint,
        ),
    ]


def judge(
    points: SurfacePoints,
    dem: Dem,
    source: Named,
    options: ConvertOptions,
    shared: Parameters | None,
    noise: float | None = None,
) -> tuple[Dem, dict[str, Any]]:
    """
    Return the model with its standard errors, if asked for, and what the report says of them.

    Parameters
    ----------
    points, source, options, shared
        As for `dem_of`.
    dem : Dem
        The model.
    noise : float, optional
        Of the points, vertical unit, where the file tells it; ``--sigma`` goes before.

    Returns
    -------
    dem : Dem
        With `Dem.sigma`.
    document : dict
        ``holdout`` and ``sigma`` of the report's ``dem``, those asked for.
    """
    if options.sigma is not None:
        noise = float(options.sigma.in_units(source.crs.metres_per_unit_z))
    if noise is not None and dem.tuned is not None:
        dem = replace(dem, noise_sigma=noise)
    document: dict[str, Any] = {}
    if options.holdout is None and "sigma" not in options.layers:
        return dem, document
    from volatool.dem.holdout import assess
    from volatool.dem.sigma import fit, sigma_layer
    from volatool.dem.split import within

    points, scratch = within(points, dem.grid), dem.scratch
    if options.holdout is not None:

        def again(train: SurfacePoints) -> Dem:
            return dem_of(train, source, options, scratch, shared, dem.grid)

        document["holdout"] = assess(points, dem, options.holdout, again, noise)
    if "sigma" in options.layers and dem.tuned is not None and dem.spacing is not None:
        model = fit(points, dem.grid, dem.tuned, dem.noise, dem.spacing, dem.crs, scratch, noise)
        if model is not None:
            document["sigma"] = model.to_dict()
            layer = sigma_layer(points, dem.grid, dem.flag, model, scratch)
            dem = replace(dem, sigma=layer)
    if "sigma" in options.layers and dem.sigma is None:
        unknown = CodedWarning(
            "W_NO_SIGMA",
            "the points are too few to tell their noise by: the layer of standard errors is void; "
            "--sigma gives the noise",
        )
        dem = replace(dem, notes=(*dem.notes, unknown))
    return dem, document


def dem_of(
    points: SurfacePoints,
    source: Named,
    options: ConvertOptions,
    scratch: Scratch,
    shared: Parameters | None,
    grid: Grid | None,
) -> Dem:
    """
    Return the model, lengths converted to the unit of the CRS.

    Parameters
    ----------
    points : SurfacePoints
        With an extent.
    source : Source, or what has its name and CRS
        Where the points are from.
    options : ConvertOptions
        What is asked for.
    scratch : Scratch
        Memory budget.
    shared : Parameters or None
        What the tiles of a set have in common, if that is given.
    grid : Grid or None
        Cells, if they don't follow from the points.
    """
    from volatool.dem.surfaces import make_dem

    resources.budget_for_rasters(scratch, options.memory)
    unit = source.crs.metres_per_unit_xy
    cell, gap = options.cell, options.max_gap
    barriers = None
    if options.breaklines is not None or options.water is not None:
        from volatool.dem.vectors import read_barriers

        barriers = read_barriers(options.breaklines, options.water, source.crs)
    dem = make_dem(
        points,
        source.crs,
        "auto" if isinstance(cell, str) else cell.in_units(unit),
        max_gap=None if gap is None else float(gap.in_units(unit)),
        fill=options.fill,
        k_surface=options.k_surface,
        k_point=options.k_point,
        spacing=None if shared is None else shared.spacing,
        ell=None if options.ell is None else float(options.ell.in_units(unit)),
        tol_m=float(options.tol.in_units(Fraction(1))),  # a bare number is in metres
        scratch=scratch,
        preset=options.preset,
        grid=grid,
        barriers=barriers,
        robust=options.robust,
        with_noise="sigma" in options.layers or options.holdout is not None,
        threads=resources.n_threads(),
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
