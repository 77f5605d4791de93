"""Running and printing the papers' experiments."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from volatool.errors import OptionError
from volatool_cli.output import configure_logging, progress_of

if TYPE_CHECKING:
    from volatool.papers.result import Reproduction


def reproduce_emap(arguments: dict[str, Any]) -> None:
    """
    Run the EMap paper's experiment; print Markdown or JSON, and on stderr what is missing.

    Parameters
    ----------
    arguments : dict
        The command's options by parameter name.
    """
    from volatool.papers.emap import reproduce
    from volatool.papers.emap_scene import Drive
    from volatool.resources import n_cores

    quiet, outdir = _start(arguments)
    with progress_of("reproduce emap", arguments["progress"], quiet) as progress:
        result = reproduce(
            Drive(duration_s=arguments["duration"], seed=arguments["seed"]),
            runs=arguments["runs"],
            jobs=arguments["jobs"] or n_cores(),
            timing=not arguments["no_resources"],
            outdir=outdir,
            overwrite=arguments["overwrite"],
            progress=progress,
        )
    _print(result, as_json=arguments["as_json"], quiet=quiet)


def reproduce_vola(arguments: dict[str, Any]) -> None:
    """
    Make the VOLA paper's tables again; print Markdown or JSON, and on stderr what is missing.

    Parameters
    ----------
    arguments : dict
        The command's options by parameter name.
    """
    from volatool.batch.plan import expand
    from volatool.naming import POINT_SUFFIXES, VOLUME_SUFFIXES
    from volatool.options import ConvertOptions
    from volatool.papers.vola import reproduce
    from volatool_cli.run import stdin_names

    quiet, outdir = _start(arguments)
    names = arguments["tiles"]
    stdin = stdin_names(arguments["nul"]) if "-" in names else ()
    paths = expand(names, stdin, POINT_SUFFIXES + VOLUME_SUFFIXES) if names else []
    options = ConvertOptions(
        crs=arguments["crs"],
        crs_default=arguments["crs_default"],
        to_crs=arguments["to_crs"],
        resources=False,
    )
    with progress_of("reproduce vola", arguments["progress"], quiet) as progress:
        result = reproduce(
            paths,
            options,
            points=arguments["points"],
            samples=arguments["samples"],
            seed=arguments["seed"],
            timing=not arguments["no_resources"],
            outdir=outdir,
            overwrite=arguments["overwrite"],
            progress=progress,
        )
    _print(result, as_json=arguments["as_json"], quiet=quiet)


def _start(arguments: dict[str, Any]) -> tuple[bool, Path | None]:
    """Set up messages; return whether to be quiet, and the folder for files."""
    quiet: bool = arguments["quiet"]
    configure_logging(quiet, arguments["verbose"], arguments["log"])
    outdir = arguments["outdir"]
    if outdir == "":
        raise OptionError("--outdir is an empty name; is a shell variable unset?")
    return quiet, None if outdir is None else Path(outdir)


def _print(result: Reproduction, *, as_json: bool, quiet: bool) -> None:
    """Print numbers or report on stdout, the rest on stderr."""
    from volatool.report import dumps

    if not quiet:
        for warning in result.document["warnings"]:
            click.echo(f"{warning['code']}: {warning['message']}", err=True)
        for path in result.paths:
            click.echo(f"wrote {path}", err=True)
    click.echo(dumps(result.document, 2) + "\n" if as_json else result.markdown, nl=False)
