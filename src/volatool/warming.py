"""Compiling kernels ahead of time, by real work on made-up tiles: their types are the real ones."""

from __future__ import annotations

import contextlib
import json
import struct
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from volatool.errors import VolatoolError
from volatool.options import ConvertOptions
from volatool.tile import convert_tile
from volatool.units import Length

_CORNER = (523000.0, 5398000.0)
"""Where the made-up tiles lie: places of EPSG:25832, so that they can be reprojected."""

_SIDE = 60.0

_OPTIONS = ConvertOptions(
    # small chunks: runs are merged, which tiles of this size would not need
    chunk_points=500,
    crs="EPSG:25832+7837",
    resources=False,
)


@dataclass(frozen=True, slots=True)
class Warmed:
    """
    What warming up did for one part.

    Parameters
    ----------
    part : str
        Its name.
    n_compiled : int
        Kernels that the cache did not have; 0 also without a cache.
    seconds : float
        Wall time.
    """

    part: str
    n_compiled: int
    seconds: float


def warm_kernels(parts: Sequence[str] = ("convert",)) -> list[Warmed]:
    """
    Compile kernels into the cache, where they are not there yet.

    Parameters
    ----------
    parts : sequence of str
        Names of `PARTS`. ``"convert"``, what conversions with the usual options need, is for the
        parent of a pool, before its workers start.

    Returns
    -------
    warmed : list of Warmed
        One per part.
    """
    done = []
    for part in parts:
        before, started = _n_cached(), time.perf_counter()
        with tempfile.TemporaryDirectory(prefix="volatool-") as folder:
            PARTS[part](Path(folder))
        done.append(Warmed(part, _n_cached() - before, time.perf_counter() - started))
    return done


def _n_cached() -> int:
    from volatool.kernels import _jit

    folder = _jit.writable_cache_dir()
    return 0 if folder is None else sum(1 for _ in folder.rglob("*.nbc"))


def _convert(folder: Path) -> None:
    path = _tile(folder / "tile.las")
    base = replace(_OPTIONS, dense="always", layers=("count", "flag", "distance"), preview=True)
    for options in (base, replace(_OPTIONS, crs=None)):
        convert_tile(path, options, outdir=folder, overwrite=True)
    _tile(path, code=1, n_low=3)  # no ground class: the ground filter, and its low guard
    convert_tile(path, base, outdir=folder, overwrite=True)
    _tile(path, with_colour=False)
    convert_tile(path, base, kind="stats")


def _surfaces(folder: Path) -> None:
    """Rarer options of conversions, and elevation models of volumes."""
    path = _tile(folder / "tile.las")
    metre = Length.parse("1m")
    beyond = _tile(folder / "beyond.las", east=_SIDE)
    variants = [
        replace(_OPTIONS, preset="paper"),
        replace(_OPTIONS, ell=Length.parse("5m"), robust_z=True, dem=True),
        replace(_OPTIONS, to_crs="EPSG:25833"),
        replace(_OPTIONS, split=Length.parse("20m"), dem=False),
        replace(_OPTIONS, compat="toolkit", depth=3, dem=False),
        replace(_OPTIONS, neighbours=(str(beyond),), cell=metre),
        *(replace(_OPTIONS, surface=name, cell=metre) for name in ("dsm", "mean", "min", "tin")),
        replace(_OPTIONS, surface="idw", cell=metre),
        replace(_OPTIONS, budget=4000, dem=False),
        replace(_OPTIONS, layers=("sigma",), holdout=10.0),
        replace(_OPTIONS, robust=True),
    ]
    for options in variants:
        convert_tile(path, options, outdir=folder, overwrite=True)
    from volatool.classification import classify_tile

    classify_tile(path, _OPTIONS, outdir=folder, overwrite=True)
    for layers in ((), ("sigma",)):
        options = ConvertOptions(layers=layers, resources=False)
        convert_tile(folder / "tile.vol.gz", options, kind="dem", outdir=folder, overwrite=True)


def _barriers(folder: Path) -> None:
    path = _tile(folder / "tile.las")
    x, y = _CORNER
    line = {"type": "LineString", "coordinates": [[x + 10, y + 5], [x + 30, y + 50]]}
    ring = [[x + 35, y + 20], [x + 50, y + 22], [x + 48, y + 40], [x + 35, y + 20]]
    options = replace(
        _OPTIONS,
        breaklines=_geojson(folder / "lines.geojson", line),
        water=_geojson(folder / "water.geojson", {"type": "Polygon", "coordinates": [ring]}),
    )
    convert_tile(path, options, outdir=folder, overwrite=True)
    options = replace(options, layers=("sigma",), holdout=10.0, robust=True)
    convert_tile(path, options, outdir=folder, overwrite=True)


