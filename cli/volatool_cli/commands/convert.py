"""``volatool convert``."""

from __future__ import annotations

from typing import Any

import click

from volatool_cli import options
from volatool_cli.params import LengthType


@click.command(short_help="Write volume, elevation model and statistics of tiles.")
@options.inputs
@options.nul_names
@options.output
@options.selection
@options.reading
@options.crs
@options.cube
@click.option(
    "--split",
    type=LengthType(),
    help="One volume per snapped cube of this side: NAME_x{X}_y{Y}_z{Z}.vol.gz.",
)
@options.depth
@options.metadata
@click.option(
    "--dense",
    type=click.Choice(["auto", "always", "never"]),
    default="auto",
    show_default="auto: up to 64 MiB",
    help="Write the dense volume too.",
)
@click.option("--gzip/--no-gzip", default=True, show_default=True, help="Compress the volumes.")
@click.option(
    "--compat",
    type=click.Choice(["toolkit"]),
    help="Write the bytes of the original VOLA toolkit; needs --depth.",
)
@click.option("--dem/--no-dem", default=True, show_default=True, help="Make the elevation model.")
@options.dem
@click.option("--preview", is_flag=True, help="Write a picture, NAME.preview.png.")
@options.memory
@click.option("--json", "as_json", is_flag=True, help="Print a report a line instead of paths.")
@options.no_resources
@options.progress
@options.messages
def convert(**arguments: Any) -> None:
    """Convert tiles in one pass to a VOLA volume, an elevation model and statistics.

    INPUT is a file, a folder, a pattern, @list.txt, or - for names on stdin. Each tile gives
    NAME.vol.gz, NAME.dvol.gz, NAME.dem.tif and NAME.stats.json; their paths are printed, one a
    line. LENGTH takes a unit (1m, 0.5ft, 2ftUS); bare numbers are in the unit of the CRS.

    \b
    Examples:
      volatool convert tile.laz
      volatool convert tiles/ -o out --memory 512M --preview
      volatool convert tile.laz -o out --class 2,9 --cell 1m --layers count,flag
      find tiles -name '*.laz' -print0 | volatool convert -0 - -o out --json
    """
    from volatool_cli.run import run_tiles

    run_tiles(arguments, kind="convert")
