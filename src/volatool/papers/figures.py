"""What the papers' figures share: whether they can be drawn, pages, PNG files."""

from __future__ import annotations

import importlib.util
import io
from pathlib import Path
from typing import Any

MISSING = (
    "figures need the PyPI package matplotlib, which is not installed: "
    'pip install "volatool[figures]"'
)


def is_available() -> bool:
    """Return whether matplotlib is installed."""
    return importlib.util.find_spec("matplotlib") is not None


def save(figure: Any, path: Path, colours: int | None = None) -> None:
    """
    Write a figure as PNG.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        The figure.
    path : pathlib.Path
        Where to.
    colours : int, optional
        Use so many colours at most, which makes pictures of scenes a third as large.
    """
    # no version and no date in the file: the same numbers give the same bytes
    if colours is None:
        figure.savefig(path, format="png", metadata={"Software": None})
        return
    from PIL import Image

    stream = io.BytesIO()
    figure.savefig(stream, format="png", metadata={"Software": None})
    with Image.open(stream) as picture:
        few = picture.convert("RGB").quantize(colours, dither=Image.Dither.NONE)
    few.save(path, "PNG", optimize=True)


def new_figure(width: float, height: float) -> Any:
    """Return a figure of so many inches, without a window."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), dpi=130, layout="constrained")
