"""volatool: LAS/LAZ/COPC tiles to VOLA volumes, EMap elevation models and statistics.

The names of this module are the public ones; the modules below are free to move. They are loaded
when they are first used: ``import volatool`` loads neither numpy nor numba nor rasterio.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from volatool._version import __version__
from volatool.errors import VolatoolError

if TYPE_CHECKING:
    from volatool.api import classify, convert, import_points, stats
    from volatool.cube import Cube
    from volatool.emap.live import EMap
    from volatool.export.api import export_volume
    from volatool.formats.registry import open_volume as open
    from volatool.merging import merge_files as merge
    from volatool.model import Bounds
    from volatool.points.reader import stream
    from volatool.report import Report
    from volatool.vola.builder import VolaBuilder
    from volatool.vola.diff import diff
    from volatool.vola.volume import Volume

_PLACES = {
    "Bounds": ("volatool.model", "Bounds"),
    "Cube": ("volatool.cube", "Cube"),
    "EMap": ("volatool.emap.live", "EMap"),
    "Report": ("volatool.report", "Report"),
    "VolaBuilder": ("volatool.vola.builder", "VolaBuilder"),
    "Volume": ("volatool.vola.volume", "Volume"),
    "classify": ("volatool.api", "classify"),
    "convert": ("volatool.api", "convert"),
    "diff": ("volatool.vola.diff", "diff"),
    "export_volume": ("volatool.export.api", "export_volume"),
    "import_points": ("volatool.api", "import_points"),
    "merge": ("volatool.merging", "merge_files"),
    "open": ("volatool.formats.registry", "open_volume"),
    "stats": ("volatool.api", "stats"),
    "stream": ("volatool.points.reader", "stream"),
}

__all__ = [
    "Bounds",
    "Cube",
    "EMap",
    "Report",
    "VolaBuilder",
    "VolatoolError",
    "Volume",
    "__version__",
    "classify",
    "convert",
    "diff",
    "export_volume",
    "import_points",
    "merge",
    "open",
    "stats",
    "stream",
]


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module 'volatool' has no attribute {name!r}")
    module, attribute = _PLACES[name]
    value = getattr(import_module(module), attribute)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
