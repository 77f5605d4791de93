"""What the papers' figures share: whether they can be drawn, pages, PNG files."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

MISSING = (
    "figures need the PyPI package matplotlib, which is not installed: "
    'pip install "volatool[figures]"'
)


def is_available() -> bool:
    """Return whether matplotlib is installed."""
    return importlib.util.find_spec("matplotlib") is not None


def save(figure: Any, path: Path) -> None:
    """Write a figure as PNG."""
    # no version and no date in the file: the same numbers give the same bytes
    figure.savefig(path, format="png", metadata={"Software": None})


def new_figure(width: float, height: float) -> Any:
    """Return a figure of so many inches, without a window."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), dpi=130, layout="constrained")
