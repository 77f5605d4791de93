"""Inputs through an executor to results; a failed one becomes a result and the rest go on."""

from __future__ import annotations

import contextlib
from collections.abc import Generator, Iterator, Sequence
from pathlib import Path

from volatool.batch.executor import Executor, Serial, Watcher
from volatool.batch.identity import identify
from volatool.batch.plan import refuse_collisions
from volatool.batch.work import Result, Unit
from volatool.classification import refuse_inputs
from volatool.options import ConvertOptions
from volatool.outputs import refuse_existing
from volatool.tile import planned_outputs
from volatool.volumes import check_files


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
        ``"convert"``, ``"import"``, ``"dem"``, ``"stats"`` or ``"classify"``.
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

    Yields
    ------
    result : Result
        One per input, in the order in which they finish (``index`` is the input's place in
        `paths`); for an input that could not be used the report's ``status`` is failed. Close the
        generator to stop the work: no worker goes on then.

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
        refuse_existing(
            [target for path in paths for target in planned_outputs(path, options, kind, outdir)],
            overwrite,
        )
    sizes = [_size(path) for path in paths]
    order = list(range(len(paths)))
    if not executor.in_order:
        order.sort(key=lambda index: -sizes[index])  # a large one begun last would end alone

    def units() -> Iterator[Unit]:
        for index in order:
            yield Unit(index, paths[index], options, kind, outdir, overwrite)

    watcher.planned(sizes, 0)
    try:
        with contextlib.closing(executor.results(units(), watcher)) as results:
            for unit, result in results:
                watcher.finished(unit, result)
                yield result
                if fail_fast and result.code is not None:
                    return
    finally:
        watcher.ended()


def _size(path: Path) -> int:
    identity = identify(path)
    return 0 if identity is None else int(identity["size"])
