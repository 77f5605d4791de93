"""The loop over inputs that convert, dem and stats share: one report each, one exit status."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from volatool.batch.plan import expand
from volatool.errors import OptionError, VolatoolError
from volatool.naming import IMPORT_SUFFIXES, POINT_SUFFIXES, VOLUME_SUFFIXES
from volatool.options import ConvertOptions
from volatool.remote.path import is_url, path_of
from volatool.report import Report
from volatool_cli.exit_codes import ExitCode
from volatool_cli.output import configure_logging, say_warnings
from volatool_cli.progress import watcher_of

if TYPE_CHECKING:
    from volatool.batch.executor import Executor

_STATUS_OF = {
    "E_OPTION": ExitCode.USAGE,
    "E_CUBE": ExitCode.USAGE,
    "E_NO_EXTRA": ExitCode.USAGE,
    "E_BUDGET": ExitCode.USAGE,
    "E_OUTPUT_EXISTS": ExitCode.USAGE,
    "E_WRITE": ExitCode.NOT_WRITTEN,
    "E_MEMORY": ExitCode.LIMIT,
    "E_SIZE": ExitCode.LIMIT,
    "E_INTERNAL": ExitCode.INTERNAL,
}
"""What the status says when every input failed for such a reason."""

RUN_ONLY = frozenset(
    [
        "quiet",
        "verbose",
        "log",
        "progress",
        "as_json",
        "form",
        "summary",
        "summary_to",
        "gates",
        "fail_fast",
        "overwrite",
        "dry_run",
        "outdir",
        "jobs",
        "manifest",
        "resume",
        "verify",
        "scheduler",
    ]
)
"""Options of commands that are about the run, not of `ConvertOptions`."""


def run_tiles(arguments: dict[str, Any], kind: str) -> None:
    """
    Run a command over its inputs and exit with the status that says how it went.

    Parameters
    ----------
    arguments : dict
        The command's options by parameter name.
    kind : str
        ``"convert"``, ``"import"``, ``"dem"``, ``"stats"``, ``"classify"`` or ``"retile"``.

    Notes
    -----
    Commands made of several runs give more: ``failed_inputs``, a set that takes the paths of those,
    ``summary_to`` and ``say_warnings``.
    """
    quiet = arguments.pop("quiet")
    configure_logging(quiet, arguments.pop("verbose"), arguments.pop("log"))
    show_progress = arguments.pop("progress")
    as_json = arguments.pop("as_json", False)
    form, summary = arguments.pop("form", None), arguments.pop("summary", False)
    summary_to = arguments.pop("summary_to", None)
    gates = arguments.pop("gates", ())
    told = partial(_told, with_warnings=arguments.pop("say_warnings", not quiet))
    failed_inputs: set[Path] = arguments.pop("failed_inputs", set())
    fail_fast, overwrite = arguments.pop("fail_fast"), arguments.pop("overwrite", False)
    dry_run, outdir = arguments.pop("dry_run", False), arguments.pop("outdir", None)
    if outdir == "":
        raise OptionError("--outdir is an empty name; is a shell variable unset?")
    folder = None if outdir is None else path_of(outdir)

    jobs, scheduler = arguments.pop("jobs"), arguments.pop("scheduler")
    record = arguments.pop("manifest", None)
    resume, verify = arguments.pop("resume", False), arguments.pop("verify", False)
    if resume and record is None:
        raise OptionError("--resume needs the --manifest of the run before")
    if verify and not resume:
        raise OptionError("--verify is for --resume: give both or none")

    suffixes = _suffixes(kind, arguments.get("from_format"))
    names, nul = arguments.pop("inputs"), arguments.pop("nul")
    paths = expand(names, stdin_names(nul) if "-" in names else (), suffixes)
    options = convert_options(arguments)
    saved: list[Path] = []
    table = None
    if kind == "stats":
        from volatool_cli.stats_output import StatsOutput, reports_in, split_reports

        saved, paths = split_reports(paths)
        table = StatsOutput(form, summary, summary_to)
        options = replace(options, all_levels=summary)

    from volatool.batch.manifest import Manifest
    from volatool.batch.run import in_order, run_inputs
    from volatool.conditions import failures

    if dry_run:
        if resume:
            paths = _not_done(paths, options, kind, folder, Path(record), verify)
        _dry_run(paths, options, kind, folder, overwrite or resume)
        return
    executor, options = _executor(jobs, scheduler, options, len(paths))
    codes, n_inputs = [], 0
    watcher = watcher_of(show_progress, quiet)
    with contextlib.ExitStack() as stack:
        results = run_inputs(
            paths,
            options,
            kind=kind,
            outdir=folder,
            overwrite=overwrite,
            fail_fast=fail_fast,
            executor=executor,
            watcher=watcher,
            manifest=None if record is None else stack.enter_context(Manifest(Path(record))),
            resume=resume,
            verify=verify,
        )
        stack.enter_context(contextlib.closing(results))
        try:
            if table is not None:
                for report in reports_in(saved):
                    n_inputs += 1
                    codes += told(report)
                    table.add(report, n_inputs)
            for result in in_order(results) if kind == "stats" else results:
                report = result.report
                n_inputs += 1
                if report.error is not None:
                    failed_inputs.add(paths[result.index])
                with watcher.aside():
                    codes += told(report)
                    if table is None:
                        _print_result(report, as_json)
                    else:
                        table.add(report, n_inputs)
        except VolatoolError as error:  # not a tile's: there is nobody left to work
            if n_inputs == len(codes):
                raise
            click.echo(f"{error.code}: {error}", err=True)
            sys.exit(ExitCode.SOME_FAILED)
    failed: list[str] = []
    if table is not None:
        failed = failures(table.print(), gates)
        for line in failed:
            click.echo(line, err=True)
    if codes:
        sys.exit(_status(codes, n_inputs + watcher.n_skipped))
    if failed:
        sys.exit(ExitCode.CHECK_FAILED)


def _told(report: Report, *, with_warnings: bool) -> list[str]:
    """Say what was wrong with an input; return the code of its error, if any."""
    if report.error is not None:
        click.echo(f"{report.error['code']}: {report.error['message']}", err=True)
        return [report.error["code"]]
    if report.input is not None and with_warnings:
        say_warnings(report.input["name"], report.warnings, quiet=False)
    return []


def _executor(
    jobs: int | None, scheduler: str | None, options: ConvertOptions, n_inputs: int
) -> tuple[Executor, ConvertOptions]:
    """Return where the work is done, and the options with each process's share of the memory."""
    from volatool.batch.executor import Serial
    from volatool.batch.jobs import share_out
    from volatool.batch.pool import Pool

    if scheduler not in (None, "local"):
        from volatool.batch.cluster import Cluster

        return Cluster(scheduler), options
    share = share_out(jobs, options.memory, n_inputs)
    if scheduler == "local":
        from volatool.batch.cluster import Cluster

        return Cluster(scheduler, share.jobs, share.threads), replace(options, memory=share.memory)
    executor = Serial() if share.jobs == 1 else Pool(share.jobs, share.threads)
    return executor, replace(options, memory=share.memory)


