"""``--mosaic``: an index of the headers before the tiles are worked on, one raster after."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from volatool.errors import OptionError
from volatool.options import ConvertOptions
from volatool_cli.exit_codes import ExitCode
from volatool_cli.run import RUN_ONLY, convert_options, refuse_url, run_tiles, stdin_names


def run_mosaic(arguments: dict[str, Any], kind: str) -> None:
    """
    Run a command over tiles whose models meet at the seams, and write the mosaic of them.

    Parameters
    ----------
    arguments : dict
        The command's options by parameter name; those of the mosaic are taken out. Without
        ``--mosaic`` the command runs as always.
    kind : str
        ``"convert"`` or ``"dem"``.
    """
    name, cog = arguments.pop("mosaic"), arguments.pop("cog")
    if name is None:
        if cog:
            raise OptionError("--cog is for --mosaic: the models of tiles are COGs anyway")
        run_tiles(arguments, kind)
        return
    from volatool.batch.plan import expand, refuse_collisions
    from volatool.dem.mosaic import finish, planned, prepare, set_path
    from volatool.naming import stem
    from volatool.outputs import refuse_existing
    from volatool.tile import planned_outputs
    from volatool_cli.output import configure_logging

    names, nul = arguments.pop("inputs"), arguments.pop("nul")
    paths = expand(names, stdin_names(nul) if "-" in names else ())
    folder = _folder(arguments["outdir"], paths)
    params_from = arguments["params_from"]
    shared = str(set_path(folder, name or ""))
    options = _options(arguments, shared)
    if not name or Path(name).name != name:
        raise OptionError(f"--mosaic {name!r}: give a name without folders")
    may_exist = arguments["overwrite"] or arguments.get("resume", False)
    targets = planned(folder, name, options, cog=cog)
    refuse_collisions(paths, folder)
    refuse_existing(targets, may_exist)
    for path in paths:  # they may be very many: no list of all their outputs
        outputs = planned_outputs(path, options, kind, folder)
        for taken in set(outputs).intersection(targets):
            message = f"--mosaic {name}: {taken.name} is a tile's; give another name"
            raise OptionError(message, "E_NAME_COLLISION")
        refuse_existing(outputs, may_exist)
    status, failed = 0, set[Path]()
    if not arguments["dry_run"]:
        configure_logging(arguments["quiet"], arguments["verbose"], arguments["log"])
        prepare(paths, options, folder, name, None if params_from is None else Path(params_from))
        arguments |= {"neighbours": (shared,), "params_from": shared}
    quiet, dry_run, as_json = (arguments[key] for key in ("quiet", "dry_run", "as_json"))
    try:
        run_tiles({**arguments, "inputs": paths, "nul": False, "failed_inputs": failed}, kind)
    except SystemExit as end:
        status = int(end.code or 0)
    if dry_run:
        for target in targets:
            click.echo(str(target))
    elif status in (ExitCode.OK, ExitCode.SOME_FAILED):
        # of a tile that failed there may be a model of an earlier run
        models = [folder / (stem(path) + ".dem.tif") for path in paths if path not in failed]
        models = [path for path in models if path.is_file()]
        if models:
            document, written = finish(models, folder, name, options, cog=cog, overwrite=may_exist)
            _say(document, quiet)
            for path in () if as_json else written:
                click.echo(str(path))
    sys.exit(status)


def _options(arguments: dict[str, Any], shared: str) -> ConvertOptions:
    """Return the library's options; what tiles have in common is to be in a file."""
    if arguments["neighbours"]:
        raise OptionError("--mosaic finds the neighbours among its tiles: leave out --neighbours")
    if arguments["like"]:
        raise OptionError("--mosaic has a grid of its own: leave out --like")
    if not arguments.get("dem", True):
        raise OptionError("--mosaic is of elevation models: leave out --no-dem")
    asked = {key: value for key, value in arguments.items() if key not in RUN_ONLY}
    return convert_options({**asked, "neighbours": (shared,), "params_from": shared})


def _folder(outdir: str | None, paths: list[Path]) -> Path:
    if outdir is not None:
        if not outdir:
            raise OptionError("--outdir is an empty name; is a shell variable unset?")
        refuse_url(outdir, "--mosaic")
        return Path(outdir)
    folders = {path.parent for path in paths}
    if len(folders) > 1:
        raise OptionError("--mosaic names models in one folder: give --outdir")
    folder = folders.pop()
    refuse_url(str(folder), "--mosaic")
    return folder


def _say(document: dict[str, Any], quiet: bool) -> None:
    if quiet:
        return
    n_cells = document["width"] * document["height"]
    parts = [
        f"{document[key] / n_cells:.1%} {key.removeprefix('cells_')}"
        for key in ("cells_measured", "cells_filled", "cells_void")
        if document[key] is not None
    ]
    click.echo(
        f"mosaic of {document['tiles']} models: {document['width']} x {document['height']} cells "
        f"of {document['cell']:g}, {', '.join(parts)}",
        err=True,
    )
