"""What comes of making a paper's experiments again: numbers, a report, files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from volatool.outputs import OutputSet
from volatool.report import dumps

REPORT, NUMBERS = "report.md", "report.json"


@dataclass(frozen=True, slots=True)
class Reproduction:
    """
    What came of the experiment.

    Parameters
    ----------
    document : dict
        The JSON object.
    markdown : str
        The report.
    paths : tuple of pathlib.Path
        Files written.
    """

    document: dict[str, Any]
    markdown: str
    paths: tuple[Path, ...] = ()


def write_report(outputs: OutputSet, outdir: Path, document: dict[str, Any], markdown: str) -> None:
    """Add `REPORT` and `NUMBERS` to the outputs; raises OSError."""
    outputs.add(outdir / REPORT).write_text(markdown, encoding="utf-8")
    outputs.add(outdir / NUMBERS).write_text(dumps(document, 2) + "\n", encoding="utf-8")
