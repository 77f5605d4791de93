"""The kinds of ``volatool query`` about space: components, clearance, path."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import click

from volatool_cli import queries
from volatool_cli.params import FloatRange, LengthType
from volatool_cli.queries import Answer, Asked, QueryCommand, text_of

if TYPE_CHECKING:
    from volatool.model import F64
    from volatool.units import Length
    from volatool.vola.components import Components
    from volatool.vola.volume import Volume

Words = tuple[str, ...]

_HEADS = ("rank", "voxels", "volume", "x0", "y0", "z0", "x1", "y1", "z1")

level = click.option(
    "--level",
    type=click.IntRange(1),
    metavar="N",
    help="Level of the cells, 1 the coarsest.  [default: the deepest]",
)


@click.command(cls=QueryCommand, short_help="Which voxels hang together?")
@click.option(
    "--connectivity",
    type=click.Choice(["6", "26"]),
    default="26",
    show_default=True,
    help="Voxels hang together over faces; or over edges and corners too.",
)
@level
@click.option(
    "--top",
    type=click.IntRange(0),
    default=20,
    show_default=True,
    metavar="N",
    help="List that many of the largest; 0: all.",
)
@queries.common
def components(asked: Asked, connectivity: str, top: int, **arguments: Any) -> None:
    """Count the connected components of all voxels, and list the largest.

    The first line has their number; a table follows: voxels, volume (in cubes of the horizontal
    unit) and box (z in the vertical unit). Exact across blocks.

    \b
    Examples:
      volatool query tile.vol.gz components
      volatool query tile.vol.gz components --connectivity 6 --level 3 --top 5 --json
    """
    at_level = arguments.pop("level")
    asked.begin(arguments)
    found = asked.volume.components(int(connectivity), at_level)
    rows = found.rows(top or None)
    facts = {
        "answer": len(found),
        "connectivity": found.connectivity,
        "level": found.level,
        "voxels": int(found.sizes.sum()),
        "components": rows,
    }
    asked.print(Answer("\n".join(_table(found, rows)), facts))
    asked.flush()


def _table(found: Components, rows: list[dict[str, Any]]) -> Iterator[str]:
    """Yield the lines of the table: numbers to the right."""
    from volatool.units import format_quantity

    n, voxels = len(found), int(found.sizes.sum())
    yield f"{n} component{'s' * (n != 1)} of {voxels} voxel{'s' * (voxels != 1)}"
    if not rows:
        return
    lines = [_HEADS] + [
        (
            str(row["rank"]),
            str(row["voxels"]),
            format_quantity(row["volume"]).replace(",", ""),
            *map(text_of, row["box"]),
        )
        for row in rows
    ]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    for line in lines:
        yield "  ".join(word.rjust(width) for word, width in zip(line, widths, strict=True))


@click.command(cls=QueryCommand, short_help="How far is the nearest voxel?")
@queries.numbers("X Y Z")
@click.option(
    "--to",
    type=click.Choice(["box", "centre"]),
    default="box",
    show_default=True,
    help="Distance to a voxel's box, 0 inside; or to its middle.",
)
@level
@queries.common
def clearance(asked: Asked, numbers: Words, to: str, **arguments: Any) -> None:
    """Tell the distance from points to the nearest voxel, in the horizontal unit.

    0 in a voxel, inf in an empty volume. Points may be outside the cube.

    \b
    Examples:
      volatool query tile.vol.gz clearance 6181200 2301150 4300
      volatool query tile.vol.gz clearance --json < points.txt
    """
    at_level = arguments.pop("level")
    asked.begin(arguments)

    def answers(rows: F64) -> Iterator[Answer]:
        for distance in asked.volume.clearance(rows, at_level, to=to).tolist():
            yield Answer(text_of(distance), {"answer": distance})

    asked.answer(numbers, ("X", "Y", "Z"), answers)


@click.command(cls=QueryCommand, short_help="Is there a way through free space?")
@queries.numbers("X0 Y0 Z0 X1 Y1 Z1")
@click.option(
    "--clearance",
    type=LengthType(),
    help="Keep so far from voxels, all along; a bare number is in the horizontal unit.",
)
@click.option("--z", type=float, nargs=2, metavar="LOW HIGH", help="Only between these heights.")
@level
@click.option(
    "--factor",
    type=FloatRange(1),
    default=1.5,
    show_default=True,
    metavar="F",
    help="At most so many times as long as the shortest way over cells; 1: none is shorter.",
)
@click.option(
    "--max-cells",
    type=click.IntRange(1024),
    metavar="N",
    help="Look at so many cells at most.  [default: 2097152]",
)
@queries.common
def path(
    asked: Asked,
    numbers: Words,
    clearance: Length | None,
    z: tuple[float, float] | None,
    factor: float,
    max_cells: int | None,
    **arguments: Any,
) -> None:
    """Find ways from X0 Y0 Z0 to X1 Y1 Z1: their length and clearance, or no path.

    All that is not occupied is free, below the ground too; nothing leaves the cube. JSON has the
    points of the line. A way that a fine gap allows is found: coarse cells only show it sooner.
    An end outside, in a voxel or nearer to one than the clearance has no path, and says why.

    \b
    Examples:
      volatool query tile.vol.gz path 6181050 2301050 4200 6181300 2301250 4050
      volatool query tile.vol.gz path 6181050 2301050 4200 6181300 2301250 4100 --clearance 9ft
    """
    from volatool.vola.path import MAX_CELLS

    options = {
        "z": z,
        "level": arguments.pop("level"),
        "factor": factor,
        "max_cells": max_cells or MAX_CELLS,
    }
    asked.begin(arguments)
    volume = asked.volume
    keep = 0.0
    if clearance is not None:
        keep = float(clearance.in_units(volume.crs.metres_per_unit_xy))
    asked.answer(
        numbers,
        ("X0", "Y0", "Z0", "X1", "Y1", "Z1"),
        lambda rows: (_path_answer(volume, row, keep, options) for row in rows),
    )


def _path_answer(volume: Volume, row: F64, keep: float, options: dict[str, Any]) -> Answer:
    from volatool.vola.path import PathEndError

    try:
        found = volume.path(row[:3], row[3:], keep, **options)
    except PathEndError as error:
        return Answer(f"no path: {error}", {"answer": "no path", "reason": str(error)})
    if found is None:
        return Answer("no path", {"answer": "no path", "reason": None})
    text = f"length {text_of(found.length)} clearance {text_of(found.clearance)}"
    return Answer(text, {"answer": "path", **found.to_dict()})


SPACE_KINDS = (components, clearance, path)
"""To be added to the group ``query``."""
