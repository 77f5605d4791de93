"""What comes of making a paper's experiments again: numbers, a report, files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

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
