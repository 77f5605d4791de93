"""The manifest: one JSON record a tile, appended by the run, proof for a later run.

A record is on the disk before its tile counts as done. A kill can tear the last line only; it is
cut off when the file is opened again.
"""

from __future__ import annotations

import contextlib
import errno
import json
import os
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Any

from volatool._version import __version__
from volatool.batch.work import Result, Unit
from volatool.errors import OptionError
from volatool.outputs import write_error
from volatool.remote.path import is_url

SCHEMA_ID = "volatool.manifest/1"

_BEGINNING = b'{"attempts": '  # of every line: keys are sorted


class Manifest:
    """
    A manifest that a run appends to; used as a context manager.

    Parameters
    ----------
    path : pathlib.Path
        The file; made, with its folder, if need be.

    Raises
    ------
    OptionError
        ``E_MANIFEST``: the file is something else, or another run is writing it.
    OutputError
        It can't be written.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = path.open("a+b", buffering=0)
        except OSError as error:
            raise write_error(path, error) from error
        try:
            self._lock()
            self._repair()
        except BaseException:
            self._file.close()
            raise

    def __enter__(self) -> Manifest:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._file.close()

    def _lock(self) -> None:
        """Keep other runs out until this process ends, however it ends."""
        try:
            import fcntl
        except ImportError:  # Windows: on your own
            return
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if error.errno in (errno.EWOULDBLOCK, errno.EACCES):
                message = f"{self.path}: another run is writing this manifest"
                raise OptionError(message, "E_MANIFEST") from error
            # some network file systems have no locks

    def _repair(self) -> None:
        """Cut off a last line that was not written to its end."""
        size = self._file.seek(0, os.SEEK_END)
        self._file.seek(0)
        head = self._file.read(len(_BEGINNING)) or b""
        if head != _BEGINNING[:size]:
            message = f"{self.path}: is not a manifest of volatool; give another name"
            raise OptionError(message, "E_MANIFEST")
        end = size
        while end:
            start = max(0, end - 65536)
            self._file.seek(start)
            newline = (self._file.read(end - start) or b"").rfind(b"\n")
            if newline >= 0:
                end = start + newline + 1
                break
            end = start
        if end < size:
            self._file.truncate(end)

    def append(self, record: dict[str, Any]) -> None:
        """
        Write a record to the disk.

        Raises
        ------
        OutputError
            It can't be written; nothing of it is left.
        """
        line = (json.dumps(record, sort_keys=True) + "\n").encode()
        size = os.fstat(self._file.fileno()).st_size
        try:
            rest = memoryview(line)
            while rest:
                rest = rest[self._file.write(rest) :]
            os.fsync(self._file.fileno())
        except OSError as error:
            with contextlib.suppress(OSError):
                self._file.truncate(size)
            raise write_error(self.path, error) from error


def read_records(path: Path) -> Iterator[dict[str, Any]]:
    """
    Yield the records of a manifest in order; of one that is not there, none.

    Parameters
    ----------
    path : pathlib.Path
        The file. Lines that are damaged are left out: they prove nothing.
    """
    with contextlib.suppress(FileNotFoundError), path.open("rb") as file:
        for line in file:
            try:
                record = json.loads(line)
            except ValueError:
                continue
            if isinstance(record, dict) and record.get("schema") == SCHEMA_ID:
                yield record


def record_of(unit: Unit, result: Result, options: str) -> dict[str, Any]:
    """
    Return the record of a tile; docs/reference/manifest.md says what is in it.

    Parameters
    ----------
    unit, result : Unit, Result
        What was to be done, and what became of it.
    options : str
        Their digest.
    """
    error = result.report.error or {}
    return {
        "schema": SCHEMA_ID,
        "version": __version__,
        "kind": unit.kind,
        "options": options,
        "input": {"path": absolute(unit.path), **(result.identity or {})},
        "status": result.report.status,
        "code": error.get("code"),
        "message": error.get("message"),
        "outputs": [
            {"path": absolute(output.path), "size": output.size, "sha256": output.sha256}
            for output in result.outputs
        ],
        "attempts": result.attempts,
        "seconds": round(result.seconds, 3),
        "finished": datetime.now(UTC).isoformat(timespec="seconds"),
    }


def absolute(path: Path) -> str:
    """Return a path that means the same in whatever folder the next run is started."""
    if is_url(path):
        return str(path).rstrip("/")
    return os.path.abspath(path)  # noqa: PTH100  as named: links are not followed
