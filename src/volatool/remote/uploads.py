"""Outputs at URLs: made in a temporary folder, then uploaded, each whole, the report last."""

from __future__ import annotations

import contextlib
import functools
import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

from volatool.errors import (
    InputError,
    InputNotFoundError,
    OptionError,
    OutputError,
    OutputExistsError,
    VolatoolError,
)
from volatool.remote import store
from volatool.remote.path import WEB, RemotePath
from volatool.remote.staging import staging
from volatool.report import Report

_Result = TypeVar("_Result")

_OBJECT_STORES = frozenset({"s3", "s3a", "gs", "gcs", "az", "abfs", "abfss", "oss", "memory"})
"""Where a file appears when all of it is there; elsewhere it is renamed when it is."""

_FEW = 20
"""So many targets in one folder are asked for one by one; for more, the folder is listed."""

_LAST = (".dem.tif", ".stats.json")
"""What is uploaded last, the very last at the end: its presence says that all is there."""


def refuse_remote(targets: Sequence[RemotePath], overwrite: bool) -> None:
    """
    Raise if outputs can't be written to their place, or exist and must not be overwritten.

    Parameters
    ----------
    targets : sequence of RemotePath
        The outputs.
    overwrite : bool
        They may be replaced.

    Raises
    ------
    OptionError
        ``E_OPTION``: a protocol that only reads; ``E_NO_EXTRA``.
    OutputExistsError
        Naming the first that exists.
    OutputError
        No such bucket, or no access.
    """
    folders: dict[RemotePath, list[RemotePath]] = {}
    for target in targets:
        if target.protocol in WEB:
            raise OptionError(
                f"{target.parent}/: nothing can be written to {target.protocol}:// addresses; give "
                "another folder by -o/--outdir"
            )
        folders.setdefault(target.parent, []).append(target)
    for folder, members in folders.items():
        _require_bucket(RemotePath(folder.url.partition("://")[0] + "://" + _bucket(folder)))
        if overwrite:
            continue
        present = _present(folder, members)
        for target in members:
            if target in present:
                raise OutputExistsError(f"{target}: exists; give --overwrite to replace it")


def _bucket(path: RemotePath) -> str:
    return path.url.partition("://")[2].partition("/")[0]


@functools.cache
def _require_bucket(bucket: RemotePath) -> None:
    """Say now, not after hours of work, that a bucket is not there."""
    if bucket.protocol not in _OBJECT_STORES - {"memory"}:
        return
    files, name = store.filesystem(bucket)
    try:
        store.asked(lambda: files.info(name), bucket)
    except InputNotFoundError:
        raise OutputError(f"{bucket}: no such bucket") from None
    except InputError as error:
        raise _unwritten(bucket, error) from None


def _present(folder: RemotePath, members: list[RemotePath]) -> set[RemotePath]:
    """Return those of a folder's files that exist."""
    if len(members) <= _FEW:
        return {target for target in members if _written(target.exists, target)}

    def listed() -> set[RemotePath]:
        try:
            return set(store.listed(folder, ("",)))
        except InputNotFoundError:  # no file is there
            return set()

    return _written(listed, folder)


def uploaded(work: Callable[..., Report], planned: Sequence[Path], overwrite: bool) -> Report:
    """
    Work on an input whose outputs are remote.

    Parameters
    ----------
    work : callable
        Called with ``outdir``, a temporary folder; gives the report.
    planned : sequence of path
        Remote outputs that may be made, as far as known.
    overwrite : bool
        They may be replaced; those that are planned but were not made are removed.

    Returns
    -------
    report : Report
        ``paths`` are the URLs. All are there, with the sizes of the local files.

    Raises
    ------
    OutputError
        One could not be uploaded or has another size; those already uploaded are removed.
    """
    folder = planned[0].parent
    with staging() as local:
        report = work(outdir=local)
        made = {folder / path.name: path for path in report.paths}
        order = sorted(made, key=lambda target: _rank(target.name))
        stale = [target for target in planned if target not in made]
        done: list[Path] = []
        try:
            if overwrite:
                # without the file that tells that all is there, until all is
                for target in [*stale, *(order[-1:] if len(order) > 1 else ())]:
                    _remove(target)
            for target in order:
                done.append(target)
                _upload(made[target], target)
        except BaseException:
            for target in done:
                with contextlib.suppress(VolatoolError):
                    _remove(target)
            raise
        return replace(report, paths=[folder / path.name for path in report.paths])


def _rank(name: str) -> int:
    return max((1 + i for i, suffix in enumerate(_LAST) if name.endswith(suffix)), default=0)


def _upload(local: Path, target: Path) -> None:
    """Upload a file, whole or not at all, and check its size."""
    assert isinstance(target, RemotePath)
    files, name = store.filesystem(target)
    if target.protocol in _OBJECT_STORES:
        _written(lambda: files.put_file(str(local), name), target)
    else:
        folder, _, last = name.rpartition("/")
        temporary = f"{folder}/.{last}.volatool-{os.getpid()}.tmp"
        _written(lambda: files.makedirs(folder, exist_ok=True), target)
        _written(lambda: files.put_file(str(local), temporary), target)
        _written(lambda: files.mv(temporary, name), target)
    files.invalidate_cache()
    size, found = local.stat().st_size, _written(lambda: store.details(target), target).size
    if found != size:
        raise OutputError(f"{target}: has {found} bytes after the upload, expected {size}")


def _remove(target: Path) -> None:
    assert isinstance(target, RemotePath)
    files, name = store.filesystem(target)

    def remove() -> None:
        with contextlib.suppress(FileNotFoundError):
            files.rm_file(name)

    _written(remove, target)


def _written(request: Callable[[], _Result], target: RemotePath) -> _Result:
    """Return the answer to a request; what fails is an output that can't be written."""
    try:
        return store.asked(request, target)
    except OptionError:
        raise
    except VolatoolError as error:
        raise _unwritten(target, error) from None


def _unwritten(target: Path, error: VolatoolError) -> OutputError:
    text = str(error).removeprefix(f"{target}: ")
    return OutputError(f"{target}: can't be written: {text}")
