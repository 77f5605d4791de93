"""``volatool reproduce``."""

from __future__ import annotations

from typing import Any

import click

from volatool_cli import options
from volatool_cli.params import FloatRange, complete_files

_files = options.group(
    click.option(
        "-o",
        "--outdir",
        type=click.Path(file_okay=False),
        metavar="DIR",
        help="Write report.md, report.json and the figures there.",
    ),
    options.overwrite,
)
_as_json = click.option("--json", "as_json", is_flag=True, help="Print the numbers as JSON.")


@click.group(short_help="Make the papers' experiments again.")
def reproduce() -> None:
    """Make the papers' tables and figures again, beside the printed ones.

    \b
    Examples:
      volatool reproduce emap --runs 1 --duration 5
      volatool reproduce vola tile.laz --no-resources
    """


@reproduce.command(short_help="The EMap paper's drive, against OctoMap.")
@click.option("--runs", type=click.IntRange(1), default=10, show_default=True, help="Drives.")
@click.option(
    "--duration",
    type=FloatRange(1, 3600),
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
@_files
@click.option(
    "-j",
    "--jobs",
    type=click.IntRange(1),
    show_default="cores",
    help="Drives at a time.",
)
@_as_json
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


@reproduce.command(short_help="The VOLA paper's tables, printed, recomputed and measured.")
@click.argument("tiles", metavar="[TILE]...", nargs=-1, shell_complete=complete_files)
@options.nul_names
@click.option(
    "--points",
    type=click.IntRange(1000, 20_000_000),
    default=500_000,
    show_default=True,
    help="Of the made-up surface of Table 1.",
)
@click.option(
    "--samples",
    type=click.IntRange(2, 100_000_000),
    default=100_000,
    show_default=True,
    help="Random blocks for each row of Table 6.",
)
@click.option(
    "--seed", type=click.IntRange(0), default=1, show_default=True, help="Of those blocks."
)
@options.crs
@_files
@_as_json
@click.option(
    "--no-resources", is_flag=True, help="Don't time look-ups and packing (Table 1, Figure 8)."
)
@options.progress
@options.messages
def vola(**arguments: Any) -> None:
    """Print Tables 1 to 7 of the VOLA paper beside what follows from them and what we measure.

    Look-ups and memory of dense and sparse volumes (and of the real OctoMap library, extra
    "octomap", left out when missing) at depths 2 to 8; the sizes and occupancies of the paper's
    data sets recomputed; contiguity by formula and by sampling; what can't be, and what it amounts
    to. Each TILE (LAS, LAZ, COPC, VOLA) adds Tables 2 to 7 measured on it, and pictures. Markdown,
    or JSON with --json.

    \b
    Examples:
      volatool reproduce vola --no-resources
      volatool reproduce vola tiles/ --samples 10000 --json
      volatool reproduce vola tile.laz -o vola-paper
    """
    from volatool_cli.reproduce import reproduce_vola

    reproduce_vola(arguments)
