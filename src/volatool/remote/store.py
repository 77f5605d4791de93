"""fsspec's file systems: what is at a URL, what a folder of URLs holds, and why it can't be had."""

from __future__ import annotations

import contextlib
import errno
import re
import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from email.utils import parsedate_to_datetime
from typing import Any, TypeVar

from volatool.errors import (
    InputError,
    InputNotFoundError,
    OptionError,
    ResourceError,
    VolatoolError,
)
from volatool.remote.path import WEB, RemotePath

_Result = TypeVar("_Result")

DELAYS = (0.5, 1.0, 2.0)
"""Seconds to wait before asking again."""

CONNECT_SECONDS, READ_SECONDS = 15, 60
"""Silence of a web server that is taken for its absence."""

_RETRY_THEMSELVES = frozenset({"s3", "s3a", "gs", "gcs", "az", "abfs", "abfss"})
_MODIFIED = ("LastModified", "Last-Modified", "last_modified", "updated", "mtime", "created")
_EXTRA = "'volatool[cloud]'"
_PACKAGES = {
    **dict.fromkeys(("http", "https", "s3", "s3a"), _EXTRA),
    **dict.fromkeys(("gs", "gcs"), "gcsfs"),
    **dict.fromkeys(("az", "abfs", "abfss"), "adlfs"),
}
"""What to install for a protocol."""

_PASSING = frozenset({408, 425, 429, 500, 502, 503, 504})
_REFUSED = frozenset({401, 403, 407})


@dataclass(frozen=True, slots=True)
class Details:
    """
    What a server says of a file.

    Parameters
    ----------
    size : int or None
        Bytes; None if it does not tell.
    ranges : bool
        It may give parts of the file; False: it says that it does not.
    etag : str or None
        What changes when the file does.
    modified : datetime.datetime or None
        When it changed last.
    """

    size: int | None
    ranges: bool = True
    etag: str | None = None
    modified: datetime | None = None


def filesystem(path: RemotePath) -> tuple[Any, str]:
    """
    Return the file system of a URL and its name for the file.

    Raises
    ------
    OptionError
        ``E_NO_EXTRA``: fsspec or the package for the protocol is not installed; ``E_OPTION``: no
        such protocol.
    """
    protocol = path.protocol
    try:
        import fsspec

        kind = fsspec.get_filesystem_class(protocol)
    except ImportError as error:
        what = f"what this says: {error}"
        if error.name == "fsspec" or protocol in _PACKAGES:
            what = f"pip install {_PACKAGES.get(protocol, _EXTRA)}"
        raise OptionError(f"{path}: {protocol}:// needs {what}", "E_NO_EXTRA") from None
    except ValueError:
        raise OptionError(f"{path}: {protocol}:// is no protocol that fsspec knows") from None
    try:
        options = kind._get_kwargs_from_urls(path.url)
        if protocol in WEB:
            options |= _web_options(fsspec.config.conf.get(protocol, {}))
        return kind(**options), kind._strip_protocol(path.url)
    except Exception as error:
        raise explained(error, path) from None


def _web_options(given: dict[str, Any]) -> dict[str, Any]:
    """Return what a web session is made with; what the user's fsspec configuration says wins."""
    import aiohttp

    timeout = aiohttp.ClientTimeout(None, sock_connect=CONNECT_SECONDS, sock_read=READ_SECONDS)
    session = {"trust_env": True, "timeout": timeout}  # proxies and .netrc, as curl takes them
    return {
        # bytes are counted: they must come as they are
        "headers": {"Accept-Encoding": "identity", **given.get("headers", {})},
        "client_kwargs": {**session, **given.get("client_kwargs", {})},
    }


def details(path: RemotePath) -> Details:
    """
    Ask for size and version of a file.

    Raises
    ------
    InputNotFoundError, InputError
        ``E_NOT_FOUND``, ``E_ACCESS``, ``E_NETWORK``.
    """
    files, name = filesystem(path)
    found = asked(lambda: files.info(name), path)
    if found.get("type") == "directory":
        raise InputError(f"{path}: is a folder, not a file; end its name with / to take its files")
    etag = found.get("ETag") or found.get("etag")
    modified = next((found[key] for key in _MODIFIED if found.get(key)), None)
    return Details(
        found.get("size"),
        found.get("partial", True) is not False,
        None if etag is None else str(etag).strip('"'),
        _time(modified),
    )


def _time(told: Any) -> datetime | None:
    """Return a time as servers tell it: an object, seconds, ISO 8601, or that of HTTP."""
    if isinstance(told, datetime):
        return told
    if isinstance(told, int | float):
        return datetime.fromtimestamp(told, UTC)
    for read in (parsedate_to_datetime, datetime.fromisoformat):
        with contextlib.suppress(ValueError, TypeError):
            return read(told)
    return None


def identity(path: RemotePath) -> dict[str, Any]:
    """
    Return what tells a version of a remote file from others.

    Parameters
    ----------
    path : RemotePath
        The file.

    Returns
    -------
    identity : dict
        ``size`` (int), ``etag`` (str) and ``modified`` (str, ISO 8601), those that the server
        tells.
    """
    found = details(path)
    modified = None if found.modified is None else found.modified.isoformat()
    facts = {"size": found.size, "etag": found.etag, "modified": modified}
    return {key: value for key, value in facts.items() if value is not None}


