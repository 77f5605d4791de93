"""``volatool retile``."""

from __future__ import annotations

from typing import Any

import click

from volatool_cli import options
from volatool_cli.params import BoundsType, LengthType


@click.command(short_help="Cut files anew into the cubes of one grid.")
@options.inputs
@options.nul_names
@options.output
@click.option("--name", default="tile", show_default=True, help="What outputs begin with.")
@click.option(
    "--split",
    type=LengthType(),
    default="100m",
    show_default=True,
    help="Side of the cubes; their corners are on multiples of it.",
)
@options.of_class
@click.option("--bounds", type=BoundsType(), help="Use only points inside, in CRS units.")
@options.reading
@options.crs
@options.depth
@options.metadata
@options.volume_files
@options.memory
@options.jobs
@options.record
@options.as_reports
@options.no_resources
@options.progress
@options.messages
def retile(**arguments: Any) -> None:
    """Cut many files into volumes on one grid of cubes: NAME_x{X}_y{Y}_z{Z}.vol.gz.

    Points of neighbouring files in one cube become one volume, as if one file held all points. All
    cubes have one depth: the one asked for, or by occupancy over the whole set, for which the
    points are read once more. Cubes are worked on in groups; each has a report.

    \b
    Examples:
      volatool retile tiles/ -o out
      volatool retile tiles/ -o out --split 250m --depth-from dataset.json
    """
    from volatool_cli.retile import run_retile

    run_retile(arguments)
