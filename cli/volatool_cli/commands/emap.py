"""``volatool emap``."""

from __future__ import annotations

from typing import Any

import click

from volatool.naming import LAYERS
from volatool_cli import options
from volatool_cli.params import (
    BoundsType,
    FloatRange,
    LengthType,
    SizeType,
    WordsType,
    complete_files,
)


@click.command(short_help="Follow scans and keep the surface up to date.")
@click.argument("inputs", metavar="[SCAN...]", nargs=-1, shell_complete=complete_files)
@click.option(
    "--format",
    "form",
    type=click.Choice(["auto", "npy"]),
    default="auto",
    show_default="auto: SCAN are names",
    help="npy: stdin is NumPy arrays, one numpy.save after another.",
)
@click.option(
    "--poses",
    type=click.Path(dir_okay=False),
    metavar="FILE",
    help="The sensor's pose of each scan, a line each: x y z [qx qy qz qw], or a 3x4 matrix.",
)
@click.option(
    "--frame",
    type=click.Choice(["sensor", "world"]),
    default="sensor",
    show_default=True,
    help="What coordinates the scans are in, when there are poses.",
)
@click.option(
    "--cell", type=LengthType(), default="0.25", show_default=True, help="Edge of a cell."
)
@click.option(
    "--window",
    type=LengthType("all"),
    default="10",
    show_default=True,
    help="Side of the window round the sensor that is kept up to date; all: all that was seen.",
)
@click.option(
    "--margin",
    type=click.IntRange(min=0),
    metavar="CELLS",
    show_default="20; 0 with --preset paper",
    help="Cells around the window that are solved with it.",
)
@click.option("--bounds", type=BoundsType(), help="A fixed window; use only points inside.")
@click.option("--radius", type=LengthType(), help="Drop returns farther from the sensor.")
@click.option(
    "--sigma",
    type=LengthType(),
    default="0.05",
    show_default=True,
    help="Standard deviation of a point's height.",
)
@click.option(
    "--forget",
    type=FloatRange(0, 1, min_open=True),
    default=1.0,
    show_default=True,
    metavar="FACTOR",
    help="Factor on all earlier scans at each new one; 1 forgets nothing.",
)
@click.option(
    "--max-weight",
    type=FloatRange(0, min_open=True),
    metavar="POINTS",
    help="What a place is worth at most, in points: new ones then replace the old.",
)
@click.option(
    "--preset",
    type=click.Choice(["emap", "paper"]),
    default="emap",
    show_default=True,
    help="Springs: ours, or the EMap paper's membrane.",
)
@click.option(
    "--k-surface", type=float, metavar="K", help="Stiffness of the surface.  [default: 10 cell^2]"
)
@click.option(
    "--tol",
    type=LengthType(),
    default="0.0001",
    show_default=True,
    help="Accuracy of the solution.",
)
@click.option("--crs", metavar="EPSG:x[+y]", help="CRS of the world.  [default: none, metres]")
@click.option(
    "--snapshot",
    type=click.Path(),
    metavar="FILE|DIR",
    help="Write the model while scans come: NAME.tif is replaced each time, a folder collects.",
)
@click.option(
    "--every",
    type=click.IntRange(min=1),
    default=50,
    show_default=True,
    metavar="N",
    help="Scans from one snapshot to the next.",
)
@click.option(
    "-o",
    "--output",
    type=click.Path(dir_okay=False),
    metavar="FILE",
    help="Write the model at the end, also after Ctrl-C.",
)
@click.option(
    "--max-gap", type=LengthType(), help="In models, fill no cell farther than this from a point."
)
@click.option(
    "--layers",
    type=WordsType(*LAYERS),
    default="none",
    help="More rasters beside each model: count,flag,distance,sigma.",
)
@options.overwrite
@click.option("--fail-fast", is_flag=True, help="Stop at the first scan that can't be used.")
@click.option(
    "--memory",
    "memory_bytes",
    type=SizeType(),
    default="1G",
    show_default=True,
    help="Half for what is known of the world, half for the models.",
)
@click.option("--no-resources", is_flag=True, help="Leave times and memory out of the lines.")
@options.messages
def emap(**arguments: Any) -> None:
    """Follow scans and keep an elevation map up to date: one JSON line a scan.

    SCAN is LAS, LAZ, COPC, PCD or NPY, a folder of them, or - for names on stdin, one a line,
    taken as they come. A scan that can't be used is a line on stderr, and the next one is taken.

    \b
    Examples:
      volatool emap scans/*.pcd --poses poses.csv -o map.tif
      cat names.txt | volatool emap - --snapshot map.tif --every 10
      cat drive.npy | volatool emap --format npy --window 20
    """
    from volatool_cli.follow import follow

    follow(arguments)