def exists(path: RemotePath) -> bool:
    """Whether there is such a file."""
    try:
        details(path)
    except InputNotFoundError:
        return False
    return True


def listed(folder: RemotePath, suffixes: tuple[str, ...]) -> list[RemotePath]:
    """
    Return the files of a folder, not those of its subfolders, in the order of their names.

    Parameters
    ----------
    folder : RemotePath
        On the web, a page with links.
    suffixes : tuple of str
        What their names end in, in lower case.

    Raises
    ------
    InputNotFoundError, InputError
        ``E_NOT_FOUND``, ``E_ACCESS``, ``E_NETWORK``.
    """
    files, name = filesystem(folder)
    files.invalidate_cache()
    entries = asked(lambda: files.ls(name, detail=True), folder)
    paths = [_path(files, entry["name"]) for entry in entries if entry["type"] == "file"]
    return sorted(
        {path for path in paths if path.name.lower().endswith(suffixes)}, key=lambda path: path.url
    )


def matched(pattern: RemotePath) -> list[RemotePath]:
    """Return the files that match a URL with ``*``, ``**``, ``[...]`` or (not on the web) ``?``."""
    files, name = filesystem(pattern)
    files.invalidate_cache()
    try:
        found = asked(lambda: files.glob(name, detail=True), pattern)
    except InputNotFoundError:
        return []
    return [_path(files, key) for key in sorted(found) if found[key]["type"] == "file"]


def has_magic(path: RemotePath) -> bool:
    """Whether a URL is a pattern."""
    rest = path.url.partition("://")[2].partition("/")[2]  # an IPv6 address has brackets
    if path.protocol in WEB:
        return bool(re.search("[*[]", re.split("[?#]", rest, maxsplit=1)[0]))
    return bool(re.search("[*?[]", rest))


def is_folder(path: RemotePath) -> bool:
    """Whether files are behind a URL: by its slash; of stores that know folders, by asking."""
    if path.url.endswith("/"):
        return True
    if path.protocol in WEB:
        return False
    files, name = filesystem(path)
    return bool(asked(lambda: files.isdir(name), path))


def _path(files: Any, name: str) -> RemotePath:
    return RemotePath(files.unstrip_protocol(name))


def asked(question: Callable[[], _Result], path: RemotePath) -> _Result:
    """
    Return the answer to a request; ask again where that may help.

    Parameters
    ----------
    question : callable
        The request.
    path : RemotePath
        What it is about, for messages.

    Raises
    ------
    InputNotFoundError, InputError
        ``E_NOT_FOUND``, ``E_ACCESS``, ``E_NETWORK``.
    """
    delays = () if path.protocol in _RETRY_THEMSELVES else DELAYS
    for delay in (*delays, None):
        try:
            return question()
        except Exception as error:
            told = explained(error, path)
            if delay is None or told.code != "E_NETWORK":
                # no trace of the cause: it shows the URL as it was given
                raise told from None
        time.sleep(delay)
    raise AssertionError("unreachable")


def explained(error: Exception, path: RemotePath) -> VolatoolError:
    """
    Return our error for one of a file system.

    Parameters
    ----------
    error : Exception
        Of fsspec or a package behind it.
    path : RemotePath
        What was asked for.
    """
    if isinstance(error, VolatoolError):
        return error
    if path.protocol in WEB and isinstance(error.__cause__, Exception):
        error = error.__cause__  # fsspec calls all that fails on the web "not found"
    status, name = getattr(error, "status", None), type(error).__name__
    if isinstance(error, FileNotFoundError) or status in (404, 410):
        return InputNotFoundError(f"{path}: no such file")
    if getattr(error, "errno", None) in (errno.ENOSPC, errno.EDQUOT):
        return ResourceError(
            f"{path}: no room for a temporary copy; free space or set TMPDIR to another folder",
            "E_SIZE",
        )
    if isinstance(error, PermissionError) or status in _REFUSED:
        how = f"HTTP {status}" if status else _reason(error)
        return InputError(f"{path}: access is refused ({how}); check credentials", "E_ACCESS")
    if "Credential" in name or "Auth" in name:
        return InputError(
            f"{path}: no credentials for {path.protocol}:// were found ({_reason(error)})",
            "E_ACCESS",
        )
    if isinstance(status, int):
        text = f"{path}: the server answers HTTP {status}"
        return InputError(text, "E_NETWORK" if status in _PASSING else "E_INPUT")
    if isinstance(error, (TypeError, AttributeError, KeyError)):
        return VolatoolError(f"{path}: {name}: {_reason(error)}")
    if name == "InvalidURL" or isinstance(error, ValueError):
        return InputError(f"{path}: can't be opened ({_reason(error)})")
    return InputError(f"{path}: the network or the server fails ({_reason(error)})", "E_NETWORK")


def _reason(error: Exception) -> str:
    """Return what an error says, without any query or password of a URL in it."""
    text = " ".join(str(error).split()) or type(error).__name__
    text = re.sub(r"(://)[^/@\s'\"]*@", r"\1", text)
    return re.sub(r"\?[^\s'\"]*", "", text)
