"""``volatool convert``."""

from __future__ import annotations

from typing import Any

import click

from volatool_cli import options


@click.command(short_help="Write volume, elevation model and statistics of tiles.")
@options.inputs
@options.nul_names
@options.output
@options.selection
@options.reading
@options.crs
@options.cube
@options.split
@options.depth
@options.metadata
@options.volume_files
@click.option("--dem/--no-dem", default=True, show_default=True, help="Make the elevation model.")
@options.dem
@options.mosaic
@click.option("--preview", is_flag=True, help="Write a picture, NAME.preview.png.")
@options.memory
@options.jobs
@options.record
@options.as_reports
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
    from volatool_cli.mosaic import run_mosaic

    run_mosaic(arguments, kind="convert")
