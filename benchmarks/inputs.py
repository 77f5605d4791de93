"""Tiles of every size for the benchmarks, made once from real ones and kept in a folder.

    python benchmarks/inputs.py WORK SPARSE.laz DENSE.laz NAME...

==========  =====================================================================================
crop        the points nearest to the lower left corner: a square with exactly so many
tiled       copies side by side, by shifting the stored integers, nearly in a square
in place    copies on top of each other, each point moved by chance by less than a voxel
==========  =====================================================================================

All of it chunk by chunk, so that 100 million points need no more memory than one, and the same
bytes again on any machine. The lines printed are JSON: name, path, points, metres per unit.
"""

from __future__ import annotations

import json
import math
import os
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import laspy
import numpy as np

VERSION = 1
"""In the files' names: a change of a recipe makes new ones."""

CHUNK = 1_000_000


@dataclass(frozen=True, slots=True)
class Recipe:
    """
    How a tile is made.

    Parameters
    ----------
    source : str
        ``"sparse"`` or ``"dense"``, the tile it is made from.
    crop : int or None
        Points to keep.
    places, in_place : int
        Copies side by side, and on top of each other.
    jitter_m : float
        By how much copies in place differ.
    """

    source: str
    crop: int | None = None
    places: int = 1
    in_place: int = 1
    jitter_m: float = 0.0


RECIPES = {
    "tile": Recipe("sparse"),
    "1k": Recipe("sparse", crop=1000),
    "100k": Recipe("sparse", crop=100_000),
    "1M": Recipe("sparse", crop=1_000_000),
    "4M": Recipe("sparse", crop=4_000_000),
    "20M": Recipe("sparse", places=2),
    "100M": Recipe("sparse", places=10),
    "20M-dense": Recipe("dense", places=4, in_place=8, jitter_m=0.03),
}
"""With the Autzen tile (10.65 M points) and the Delft tile (0.64 M) of the shared ones."""

QUICK = {
    **RECIPES,
    "1k": Recipe("sparse", crop=100),
    "100k": Recipe("sparse", crop=500),
    "1M": Recipe("sparse", crop=1000),
    "4M": Recipe("sparse", crop=4000),
    "20M-dense": Recipe("dense", places=2, in_place=2, jitter_m=0.03),
}
"""For a tile of some thousand points."""


def made(recipe: Recipe, source: Path, work: Path) -> Path:
    """
    Return the tile of a recipe, made if it isn't there yet.

    Parameters
    ----------
    recipe : Recipe
        How.
    source : pathlib.Path
        LAS or LAZ.
    work : pathlib.Path
        Folder that keeps it.
    """
    if recipe.crop is None and recipe.places * recipe.in_place == 1:
        return source
    what = f"crop{recipe.crop}" if recipe.crop else f"{recipe.places}x{recipe.in_place}"
    path = work / f"{source.stem}-{source.stat().st_size}-{what}-v{VERSION}.laz"
    if path.exists():
        return path
    work.mkdir(parents=True, exist_ok=True)
    part = work / f".{path.stem}-{os.getpid()}.laz"
    try:
        with laspy.open(source) as reader:
            header = new_header(reader.header)
        with laspy.open(
            part, "w", header=header, laz_backend=laspy.LazBackend.LazrsParallel
        ) as writer:
            pieces = cropped(source, recipe.crop) if recipe.crop else tiled(source, recipe)
            for points in pieces:
                writer.write_points(points)
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
    return path


def new_header(header: Any) -> Any:
    """Return the header of a copy: same format, scale and CRS, no index of the old points."""
    fresh = laspy.LasHeader(point_format=header.point_format, version=header.version)
    fresh.scales, fresh.offsets = header.scales, header.offsets
    fresh.global_encoding = header.global_encoding
    fresh.vlrs = [vlr for vlr in header.vlrs if vlr.user_id == "LASF_Projection"]
    return fresh


def chunks(source: Path) -> Iterator[Any]:
    """Yield the points of a file in order."""
    with laspy.open(source, laz_backend=laspy.LazBackend.LazrsParallel) as reader:
        yield from reader.chunk_iterator(CHUNK)


def cropped(source: Path, n_points: int) -> Iterator[Any]:
    """Yield the points nearest to the lower left corner, by the larger of both distances."""
    corner = np.array([[p.X.min(), p.Y.min()] for p in chunks(source)]).min(axis=0)

    def reach(points: Any) -> np.ndarray:
        x, y = np.asarray(points.X, np.int64), np.asarray(points.Y, np.int64)
        return np.maximum(x - corner[0], y - corner[1])

    far = np.concatenate([reach(points) for points in chunks(source)])
    if n_points > len(far):
        sys.exit(f"{source}: {len(far)} points, {n_points} are wanted")
    limit = np.partition(far, n_points - 1)[n_points - 1]
    n_ties = n_points - int(np.count_nonzero(far < limit))
    for points in chunks(source):
        distance = reach(points)
        ties = np.flatnonzero(distance == limit)[:n_ties]
        n_ties -= len(ties)
        keep = distance < limit
        keep[ties] = True
        if keep.any():
            yield points[keep]


def tiled(source: Path, recipe: Recipe) -> Iterator[Any]:
    """Yield the points of all copies, copy after copy."""
    with laspy.open(source) as reader:
        header = reader.header
        scales, extent = header.scales, header.maxs - header.mins
    step = [int(length / scale) + 1 for length, scale in zip(extent, scales, strict=True)]
    jitter = [int(recipe.jitter_m / scale) for scale in scales]
    columns = math.ceil(math.sqrt(recipe.places))
    for copy in range(recipe.places * recipe.in_place):
        place, layer = divmod(copy, recipe.in_place)
        row, column = divmod(place, columns)
        rng = np.random.default_rng(copy)
        for points in chunks(source):
            for axis, shift in zip("XYZ", (column * step[0], row * step[1], 0), strict=True):
                stored = np.asarray(points[axis], np.int64) + shift
                if layer:
                    most = jitter["XYZ".index(axis)]
                    stored += rng.integers(-most, most + 1, len(stored))
                points[axis] = stored.astype(np.int32)
            yield points


def metres_per_unit(header: Any) -> float:
    """Return the horizontal unit of a tile; metres where the CRS doesn't tell."""
    crs = header.parse_crs()
    return 1.0 if crs is None else float(crs.axis_info[0].unit_conversion_factor)


def save_metres(tile: Path, out: Path) -> None:
    """Write a tile's coordinates in metres from its corner, for libraries that take arrays."""
    las = laspy.read(tile)
    np.save(out, (np.asarray(las.xyz) - las.header.mins) * metres_per_unit(las.header))


def main() -> None:
    if sys.argv[1] == "--npy":
        save_metres(Path(sys.argv[2]), Path(sys.argv[3]))
        return
    work, sparse, dense = (Path(name) for name in sys.argv[1:4])
    recipes = QUICK if "--quick" in sys.argv else RECIPES
    for name in (word for word in sys.argv[4:] if word != "--quick"):
        recipe = recipes[name]
        path = made(recipe, sparse if recipe.source == "sparse" else dense, work)
        with laspy.open(path) as reader:
            n_points, unit = reader.header.point_count, metres_per_unit(reader.header)
        told = {"name": name, "path": str(path), "points": n_points, "unit_m": unit}
        print(json.dumps(told), flush=True)


if __name__ == "__main__":
    main()
