"""Time the live loop: add a scan of about 7500 points, solve the window and its margin.

    python benchmarks/live.py --scans 40

CPU seconds of this process a loop, kernels warm, by nodes of the window; a margin of 20 cells
comes on top of them. The last line is CPU(102400) / CPU(1600): below 64 is better than linear.
"""

from __future__ import annotations

import argparse
import statistics
import time

import numpy as np

import volatool as vt

SIDES = (20, 40, 80, 160, 320)
WARM_UP = 5


def scan(at: float, seed: int, n: int = 7500) -> np.ndarray:
    """Return a scan of a sensor at (at, 0) over sin(x / pi) sin(y / pi), denser near it."""
    rng = np.random.default_rng(seed)
    r, a = 10 * rng.random(n), 2 * np.pi * rng.random(n)
    x, y = at + r * np.cos(a), r * np.sin(a)
    z = np.sin(x / np.pi) * np.sin(y / np.pi) + rng.normal(0, 0.05, n)
    return np.column_stack([x, y, z])


def loop_ms(side: int, scans: list[np.ndarray], preset: str) -> tuple[float, float, float]:
    """Return median CPU ms of the loop, of adding, and the mean number of iterations."""
    m = vt.EMap(preset=preset)
    whole, adding, iterations = [], [], []
    for k, points in enumerate(scans):
        start = time.process_time()
        m.update(points)
        middle = time.process_time()
        surface = m.window((0.2 * k, 0.0), side * m.cell)
        end = time.process_time()
        if k >= WARM_UP:
            whole.append(1e3 * (end - start))
            adding.append(1e3 * (middle - start))
            iterations.append(surface.info.iterations)
    return statistics.median(whole), statistics.median(adding), statistics.mean(iterations)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--scans", type=int, default=40)
    arguments = parser.parse_args()
    scans = [scan(0.2 * k, k) for k in range(arguments.scans + WARM_UP)]
    for preset in ("emap", "paper"):
        loop_ms(20, scans[: WARM_UP + 1], preset)
        print(f"{preset}: nodes, CPU ms a loop, of these adding the scan, iterations")
        times = {}
        for side in SIDES:
            times[side], adding, iterations = loop_ms(side, scans, preset)
            print(f"{side * side:7d} {times[side]:8.1f} {adding:6.2f} {iterations:5.1f}")
        print(f"ratio {times[320] / times[40]:.1f}")


if __name__ == "__main__":
    main()
