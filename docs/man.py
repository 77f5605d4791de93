"""Manual pages of all commands, from their own ``--help``: ``python docs/man.py FOLDER``.

The wheel has them as ``share/man/man1`` (``hatch_build.py``).
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import click
from click_man.core import generate_man_page


def write_pages(folder: Path) -> list[Path]:
    """
    Write the pages.

    Parameters
    ----------
    folder : pathlib.Path
        Made if need be; pages of that name are replaced.

    Returns
    -------
    pages : list of pathlib.Path
        ``volatool.1``, ``volatool-convert.1`` and so on.
    """
    from volatool import __version__
    from volatool_cli.main import cli

    folder.mkdir(parents=True, exist_ok=True)
    seconds = os.environ.get("SOURCE_DATE_EPOCH")  # the same bytes of the same source
    when = datetime.now(UTC) if seconds is None else datetime.fromtimestamp(int(seconds), UTC)
    pages = []
    for name, context in _contexts(click.Context(cli, info_name="volatool"), "volatool"):
        text = generate_man_page(context, version=__version__, date=f"{when:%Y-%m-%d}")
        # "volatool query FILE box" is how it is typed, not what it is called
        path = context.command_path
        text = text.replace(path.upper(), name.upper(), 1)
        text = text.replace(path.replace(" ", r"\-"), name.replace(" ", r"\-"), 1)
        page = folder / f"{name.replace(' ', '-')}.1"
        page.write_text(text, encoding="utf-8")
        pages.append(page)
    return pages


def _contexts(context: click.Context, name: str) -> Iterator[tuple[str, click.Context]]:
    """Yield name and context of a command and of all below it."""
    yield name, context
    if isinstance(context.command, click.Group):
        for key, command in context.command.commands.items():
            below = click.Context(command, info_name=key, parent=context)
            yield from _contexts(below, f"{name} {key}")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python docs/man.py FOLDER")
    for path in write_pages(Path(sys.argv[1])):
        print(path)
