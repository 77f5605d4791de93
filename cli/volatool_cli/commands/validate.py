"""``volatool validate``."""

from __future__ import annotations

import sys

import click

from volatool_cli import options


@click.command(short_help="Check volumes, elevation models and reports.")
@click.argument("files", metavar="FILE...", nargs=-1, required=True, type=click.Path())
@click.option(
    "--set",
    "whole_set",
    is_flag=True,
    help="Take in the other files of each tile beside those given, and require what its report "
    "names.",
)
@click.option("--json", "as_json", is_flag=True, help="One JSON object a line.")
@options.messages
def validate(
    files: tuple[str, ...],
    whole_set: bool,
    as_json: bool,
    quiet: bool,
    verbose: int,
    log: str | None,
) -> None:
    """Check structure, counts and checksums of volumes, and that DEMs and reports read back.

    Files of one tile (tile.vol.gz, tile.dvol.gz, tile.dem.tif, tile.stats.json) are also held
    against each other: dense with sparse, word by word, and the report with all of them.

    Exit status 6 if a check does not hold, 4 if the files are not there, 7 if they are too large
    to be read; each fault is one line with its offset.

    \b
    Examples:
      volatool validate tile.vol.gz tile.dvol.gz
      volatool validate tile.dem.tif tile.stats.json --json
      volatool validate tile.stats.json --set
    """
    from volatool.report import dumps
    from volatool.validate import validate_files
    from volatool_cli.exit_codes import ExitCode
    from volatool_cli.output import configure_logging

    configure_logging(quiet, verbose, log)
    reports = validate_files(files, whole_set=whole_set)
    for report in reports:
        if as_json:
            click.echo(dumps(report.to_dict()))
            continue
        click.echo(f"{report.path}: {'ok' if report.ok else 'FAULTY'} ({report.kind})")
        for problem in report.problems:
            click.echo(f"  {problem}")
    codes = {problem.code for report in reports for problem in report.problems}
    if codes == {"E_NOT_FOUND"}:
        sys.exit(ExitCode.ALL_FAILED)
    if codes == {"E_SIZE"}:
        sys.exit(ExitCode.LIMIT)
    if codes:
        sys.exit(ExitCode.CHECK_FAILED)
