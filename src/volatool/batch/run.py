"""Inputs one after the other; a failed one becomes a report and the rest go on."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from pathlib import Path

from volatool.batch.plan import refuse_collisions
from volatool.classification import classify_tile, refuse_inputs
from volatool.errors import VolatoolError
from volatool.model import Progress
from volatool.options import ConvertOptions
from volatool.outputs import refuse_existing
from volatool.report import Report
from volatool.tile import convert_tile, planned_outputs
from volatool.volumes import check_files

logger = logging.getLogger(__name__)

ProgressMaker = Callable[[Path], AbstractContextManager[Progress]]


def run_inputs(
    paths: Sequence[Path],
    options: ConvertOptions,
    *,
    kind: str,
    outdir: Path | None,
    overwrite: bool,
    fail_fast: bool,
    progress: ProgressMaker,
) -> Iterator[Report]:
    """
    Work on inputs in order.

    Parameters
    ----------
    paths : sequence of pathlib.Path
        The inputs.
    options : ConvertOptions
        For all of them.
    kind : str
        ``"convert"``, ``"import"``, ``"dem"``, ``"stats"`` or ``"classify"``.
    outdir : pathlib.Path or None
        Folder for the outputs; beside each input by default.
    overwrite : bool
        Replace outputs that exist.
    fail_fast : bool
        Stop after the first failed input.
    progress : callable
        Gives a context manager of a progress callback for an input.

    Yields
    ------
    report : Report
        One per input; with ``status`` failed and ``error`` for an input that could not be used.

    Raises
    ------
    OptionError
        Outputs that exist or collide, and options that fit no input, before any work.
    """
    check_files(options)
    if kind != "stats":
        refuse_collisions(paths, outdir)
        if kind == "classify":
            refuse_inputs(list(paths), options, outdir)
        refuse_existing(
            [target for path in paths for target in planned_outputs(path, options, kind, outdir)],
            overwrite,
        )
    for path in paths:
        try:
            with progress(path) as report_progress:
                yield _work(path, options, kind, outdir, overwrite, report_progress)
            continue
        except VolatoolError as error:
            failure = error
        except Exception as error:  # a bug met on one tile must not stop a night's work
            if len(paths) == 1:
                raise
            failure = VolatoolError(f"{path}: {type(error).__name__}: {error}")
        logger.info("%s failed", path, exc_info=failure)
        report = failed_report(path, failure, options)
        del failure  # its traceback holds the tile's memory
        yield report
        if fail_fast:
            return


def _work(
    path: Path,
    options: ConvertOptions,
    kind: str,
    outdir: Path | None,
    overwrite: bool,
    progress: Progress,
) -> Report:
    if kind == "classify":
        return classify_tile(path, options, outdir=outdir, overwrite=overwrite, progress=progress)
    return convert_tile(
        path, options, kind=kind, outdir=outdir, overwrite=overwrite, progress=progress
    )


def failed_report(path: Path, error: VolatoolError, options: ConvertOptions) -> Report:
    """
    Return the report of an input that could not be used.

    Parameters
    ----------
    path : pathlib.Path
        The input.
    error : VolatoolError
        Why.
    options : ConvertOptions
        What was asked for.
    """
    return Report(
        status="failed",
        input={"name": path.name},
        options=options.given(),
        error={"code": error.code, "message": str(error)},
    )
