"""``volatool reproduce``."""

from __future__ import annotations

from typing import Any

import click

from volatool_cli import options


@click.group(short_help="Make the papers' experiments again.")
def reproduce() -> None:
    """Make the papers' tables and figures again, beside the printed ones.

    \b
    Examples:
      volatool reproduce emap --runs 1 --duration 5
    """


@reproduce.command(short_help="The EMap paper's drive, against OctoMap.")
@click.option("--runs", type=click.IntRange(1), default=10, show_default=True, help="Drives.")
@click.option(
    "--duration",
    type=click.FloatRange(1, 3600),
    default=30.0,
    show_default=True,
    metavar="SECONDS",
    help="Length of a drive, at 1 m/s and 5 scans a second.",
)
@click.option(
    "--seed",
    type=click.IntRange(0),
    default=1000,
    show_default=True,
    help="Of the sensor's noise; run n uses SEED + n.",
)
@click.option(
    "-o",
    "--outdir",
    type=click.Path(file_okay=False),
    metavar="DIR",
    help="Write report.md, report.json and the figures there.",
)
@click.option("--overwrite", is_flag=True, help="Replace files that exist.")
@click.option(
    "-j",
    "--jobs",
    type=click.IntRange(1),
    show_default="cores",
    help="Drives at a time.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the numbers as JSON.")
@click.option("--no-resources", is_flag=True, help="Don't time loops (no Figure 6).")
@options.progress
@options.messages
def emap(**arguments: Any) -> None:
    """Print Table 1 of the EMap paper beside ours, and what explains the differences.

    A robot drives over sin(x/pi) sin(y/pi) with a 64-ring lidar; EMap and the real OctoMap
    library (extra "octomap", left out when missing) make a surface of its scans. Markdown, or
    JSON with --json. Ten runs take a few minutes.

    \b
    Examples:
      volatool reproduce emap
      volatool reproduce emap --runs 2 --duration 10 --json
      volatool reproduce emap -o emap-paper
    """
    from volatool_cli.reproduce import reproduce_emap

    reproduce_emap(arguments)
