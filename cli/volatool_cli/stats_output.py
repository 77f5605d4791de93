"""What ``stats`` prints: every report, or their sum, of which no report is kept."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import click

from volatool.encodings import output_stream
from volatool.errors import VolatoolError
from volatool.outputs import OutputSet
from volatool.report import Report
from volatool.summary import Summary, is_report, read_reports


class StatsOutput:
    """
    Takes reports as they come and prints at the end.

    Parameters
    ----------
    form : str
        Of `volatool.tables.FORMATS`.
    is_summary : bool
        Print the sum of the reports; failed ones are left out.
    target : pathlib.Path, optional
        File for the sum instead, replaced when it exists.
    """

    def __init__(self, form: str, is_summary: bool, target: Path | None = None) -> None:
        self.form = form
        self.target = target
        self.summary = Summary() if is_summary else None
        self._kept: dict[int, Report] = {}

    def add(self, report: Report, place: int) -> None:
        """Take a report, one of a failed input too; `place` is its number, in whatever order."""
        if self.summary is None or not report.levels:
            self._kept[place] = report
        if self.summary is not None and report.error is None:
            self.summary.add(report, place)

    def print(self) -> list[Report]:
        """Print what was taken; return the reports that it tells of, without failed inputs."""
        from volatool.tables import render

        if self.summary is not None and self.summary.n_volumes:
            total = self.summary.report()
            text = render([total], self.form)
            if self.target is None:
                click.echo(text)
            else:
                _write(self.target, text)
            return [total]
        if self.target is not None:
            return []
        reports = [self._kept[place] for place in sorted(self._kept)]
        good = [report for report in reports if report.error is None]
        if self.form in ("json", "jsonl"):
            click.echo(render(reports, self.form))
        elif good:
            click.echo(render(good, self.form))
        return good


def _write(path: Path, text: str) -> None:
    with OutputSet(overwrite=True) as outputs:
        with output_stream(outputs.add(path)) as stream:
            stream.write((text + "\n").encode())
        outputs.commit()


def split_reports(paths: Sequence[Path]) -> tuple[list[Path], list[Path]]:
    """Return files of reports, and all others."""
    reports = [path for path in paths if is_report(path)]
    return reports, [path for path in paths if not is_report(path)]


def reports_in(paths: Sequence[Path]) -> Iterator[Report]:
    """Yield the reports in files of them; a failed one for a file that is none."""
    for path in paths:
        try:
            yield from read_reports(path)
        except VolatoolError as error:
            yield Report(
                status="failed",
                input={"name": path.name},
                error={"code": error.code, "message": str(error)},
            )
