"""One unit of work: an input and what is asked for, to outputs and a result."""

from __future__ import annotations

import hashlib
import logging
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeAlias

from volatool.batch.identity import Identity, identify
from volatool.errors import ResourceError, VolatoolError
from volatool.model import Progress, no_progress
from volatool.options import ConvertOptions
from volatool.report import Report

logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Unit:
    """
    One input and what to do with it; can be pickled.

    Parameters
    ----------
    index : int
        Its number among the inputs of the run.
    path : pathlib.Path
        The input.
    options : ConvertOptions
        ``memory`` is the ceiling of the process that does the work.
    kind : str
        ``"convert"``, ``"import"``, ``"dem"``, ``"stats"``, ``"classify"`` or ``"retile"``.
    outdir : pathlib.Path or None
        Folder for the outputs; beside the input by default.
    overwrite : bool
        Replace outputs that exist.
    with_digests : bool
        Read the outputs once more for their digests.
    attempt : int
        Counts from 1.
    """

    index: int
    path: Path
    options: ConvertOptions
    kind: str
    outdir: Path | None = None
    overwrite: bool = False
    with_digests: bool = False
    attempt: int = 1

    def again(self) -> Unit:
        """Return the unit for another attempt, after its worker was lost."""
        # the lost worker may have given its outputs their names; they were not there before
        return replace(self, overwrite=True, attempt=self.attempt + 1)


@dataclass(frozen=True, slots=True)
class Output:
    """A file that was written: its size in bytes, and its SHA-256 in hexadecimal if wanted."""

    path: Path
    size: int
    sha256: str | None


@dataclass(frozen=True, slots=True)
class Result:
    """
    What became of a unit; can be pickled.

    Parameters
    ----------
    index : int
        Of the unit.
    report : Report
        With ``status`` failed and ``error`` for an input that could not be used.
    identity : dict or None
        Of the input, taken before it was read.
    outputs : tuple of Output
        In the order in which they were written.
    seconds : float
        Wall time of the work.
    attempts : int
        How often it was tried.
    """

    index: int
    report: Report
    identity: Identity | None = None
    outputs: tuple[Output, ...] = ()
    seconds: float = 0.0
    attempts: int = 1

    @property
    def code(self) -> str | None:
        """The code of the error; None if there was none."""
        return None if self.report.error is None else self.report.error["code"]


Work: TypeAlias = Callable[[Unit, Progress], Result]
"""What is done with a unit: `perform`, and simulations of it."""


def perform(unit: Unit, progress: Progress = no_progress) -> Result:
    """
    Work on a unit; what goes wrong becomes part of the result.

    Parameters
    ----------
    unit : Unit
        What to do.
    progress : callable
        Called with (points done, points of the file).
    """
    started = time.perf_counter()
    identity = identify(unit.path)
    outputs: tuple[Output, ...] = ()
    try:
        report = _report(unit, progress)
        outputs = tuple(_outputs(report.paths, unit.with_digests))
    except Exception as error:  # a bug met on one tile must not stop a night's work
        logger.info("%s failed", unit.path, exc_info=error)
        report = _failed(unit, _coded(unit, error))
    seconds = time.perf_counter() - started
    return Result(unit.index, report, identity, outputs, seconds, unit.attempt)


def lost(unit: Unit, what: str) -> Result:
    """
    Return the result of a unit whose workers were lost.

    Parameters
    ----------
    unit : Unit
        As it was tried last.
    what : str
        How the worker ended.
    """
    message = (
        f"{unit.path}: its worker {what}, {unit.attempt} times; if memory ran out, "
        "lower --jobs or --memory"
    )
    report = _failed(unit, VolatoolError(message, "E_WORKER"))
    return Result(unit.index, report, identify(unit.path), attempts=unit.attempt)


def _report(unit: Unit, progress: Progress) -> Report:
    if unit.kind == "classify":
        from volatool.classification import classify_tile

        return classify_tile(
            unit.path,
            unit.options,
            outdir=unit.outdir,
            overwrite=unit.overwrite,
            progress=progress,
        )
    from volatool.tile import convert_tile

    return convert_tile(
        unit.path,
        unit.options,
        kind=unit.kind,
        outdir=unit.outdir,
        overwrite=unit.overwrite,
        progress=progress,
    )


def _outputs(paths: Iterable[Path], with_digests: bool) -> Iterable[Output]:
    for path in paths:
        yield Output(path, path.stat().st_size, digest_of(path) if with_digests else None)


def digest_of(path: Path) -> str:
    """Return the SHA-256 of a file, in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _coded(unit: Unit, error: Exception) -> VolatoolError:
    if isinstance(error, VolatoolError):
        return error
    if isinstance(error, MemoryError):
        what_to_do = "lower --memory or --jobs, or close others"
        return ResourceError(f"{unit.path}: the machine has no memory left; {what_to_do}")
    return VolatoolError(f"{unit.path}: {type(error).__name__}: {error} (-v shows where)")


def _failed(unit: Unit, error: VolatoolError) -> Report:
    return Report(
        status="failed",
        input={"name": unit.path.name},
        options=unit.options.given(),
        error={"code": error.code, "message": str(error)},
    )
