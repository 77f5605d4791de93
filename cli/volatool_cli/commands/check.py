"""``volatool check``."""

from __future__ import annotations

import sys
from typing import Any

import click

from volatool_cli import options
from volatool_cli.params import LengthType


@click.command(short_help="Hold an elevation model against surveyed checkpoints.")
@click.argument("dem", metavar="DEM", type=click.Path(dir_okay=False))
@click.option(
    "--points",
    required=True,
    metavar="CSV",
    help="Checkpoints: columns x,y,z, by heads or in this order, and id, cover (NVA|VVA); - reads "
    "stdin.",
)
@click.option(
    "--points-crs",
    metavar="EPSG:x",
    help="CRS of the checkpoints' x and y.  [default: the DEM's]",
)
@click.option(
    "--points-unit",
    type=click.Choice(["mm", "cm", "m", "ft", "ftUS", "in"]),
    help="Unit of the checkpoints' heights.  [default: that of the DEM's]",
)
@click.option(
    "--checkpoint-rmse",
    type=LengthType(),
    help="The checkpoints' own vertical error; nothing is reportable without. A bare number is in "
    "the unit of the DEM's heights.",
)
@click.option(
    "--require",
    type=LengthType(),
    help="Largest RMSE_V of non-vegetated points that will do; status 6 if not shown to hold.",
)
@click.option(
    "--sigma",
    type=click.Path(dir_okay=False),
    metavar="TIF",
    help="Layer of standard errors.  [default: NAME.dem.sigma.tif beside the DEM, if there]",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
@options.messages
def check(dem: str, points: str, as_json: bool, **arguments: Any) -> None:
    """Assess the vertical accuracy of an elevation model by checkpoints (ASPRS edition 2, 2023).

    RMSE_V is the errors' root mean square combined with the checkpoints' own error. Fewer than 30
    checkpoints are shown but not reportable, and nothing passes that was not required.

    \b
    Examples:
      volatool check tile.dem.tif --points checkpoints.csv
      volatool check tile.dem.tif --points checkpoints.csv --checkpoint-rmse 2cm --json
      volatool check tile.dem.tif --points checkpoints.csv --checkpoint-rmse 2cm --require 30cm
    """
    from pathlib import Path

    from volatool.dem import accuracy
    from volatool.dem.raster import read_profile
    from volatool.report import dumps
    from volatool_cli.exit_codes import ExitCode
    from volatool_cli.output import configure_logging

    names = ("quiet", "verbose", "log")
    configure_logging(*(arguments.pop(name) for name in names))
    path = Path(dem)
    unit = read_profile(path)["unit"]
    crs = accuracy.crs_of(path)
    metres = accuracy.metres_per_height(crs, unit)
    checkpoints = accuracy.read_points(points)
    if arguments["points_crs"] is not None:
        checkpoints = accuracy.moved(checkpoints, arguments["points_crs"], crs, path.name)
    if arguments["points_unit"] is not None:
        checkpoints = accuracy.in_unit(checkpoints, arguments["points_unit"], metres)
    lengths = {
        name: None if arguments[name] is None else float(arguments[name].in_units(metres))
        for name in ("checkpoint_rmse", "require")
    }
    result = accuracy.assess(
        path,
        checkpoints,
        checkpoint_rmse=lengths["checkpoint_rmse"],
        required=lengths["require"],
        sigma=None if arguments["sigma"] is None else Path(arguments["sigma"]),
    )
    click.echo(dumps(result.to_dict()) if as_json else accuracy.summary(result))
    if not result.holds:
        sys.exit(ExitCode.CHECK_FAILED)