def _not_done(
    paths: Sequence[Path],
    options: ConvertOptions,
    kind: str,
    outdir: Path | None,
    record: Path,
    verify: bool,
) -> list[Path]:
    """Return the inputs that a manifest does not prove done."""
    from volatool.batch.manifest import read_records
    from volatool.batch.resume import options_digest, proven

    digest = options_digest(options, kind)
    is_done = proven(
        read_records(record), paths, kind=kind, options=digest, outdir=outdir, verify=verify
    )
    return [path for path, done in zip(paths, is_done, strict=True) if not done]


def _suffixes(kind: str, from_format: str | None) -> tuple[str, ...]:
    """Return what a folder is searched for."""
    if kind != "import":
        return POINT_SUFFIXES + (VOLUME_SUFFIXES if kind == "stats" else ())
    if from_format is None:
        return IMPORT_SUFFIXES
    from volatool.imports.registry import FORMATS

    return FORMATS[from_format].suffixes


def _status(codes: Sequence[str], n_inputs: int) -> ExitCode:
    """Return the status for the codes of the inputs that failed."""
    if len(codes) < n_inputs:
        return ExitCode.SOME_FAILED
    first, *others = {_STATUS_OF.get(code, ExitCode.ALL_FAILED) for code in codes}
    return ExitCode.ALL_FAILED if others else first


def convert_options(arguments: dict[str, Any]) -> ConvertOptions:
    """Return the library's options for the command line's."""
    arguments["fill"] = not arguments.pop("no_fill", False)
    arguments["resources"] = not arguments.pop("no_resources")
    return ConvertOptions(**arguments)


def refuse_url(outdir: str, command: str) -> None:
    """Raise if what a command keeps for all its tiles would have to be at a URL."""
    if is_url(outdir):
        raise OptionError(
            f"{command} needs a local folder for what its tiles share: give another --outdir and "
            "copy it when it is done"
        )


def stdin_names(nul: bool) -> list[str]:
    """
    Return the names on stdin, which may hold any byte but the separator.

    Parameters
    ----------
    nul : bool
        The separator is NUL, not the end of a line.
    """
    data = sys.stdin.buffer.read()
    separator = b"\0" if nul else b"\n"
    names = [name.rstrip(b"\r") if not nul else name for name in data.split(separator)]
    return [name.decode(sys.getfilesystemencoding(), "surrogateescape") for name in names if name]


def _print_result(report: Report, as_json: bool) -> None:
    if as_json:
        click.echo(report.to_json())
    else:
        for path in report.paths:
            click.echo(str(path))


def _dry_run(
    paths: Sequence[Path],
    options: ConvertOptions,
    kind: str,
    outdir: Path | None,
    overwrite: bool,
) -> None:
    """Print what would be written, after the checks that need no points."""
    from volatool.batch.plan import refuse_collisions
    from volatool.classification import refuse_inputs
    from volatool.opening import open_source
    from volatool.outputs import refuse_existing
    from volatool.tile import planned_outputs

    refuse_collisions(paths, outdir)
    if kind == "classify":
        refuse_inputs(list(paths), options, outdir)
    targets = [target for path in paths for target in planned_outputs(path, options, kind, outdir)]
    refuse_existing(targets, overwrite)
    codes = []
    for path in paths:
        try:
            if kind == "dem" and path.name.lower().endswith(VOLUME_SUFFIXES):
                _describe_volume(path)
                for target in planned_outputs(path, options, kind, outdir):
                    click.echo(str(target))
                continue
            unmoved = replace(options, to_crs=None)
            with open_source(path, unmoved, allow_degrees=kind == "classify", kind=kind) as source:
                crs = source.crs.horizontal or "no CRS"
                click.echo(f"{path}: {source.n_points:,} points, {crs}", err=True)
        except VolatoolError as error:
            if not (options.to_crs and error.code == "E_GEOGRAPHIC"):
                click.echo(f"{error.code}: {error}", err=True)
                codes.append(error.code)
                continue
        for target in planned_outputs(path, options, kind, outdir):
            click.echo(str(target))
    if codes:
        sys.exit(_status(codes, len(paths)))


def _describe_volume(path: Path) -> None:
    """Say what a VOLA file's header and trailer tell."""
    from volatool.formats.registry import read_info

    found = read_info(path)
    click.echo(f"{path}: a volume, {found.info.crs.horizontal or 'no CRS'}", err=True)
