"""``volatool retile``: a plan from the headers, one depth for all, then group by group."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from volatool.errors import InputError, OptionError
from volatool_cli.exit_codes import ExitCode
from volatool_cli.output import configure_logging
from volatool_cli.run import RUN_ONLY, convert_options, refuse_url, run_tiles, stdin_names


def run_retile(arguments: dict[str, Any]) -> None:
    """
    Run the command and exit with the status that says how it went.

    Parameters
    ----------
    arguments : dict
        The command's options by parameter name.
    """
    from volatool.batch.plan import expand
    from volatool.batch.resume import options_digest
    from volatool.outputs import refuse_existing
    from volatool.retile import (
        COUNT_NAME,
        GROUP_SUFFIX,
        count_proof,
        is_counted,
        plan,
        write_groups,
    )
    from volatool.tile import planned_outputs
    from volatool.volumes import check_files

    configure_logging(arguments["quiet"], arguments["verbose"], arguments["log"])
    name, outdir = arguments.pop("name"), arguments["outdir"]
    if not name or Path(name).name != name:
        raise OptionError(f"--name {name!r}: give a name without folders")
    if not outdir:
        raise OptionError("retile needs a folder for its cubes: --outdir")
    refuse_url(outdir, "retile")
    names, nul = arguments.pop("inputs"), arguments.pop("nul")
    paths = expand(names, stdin_names(nul) if "-" in names else ())
    options = convert_options({k: v for k, v in arguments.items() if k not in RUN_ONLY})
    check_files(options)
    groups, failed = plan(paths, options, name)
    for error in failed.values():
        click.echo(f"{error.code}: {error}", err=True)
    if not groups:
        if failed:
            sys.exit(ExitCode.ALL_FAILED)
        raise InputError("none of the files has a point: there is nothing to cut")
    folder = Path(outdir) / f"{name}.cubes"
    targets = [folder / (group.name + GROUP_SUFFIX) for group in groups]
    may_exist = arguments["overwrite"] or arguments.get("resume", False)
    outputs = [planned_outputs(path, options, "retile", Path(outdir))[0] for path in targets]
    refuse_existing(outputs, may_exist)
    if arguments["dry_run"]:
        for group, path in zip(groups, outputs, strict=True):
            click.echo(f"{group.name}: {len(group.pieces)} files", err=True)
            click.echo(str(path))
        return
    work = {**arguments, "inputs": write_groups(groups, folder), "nul": False}
    if not options.depth_options:
        proof = count_proof(groups, options_digest(options, "stats"))
        if not (arguments.get("resume", False) and is_counted(folder, proof)):
            _count(work, folder, proof)
        work["depth_from"] = str(folder / COUNT_NAME)
    status = _status_of(work, "retile")
    if failed and status == ExitCode.OK:
        status = ExitCode.SOME_FAILED
    sys.exit(status)


def _count(work: dict[str, Any], folder: Path, proof: str) -> None:
    """Count the cubes of all groups: their depth follows from the sum."""
    from volatool.retile import COUNT_NAME, keep_proof

    outputs = ("outdir", "overwrite", "dry_run", "as_json", "manifest", "resume", "verify")
    asked = {key: value for key, value in work.items() if key not in outputs}
    asked |= {"form": "json", "summary": True, "summary_to": folder / COUNT_NAME}
    # a group has no depth of its own, and all else is said again when it is written
    status = _status_of({**asked, "say_warnings": False}, "stats")
    if status == ExitCode.OK:
        keep_proof(folder, proof)
    elif status != ExitCode.SOME_FAILED:
        sys.exit(status)


def _status_of(arguments: dict[str, Any], kind: str) -> int:
    try:
        run_tiles(arguments, kind)
    except SystemExit as end:
        return int(end.code or 0)
    return int(ExitCode.OK)
