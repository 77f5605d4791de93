"""``volatool import``."""

from __future__ import annotations

from typing import Any

import click

from volatool.imports.registry import FORMATS
from volatool_cli import options
from volatool_cli.params import LengthType


@click.command("import", short_help="Make volumes of points, meshes and grids of other formats.")
@options.inputs
@options.nul_names
@click.option(
    "--from",
    "from_format",
    type=click.Choice(list(FORMATS)),
    help="Format of the inputs.  [default: by suffix]",
)
@click.option(
    "--columns",
    metavar="NAMES",
    help="What the columns are: x,y,z,intensity,red,green,blue,class; - leaves one out."
    "  [default: a header line, else their number]",
)
@click.option(
    "--mesh",
    type=click.Choice(["auto", "voxelize", "sample", "vertices"]),
    default="auto",
    show_default="auto: voxelize, but vertices of PLY",
    help="What of a mesh is taken: each voxel that its surface touches, points on it, or corners.",
)
@click.option(
    "--spacing",
    type=LengthType(),
    help="Distance of the points of --mesh sample.  [default: half a cell]",
)
@click.option("--swap-yz", is_flag=True, help="Swap y and z: for files whose y is up.")
@options.output
@options.selection
@options.chunk_points
@options.crs
@options.cube
@options.split
@options.depth
@options.metadata
@options.volume_files
@click.option(
    "--dem/--no-dem", default=False, show_default=True, help="Make the elevation model too."
)
@options.dem
@click.option("--preview", is_flag=True, help="Write a picture, NAME.preview.png.")
@options.memory
@options.jobs
@options.record
@options.as_reports
@options.no_resources
@options.progress
@options.messages
def import_(**arguments: Any) -> None:
    """Make VOLA volumes of points, meshes, grids and rasters of other formats.

    Takes xyz, txt, csv, pts, ply, pcd, npy, npz, bin (KITTI), stl, obj, binvox, bt (OctoMap), asc
    and tif (elevation models). Each input gives NAME.vol.gz, NAME.dvol.gz and NAME.stats.json, as
    convert makes them of LAS files; their paths are printed, one a line.

    \b
    Examples:
      volatool import cloud.xyz --crs EPSG:28992
      volatool import cloud.csv -o out --columns x,y,z,-,intensity --resolution 0.5
      volatool import scan.npy -o out --depth 4 --json
    """
    from volatool_cli.run import run_tiles

    run_tiles(arguments, kind="import")
