"""URLs as paths: named, joined and opened like files, and shown without credentials."""

from __future__ import annotations

import io
import os
import re
import sys
from pathlib import Path, PosixPath
from typing import IO, Any
from urllib.parse import unquote, urlsplit

from volatool.errors import InputError, OptionError

_URL = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+)(::[A-Za-z0-9+.-]+)*://")

WEB = ("http", "https")
"""Protocols that can be read only, and whose URLs have a query."""

_ACCOUNT_BEHIND_AT = ("abfs", "abfss", "az", "wasb", "wasbs")
"""Protocols in which what stands before the @ is no user, but the container."""


class RemotePath(PosixPath):
    """
    A URL in the place of a path.

    It has a name and a parent, can be joined, and opened for reading. The operating system knows
    nothing of it: what only works with a local file raises `InputError`.

    Parameters
    ----------
    url : str
        As given, credentials and query included.

    Attributes
    ----------
    url : str
        To open it with; never to be shown. ``str(path)`` is what can be.
    """

    url: str

    def __new__(cls, url: str) -> RemotePath:
        """Return the path of a URL."""
        if sys.version_info >= (3, 12):
            path = super().__new__(cls)
        else:
            path = super().__new__(cls, _shown(url))
        path.url = url
        return path

    def __init__(self, url: str) -> None:
        if sys.version_info >= (3, 12):
            super().__init__(_shown(url))

    def __reduce__(self) -> tuple[Any, ...]:
        return (type(self), (self.url,))

    def __str__(self) -> str:
        return _shown(self.url)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({str(self)!r})"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, RemotePath) and self.url == other.url

    def __hash__(self) -> int:
        return hash(self.url)

    def __fspath__(self) -> str:
        raise InputError(f"{self}: is a URL; this works with local files only")

    @property
    def protocol(self) -> str:
        """What stands before ``://``, in lower case."""
        return self.url.partition("://")[0].lower()

    @property
    def name(self) -> str:
        """The last part, without a query; of the web with %20 and the like decoded."""
        last = str(self).partition("://")[2].rpartition("/")[2]
        return unquote(last).replace("/", "_") if self.protocol in WEB else last

    @property
    def parent(self) -> RemotePath:
        """The folder, without a query."""
        head, _, rest = self.url.partition("://")
        if self.protocol in WEB:
            rest = re.split("[?#]", rest, maxsplit=1)[0]
        return RemotePath(f"{head}://{rest.rpartition('/')[0] or rest}")

    def __truediv__(self, name: Any) -> RemotePath:
        return RemotePath(f"{self.url.rstrip('/')}/{name}")

    def with_name(self, name: str) -> RemotePath:
        """Return another file of the same folder."""
        return self.parent / name

    def resolve(self, strict: bool = False) -> RemotePath:
        """Return the path itself."""
        return self

    absolute = resolve

    def exists(self, *, follow_symlinks: bool = True) -> bool:
        """Ask the server."""
        from volatool.remote.store import exists

        return exists(self)

    def is_file(self, *, follow_symlinks: bool = True) -> bool:
        """Ask the server."""
        return self.exists()

    def is_dir(self, *, follow_symlinks: bool = True) -> bool:
        """Return False: a folder is told by its slash, see `volatool.batch.plan.expand`."""
        return False

    def is_symlink(self) -> bool:
        """Return False."""
        return False

    def stat(self, *, follow_symlinks: bool = True) -> os.stat_result:
        """Return size and time of the last change, 0 if the server does not tell; nothing else."""
        from volatool.remote.store import details

        found = details(self)
        changed = 0 if found.modified is None else int(found.modified.timestamp())
        return os.stat_result((0, 0, 0, 1, 0, 0, found.size or 0, changed, changed, changed))

    def open(  # type: ignore[override]
        self,
        mode: str = "r",
        buffering: int = -1,
        encoding: str | None = None,
        errors: str | None = None,
        newline: str | None = None,
    ) -> IO[Any]:
        """Open for reading."""
        from volatool.remote.ranges import open_url

        if "b" in mode:
            return open_url(self)
        return io.TextIOWrapper(io.BytesIO(open_url(self).read()), encoding, errors, newline)


def is_url(name: object) -> bool:
    """Whether a name is a URL, not a local file's."""
    return isinstance(name, RemotePath) or (isinstance(name, str) and bool(_URL.match(name)))


def path_of(name: str | Path | Any) -> Path:
    """
    Return the path that a name stands for.

    Parameters
    ----------
    name : str or path
        A file's name or a URL; ``file://`` URLs are local files.

    Raises
    ------
    OptionError
        A URL in a URL (``zip://a.laz::https://...``).

    Examples
    --------
    >>> path_of("https://me:secret@host/a/tile%201.laz?sign=secret")
    RemotePath('https://host/a/tile%201.laz')
    >>> path_of("file:///a/tile%201.laz").name
    'tile 1.laz'
    """
    if not isinstance(name, str):
        return Path(name) if not isinstance(name, Path) else name
    match = _URL.match(name)
    if match is None:
        return Path(name)
    if match[2] or (_URL.search(name, match.end()) and "::" in name[match.end() :]):
        raise OptionError(f"{_shown(name)}: URLs inside URLs (::) are not read")
    if match[1].lower() == "file":
        return Path(unquote(urlsplit(name).path) or "/")
    return RemotePath(name)


def _shown(url: str) -> str:
    """Return a URL without user, password and the query of a web address."""
    protocol, _, rest = url.partition("://")
    protocol = protocol.lower()
    if protocol in WEB:
        rest = re.split("[?#]", rest, maxsplit=1)[0]
    place, slash, path = rest.partition("/")
    if protocol not in _ACCOUNT_BEHIND_AT:
        place = place.rpartition("@")[2]
    return f"{protocol}://{place}{slash}{path}"
