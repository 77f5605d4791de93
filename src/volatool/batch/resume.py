"""What a manifest proves: inputs that need not be worked on again."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from volatool._version import __version__
from volatool.batch.identity import identify
from volatool.batch.manifest import absolute
from volatool.batch.plan import expand
from volatool.batch.work import digest_of
from volatool.errors import InputError
from volatool.naming import SET_SUFFIX
from volatool.options import ConvertOptions
from volatool.remote.path import is_url, path_of

_FILES = ("depth_from", "cube_from", "like", "params_from", "breaklines", "water")
"""Options that name a file whose content bears on the results."""


def options_digest(options: ConvertOptions, kind: str) -> str:
    """
    Return what differs when a run would not give the same outputs of the same inputs.

    Parameters
    ----------
    options : ConvertOptions
        Those that only say how the work is done are left out; files that they name count with
        their content, neighbours with their identity, the set of a mosaic with its content.
    kind : str
        The command.

    Returns
    -------
    digest : str
        SHA-256, the first 16 hexadecimal digits.
    """
    document = {
        "kind": kind,
        "options": options.given(),
        "strict": options.strict,
        "resources": options.resources,
        "files": {name: _content(getattr(options, name)) for name in _FILES},
        "neighbours": list(_neighbours(options)),
    }
    return hashlib.sha256(json.dumps(document, sort_keys=True).encode()).hexdigest()[:16]


def _content(name: str | os.PathLike[str] | None) -> Any:
    if name is None:
        return None
    path = Path(name)
    try:
        return digest_of(path)
    except OSError:  # a folder, say: some vector data are
        return identify(path)


def _neighbours(options: ConvertOptions) -> Iterator[Any]:
    if options.neighbours:
        for path in expand(options.neighbours):
            # a set tells the identities of its tiles
            yield str(path), _content(path) if path.name.endswith(SET_SUFFIX) else identify(path)


def proven(
    records: Iterable[dict[str, Any]],
    paths: Sequence[Path],
    *,
    kind: str,
    options: str,
    outdir: Path | None,
    verify: bool = False,
) -> bytearray:
    """
    Return which inputs are done already.

    Parameters
    ----------
    records : iterable of dict
        Of a manifest, in order; the last one of an input counts, of whatever command: another one
        may have replaced outputs.
    paths : sequence of pathlib.Path
        The inputs.
    kind : str
        The command.
    options : str
        Digest of its options.
    outdir : pathlib.Path or None
        Where the outputs belong.
    verify : bool
        Read the outputs and compare their digests.

    Returns
    -------
    is_done : bytearray
        1 for each input that is the same as recorded, and whose outputs are there with the recorded
        size (and content); 0 for the others.
    """
    is_done = bytearray(len(paths))
    index_of = {absolute(path): index for index, path in enumerate(paths)}
    folder = None if outdir is None else absolute(outdir)
    wanted = {"kind": kind, "options": options, "version": __version__}
    for record in records:
        try:
            index = index_of.get(record["input"]["path"])
            if index is None:
                continue
            home = folder or os.path.dirname(record["input"]["path"])  # noqa: PTH120  many
            is_done[index] = (
                record["status"] != "failed"
                and all(record[key] == value for key, value in wanted.items())
                and _same_input(record["input"], paths[index])
                and all(_is_there(output, home) for output in record["outputs"])
                and (not verify or all(map(_is_intact, record["outputs"])))
            )
        except (KeyError, TypeError):  # not a whole record: it proves nothing
            continue
    return is_done


def _same_input(recorded: dict[str, Any], path: Path) -> bool:
    identity = identify(path)
    return identity is not None and {**identity, "path": recorded["path"]} == recorded


def _is_there(output: dict[str, Any], folder: str) -> bool:
    path: str = output["path"]
    try:
        size: int = path_of(path).stat().st_size if is_url(path) else os.stat(path).st_size  # noqa: PTH116  many
    except (OSError, ValueError):
        return False
    return size == output["size"] and os.path.dirname(path) == folder  # noqa: PTH120


def _is_intact(output: dict[str, Any]) -> bool:
    try:
        digest = digest_of(path_of(output["path"]))
    except (OSError, InputError):
        return False
    return bool(digest == output["sha256"])
