"""What this installation has; compiling its kernels ahead of time is `volatool.warming`."""

from __future__ import annotations

import sys
import tempfile
from importlib import metadata
from typing import Any

from volatool import resources
from volatool._version import __version__
from volatool.units import format_size
from volatool.warming import warm_kernels

__all__ = ["diagnose", "warm_kernels"]

_PACKAGES = ("numpy", "numba", "laspy", "lazrs", "pyproj", "rasterio", "pillow", "click", "tqdm")


def diagnose() -> dict[str, Any]:
    """
    Return what a bug report should say, in the order to print it.

    Returns
    -------
    facts : dict of str to str or int
        Versions, LAZ backend, CRS database, kernel cache, cores, memory, temporary folder.
    """
    from volatool.kernels import _jit
    from volatool.points.crs import database_version
    from volatool.points.reader import laz_backend_name

    facts: dict[str, Any] = {"volatool": __version__, "python": sys.version.split()[0]}
    for package in _PACKAGES:
        try:
            facts[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            facts[package] = "MISSING"
    facts["laz backend"] = laz_backend_name()
    facts["crs database"] = database_version()
    folder = _jit.writable_cache_dir()
    if folder is None:
        facts["kernel cache"] = "not writable: kernels compile again in each process"
    else:
        facts["kernel cache"] = f"{folder} ({len(list(folder.rglob('*.nbc')))} kernels)"
    facts["cores"] = resources.n_cores()
    facts["memory ceiling"] = (
        f"{format_size(resources.DEFAULT_MEMORY_BYTES)} unless --memory says otherwise; "
        "outputs are built inside it, what is over it goes to the temporary folder"
    )
    facts["temporary folder"] = tempfile.gettempdir()
    return facts
