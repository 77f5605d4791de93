"""``volatool merge``."""

from __future__ import annotations

from typing import Any

import click

from volatool_cli import options
from volatool_cli.params import DepthType, complete_files


@click.command(short_help="Unite or subtract volumes on one grid.")
@click.argument(
    "volumes", metavar="VOLUME...", nargs=-1, required=True, shell_complete=complete_files
)
@click.option(
    "-o",
    "--output",
    type=click.Path(dir_okay=False),
    metavar="FILE",
    required=True,
    help="What is written: a name in .vol.gz, .vol, .dvol.gz or .dvol.",
)
@options.overwrite
@click.option(
    "--op",
    type=click.Choice(["or", "and", "xor", "sub"]),
    default="or",
    show_default=True,
    help="Union, intersection, symmetric difference, or the first without the others.",
)
@click.option(
    "--resample",
    is_flag=True,
    help="Bring volumes of other grids to that of the result, cell by cell.",
)
@click.option(
    "--cube-from",
    type=click.Path(dir_okay=False),
    metavar="VOLUME",
    help="Cube and depth of the result.  [default: those of the inputs, or the smallest cube "
    "around their cubes]",
)
@click.option(
    "--depth", type=DepthType(), default="auto", show_default="all levels", help="Levels to keep."
)
@options.messages
def merge(volumes: tuple[str, ...], output: str, **arguments: Any) -> None:
    """Merge volumes into one.

    VOLUME is a file, a folder (its .vol and .vol.gz files), a pattern or @list.txt. They must be on
    one grid, or in cubes of one side that lie whole sides apart, such as --split and --snap --cube
    make: then every cell stays as it is. Anything else is refused, unless it is to be resampled.

    \b
    Examples:
      volatool merge may.vol.gz june.vol.gz -o both.vol.gz
      volatool merge cubes/ -o town.vol.gz
      volatool merge june.vol.gz may.vol.gz --op sub -o new.vol.gz
      volatool merge other.vol.gz --cube-from may.vol.gz --resample -o same-grid.vol.gz
    """
    from pathlib import Path

    from volatool.batch.plan import expand
    from volatool.merging import merge_files
    from volatool_cli.output import configure_logging, say_warnings

    quiet = arguments.pop("quiet")
    configure_logging(quiet, arguments.pop("verbose"), arguments.pop("log"))
    # each by itself: a file named twice takes part twice, so that A --op sub A is empty
    paths = [path for name in volumes for path in expand([name], (), (".vol.gz", ".vol"))]
    if arguments["op"] == "or":
        paths = list(dict.fromkeys(paths))
    merged = merge_files(paths, Path(output), **arguments)
    say_warnings(merged.path.name, merged.warnings, quiet)
    click.echo(str(merged.path))
