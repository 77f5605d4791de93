"""``volatool index``."""

from __future__ import annotations

from typing import Any

import click

from volatool_cli import options

_TEXTS = ("dataset", "info", "url", "author", "authorurl", "license", "licenseurl")


@click.command(short_help="Index a folder of volumes: .vola, VRT, STAC.")
@click.argument("folder", metavar="DIR", type=click.Path(file_okay=False))
@click.option("--name", help="Of the index and the mosaics.  [default: the folder's]")
@click.option(
    "--from",
    "info_file",
    type=click.Path(dir_okay=False),
    metavar="JSON",
    help="Texts of the index.  [default: DIR/info.json, if there]",
)
@click.option("--dataset", help="Name of the data set.  [default: the folder's]")
@click.option("--info", help="A description.")
@click.option("--url", help="Where the data set is told about.")
@click.option("--author", help="Who made the data; must be said here or in the JSON.")
@click.option("--authorurl", help="Where to find them.")
@click.option("--license", help="Licence of the data, such as CC-BY-4.0; must be said, too.")
@click.option("--licenseurl", help="Its text.")
@click.option("--vrt/--no-vrt", default=True, show_default=True, help="Mosaics of the models.")
@click.option("--stac", is_flag=True, help="Write STAC items and a collection; needs --datetime.")
@click.option(
    "--datetime",
    metavar="START[/END]",
    help="When the points were measured: 2019-05-01 or 2019-05-01/2019-06-30.",
)
@options.overwrite
@options.messages
def index(folder: str, **arguments: Any) -> None:
    """Index the volumes of a folder for viewers, GIS and catalogues.

    Writes NAME.vola, the original viewer's list of .vol (and .vol.gz) files; NAME.dem.vrt over
    their elevation models, and one over each layer; with --stac an item beside each volume and
    collection.json. Names inside are relative. Paths written are printed.

    \b
    Examples:
      volatool index out --author "City of Delft" --license CC-BY-4.0
      volatool index out --author Delft --license CC0-1.0 --stac --datetime 2019-05-01
    """
    from pathlib import Path

    from volatool.catalog.index import index_folder
    from volatool.catalog.stac import Period
    from volatool.errors import OptionError
    from volatool_cli.output import configure_logging, say_warnings

    configure_logging(arguments["quiet"], arguments["verbose"], arguments["log"])
    if arguments["stac"] != (arguments["datetime"] is not None):
        raise OptionError("--stac and --datetime go together: an item says when it was measured")
    info_file = arguments["info_file"]
    indexed = index_folder(
        Path(folder),
        name=arguments["name"],
        info_file=None if info_file is None else Path(info_file),
        attribution={name: arguments[name] for name in _TEXTS},
        vrt=arguments["vrt"],
        period=Period.parse(arguments["datetime"]) if arguments["stac"] else None,
        overwrite=arguments["overwrite"],
    )
    say_warnings(folder, indexed.warnings, arguments["quiet"])
    for path in indexed.paths:
        click.echo(str(path))