def _volumes(folder: Path) -> None:
    """Questions about volumes, changes and unions."""
    import volatool as vt

    paths = []
    for name, seed in (("a", 0), ("b", 1)):
        path = _tile(folder / f"{name}.las", seed=seed)
        options = replace(_OPTIONS, dem=False, depth=3, snap=True)
        report = convert_tile(path, options, outdir=folder, overwrite=True)
        paths.append(next(path for path in report.paths if path.name.endswith(".vol.gz")))
    a, b = map(vt.open, paths)
    low, high = np.array([[*_CORNER, 0.0]]), np.array([[*_CORNER, 40.0]]) + _SIDE / 2
    a.contains(low)
    a.ray(low, [[1.0, 0.5, 0.2]])
    for ignore_ends in (False, True):
        a.sight(low, high, ignore_ends=ignore_ends)
    a.box(low[0], high[0])
    a.columns(low[:, :2])
    a.census(bands=(2.0, 5.0))
    for connectivity in (26, 6):
        a.neighbours(low, connectivity=connectivity)
        a.neighbours(low, connectivity=connectivity, exact=False)
        a.neighbour_error(connectivity)
        a.components(connectivity)
    a.neighbours(low, radius=2.0)
    for to in ("box", "centre"):
        a.clearance(low, to=to)
    x, y = _CORNER
    for clearance in (0.0, 1.0):
        a.path((x + 20, y + 20, 50.0), (x + 40, y + 40, 50.0), clearance)
    for result in (a | b, a & b, a ^ b, a - b, a.downsample(), a.regrid(b.cube, 2)):
        len(result)
    bounds = (x, y, x + _SIDE / 2, y + _SIDE / 2)
    len(a.crop(bounds))
    a.window(bounds).to_numpy()
    vt.diff(a, b)
    vt.merge(paths, folder / "merged.vol.gz")


def _formats(folder: Path) -> None:
    """Write and read the other formats."""
    import volatool as vt
    from volatool.export.registry import FORMATS

    path = _tile(folder / "tile.las")
    convert_tile(path, replace(_OPTIONS, dem=False, depth=3), outdir=folder, overwrite=True)
    volume = vt.open(folder / "tile.vol.gz")
    out = folder / "out"
    out.mkdir()
    for name in FORMATS:
        _if_there(partial(vt.export_volume, volume, out / "a", name, overwrite=True))
    for made in sorted(out.iterdir()):
        _if_there(partial(vt.import_points, made, outdir=folder / "in", dem=False))


def _live(folder: Path) -> None:
    from volatool.emap.live import EMap

    xyz = np.random.default_rng(0).uniform(0, 4, (200, 3))
    for live in (EMap((0, 0, 4, 4)), EMap(cell=0.5, forget=0.9, max_weight=5.0)):
        for _ in range(2):
            live.update(xyz, origin=(2.0, 2.0, 2.0))
        live.heights_at(live.z[:1, :2] if live.z.ndim == 1 else xyz)
        _ = live.sigma


PARTS: dict[str, Callable[[Path], None]] = {
    "convert": _convert,
    "surfaces": _surfaces,
    "barriers": _barriers,
    "volumes": _volumes,
    "formats": _formats,
    "live": _live,
}
"""What can be warmed up, by name."""


def _if_there(work: Callable[[], object]) -> None:
    """Do something for which an extra may be missing, or which small tiles have nothing for."""
    with contextlib.suppress(VolatoolError):
        work()


def _geojson(path: Path, geometry: Mapping[str, object]) -> str:
    feature = {"type": "Feature", "properties": {}, "geometry": geometry}
    crs = {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::25832"}}
    document = {"type": "FeatureCollection", "crs": crs, "features": [feature]}
    path.write_text(json.dumps(document), encoding="utf-8")
    return str(path)


def _tile(
    path: Path,
    *,
    code: int = 2,
    with_colour: bool = True,
    east: float = 0.0,
    seed: int = 0,
    n_points: int = 3000,
    n_low: int = 0,
) -> Path:
    """Write a LAS 1.2 file, point format 3 or 1, of a rough ground of one class; some far below."""
    fields = [("x", "<i4"), ("y", "<i4"), ("z", "<i4"), ("intensity", "<u2"), ("returns", "u1"),
              ("class", "u1"), ("angle", "i1"), ("user", "u1"), ("source", "<u2"),
              ("time", "<f8")]  # fmt: skip
    if with_colour:
        fields.append(("rgb", "<u2", 3))  # type: ignore[arg-type]
    points = np.zeros(n_points, np.dtype(fields))
    rng = np.random.default_rng(seed)
    points["x"] = rng.integers(0, round(_SIDE * 100), n_points)
    points["y"] = rng.integers(0, round(_SIDE * 100), n_points)
    points["z"] = points["x"] // 20 + rng.integers(0, 30, n_points)
    points["z"][:n_low] -= 2000
    points["returns"] = 0b001001
    points["class"] = code
    if with_colour:
        points["rgb"] = rng.integers(0, 65536, (n_points, 3))
    offset = (_CORNER[0] + east, _CORNER[1], 0.0)
    low = [float(points[axis].min()) / 100 + offset[k] for k, axis in enumerate("xyz")]
    high = [float(points[axis].max()) / 100 + offset[k] for k, axis in enumerate("xyz")]
    box = [bound for pair in zip(high, low, strict=True) for bound in pair]
    size, point_format = points.dtype.itemsize, 3 if with_colour else 1
    path.write_bytes(
        b"LASF"
        + struct.pack("<HHIHH8s", 0, 0, 0, 0, 0, b"")
        + struct.pack("<BB32s32sHH", 1, 2, b"volatool", b"volatool", 1, 2026)
        + struct.pack("<HIIBHI5I", 227, 227, 0, point_format, size, n_points, n_points, 0, 0, 0, 0)
        + struct.pack("<12d", 0.01, 0.01, 0.01, *offset, *box)
        + points.tobytes()
    )
    return path
