"""What an input is, so that a later run can tell whether it is still the same."""

from __future__ import annotations

from pathlib import Path
from typing import TypeAlias

Identity: TypeAlias = dict[str, int | str]
"""Facts that change when the input does: ``size`` in bytes, and ``mtime_ns`` of a file."""


def identify(path: Path) -> Identity | None:
    """
    Return what tells an input from a changed one, without reading it.

    Parameters
    ----------
    path : pathlib.Path
        The input.

    Returns
    -------
    identity : dict or None
        ``size`` (bytes) and ``mtime_ns``; None if there is no such file.
    """
    try:
        found = path.stat()
    except (OSError, ValueError):  # not there, or no name a file can have
        return None
    return {"size": found.st_size, "mtime_ns": found.st_mtime_ns}
