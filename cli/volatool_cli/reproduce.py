"""Running and printing the papers' experiments."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from volatool_cli.output import configure_logging, progress_of


def reproduce_emap(arguments: dict[str, Any]) -> None:
    """
    Run the EMap paper's experiment; print Markdown or JSON, and on stderr what is missing.

    Parameters
    ----------
    arguments : dict
        The command's options by parameter name.
    """
    from volatool.errors import OptionError
    from volatool.papers.emap import reproduce
    from volatool.papers.emap_scene import Drive
    from volatool.report import dumps
    from volatool.resources import n_cores

    quiet = arguments["quiet"]
    configure_logging(quiet, arguments["verbose"], arguments["log"])
    if arguments["outdir"] == "":
        raise OptionError("--outdir is an empty name; is a shell variable unset?")
    with progress_of("reproduce emap", arguments["progress"], quiet) as progress:
        result = reproduce(
            Drive(duration_s=arguments["duration"], seed=arguments["seed"]),
            runs=arguments["runs"],
            jobs=arguments["jobs"] or n_cores(),
            timing=not arguments["no_resources"],
            outdir=None if arguments["outdir"] is None else Path(arguments["outdir"]),
            overwrite=arguments["overwrite"],
            progress=progress,
        )
    if not quiet:
        for warning in result.document["warnings"]:
            click.echo(f"{warning['code']}: {warning['message']}", err=True)
        for path in result.paths:
            click.echo(f"wrote {path}", err=True)
    click.echo(dumps(result.document, 2) if arguments["as_json"] else result.markdown, nl=False)
    if arguments["as_json"]:
        click.echo()
