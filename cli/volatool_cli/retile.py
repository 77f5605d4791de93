"""``volatool retile``: a plan from the headers, one depth for all, then group by group."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from volatool.errors import InputError, OptionError
from volatool_cli.exit_codes import ExitCode
from volatool_cli.output import configure_logging
from volatool_cli.run import RUN_ONLY, convert_options, run_tiles, stdin_names


def run_retile(arguments: dict[str, Any]) -> None:
    """
    Run the command and exit with the status that says how it went.

    Parameters
    ----------
    arguments : dict
        The command's options by parameter name.
    """
    from volatool.batch.plan import expand
    from volatool.outputs import refuse_existing
    from volatool.retile import plan, write_groups
    from volatool.tile import planned_outputs
    from volatool.volumes import check_files

    configure_logging(arguments["quiet"], arguments["verbose"], arguments["log"])
    name, outdir = arguments.pop("name"), arguments["outdir"]
    if not name or Path(name).name != name:
        raise OptionError(f"--name {name!r}: give a name without folders")
    if not outdir:
        raise OptionError("retile needs a folder for its cubes: --outdir")
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
    targets = [folder / (group.name + ".cubes") for group in groups]
    may_exist = arguments["overwrite"] or arguments.get("resume", False)
    outputs = [planned_outputs(path, options, "retile", Path(outdir))[0] for path in targets]
    refuse_existing(outputs, may_exist)
    if arguments["dry_run"]:
        for group, path in zip(groups, outputs, strict=True):
            click.echo(f"{group.name}: {len(group.pieces)} files", err=True)
            click.echo(str(path))
        return
    given = [str(path) for path in write_groups(groups, folder)]
    work = {**arguments, "inputs": given, "nul": False}
    if not options.depth_options:
        work["depth_from"] = str(_one_depth(work, folder / "dataset.json"))
    status = _status_of(work, "retile")
    if failed and status == ExitCode.OK:
        status = ExitCode.SOME_FAILED
    sys.exit(status)


def _one_depth(work: dict[str, Any], target: Path) -> Path:
    """Count the cubes of all groups and choose their depth; return the file that says it."""
    outputs = ("outdir", "overwrite", "dry_run", "as_json", "manifest", "resume", "verify")
    asked = {key: value for key, value in work.items() if key not in outputs}
    status = _status_of({**asked, "form": "json", "summary": True, "summary_to": target}, "stats")
    if status not in (ExitCode.OK, ExitCode.SOME_FAILED):
        sys.exit(status)
    return target


def _status_of(arguments: dict[str, Any], kind: str) -> int:
    try:
        run_tiles(arguments, kind)
    except SystemExit as end:
        return int(end.code or 0)
    return int(ExitCode.OK)
