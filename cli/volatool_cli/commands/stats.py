"""``volatool stats``."""

from __future__ import annotations

from typing import Any

import click

from volatool_cli import options
from volatool_cli.params import ConditionType


@click.command(short_help="Print occupancy and size tables of tiles or volumes.")
@options.inputs
@options.nul_names
@click.option(
    "--format",
    "form",
    type=click.Choice(["table", "json", "jsonl", "csv", "md"]),
    default="table",
    show_default=True,
    help="What to print.",
)
@click.option("--summary", is_flag=True, help="One table summed over all inputs.")
@click.option(
    "--fail-if",
    "gates",
    type=ConditionType(),
    multiple=True,
    help="Exit with status 6 if this is true of a tile (of the sum, with --summary): 'depth < 5', "
    "'crs == none', 'warnings has W_NO_CRS'; may be repeated.",
)
@options.selection
@options.reading
@options.crs
@options.cube
@options.depth
@options.metadata
@options.memory
@options.jobs
@click.option("--fail-fast", is_flag=True, help="Stop at the first input that fails.")
@options.no_resources
@options.progress
@options.messages
def stats(**arguments: Any) -> None:
    """Print the occupancy of each level, the sizes, and the depth that follows.

    INPUT is LAS, LAZ, COPC or a VOLA file. Nothing is written. The first columns are those of the
    VOLA paper's tables; * marks the chosen level. The names that --fail-if knows are those of the
    report; a wrong one lists them.

    \b
    Examples:
      volatool stats tile.laz
      volatool stats tile.vol.gz --format json
      volatool stats tiles/ --summary --format md
      volatool stats tile.laz --fail-if 'depth < 3' --fail-if 'warnings has W_NO_CRS'
    """
    from volatool_cli.run import run_tiles

    run_tiles(arguments, kind="stats")
