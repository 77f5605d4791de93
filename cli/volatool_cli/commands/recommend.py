"""``volatool recommend``."""

from __future__ import annotations

from typing import Any

import click

from volatool_cli import options
from volatool_cli.params import FloatRange


@click.command(short_help="Recommend voxel and cell size for a data set.")
@options.inputs
@options.nul_names
@click.option(
    "--sample",
    type=click.IntRange(min=1),
    metavar="N",
    help="Read only N tiles, at equal steps through the list; of the others the header.",
)
@options.of_class
@options.reading
@options.crs
@options.cube
@options.split
@click.option(
    "--min-occupancy",
    type=FloatRange(0, 1, min_open=True),
    default=0.15,
    show_default=True,
    metavar="FRACTION",
    help="Average fill of stored blocks that the depth must reach.",
)
@options.memory
@options.jobs
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@options.progress
@options.messages
def recommend(**arguments: Any) -> None:
    """Recommend voxel and cell size for a set of tiles, with the curve and the expected sizes.

    INPUT are tiles, or what was made of them: reports (NAME.stats.json, lines of --json) or the
    data set's summary (stats --summary --format json). Tiles are read for the occupancy of every
    level, and some of them once more for the cell of the elevation model; from reports the cell
    is estimated by the density.

    \b
    Examples:
      volatool recommend tiles/
      volatool recommend tiles/ --sample 50 --json
      volatool recommend dataset.json
    """
    from volatool_cli.recommend import run_recommend

    run_recommend(arguments)
