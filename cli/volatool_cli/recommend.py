"""``volatool recommend``: tiles, reports or a summary to a voxel and a cell size."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from volatool.errors import FormatError, OptionError, VolatoolError
from volatool.options import ConvertOptions
from volatool.report import Report, dumps
from volatool_cli.exit_codes import ExitCode
from volatool_cli.output import configure_logging
from volatool_cli.run import RUN_ONLY, convert_options, run_tiles, stdin_names


def run_recommend(arguments: dict[str, Any]) -> None:
    """
    Print a recommendation and exit with the status that says how it went.

    Parameters
    ----------
    arguments : dict
        The command's options by parameter name.
    """
    from volatool.batch.plan import expand
    from volatool.recommendation import as_text, recommend

    configure_logging(arguments["quiet"], arguments["verbose"], arguments["log"])
    most, as_json = arguments.pop("sample"), arguments.pop("as_json")
    names, nul = arguments.pop("inputs"), arguments.pop("nul")
    paths = expand(names, stdin_names(nul) if "-" in names else ())
    arguments["no_resources"] = True
    options = convert_options({k: v for k, v in arguments.items() if k not in RUN_ONLY})
    found = _Found(paths, options, most)
    summary, status = _summary(found.looked_at, arguments)
    document = recommend(
        summary,
        parameters=found.parameters(),
        min_occupancy=options.min_occupancy,
        n_tiles=found.n_tiles,
        factor=found.factor,
        metres_per_unit=found.metres_per_unit,
    )
    click.echo(dumps(document, 2) if as_json else as_text(document))
    sys.exit(status)


class _Found:
    """The inputs: which are looked at, and what the headers of all say."""

    def __init__(self, paths: Sequence[Path], options: ConvertOptions, most: int | None) -> None:
        from volatool.catalog.headers import index_headers
        from volatool.recommendation import sample
        from volatool.summary import is_report

        self.looked_at: list[Path] = list(paths)
        self.options = options
        self.n_tiles: int | None = None
        self.factor = 1.0
        self.index = None
        self.metres_per_unit = None
        if any(is_report(path) for path in paths):
            if most is not None:
                raise OptionError("--sample is for tiles: reports are read whole")
            if not all(is_report(path) for path in paths):
                raise OptionError("give tiles or reports, not both")
            return
        self.index = index_headers(paths, options)
        if not len(self.index):
            return
        self.metres_per_unit = self.index.crs_at(0).metres_per_unit_xy
        if most is not None:
            numbers = sample(range(len(self.index)), most)
            self.looked_at = [self.index.paths[number] for number in numbers]
            n_read = sum(self.index.n_points[number] for number in numbers)
            self.n_tiles, self.factor = len(self.index), sum(self.index.n_points) / n_read

    def parameters(self) -> Any:
        """Return cell and spacing as some of the tiles' points tell them; None of reports."""
        from volatool.dem.parameters import measure_parameters

        if self.index is None or not len(self.index):
            return None
        try:
            return measure_parameters(self.index, self.options)
        except VolatoolError as error:  # a tile that can't be read is told already
            click.echo(f"the cell is estimated from the density: {error}", err=True)
            return None


def _summary(paths: Sequence[Path], arguments: dict[str, Any]) -> tuple[Report, int]:
    """Return the sum over files, and the status of reading them; exit if there is none."""
    from volatool.summary import is_report, read_reports

    if len(paths) == 1 and is_report(paths[0]):
        reports = list(read_reports(paths[0]))
        if len(reports) == 1 and reports[0].levels:
            return reports[0], ExitCode.OK
    with tempfile.TemporaryDirectory(prefix="volatool-") as folder:
        target = Path(folder) / "dataset.json"
        asked = {**arguments, "inputs": list(paths), "nul": False, "fail_fast": False}
        status = int(ExitCode.OK)
        try:
            run_tiles({**asked, "form": "json", "summary": True, "summary_to": target}, "stats")
        except SystemExit as end:
            status = int(end.code or 0)
        if not target.exists():
            if status:
                sys.exit(status)
            raise FormatError("none of the inputs has a volume: there is nothing to go by")
        (summary,) = read_reports(target)
        return summary, status
