"""Accuracy of the DEM at held-out ground points of real tiles, beside a linear TIN.

    python benchmarks/dem_loo.py --shared /path/to/shared
    python benchmarks/dem_loo.py --tiles topo,ahn1 --seeds 3 --rule 0.05,5 --cell auto
    python benchmarks/dem_loo.py --rule 2,20+0.01,1,1.2

One tenth of each tile's ground points is held out, at random or in square gaps of 5, 10 and 20 m;
the DEM is made of the others by the product's own `make_dem`, written nowhere, and read bilinearly
at the held-out points. The table has RMSE over that of a TIN of the same points (nearest point
outside the hull), squares pooled over the seeds. The DEM leaves cells outside the hull of its
points void: those points count for neither, and the table says how many they are.

``--rule product`` is the rule of the product. ``--rule RHO,ELL`` is one net for all tiles, in
squares and multiples of the spacing; ``RHO,ELL+RHO,ELL,TETHER`` two nets. As the product's rule was
chosen on these tiles, ``--rule loo`` judges what such a choice is worth on another tile: each gets,
of the list of nets, those that are best in the mean of all others.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
import tempfile
import time
from collections.abc import Iterable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import ground_tiles
import numpy as np
from ground_tiles import F64, KINDS, Ground

from volatool.dem.gather import ROW, SurfaceGatherer, SurfacePoints
from volatool.dem.surfaces import Dem, make_dem
from volatool.emap import tuning
from volatool.kernels import spring
from volatool.model import CrsInfo, PointChunk
from volatool.scratch import Scratch, Spool

FIRST_SEED = 10
MAX_GAP_M = 1000.0
"""Gaps of the test are filled whatever their size: what is void is outside the hull."""

CANDIDATES = (
    "0.02,3",
    "0.05,5",
    "0.1,10",
    "5,20+0.01,1,1.2",
    "2,20+0.01,1,1.2",
    "3,40+0.02,1,1.2",
    "2,20+0.02,1.5,1.1",
    "5,20+0.05,2,2",
    "25,20+0.5,3,4+0.02,1,1",
)
"""The rules that ``--rule loo`` chooses from."""

LAYERS = tuning.LAYERS


def surface_points(ground: Ground) -> SurfacePoints:
    """Return a tile's ground as the product's gatherer hands it on."""
    gatherer = SurfaceGatherer("dtm", Scratch(), {"classification"})
    stored = (np.ascontiguousarray(ground.rows[:, k]) for k in range(3))
    classes = {"classification": np.full(len(ground.rows), 2, np.uint8)}
    gatherer.add(PointChunk(0, *stored, ground.scale, ground.offset, classes))
    return gatherer.result()


def train(points: SurfacePoints, rows: Any) -> SurfacePoints:
    """Return the points without those held out; the DEM still covers all of them."""
    spool = Spool(Scratch(), ROW)
    spool.append(np.ascontiguousarray(rows))
    return replace(points, spool=spool)


def nets(rule: str) -> tuple[tuple[float, float, float], ...]:
    """Return what a rule says of each net: stiffness, length, tether (0: none)."""
    layers = []
    for net in rule.split("+"):
        rho, ell, tether = map(float, (net + ",0").split(",")[:3])
        layers.append((rho, ell, tether))
    return tuple(layers)


def dem_errors(
    ground: Ground, points: SurfacePoints, out: Any, cell: str, rule: str
) -> tuple[F64, Dem]:
    """Return DEM minus held-out point in metres, NaN where the DEM is void, and the DEM."""
    unit = ground.unit
    crs = CrsInfo(metres_per_unit_xy=unit, metres_per_unit_z=unit)
    used = train(points, ground.rows[~out])
    tuning.LAYERS = LAYERS if rule == "product" else nets(rule)
    edge: Any = "auto" if cell == "auto" else Fraction(cell) / unit
    dem = make_dem(used, crs, edge, max_gap=MAX_GAP_M / float(unit))
    col, row = dem.grid.places(ground.rows[out], points.scale, points.offset)
    found = np.empty(len(col))
    heights = dem.z.astype(np.float64)
    spring.interpolate(heights, col, row, False, 0, dem.grid.height, found)
    return found * float(unit) - ground.xyz[out, 2], dem


def tin_errors(tile: str, ground: Ground, out: Any, kind: str, seed: int, cache: Path) -> F64:
    """Return TIN minus held-out point in metres, kept in a file for the next run."""
    path = cache / f"{tile}-{len(ground.rows)}-{kind.replace(' ', '')}-{seed}.npy"
    if path.exists():
        return np.asarray(np.load(path))
    errors = ground_tiles.tin(ground.xyz[~out], ground.xyz[out, :2]) - ground.xyz[out, 2]
    cache.mkdir(parents=True, exist_ok=True)
    np.save(path, errors)
    return errors


def judge(
    tile: ground_tiles.Tile, seeds: int, cell: str, rules: Iterable[str], cache: Path
) -> list[dict[str, Any]]:
    """Return a record for each kind of hold-out and rule of a tile."""
    ground = ground_tiles.load(tile)
    points = surface_points(ground)
    records = []
    for kind in KINDS:
        sums = {rule: np.zeros(4) for rule in rules}  # squares of DEM and TIN, points, void
        chosen: dict[str, Any] = {}
        spent = dict.fromkeys(sums, 0.0)
        for seed in range(FIRST_SEED, FIRST_SEED + seeds):
            out = ground_tiles.holdout_mask(ground.xyz[:, :2], kind, seed)
            theirs = tin_errors(tile.name, ground, out, kind, seed, cache)
            for rule, total in sums.items():
                start = time.process_time()
                ours, dem = dem_errors(ground, points, out, cell, rule)
                spent[rule] += time.process_time() - start
                known = ~np.isnan(ours)
                total += (
                    np.square(ours[known]).sum(), np.square(theirs[known]).sum(),
                    np.count_nonzero(known), np.count_nonzero(~known),
                )  # fmt: skip
                chosen[rule] = dem.solver | {"cell": dem.grid.cell * float(tile.unit)}
        for rule, (ours2, theirs2, n, void) in sums.items():
            records.append(
                {
                    "tile": tile.name,
                    "kind": kind,
                    "rule": rule,
                    "rmse": math.sqrt(ours2 / n),
                    "tin": math.sqrt(theirs2 / n),
                    "ratio": math.sqrt(ours2 / theirs2),
                    "void": void / (n + void),
                    "cpu_s": spent[rule] / seeds,
                    "solver": chosen[rule],
                }
            )
    return records


def leave_one_out(records: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return each tile's records under the rule with the best mean log ratio of all others."""
    rules = sorted({record["rule"] for record in records})
    result = []
    for tile in dict.fromkeys(record["tile"] for record in records):
        means = {
            rule: np.mean([
                math.log(r["ratio"]) for r in records if r["rule"] == rule and r["tile"] != tile
            ])
            for rule in rules
        }  # fmt: skip
        best = min(rules, key=lambda rule: float(means[rule]))
        result += [r for r in records if r["tile"] == tile and r["rule"] == best]
    return result


