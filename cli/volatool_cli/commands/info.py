"""``volatool info``."""

from __future__ import annotations

import sys

import click

from volatool_cli import options


@click.command(short_help="Print what headers and trailers say.")
@click.argument("files", metavar="FILE...", nargs=-1, required=True, type=click.Path())
@click.option("--json", "as_json", is_flag=True, help="One JSON object a line.")
@options.messages
def info(
    files: tuple[str, ...],
    as_json: bool,
    quiet: bool,
    verbose: int,
    log: str | None,
) -> None:
    """Print what the header and trailer of point, volume and DEM files say.

    The body is not read: counts and boxes are those that the file claims.

    \b
    Examples:
      volatool info tile.laz
      volatool info tile.vol.gz tile.dem.tif --json
    """
    from volatool.errors import VolatoolError
    from volatool.info import describe, describe_text
    from volatool.remote.path import path_of
    from volatool.report import dumps
    from volatool_cli.exit_codes import ExitCode
    from volatool_cli.output import configure_logging

    configure_logging(quiet, verbose, log)
    n_failed = 0
    for name in files:
        try:
            document = describe(path_of(name))
        except VolatoolError as error:
            click.echo(f"{error.code}: {error}", err=True)
            n_failed += 1
            continue
        click.echo(dumps(document) if as_json else describe_text(document))
    if n_failed:
        sys.exit(ExitCode.ALL_FAILED if n_failed == len(files) else ExitCode.SOME_FAILED)
