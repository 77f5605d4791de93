"""``volatool export``."""

from __future__ import annotations

from typing import Any

import click

from volatool.export.model import COLOURS, SHAPES, SLICES
from volatool.export.registry import FORMATS
from volatool_cli import options
from volatool_cli.params import BoundsType, LengthOrZeroType, LengthRangeType, RangeType, SizeType

_WIDTH = max(map(len, FORMATS)) + 2
_LIST = "\n".join(f"  {name:{_WIDTH}}{one.title}" for name, one in FORMATS.items())
_HELP = f"""Write a volume in another format: all of it, a coarser level, or a part.

The output lies beside FILE, with the suffix of the format; its path is printed (of several
files one a line). Points are called tile.voxels.laz: tile.laz is what the volume was made from.

\b
Formats:
{_LIST}

\b
Examples:
  volatool export tile.vol.gz --to laz
  volatool export tile.vol.gz --to nav2 --above 0.5m,5m -o map.yaml
  volatool export tile.vol.gz --to png --level 3 --slices top
"""


@click.command(short_help="Write a volume in another format.", help=_HELP)
@click.argument("file", metavar="FILE", type=click.Path())
@click.option(
    "--to",
    type=click.Choice(list(FORMATS)),
    metavar="FORMAT",
    help="The format.  [default: by the name of the output]",
)
@click.option(
    "-o",
    "--output",
    type=click.Path(),
    metavar="PATH",
    help="The output, or a folder/ for it.  [default: beside the input]",
)
@options.overwrite
@click.option("--level", type=click.IntRange(min=1), metavar="N", help="A coarser level; exact.")
@click.option("--bounds", type=BoundsType(), help="Only cells that meet this rectangle.")
@click.option(
    "--z", type=RangeType(), help="Only cells that meet these heights, in the vertical unit."
)
@click.option(
    "--local/--world",
    default=None,
    help="Coordinates from the cube's corner, which single precision can hold, or those of the CRS "
    "(ply, glb, nav2, bt, binvox, vdb).",
)
@click.option("--free", is_flag=True, default=None, help="bt: the rest of the cube is free.")
@click.option(
    "--shape", type=click.Choice(SHAPES), help="ply: points, or cubes as a mesh of their faces."
)
@click.option("--colour", type=click.Choice(COLOURS), help="ply, glb: what the colours show.")
@click.option("--sparse", is_flag=True, default=None, help="npy: coordinates, (n, 3) int32.")
@click.option(
    "--slices",
    type=click.Choice(SLICES),
    help="png: a picture of each layer, or one view from the top.  [default: all]",
)
@click.option(
    "--above",
    type=LengthRangeType(),
    help="nav2: heights above the ground of what is an obstacle.  [default: 0.2m,2m]",
)
@click.option(
    "--ground",
    type=click.Path(dir_okay=False),
    metavar="DEM.tif",
    help="nav2: the ground.  [default: the bare earth of the volume, as dem makes it]",
)
@click.option(
    "--near",
    type=LengthOrZeroType(),
    help="nav2: how far from ground that was seen an empty column is free.  [default: 0.5m]",
)
@click.option("--name", metavar="WORD", help="c-array: what the array is called.")
@click.option("--dense", is_flag=True, default=None, help="vol1: the dense form.")
@click.option(
    "--limit", type=SizeType(), help="npy, png, c-array, binvox: largest output that is written."
)
@options.messages
def export(
    file: str,
    to: str | None,
    output: str | None,
    overwrite: bool,
    quiet: bool,
    verbose: int,
    log: str | None,
    **chosen: Any,
) -> None:
    """Write a volume in another format; `_HELP` is what a user sees."""
    from volatool.errors import OptionError
    from volatool.export.api import export_volume
    from volatool_cli.output import configure_logging, say_warnings

    configure_logging(quiet, verbose, log)
    if output == "":
        raise OptionError("--output is an empty name; is a shell variable unset?")
    done = export_volume(file, output, to, overwrite=overwrite, **chosen)
    say_warnings(file, done.warnings, quiet)
    for path in done.paths:
        click.echo(str(path))
