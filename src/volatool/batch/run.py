"""Inputs through an executor to results and records; a failed one does not stop the rest."""

from __future__ import annotations

import contextlib
import logging
import os
from array import array
from collections.abc import Generator, Iterable, Iterator, Sequence
from pathlib import Path

from volatool.batch.executor import Executor, Serial, Watcher
from volatool.batch.identity import identify
from volatool.batch.manifest import Manifest, absolute, read_records, record_of
from volatool.batch.plan import refuse_collisions
from volatool.batch.resume import options_digest, proven
from volatool.batch.work import Result, Unit
from volatool.classification import refuse_inputs
from volatool.errors import VolatoolError
from volatool.options import ConvertOptions
from volatool.outputs import OutputSet, refuse_existing, sweep
from volatool.tile import planned_outputs
from volatool.volumes import check_files

FAILED_NAME = "failed.txt"
"""File beside the manifest that lists the inputs that failed, for ``@failed.txt``."""

logger = logging.getLogger(__name__)


def run_inputs(
    paths: Sequence[Path],
    options: ConvertOptions,
    *,
    kind: str,
    outdir: Path | None = None,
    overwrite: bool = False,
    fail_fast: bool = False,
    executor: Executor | None = None,
    watcher: Watcher | None = None,
    manifest: Manifest | None = None,
    resume: bool = False,
    verify: bool = False,
) -> Generator[Result, None, None]:
    """
    Work on inputs.

    Parameters
    ----------
    paths : sequence of pathlib.Path
        The inputs.
    options : ConvertOptions
        For all of them; ``memory`` is the ceiling of each process.
    kind : str
        ``"convert"``, ``"import"``, ``"dem"``, ``"stats"``, ``"classify"`` or ``"retile"``.
    outdir : pathlib.Path or None
        Folder for the outputs; beside each input by default.
    overwrite : bool
        Replace outputs that exist.
    fail_fast : bool
        Stop after the first failed input.
    executor : Executor, optional
        Where the work is done; in this process by default.
    watcher : Watcher, optional
        Told how it gets on.
    manifest : Manifest, optional
        Gets a record of each input, before its result is yielded.
    resume : bool
        Leave out inputs that the manifest proves done; do the others, whatever outputs of theirs a
        killed run has left.
    verify : bool
        Have the manifest's proof include the content of the outputs.

    Yields
    ------
    result : Result
        One per input, in the order in which they finish (``index`` is the input's place in
        `paths`; see `in_order`); for an input that could not be used the report's ``status`` is
        failed. Close the generator to stop the work: no worker goes on then.

    Raises
    ------
    OptionError
        Outputs that exist or collide, and options that fit no input, before any work.
    """
    executor, watcher = executor or Serial(), watcher or Watcher()
    check_files(options)
    if kind != "stats":
        refuse_collisions(paths, outdir)
    if kind == "classify":
        refuse_inputs(list(paths), options, outdir)
    digest = "" if manifest is None else options_digest(options, kind)
    is_done = bytearray(len(paths))
    if resume:
        assert manifest is not None
        is_done = proven(
            read_records(manifest.path),
            paths,
            kind=kind,
            options=digest,
            outdir=outdir,
            verify=verify,
        )
        logger.warning("%d of %d inputs are done already", sum(is_done), len(paths))
    folders: set[Path] = set()
    if kind != "stats":
        _refuse_outputs(paths, is_done, options, kind, outdir, overwrite=overwrite or resume)
        folders = {path.parent for path in paths} if outdir is None else {outdir}
        for folder in folders:
            sweep(folder)
    sizes = array("q", (0 if is_done[i] else _size(path) for i, path in enumerate(paths)))
    order = array("q", (index for index, done in enumerate(is_done) if not done))
    if kind != "stats" and not executor.in_order:  # a large one begun last would end alone
        order = array("q", sorted(order, key=lambda index: -sizes[index]))

    def units() -> Iterator[Unit]:
        for index in order:
            yield Unit(
                index,
                paths[index],
                options,
                kind,
                outdir,
                overwrite=overwrite or resume,
                with_digests=manifest is not None,
            )

    failed: list[str] = []
    watcher.planned(sizes, sum(is_done))
    try:
        with contextlib.closing(executor.results(units(), watcher)) as results:
            for unit, result in results:
                if manifest is not None:
                    manifest.append(record_of(unit, result, digest))
                if result.code is not None:
                    failed.append(absolute(unit.path))
                watcher.finished(unit, result)
                yield result
                if fail_fast and result.code is not None:
                    return
    finally:
        watcher.ended()
        with contextlib.suppress(VolatoolError):  # what is done is done
            for folder in folders:  # workers of a killed run may have lived until now
                sweep(folder)
        if manifest is not None:
            _list_failed(manifest.path.with_name(FAILED_NAME), failed)


def in_order(results: Iterable[Result]) -> Iterator[Result]:
    """
    Yield results in the order of the inputs, each as soon as those before it are there.

    Parameters
    ----------
    results : iterable of Result
        Of a run; only those that wait for others are kept. When the run stops early there are gaps.
    """
    waiting: dict[int, Result] = {}
    following = 0
    for result in results:
        waiting[result.index] = result
        while following in waiting:
            yield waiting.pop(following)
            following += 1
    for index in sorted(waiting):
        yield waiting[index]


def _refuse_outputs(
    paths: Sequence[Path],
    is_done: Sequence[int],
    options: ConvertOptions,
    kind: str,
    outdir: Path | None,
    *,
    overwrite: bool,
) -> None:
    """Raise if an output can't be written; some inputs at a time, as they may be very many."""
    for start in range(0, len(paths), 1000):
        targets = [
            target
            for index in range(start, min(start + 1000, len(paths)))
            if not is_done[index]
            for target in planned_outputs(paths[index], options, kind, outdir)
        ]
        refuse_existing(targets, overwrite)


def _size(path: Path) -> int:
    identity = identify(path)
    return 1 if identity is None else max(1, int(identity["size"]))


def _list_failed(path: Path, failed: Sequence[str]) -> None:
    """Write the list of inputs that failed; without any there is no list."""
    if not failed:
        path.unlink(missing_ok=True)
        return
    with OutputSet(overwrite=True) as outputs:
        text = "".join(f"{name}\n" for name in failed)
        outputs.add(path).write_bytes(os.fsencode(text))
        outputs.commit()
