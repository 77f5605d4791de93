"""What an input is, so that a later run can tell whether it is still the same."""

from __future__ import annotations

from pathlib import Path
from typing import TypeAlias

from volatool.errors import VolatoolError
from volatool.remote.path import RemotePath

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
        ``size`` (bytes) and ``mtime_ns``, of a URL ``etag`` and ``modified``; None if there is no
        such file, or if the server tells nothing that changes with it.
    """
    if isinstance(path, RemotePath):
        from volatool.remote.store import identity

        try:
            found_there = identity(path)
        except VolatoolError:  # reading it says so
            return None
        return {"size": 0, **found_there} if found_there.keys() - {"size"} else None
    try:
        found = path.stat()
    except (OSError, ValueError):  # not there, or no name a file can have
        return None
    return {"size": found.st_size, "mtime_ns": found.st_mtime_ns}