def table(records: list[dict[str, Any]]) -> str:
    """Return the table: a line for each tile, geometric means and worst ratios below."""
    kinds = [kind for kind in KINDS if any(r["kind"] == kind for r in records)]
    lines = ["tile        " + "".join(f"{kind:>24}" for kind in kinds) + "   void  CPU s"]
    lines.append(" " * 12 + f"{'DEM     TIN   ratio':>24}" * len(kinds))
    for tile in dict.fromkeys(r["tile"] for r in records):
        own = {r["kind"]: r for r in records if r["tile"] == tile}
        cells = "".join(
            f"{own[k]['rmse']:>10.4f}{own[k]['tin']:>8.4f}{own[k]['ratio']:>6.2f}" for k in kinds
        )
        void, cpu = (np.mean([r[name] for r in own.values()]) for name in ("void", "cpu_s"))
        rule = next(iter(own.values()))["rule"]
        lines.append(f"{tile:<12}{cells}  {void:>5.1%} {cpu:>6.2f}  {rule}")
    for kind in (*kinds, "all"):
        ratios = [r["ratio"] for r in records if kind in (r["kind"], "all")]
        mean = math.exp(np.mean(np.log(ratios)))
        lines.append(f"{kind:<8} geometric mean {mean:.3f}  worst {max(ratios):.3f}")
    return "\n".join(lines)


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--shared", default=os.environ.get("VOLATOOL_SHARED"), type=Path)
    parser.add_argument("--tiles", help="names, comma between; all by default")
    parser.add_argument("--seeds", type=int, default=3, help="hold-outs of each kind [3]")
    parser.add_argument("--rule", default="product", help="product, nets, or loo [product]")
    parser.add_argument("--cell", default="1", help="edge in metres, or auto [1]")
    parser.add_argument("--json", type=Path, help="also write the numbers to this file")
    parser.add_argument(
        "--cache", type=Path, default=Path(tempfile.gettempdir()) / "volatool-tin",
        help="folder that keeps the TIN's errors",
    )  # fmt: skip
    args = parser.parse_args()
    if args.shared is None:
        sys.exit("--shared or VOLATOOL_SHARED must say where the tiles are")
    chosen = ground_tiles.tiles(args.shared)
    if args.tiles:
        wanted = args.tiles.split(",")
        unknown = set(wanted) - {tile.name for tile in chosen}
        if unknown:
            sys.exit(f"no such tile: {', '.join(sorted(unknown))}")
        chosen = [tile for tile in chosen if tile.name in wanted]
    rules = CANDIDATES if args.rule == "loo" else (args.rule,)
    records: list[dict[str, Any]] = []
    for tile in chosen:
        records += judge(tile, args.seeds, args.cell, rules, args.cache)
        print(f"\r{tile.name:<12}", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    if args.json:
        args.json.write_text(json.dumps(records, indent=1) + "\n")
    print(table(leave_one_out(records) if args.rule == "loo" else records))


if __name__ == "__main__":
    main()
