"""``volatool query`` and its kinds."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import click

from volatool_cli import queries
from volatool_cli.queries import Answer, Asked

if TYPE_CHECKING:
    from volatool.model import F64


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

    Numbers are arguments, or lines on stdin (none given, or -) separated by blanks or commas;
    empty lines and # comments are passed over. Coordinates are in units of the CRS, heights in
    the vertical unit. A line that is no query ends the run with status 2 and its number.

    \b
    Examples:
      volatool query tile.vol.gz point 6181200 2301150 3990
      echo 6181200 2301150 3990 | volatool query tile.vol.gz point --json
    """
    ctx.obj = Asked(file)


@query.command(short_help="Is there a voxel at a point?")
@queries.numbers("X Y Z ...")
@queries.common
def point(asked: Asked, numbers: tuple[str, ...], **arguments: Any) -> None:
    """Tell whether points fall into a voxel: occupied, free, or outside (of the cube).

    JSON has the cell (x, y, z from the cube's corner) and, in a voxel, its block's metadata.

    \b
    Examples:
      volatool query tile.vol.gz point 6181200 2301150 3990
      volatool query tile.vol.gz point --json < points.txt
    """
    asked.begin(arguments)
    asked.answer(numbers, ("X", "Y", "Z"), lambda rows: _points(asked, rows))


def _points(asked: Asked, rows: F64) -> Iterator[Answer]:
    volume = asked.volume
    cells = volume.cell_indices(rows)
    found = volume.find(cells) >= 0
    for cell, is_voxel in zip(cells.tolist(), found.tolist(), strict=True):
        word = "occupied" if is_voxel else "outside" if cell[0] < 0 else "free"
        facts: dict[str, Any] = {"answer": word}
        if cell[0] >= 0:
            facts["cell"] = cell
        yield Answer(word, facts)
