"""Printing: data to stdout, messages and progress to stderr."""

from __future__ import annotations

import json
import logging
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import click

from volatool.errors import CodedWarning, OutputError
from volatool.model import Progress, no_progress


def configure_logging(quiet: bool, verbose: int, log: str | None) -> None:
    """
    Send the library's log to stderr and, if asked, to a file.

    Parameters
    ----------
    quiet : bool
        Only errors.
    verbose : int
        0 warnings, 1 information, 2 debugging.
    log : str or None
        File that gets everything.
    """
    logger = logging.getLogger("volatool")
    for handler in list(logger.handlers):
        logger.removeHandler(handler)
        handler.close()
    logger.setLevel(logging.DEBUG)
    stream = logging.StreamHandler(sys.stderr)
    levels = [logging.WARNING, logging.INFO, logging.DEBUG]
    stream.setLevel(logging.ERROR if quiet else levels[min(verbose, 2)])
    stream.setFormatter(logging.Formatter("%(message)s"))
    logger.addHandler(stream)
    if log is not None:
        try:
            file = logging.FileHandler(log, encoding="utf-8")
        except OSError as error:
            raise OutputError(f"{log}: the log can't be written ({error.strerror})") from error
        file.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(name)s %(message)s"))
        logger.addHandler(file)


def say_warnings(name: str, warnings: Sequence[CodedWarning], quiet: bool) -> None:
    """Print a tile's warnings on stderr, one a line."""
    if not quiet:
        for warning in warnings:
            click.echo(f"{warning.code}: {name}: {warning.message}", err=True)


@contextmanager
def progress_of(name: str, form: str, quiet: bool) -> Iterator[Progress]:
    """
    Give a progress callback for one tile.

    Parameters
    ----------
    name : str
        What is worked on.
    form : str
        ``"auto"`` (a bar on a terminal), ``"bar"``, ``"json"`` (a line an event, the last one
        says done or failed) or ``"none"``.
    quiet : bool
        No bar unless asked for by name.
    """
    if form == "json":
        event = {"event": "failed", "name": name}
        try:
            yield _JsonProgress(name)
            event["event"] = "done"
        finally:
            click.echo(json.dumps(event, sort_keys=True), err=True)
    elif form == "bar" or (form == "auto" and not quiet and sys.stderr.isatty()):
        from tqdm import tqdm

        bar = tqdm(desc=name, unit="pt", unit_scale=True, file=sys.stderr, leave=False)

        def show(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        try:
            yield show
        finally:
            bar.close()
    else:
        yield no_progress


class _JsonProgress:
    """One JSON line on stderr each time another per cent is done."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.percent = -1

    def __call__(self, done: int, total: int) -> None:
        percent = 100 * done // total if total else 100
        if percent > self.percent:
            self.percent = percent
            event: dict[str, Any] = {
                "event": "progress",
                "name": self.name,
                "done": done,
                "total": total,
            }
            click.echo(json.dumps(event, sort_keys=True), err=True)
