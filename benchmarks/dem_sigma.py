"""Do the intervals of the DEM's standard errors hold? Coverage at held-out ground points.

    VOLATOOL_SHARED=... python benchmarks/dem_sigma.py [--tiles topo,ntm46] [--cell 1] [--seeds 2]

Tiles and hold-outs are those of `ground_tiles.py`; the DEM, its noise and its factors are made from
the other points alone, as the product does by default. Exits 1 if a 95 % interval covers less than
91 or more than 99 %.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from fractions import Fraction
from pathlib import Path

import ground_tiles
import numpy as np

from volatool.dem.gather import ROW, SurfacePoints
from volatool.dem.holdout import errors_at
from volatool.dem.sigma import Ensemble, distances_at, fit, scale_at, unit_errors_at
from volatool.dem.surfaces import make_dem
from volatool.model import CrsInfo
from volatool.scratch import Scratch, Spool

LOW, HIGH = 0.91, 0.99
MAX_GAP_M = 100.0


def points_of(ground: ground_tiles.Ground, keep: np.ndarray) -> SurfacePoints:
    """Return some of a tile's points as a surface's, over the extent of all."""
    spool = Spool(Scratch(), ROW)
    spool.append(np.ascontiguousarray(ground.rows[keep]))
    low, high = ground.rows.min(axis=0), ground.rows.max(axis=0)
    extent = (int(low[0]), int(low[1]), int(high[0]), int(high[1]))
    return SurfacePoints(
        "dtm", "class 2", spool, ground.scale, ground.offset, extent, (int(low[2]), int(high[2]))
    )


def main() -> None:
    """Print a line per tile, hold-out and seed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tiles", help="names, by commas; all by default")
    parser.add_argument("--kinds", default="random,10 m", help="hold-outs, by commas")
    parser.add_argument("--cell", type=float, default=1.0, help="metres")
    parser.add_argument("--seeds", type=int, default=2)
    options = parser.parse_args()
    names = None if options.tiles is None else options.tiles.split(",")
    faults = n_tests = 0
    print("tile      kind   seed      n   rmse     sd  sigma   68 %   95 %  std z  CPU s")
    for tile in ground_tiles.tiles(Path(os.environ["VOLATOOL_SHARED"])):
        if names is not None and tile.name not in names:
            continue
        ground = ground_tiles.load(tile)
        unit = float(ground.unit)
        crs = CrsInfo(metres_per_unit_xy=ground.unit, metres_per_unit_z=ground.unit)
        for kind in options.kinds.split(","):
            for seed in range(options.seeds):
                out = ground_tiles.holdout_mask(ground.xyz[:, :2], kind, seed)
                train, test = points_of(ground, ~out), points_of(ground, out)
                scratch = Scratch()
                cell = Fraction(str(options.cell)) / ground.unit
                dem = make_dem(
                    train, crs, cell, scratch=scratch, max_gap=MAX_GAP_M / unit, with_noise=True
                )
                assert dem.tuned is not None
                assert dem.spacing is not None
                start = time.process_time()
                model = fit(train, dem.grid, dem.tuned, dem.noise, dem.spacing, crs, scratch)
                assert model is not None
                ensemble = Ensemble(train, model.tuned, dem.grid, scratch)
                own = unit_errors_at(ensemble, ensemble.evidence(), test)
                distance = distances_at(train, test, dem.grid, scratch)
                spread = scale_at(model, test, distance) * np.sqrt(1 + np.square(own))
                seconds = time.process_time() - start
                errors = errors_at(dem, test)
                known = np.isfinite(errors)
                errors, spread = errors[known], spread[known]
                ratio = errors / spread
                inside = [float(np.mean(np.abs(ratio) <= limit)) for limit in (1, 1.96)]
                n_tests += 1
                bad = not LOW <= inside[1] <= HIGH
                faults += bad
                rms = [unit * float(np.sqrt(np.mean(v * v))) for v in (errors, spread)]
                print(
                    f"{tile.name:9s} {kind:6s} {seed:4d} {len(errors):6d} {rms[0]:6.3f} "
                    f"{rms[1]:6.3f} {unit * (dem.noise_sigma or np.nan):6.3f} {inside[0]:6.3f} "
                    f"{inside[1]:6.3f} {ratio.std():6.2f} {seconds:6.1f}{'  <-' if bad else ''}",
                    flush=True,
                )
    print(f"{faults} of {n_tests} outside {LOW} to {HIGH}")
    sys.exit(faults > 0)


if __name__ == "__main__":
    main()
