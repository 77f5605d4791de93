"""``volatool dem``."""

from __future__ import annotations

from typing import Any

import click

from volatool_cli import options


@click.command(short_help="Write the elevation model of tiles.")
@options.inputs
@options.nul_names
@options.output
@options.selection
@options.reading
@options.crs
@options.dem
@options.mosaic
@options.memory
@options.jobs
@options.record
@options.as_reports
@options.no_resources
@options.progress
@options.messages
def dem(**arguments: Any) -> None:
    """Make the elevation model of tiles and nothing else: NAME.dem.tif.

    A float32 Cloud-Optimised GeoTIFF: the EMap surface through the points, filled as far as
    --max-gap from measured cells, nodata -9999 beyond. INPUT may also be a VOLA file, named
    outright: its voxels are the points then.

    \b
    Examples:
      volatool dem tile.laz
      volatool dem tile.laz -o out --surface dsm --cell 0.5m
      volatool dem tile.laz -o out --max-gap 10m --layers flag,count,distance
      volatool dem tiles/ -o out --mosaic town --cog
      volatool dem tile.vol.gz -o out --surface dsm
    """
    from volatool_cli.mosaic import run_mosaic

    run_mosaic(arguments, kind="dem")
