"""``volatool diff``."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

import click

from volatool_cli import options
from volatool_cli.params import FloatRange

if TYPE_CHECKING:
    from volatool.vola.diff import Difference


@click.command(short_help="Tell what changed from one volume to another.")
@click.argument("a", metavar="A", type=click.Path(dir_okay=False))
@click.argument("b", metavar="B", type=click.Path(dir_okay=False))
@click.option(
    "--format",
    "form",
    type=click.Choice(["json", "geojson", "text"]),
    default="json",
    show_default=True,
    help="Counts and volumes; the places that changed; a table.",
)
@click.option(
    "-o",
    "--output",
    type=click.Path(dir_okay=False),
    metavar="FILE",
    help="Write it there and print the path.  [default: print it]",
)
@options.overwrite
@click.option("--resample", is_flag=True, help="Bring B to the grid of A if it is on another one.")
@click.option(
    "--noise",
    type=click.IntRange(0, 4),
    default=1,
    show_default=True,
    metavar="N",
    help="Changed voxels with one of the other volume within N voxels are noise-like.",
)
@click.option(
    "--min-voxels",
    type=click.IntRange(min=1),
    default=4,
    show_default=True,
    metavar="N",
    help="So many changed voxels that are not noise-like make a place significant.",
)
@click.option(
    "--level",
    type=click.IntRange(min=1),
    metavar="N",
    show_default="deepest",
    help="Level whose blocks of 4 x 4 x 4 cells are the places.",
)
@click.option(
    "--by",
    type=click.Choice(["column", "block"]),
    default="column",
    show_default=True,
    help="Take blocks above each other as one place, or apart.",
)
@click.option(
    "--significant", "significant_only", is_flag=True, help="GeoJSON: only significant places."
)
@click.option(
    "--keep-crs", is_flag=True, help="GeoJSON: coordinates as in the volumes, not in degrees."
)
@click.option(
    "--fail-above",
    type=FloatRange(min=0),
    metavar="VOLUME",
    help="Status 6 if more than this, in cubed units of the CRS, changed at significant places.",
)
@options.messages
def diff(a: str, b: str, **arguments: Any) -> None:
    """Tell what changed from volume A to volume B.

    The volumes must be on the same grid, as --cube-from makes them, unless B is to be resampled.
    Voxels of B only are added, of A only removed. One that has a voxel of the other volume near it
    counts as noise of the points; --noise 0 takes every change for real.

    \b
    Examples:
      volatool diff may.vol.gz june.vol.gz --format text
      volatool diff may.vol.gz june.vol.gz --format geojson --significant -o changes.geojson
      volatool diff may.vol.gz june.vol.gz --noise 2 --fail-above 100
    """
    from pathlib import Path

    from volatool import changes
    from volatool.formats.registry import open_volume
    from volatool.merging import refuse_input
    from volatool.outputs import refuse_existing
    from volatool_cli.exit_codes import ExitCode
    from volatool_cli.output import configure_logging, say_warnings

    names = ("quiet", "verbose", "log")
    quiet = arguments["quiet"]
    configure_logging(*(arguments.pop(name) for name in names))
    form, limit = arguments.pop("form"), arguments.pop("fail_above")
    output, overwrite = arguments.pop("output"), arguments.pop("overwrite")
    shape = {name: arguments.pop(name) for name in ("keep_crs", "significant_only")}
    if output is not None:
        refuse_input(Path(output), [Path(a), Path(b)])
        refuse_existing([Path(output)], overwrite)
    volumes = [open_volume(name) for name in (a, b)]
    difference, warnings = changes.compare(*volumes, names=(a, b), **arguments)
    short = Path(a).name, Path(b).name
    shown = (a, b) if short[0] == short[1] else short
    summary = changes.document(difference, shown, warnings)
    lines, more = _lines(difference, summary, form, shape)
    say_warnings(", ".join(shown), [*warnings, *more], quiet)
    if output is None:
        for line in lines:
            click.echo(line)
    else:
        changes.write_lines(lines, Path(output), overwrite)
        click.echo(output)
    if limit is not None:
        found = changes.significant_volume(difference)
        if found > limit:
            click.echo(
                f"{found:g} cubic units changed at significant places, {limit:g} are allowed",
                err=True,
            )
            sys.exit(ExitCode.CHECK_FAILED)


def _lines(
    difference: Difference, summary: dict[str, Any], form: str, shape: dict[str, bool]
) -> tuple[Any, Any]:
    """Return what is printed, and what came up on the way."""
    from volatool import changes
    from volatool.report import dumps

    if form == "geojson":
        return changes.geojson_lines(difference, summary, **shape)
    if form == "text":
        return [changes.text(summary)], ()
    return [dumps(summary, indent=2)], ()
