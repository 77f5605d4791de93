"""``volatool query`` and its kinds."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from volatool.errors import OptionError
from volatool_cli import queries
from volatool_cli.params import FloatRange, LengthType, NumbersType, complete_files
from volatool_cli.queries import Asked

if TYPE_CHECKING:
    from volatool.units import Length

Words = tuple[str, ...]


@click.group(
    cls=queries.QueryGroup,
    no_args_is_help=False,
    subcommand_metavar="KIND [ARGS]...",
    short_help="Ask a volume: points, boxes, rays, counts.",
)
@click.argument("file", metavar="FILE", type=click.Path())
@click.pass_context
def query(ctx: click.Context, file: str) -> None:
    """Ask a VOLA file questions: one answer line for each query.

    Numbers are arguments (several queries one after another), or lines on stdin (none given, or -)
    separated by blanks or commas; empty lines and # comments are passed over. Coordinates are in
    units of the CRS, heights in the vertical unit. A line that is no query ends the run with
    status 2 and its number, after the answers to all lines before it.

    \b
    Examples:
      volatool query tile.vol.gz point 6181200 2301150 3990
      volatool query tile.vol.gz column 6181200 2301150 --json
      echo 6181200 2301150 5000 0 0 -1 | volatool query tile.vol.gz ray
    """
    ctx.obj = Asked(file)


@query.command(short_help="Is there a voxel at a point?")
@queries.numbers("X Y Z")
@queries.common
def point(asked: Asked, numbers: Words, **arguments: Any) -> None:
    """Tell whether points fall into a voxel: occupied, free, or outside (the cube).

    A point on a face belongs to the cell above it. JSON has the cell (x, y, z from the cube's
    corner) and, in a voxel, the metadata of its block.

    \b
    Examples:
      volatool query tile.vol.gz point 6181200 2301150 3990
      volatool query tile.vol.gz point --json < points.txt
    """
    from volatool_cli import query_answers as answers

    asked.begin(arguments)
    asked.answer(numbers, ("X", "Y", "Z"), lambda rows: answers.points(asked.volume, rows))


@query.command(short_help="What is in a box?")
@queries.numbers("X0 Y0 Z0 X1 Y1 Z1")
@queries.common
def box(asked: Asked, numbers: Words, **arguments: Any) -> None:
    """Count voxels and blocks in boxes, and tell the tight box around them; none, or outside.

    Voxels count that a point of the closed box falls into; fill is their share of all such cells.
    -inf and inf are no limit. For voxels by their centre: census.

    \b
    Examples:
      volatool query tile.vol.gz box 6181100 2301100 3900 6181200 2301200 4000
      volatool query tile.vol.gz box -inf -inf 4200 inf inf inf --json
    """
    from volatool_cli import query_answers as answers

    asked.begin(arguments)
    names = ("X0", "Y0", "Z0", "X1", "Y1", "Z1")
    asked.answer(numbers, names, lambda rows: answers.boxes(asked.volume, rows))


@query.command(short_help="Which heights are occupied over a place?")
@queries.numbers("X Y")
@queries.common
def column(asked: Asked, numbers: Words, **arguments: Any) -> None:
    """Tell the occupied runs over places from top to bottom, LOW..HIGH each; empty, or outside.

    \b
    Examples:
      volatool query tile.vol.gz column 6181200 2301150
      cut -d " " -f 1,2 points.txt | volatool query tile.vol.gz column
    """
    from volatool_cli import query_answers as answers

    asked.begin(arguments)
    asked.answer(numbers, ("X", "Y"), lambda rows: answers.columns(asked.volume, rows))


@query.command(short_help="Which voxel does a ray meet first?")
@queries.numbers("X Y Z DX DY DZ")
@click.option(
    "--max-distance",
    type=LengthType(),
    help="Follow rays so far; a bare number is in the horizontal unit.",
)
@queries.common
def ray(asked: Asked, numbers: Words, max_distance: Length | None, **arguments: Any) -> None:
    """Tell the first voxel that rays from X Y Z in direction DX DY DZ meet, or none.

    The answer is the distance in the horizontal unit and the point where the ray comes into the
    voxel: the origin itself, at 0, if that is in a voxel. The direction's length does not matter,
    DZ is in the vertical unit. Rays may start outside the cube.

    \b
    Examples:
      volatool query tile.vol.gz ray 6181200 2301150 5000 0 0 -1
      volatool query tile.vol.gz ray 6181200 2301150 5000 0.1 0.1 -1 --max-distance 1500ft --json
    """
    from volatool_cli import query_answers as answers

    asked.begin(arguments)
    names = ("X", "Y", "Z", "DX", "DY", "DZ")
    asked.answer(numbers, names, lambda rows: answers.rays(asked.volume, rows, max_distance))


@query.command(short_help="Do two points see each other?")
@queries.numbers("X0 Y0 Z0 X1 Y1 Z1")
@click.option(
    "--ignore-ends", is_flag=True, help="The voxels that hold the two points are no obstacles."
)
@queries.common
def sight(asked: Asked, numbers: Words, ignore_ends: bool, **arguments: Any) -> None:
    """Tell whether two points see each other: clear, or blocked and where, from the first.

    Eyes and targets that stand on a surface are often inside a voxel of it: --ignore-ends. What is
    outside the cube is free.

    \b
    Examples:
      volatool query tile.vol.gz sight 6181050 2301050 4300 6181300 2301250 4300
      volatool query tile.vol.gz sight 6181050 2301050 4300 6181300 2301250 3950 --ignore-ends
    """
    from volatool_cli import query_answers as answers

    asked.begin(arguments)
    names = ("X0", "Y0", "Z0", "X1", "Y1", "Z1")
    asked.answer(numbers, names, lambda rows: answers.sights(asked.volume, rows, ignore_ends))


@query.command(short_help="How many voxels are around a place?")
@queries.numbers("X Y Z")
@click.option(
    "--connectivity",
    type=click.Choice(["6", "18", "26"]),
    multiple=True,
    show_default="6 and 26",
    help="Which cells are neighbours: those with a common face, also edge, also corner.",
)
@click.option(
    "--radius",
    type=FloatRange(0, 16),
    metavar="CELLS",
    help="Instead: those whose centre is at most so far away, in cells.",
)
@click.option(
    "--by-block",
    is_flag=True,
    help="Only those in the place's own block, as the VOLA paper does: cheap, never too many.",
)
@click.option(
    "--error", is_flag=True, help="What counting by block misses over all voxels; no coordinates."
)
@queries.common
def neighbours(
    asked: Asked,
    numbers: Words,
    connectivity: tuple[str, ...],
    radius: float | None,
    by_block: bool,
    error: bool,
    **arguments: Any,
) -> None:
    """Count the voxels around the cells of points, exactly or inside their block; or outside.

    The cell itself need not be a voxel and is not counted.

    \b
    Examples:
      volatool query tile.vol.gz neighbours 6181200 2301150 3990
      volatool query tile.vol.gz neighbours 6181200 2301150 3990 --radius 5 --json
      volatool query tile.vol.gz neighbours --error
    """
    from volatool_cli import query_answers as answers

    kinds = [int(kind) for kind in dict.fromkeys(connectivity or ("6", "26"))]
    if error and (numbers or by_block or radius is not None):
        raise OptionError(
            "--error is about all voxels: it takes no coordinates, --radius or --by-block"
        )
    if radius is not None and connectivity:
        raise OptionError("give --connectivity or --radius, not both")
    asked.begin(arguments)
    if error:
        for answer in answers.neighbour_errors(asked.volume, kinds):
            asked.print(answer)
        return
    asked.answer(
        numbers,
        ("X", "Y", "Z"),
        lambda rows: answers.neighbours(asked.volume, rows, kinds, radius, not by_block),
    )


@query.command(short_help="What is in a region, by class, height and metadata?")
@queries.numbers("X0 Y0 [Z0] X1 Y1 [Z1]")
@click.option(
    "--polygon",
    metavar="FILE|WKT",
    shell_complete=complete_files,
    help="In place of boxes: each polygon of a vector file, of a file with one WKT a line, or WKT.",
)
@click.option("--all", "whole", is_flag=True, help="In place of boxes: the whole volume.")
@click.option(
    "--z", type=float, nargs=2, metavar="LOW HIGH", help="Only voxels between these heights."
)
@click.option(
    "--bands",
    type=NumbersType(),
    default=(),
    help="Count also between these heights; -inf and inf are no limit.",
)
@queries.common
def census(
    asked: Asked,
    numbers: Words,
    polygon: str | None,
    whole: bool,
    z: tuple[float, float] | None,
    bands: tuple[float, ...],
    **arguments: Any,
) -> None:
    """Count the voxels of boxes or polygons by class and height band, and sum up their metadata.

    Voxels count whose centre is in the box (its upper sides excluded: boxes side by side share
    none), or in the polygon or on its outline. Metadata is one value a block of 4 x 4 x 4 voxels:
    each voxel counts with that of its block, and all voxels weigh equally.

    \b
    Examples:
      volatool query tile.vol.gz census 6181100 2301100 6181200 2301200 --bands 3800,3900,4000
      volatool query tile.vol.gz census --all --z 4000 inf --json
    """
    from volatool_cli import query_answers as answers

    if (polygon is not None) + whole + bool(numbers) > 1:
        raise OptionError("give boxes, --polygon or --all, not two of them")
    asked.begin(arguments)
    volume = asked.volume
    if whole:
        asked.print(answers.census(volume.census(z=z, bands=bands)))
    elif polygon is not None:
        from volatool.vola.polygons import read_polygons

        found = read_polygons(polygon, volume.crs)
        asked.warn(found.warnings)
        for number, (shape, fields) in enumerate(zip(found.shapes, found.fields, strict=True), 1):
            counted = volume.census(z=z, polygon=shape, bands=bands)
            asked.print(answers.census(counted, {"polygon": number, "fields": fields}))
    else:
        asked.answer(
            numbers,
            ("X0", "Y0", "Z0", "X1", "Y1", "Z1"),
            lambda rows: (
                answers.census(volume.census(row.tolist(), z=z, bands=bands)) for row in rows
            ),
            short=("X0", "Y0", "X1", "Y1"),
            widen=lambda row: [*row[:2], float("-inf"), *row[2:], float("inf")],
        )
