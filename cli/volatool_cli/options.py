"""Options that several commands share; each means the same everywhere."""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce
from typing import Any

import click

from volatool.channels import CHANNELS
from volatool.naming import LAYERS
from volatool_cli.params import (
    BoundsType,
    CodesType,
    DepthType,
    FloatRange,
    JobsType,
    LengthType,
    SizeType,
    WordsType,
    complete_files,
    joined,
)


def group(*decorators: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Return one decorator that applies several, keeping their order in the help."""
    return lambda function: reduce(
        lambda inner, outer: outer(inner), reversed(decorators), function
    )


inputs = click.argument(
    "inputs", metavar="INPUT...", nargs=-1, required=True, shell_complete=complete_files
)

nul_names = click.option(
    "-0", "nul", is_flag=True, help="Names from stdin (INPUT -) end in NUL, as find -print0 writes."
)

of_class = group(
    click.option(
        "--class",
        "classes",
        type=CodesType(),
        multiple=True,
        callback=joined,
        help="Use only these class codes: 2,9.",
    ),
    click.option(
        "--exclude-class",
        "exclude_classes",
        type=CodesType(),
        multiple=True,
        callback=joined,
        help="Leave these out.",
    ),
    click.option(
        "--returns",
        type=click.Choice(["all", "first", "last"]),
        default="all",
        show_default=True,
        help="Which returns of a pulse to use.",
    ),
    click.option("--keep-withheld", is_flag=True, help="Use points flagged as withheld."),
    click.option("--keep-noise", is_flag=True, help="Use points of the noise classes 7 and 18."),
)

of_place = group(
    click.option("--bounds", type=BoundsType(), help="Use only points inside, in CRS units."),
    click.option(
        "--thin", type=click.IntRange(min=1), metavar="N", help="Use every N-th point of the file."
    ),
)

of_height = click.option(
    "--robust-z", is_flag=True, help="Leave points out that stand alone far above or below."
)

selection = group(of_class, of_place, of_height)

chunk_points = click.option(
    "--chunk-points",
    type=click.IntRange(min=1),
    default=400_000,
    show_default=True,
    metavar="N",
    help="Points read at a time; does not change any result.",
)

reading = group(
    chunk_points,
    click.option("--salvage", is_flag=True, help="Use the readable points of a damaged file."),
    click.option("--strict", is_flag=True, help="Refuse files with faults that are warnings."),
)

crs_of_file = group(
    click.option("--crs", metavar="EPSG:x[+y]", help="CRS of the points, whatever the file says."),
    click.option("--crs-default", metavar="EPSG:x[+y]", help="CRS of files that have none."),
)

crs = group(
    crs_of_file,
    click.option("--to-crs", metavar="EPSG:x|utm", help="Reproject while reading."),
)

cube = group(
    click.option(
        "--cube",
        type=LengthType("auto"),
        default="auto",
        show_default="auto: longest side of the box of all points",
        help="Side of the cube, anchored at the minimum of the box.",
    ),
    click.option("--snap", is_flag=True, help="Cube corner on multiples of its side."),
    click.option(
        "--cube-from",
        type=click.Path(dir_okay=False),
        metavar="VOLUME",
        help="Cube and, unless given otherwise, depth of a VOLA file: the same grid as another "
        "epoch's.",
    ),
)

depth = group(
    click.option(
        "--depth",
        type=DepthType(),
        default="auto",
        show_default="auto: by block occupancy",
        help="Number of levels.",
    ),
    click.option("--resolution", type=LengthType(), help="Cell edge; the nearest not coarser."),
    click.option(
        "--min-occupancy",
        type=FloatRange(0, 1, min_open=True),
        default=0.15,
        show_default=True,
        metavar="FRACTION",
        help="Average fill of stored blocks that a depth must reach.",
    ),
    click.option(
        "--max-depth",
        type=click.IntRange(2, 10),
        default=8,
        show_default=True,
        help="Deepest level looked at.",
    ),
    click.option("--budget", type=SizeType(), help="Deepest level whose gzip file fits."),
    click.option(
        "--depth-from",
        type=click.Path(dir_okay=False),
        metavar="DATASET.json",
        help="Depth of a data set, from stats --summary --format json.",
    ),
)

split = click.option(
    "--split",
    type=LengthType(),
    help="One volume per snapped cube of this side: NAME_x{X}_y{Y}_z{Z}.vol.gz.",
)

metadata = click.option(
    "--meta",
    type=WordsType(*CHANNELS),
    metavar="WORDS",
    default=",".join(CHANNELS),
    show_default="all that the file has",
    help="Metadata per block: rgb,height,returns,intensity,class or none.",
)

volume_files = group(
    click.option(
        "--dense",
        type=click.Choice(["auto", "always", "never"]),
        default="auto",
        show_default="auto: up to 64 MiB",
        help="Write the dense volume too.",
    ),
    click.option("--gzip/--no-gzip", default=True, show_default=True, help="Compress the volumes."),
    click.option(
        "--compat",
        type=click.Choice(["toolkit"]),
        help="Write the bytes of the original VOLA toolkit; needs --depth.",
    ),
)

memory = click.option(
    "--memory",
    type=SizeType(),
    default="1G",
    show_default=True,
    help="Ceiling for the whole run, kept by spilling to temporary files; --jobs share it.",
)

jobs = group(
    click.option(
        "-j",
        "--jobs",
        type=JobsType(),
        default="1",
        show_default=True,
        help="Processes that work at once; auto: as many as cores and --memory allow.",
    ),
    click.option(
        "--scheduler",
        metavar="ADDRESS",
        help="Work on a Dask cluster (extra dask): tcp://HOST:PORT, whose workers each get "
        "--memory; or local, --jobs workers of its own.",
    ),
)

record = group(
    click.option(
        "--manifest",
        type=click.Path(dir_okay=False),
        metavar="FILE",
        help="Append a record of each tile, a JSON line, for --resume.",
    ),
    click.option(
        "--resume", is_flag=True, help="Skip the tiles that the manifest proves done; do the rest."
    ),
    click.option(
        "--verify", is_flag=True, help="With --resume: prove outputs by their content, not size."
    ),
)

dem = group(
    click.option(
        "--cell",
        type=LengthType("auto"),
        default="auto",
        show_default="auto: 60 % of the cells hold a point",
        help="Edge of a DEM cell.",
    ),
    click.option(
        "--surface",
        type=click.Choice(["auto", "dtm", "dsm", "min", "max", "mean", "idw", "tin"]),
        default="auto",
        show_default="auto: dtm of ground-class points, else of the ground filter's",
        help="Which points make the surface; from min on plain baselines without EMap.",
    ),
    click.option(
        "--max-gap", type=LengthType(), help="Fill no cell farther than this from a measured one."
    ),
    click.option("--no-fill", is_flag=True, help="Leave every cell without a point empty."),
    click.option(
        "--preset",
        type=click.Choice(["emap", "paper"]),
        default="emap",
        show_default=True,
        help="Springs: ours, or the EMap paper's membrane.",
    ),
    click.option(
        "--k-surface",
        type=float,
        metavar="K",
        help="Stiffness of a single surface net.  [default: the sum of two, by the spacing]",
    ),
    click.option(
        "--ell",
        type=LengthType(),
        help="Length beyond which a single net would rather be level than keep its slope.",
    ),
    click.option("--k-point", type=float, metavar="K", help="Stiffness of the point springs."),
    click.option(
        "--tol",
        type=LengthType(),
        default="0.1mm",
        show_default=True,
        help="Accuracy of the solution.",
    ),
    click.option(
        "--layers",
        type=WordsType(*LAYERS),
        default="none",
        help="More rasters beside the DEM: count,flag,distance,sigma (standard error).",
    ),
    click.option(
        "--sigma",
        type=LengthType(),
        help="Noise of the points' heights.  [default: estimated, by region]",
    ),
    click.option(
        "--holdout",
        type=FloatRange(0, 50, min_open=True),
        metavar="PERCENT",
        help="Judge the DEM by so many points, made once more without them; see the report.",
    ),
    click.option(
        "--neighbours",
        multiple=True,
        metavar="DIR|LIST",
        shell_complete=complete_files,
        help="Tiles around (folder, file, pattern, @list), so that DEMs meet at the seams.",
    ),
    click.option(
        "--buffer",
        type=LengthType(),
        show_default="32 cells, twice --max-gap, and beyond gaps at the seam",
        help="How far beyond the tile neighbours' points are used.",
    ),
    click.option(
        "--params-from",
        metavar="REPORTS",
        shell_complete=complete_files,
        help="Cell and stiffness of a whole set, from the reports of a first run.",
    ),
    click.option(
        "--like",
        metavar="REF.tif",
        shell_complete=complete_files,
        help="Cells, corner and extent of a raster.",
    ),
    click.option(
        "--robust", is_flag=True, help="Points far off the surface of the others hardly count."
    ),
    click.option(
        "--breaklines",
        metavar="FILE",
        shell_complete=complete_files,
        help="Lines (GeoJSON, GeoPackage, ...) that the surface may break along.",
    ),
    click.option(
        "--water",
        metavar="FILE",
        shell_complete=complete_files,
        help="Polygons: lakes become level, river banks may break.",
    ),
)

mosaic = group(
    click.option(
        "--mosaic",
        metavar="NAME",
        help="Seamless: each tile with its neighbours, on one grid, with one stiffness; "
        "NAME.dem.vrt over all.",
    ),
    click.option("--cog", is_flag=True, help="Write the mosaic as one file, too: NAME.dem.tif."),
)

overwrite = click.option("--overwrite", is_flag=True, help="Replace outputs that exist.")

output = group(
    click.option(
        "-o",
        "--outdir",
        type=click.Path(file_okay=False),
        metavar="DIR",
        help="Folder for the outputs; made if need be.  [default: beside the input]",
    ),
    overwrite,
    click.option("--dry-run", is_flag=True, help="Say what would be written; read headers only."),
    click.option("--fail-fast", is_flag=True, help="Stop at the first input that fails."),
)

as_reports = click.option(
    "--json", "as_json", is_flag=True, help="Print a report a line instead of paths."
)

no_resources = click.option(
    "--no-resources", is_flag=True, help="Leave time and memory out of the report."
)

progress = click.option(
    "--progress",
    type=click.Choice(["auto", "bar", "json", "none"]),
    default="auto",
    show_default="bar on a terminal",
    help="Progress on stderr.",
)

messages = group(
    click.option("-q", "--quiet", is_flag=True, help="Only errors on stderr."),
    click.option("-v", "--verbose", count=True, help="More on stderr; twice for debugging."),
    click.option(
        "--log", type=click.Path(dir_okay=False), metavar="FILE", help="Write a log, with traces."
    ),
)
