"""Temporary folders for copies of remote files; those of killed runs are removed by later ones."""

from __future__ import annotations

import os
import platform
import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from volatool.errors import ResourceError, VolatoolError
from volatool.outputs import is_alive
from volatool.remote.path import RemotePath

_HOST = re.sub("[^A-Za-z0-9]", "_", platform.node())[:24]
_NAME = re.compile(rf"volatool-{re.escape(_HOST)}-([0-9]+)-[a-z0-9_]+")


@contextmanager
def staging() -> Iterator[Path]:
    """Give an empty folder among the system's temporary ones, and remove it."""
    root = Path(tempfile.gettempdir())
    _sweep(root)
    prefix = f"volatool-{_HOST}-{os.getpid()}-"
    with tempfile.TemporaryDirectory(prefix=prefix, dir=root) as folder:
        yield Path(folder)


@contextmanager
def local_copy(path: Path) -> Iterator[Path]:
    """
    Give a file that the operating system can open: the file itself, of a URL a temporary copy.

    Parameters
    ----------
    path : pathlib.Path
        A local file, or a URL.

    Raises
    ------
    OptionError, InputNotFoundError, InputError, ResourceError
        As `volatool.remote.ranges.open_url`. Errors of the block that name the copy name the URL
        instead.
    """
    if not isinstance(path, RemotePath):
        yield path
        return
    with staging() as folder:
        copy = folder / path.name
        with path.open("rb") as stream:
            refuse_full(path, stream.seek(0, os.SEEK_END))
            stream.seek(0)
            with copy.open("wb") as file:
                shutil.copyfileobj(stream, file, 1 << 22)
        try:
            yield copy
        except VolatoolError as error:
            error.args = (str(error).replace(str(copy), str(path)),)
            raise


def refuse_full(path: RemotePath, size: int) -> None:
    """
    Raise if there is no room for a temporary copy.

    Raises
    ------
    ResourceError
        ``E_SIZE``.
    """
    folder = tempfile.gettempdir()
    n_free = shutil.disk_usage(folder).free
    if size > n_free:
        raise ResourceError(
            f"{path}: a temporary copy of {size} bytes is needed and {folder} has {n_free} free; "
            "set TMPDIR to another folder",
            "E_SIZE",
        )


def _sweep(root: Path) -> None:
    """Remove the folders of this machine's runs that are no longer alive."""
    for entry in root.glob(f"volatool-{_HOST}-*"):
        match = _NAME.fullmatch(entry.name)
        if match and not is_alive(int(match[1])):
            shutil.rmtree(entry, ignore_errors=True)
