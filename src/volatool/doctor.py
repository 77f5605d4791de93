"""What this installation has, and compiling its kernels ahead of time."""

from __future__ import annotations

import struct
import sys
import tempfile
from dataclasses import replace
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from volatool import resources
from volatool._version import __version__
from volatool.units import format_size

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


def warm_kernels() -> None:
    """Compile every kernel into the cache by converting a small made-up tile."""
    from volatool.emap.live import EMap
    from volatool.options import ConvertOptions
    from volatool.tile import convert_tile

    live = EMap((0, 0, 4, 4))
    live.update(np.zeros((1, 3)))
    live.heights_at(live.z[:1, :2])
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "warm.las"
        path.write_bytes(_small_tile())
        # small chunks: runs are merged, which a tile of this size would not need
        base = ConvertOptions(dense="always", layers=("distance",), preview=True, chunk_points=500)
        variants = [
            base,
            replace(base, preset="paper", crs="EPSG:25832+6360"),
            replace(base, surface="mean"),
            replace(base, compat="toolkit", depth=3, dem=False),
        ]
        for options in variants:
            convert_tile(path, options, outdir=Path(folder), overwrite=True)
        path.write_bytes(_small_tile(code=1))  # no ground class: the ground filter
        convert_tile(path, base, outdir=Path(folder), overwrite=True)


def _small_tile(n_points: int = 3000, code: int = 2) -> bytes:
    """Return a LAS 1.2 file, point format 3, of a rough ground of one class."""
    record = np.dtype(
        [("x", "<i4"), ("y", "<i4"), ("z", "<i4"), ("intensity", "<u2"), ("returns", "u1"),
         ("class", "u1"), ("angle", "i1"), ("user", "u1"), ("source", "<u2"), ("time", "<f8"),
         ("rgb", "<u2", 3)]
    )  # fmt: skip
    rng = np.random.default_rng(0)
    points = np.zeros(n_points, record)
    points["x"] = rng.integers(0, 6000, n_points)
    points["y"] = rng.integers(0, 6000, n_points)
    points["z"] = points["x"] // 20 + rng.integers(0, 30, n_points)
    points["returns"] = 0b001001
    points["class"] = code
    points["rgb"] = rng.integers(0, 65536, (n_points, 3))
    low = [float(points[axis].min()) / 100 for axis in "xyz"]
    high = [float(points[axis].max()) / 100 for axis in "xyz"]
    box = [bound for pair in zip(high, low, strict=True) for bound in pair]
    return (
        b"LASF"
        + struct.pack("<HHIHH8s", 0, 0, 0, 0, 0, b"")
        + struct.pack("<BB32s32sHH", 1, 2, b"volatool", b"volatool", 1, 2026)
        + struct.pack("<HIIBHI5I", 227, 227, 0, 3, record.itemsize, n_points, n_points, 0, 0, 0, 0)
        + struct.pack("<12d", 0.01, 0.01, 0.01, 0.0, 0.0, 0.0, *box)
        + points.tobytes()
    )
