"""``volatool classify``."""

from __future__ import annotations

from typing import Any

import click

from volatool_cli import options


@click.command(short_help="Write points with the ground class set by the ground filter.")
@options.inputs
@options.nul_names
@options.output
@options.of_class
@options.of_height
@options.reading
@options.crs_of_file
@options.memory
@options.jobs
@options.record
@options.as_reports
@options.no_resources
@options.progress
@options.messages
def classify(**arguments: Any) -> None:
    """Set class 2 by the EMap ground filter and write the same points: NAME.laz.

    Points that the filter keeps become class 2; points of class 2 that it does not keep become 1.
    Points that don't take part (withheld, noise, what the options leave out) and everything else
    in the file stay as they are. An input is never written over.

    \b
    Examples:
      volatool classify tile.laz -o out
      volatool classify tiles/ -o out --memory 512M
      volatool classify tile.laz -o out --returns last --exclude-class 9
    """
    from volatool_cli.run import run_tiles

    run_tiles(arguments, kind="classify")
