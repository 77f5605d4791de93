"""The parts of a conversion timed in one process, turn by turn, beside plain decoding.

    python benchmarks/stages.py tile.laz --warm small.laz --runs 3 decode read occupancy
    python benchmarks/stages.py --decode tile.laz          # the decoder as a whole process

Each line printed is JSON: stage, wall and CPU seconds, peak MiB, and how many units were done. Peak
memory is that of this process while the stage runs, with what stages before it hold: the points for
``builder``, ``gather`` and what follows.
"""

from __future__ import annotations

import argparse
import io
import json
import math
import sys
import tempfile
import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from costs import Cost, forget_peak, resident

CHUNK = 500_000
CELL_M = 1.0
WARM_SHARE = 1 / 400
SPACING = 2.0
"""Mean spacing of the solver's points, in cells."""


def decode(path: Path) -> int:
    """Decode the coordinates of a file and nothing else; the floor of all that reads it."""
    import laspy

    selection = laspy.DecompressionSelection.XY_RETURNS_CHANNEL | laspy.DecompressionSelection.Z
    total = 0
    with laspy.open(
        path, laz_backend=laspy.LazBackend.LazrsParallel, decompression_selection=selection
    ) as reader:
        for points in reader.chunk_iterator(CHUNK):
            total += len(points.X) + 0 * int(points.Y[0]) * int(points.Z[0])
    return total


class Stages:
    """
    What the stages of one turn share; each returns how many units it did.

    Parameters
    ----------
    tile : pathlib.Path
        LAS or LAZ.
    folder : pathlib.Path
        For outputs.
    solve_share : float
        Part of the solver's cells, for a quick look.
    """

    def __init__(self, tile: Path, folder: Path, solve_share: float = 1.0) -> None:
        from volatool.points.reader import open_points
        from volatool.scratch import Scratch

        self.tile, self.folder, self.solve_share = tile, folder, solve_share
        self.scratch = Scratch()
        with open_points(tile) as source:
            self.crs, self.header = source.crs, source.header
        self.chunks: list[Any] = []
        self.body = b""
        self.gatherer: Any = None
        self.points: Any = None
        self.dem: Any = None

    # the file's way

    def decode(self) -> int:
        return decode(self.tile)

    def read(self) -> int:
        """Coordinates through our reader."""
        return self._read(())

    def read_all(self) -> int:
        """With all attributes that metadata need."""
        from volatool.channels import CHANNELS
        from volatool.vola.metadata import attributes_for

        return self._read(attributes_for(CHANNELS))

    def _read(self, attributes: Iterable[str]) -> int:
        from volatool.points.reader import open_points

        with open_points(self.tile) as source:
            return sum(len(chunk) for chunk in source.chunks(attributes))

    def occupancy(self) -> int:
        return self._convert(meta=())

    def metadata(self) -> int:
        return self._convert()

    def _convert(self, **options: Any) -> int:
        import volatool as vt

        report = vt.convert(
            self.tile, self.folder, overwrite=True, dem=False, dense="never", gzip=False, **options
        )
        assert report.input is not None
        return int(report.input["points_read"])

    # its parts, from what was read before

    def hold_points(self) -> None:
        """Read all points, for the stages that begin with points in memory."""
        from volatool.points.reader import open_points

        def copied(chunk: Any) -> Any:
            held = {name: values.copy() for name, values in chunk.attributes.items()}
            x, y, z = chunk.x.copy(), chunk.y.copy(), chunk.z.copy()
            return replace(chunk, x=x, y=y, z=z, attributes=held)

        if not self.chunks:
            with open_points(self.tile) as source:
                self.chunks = [copied(chunk) for chunk in source.chunks(["classification"])]

    def builder(self) -> int:
        """Path keys, sort, fold and levels, without metadata."""
        import volatool as vt
        from volatool.census import box_corners, header_box
        from volatool.cube import Cube

        header = self.header
        box = header_box(header.box, header.scale, header.offset)
        assert box is not None
        cube = Cube.around(box_corners(box, header.scale, header.offset, self.crs.z_ratio), None)
        n_points = sum(map(len, self.chunks))
        builder = vt.VolaBuilder(cube, n_points_hint=n_points, z_ratio=self.crs.z_ratio)
        with builder:
            for chunk in self.chunks:
                builder.add(chunk)
            builder.build()
        return n_points

    def hold_body(self) -> None:
        """Make the bytes that are compressed: the sparse volume with metadata."""
        if not self.body:
            self.metadata()
            (path,) = self.folder.glob("*.vol")
            self.body = path.read_bytes()

    def gzip(self) -> int:
        from volatool.formats import gz

        out = io.BytesIO()
        with gz.writer(out) as stream:
            stream.write(self.body)
        return len(self.body)

    def gather(self) -> int:
        """Points of the elevation model from the stream."""
        from volatool.dem.gather import SurfaceGatherer

        self.gatherer = SurfaceGatherer("auto", self.scratch, {"classification"})
        for chunk in self.chunks:
            self.gatherer.add(chunk)
        return sum(map(len, self.chunks))

    def ground(self) -> int:
        """Run the ground filter; next to nothing on a tile that has the ground class."""
        self.points = self.gatherer.result(self.crs)
        return sum(map(len, self.chunks))

    def surface(self) -> int:
        """Evidence of the points and the solve, all nets."""
        from volatool.dem.surfaces import make_dem

        cell = CELL_M / float(self.crs.metres_per_unit_xy or 1)
        self.dem = make_dem(self.points, self.crs, cell, scratch=self.scratch)
        return int(self.dem.z.size)

    def dem_write(self) -> int:
        """Cloud-optimised GeoTIFF, read back."""
        from volatool.dem import geotiff

        geotiff.write_dem(self.folder / "surface.tif", self.dem)
        return int(self.dem.z.size)

    # the solver alone

    def hold_evidence(self, n_cells: int) -> Any:
        """Return the evidence of points at random on hills, a square of cells, and its springs."""
        from volatool.emap.system import Evidence, Springs

        side = math.isqrt(round(n_cells * self.solve_share))
        evidence = Evidence(side, side)
        springs = Springs.emap(1.0, SPACING)
        rng = np.random.default_rng(side)
        for _ in range(math.ceil(side**2 / SPACING**2 / CHUNK)):
            n_points = min(CHUNK, math.ceil(side**2 / SPACING**2))
            col, row = rng.random((2, n_points)) * side
            z = 20 * np.sin(col / 97) * np.cos(row / 61) + 3 * np.sin(col / 7)
            evidence.add(col, row, z + rng.normal(0, 0.05, len(z)), springs)
        return evidence, springs

    def solve(self, held: Any) -> int:
        """One net of bending and stretching springs, to 0.1 mm."""
        from volatool.emap.solve import solve

        evidence, springs = held
        _, info = solve(evidence, springs, tol=1e-4)
        assert info.converged
        return int(evidence.right.size)

    def close(self) -> None:
        """Drop what is held."""
        if self.points is not None:
            self.points.close()
        if self.gatherer is not None:
            self.gatherer.close()


Prepare = Callable[[Stages], Any]
Run = Callable[[Stages, Any], int]

NEEDS: dict[str, tuple[str, ...]] = {
    "ground": ("gather",),
    "surface": ("gather", "ground"),
    "dem-write": ("gather", "ground", "surface"),
}
"""Stages whose results another begins with."""

STAGES: dict[str, tuple[Prepare, Run]] = {
    "decode": (lambda s: None, lambda s, _: s.decode()),
    "read": (lambda s: None, lambda s, _: s.read()),
    "read-all": (lambda s: None, lambda s, _: s.read_all()),
    "occupancy": (lambda s: None, lambda s, _: s.occupancy()),
    "metadata": (lambda s: None, lambda s, _: s.metadata()),
    "gzip": (Stages.hold_body, lambda s, _: s.gzip()),
    "builder": (Stages.hold_points, lambda s, _: s.builder()),
    "gather": (Stages.hold_points, lambda s, _: s.gather()),
    "ground": (lambda s: None, lambda s, _: s.ground()),
    "surface": (lambda s: None, lambda s, _: s.surface()),
    "dem-write": (lambda s: None, lambda s, _: s.dem_write()),
    "solve-250k": (lambda s: s.hold_evidence(250_000), lambda s, held: s.solve(held)),
    "solve-4M": (lambda s: s.hold_evidence(4_000_000), lambda s, held: s.solve(held)),
    "solve-16M": (lambda s: s.hold_evidence(16_000_000), lambda s, held: s.solve(held)),
}


def with_needs(names: list[str]) -> list[str]:
    """
    Return the stages to run for those asked for, in the order of `STAGES`.

    Examples
    --------
    >>> with_needs(["decode", "surface"])
    ['decode', 'gather', 'ground', 'surface']
    """
    wanted = {need for name in names for need in (*NEEDS.get(name, ()), name)}
    return [name for name in STAGES if name in wanted]


def timed(stages: Stages, name: str) -> tuple[Cost, int]:
    """Run one stage; return its cost and the units it did."""
    prepare, run = STAGES[name]
    held = prepare(stages)
    forget_peak()
    cpu, wall = time.process_time(), time.perf_counter()
    units = run(stages, held)
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    return Cost(wall, cpu, resident("self")[1] / 2**20), units


def turns(
    tile: Path, names: list[str], n_turns: int, solve_share: float, told: bool = True
) -> None:
    """Run the stages in turn so often, and print what each took."""
    for _ in range(n_turns):
        with tempfile.TemporaryDirectory() as folder:
            stages = Stages(tile, Path(folder), solve_share)
            for name in with_needs(names):
                cost, units = timed(stages, name)
                if told and name in names:
                    print(json.dumps({"name": name, "units": units, **cost.to_dict()}), flush=True)
            stages.close()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("tile", type=Path)
    parser.add_argument("stages", nargs="*", choices=[[], *STAGES])
    parser.add_argument("--decode", action="store_true", help="decode and do nothing else")
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--warm", type=Path, help="a small tile to load the kernels with")
    parser.add_argument("--solve-share", type=float, default=1.0, help="of the solver's cells")
    options = parser.parse_args()
    if options.decode:
        decode(options.tile)
        return
    names = options.stages or list(STAGES)
    others = [name for name in names if name != "decode"]
    turns(options.warm or options.tile, others, 1, WARM_SHARE, told=False)
    decode(options.tile)  # into the system's file cache
    turns(options.tile, names, options.runs, options.solve_share)


if __name__ == "__main__":
    sys.exit(main())
