"""Components, clearance and paths beside scipy's dense and tree-based ways, on the same voxels.

One table, as Markdown; CPU time of this process, medians. Labels are held against scipy's.
"""

from __future__ import annotations

import statistics
import tempfile
from pathlib import Path

import numpy as np
from query import chosen_points, cpu_seconds, made_volume, parsed, tile_parser
from scipy import ndimage
from scipy.spatial import cKDTree

import volatool as vt
from volatool.vola.path import Path as Way
from volatool.vola.path import PathEndError

MOST_CELLS = 300_000_000
"""Cells of a dense grid that scipy is given."""


def label_rows(volume: vt.Volume, runs: int) -> None:
    voxels = volume.voxels()
    corner = voxels.min(axis=0)
    shape = voxels.max(axis=0) - corner + 1
    is_dense = np.prod(shape, dtype=float) <= MOST_CELLS
    if is_dense:
        grid = np.zeros(shape, bool)
        grid[tuple((voxels - corner).T)] = True
    n = volume.n_blocks()
    for connectivity, rank in ((6, 1), (26, 3)):
        volume.components(connectivity)  # compiles
        own = statistics.median(
            cpu_seconds(lambda c=connectivity: volume.components(c)) for _ in range(runs)
        )
        found = volume.components(connectivity)
        print(
            f"| components, {connectivity}-connected: {len(found)} "
            f"| {n / own / 1e6:.2f} M blocks/s | {own * 1e3:.0f} ms | |"
        )
        if not is_dense:
            continue
        structure = ndimage.generate_binary_structure(3, rank)
        theirs = cpu_seconds(lambda s=structure: ndimage.label(grid, s))
        labels, n_labels = ndimage.label(grid, structure)
        assert n_labels == len(found)
        pairs = np.column_stack([labels[tuple((voxels - corner).T)], found.labels])
        assert len(np.unique(pairs, axis=0)) == n_labels
        del labels
        print(
            f"| scipy.ndimage.label of the box, {grid.size / 1e6:.0f} M cells: the same parts | "
            f"{n / theirs / 1e6:.3f} M blocks/s | {theirs * 1e3:.0f} ms | {theirs / own:.0f} |"
        )


def clearance_rows(volume: vt.Volume, n: int, runs: int) -> None:
    points = chosen_points(volume, n, np.random.default_rng(1))
    unit = np.array([1, 1, float(volume.crs.z_ratio)])
    volume.clearance(points[:1])
    own = statistics.median(cpu_seconds(lambda: volume.clearance(points)) for _ in range(runs))
    print(
        f"| clearance, to boxes | {n / own / 1e6:.2f} M points/s | {own * 1e9 / n:.0f} ns each | |"
    )
    own = statistics.median(
        cpu_seconds(lambda: volume.clearance(points, to="centre")) for _ in range(runs)
    )
    distances = volume.clearance(points, to="centre")
    print(
        f"| clearance, to centres | {n / own / 1e6:.2f} M points/s "
        f"| {own * 1e9 / n:.0f} ns each | |"
    )
    centers = volume.centers() * unit
    tree = cKDTree(centers)
    made = cpu_seconds(lambda: cKDTree(centers))
    theirs = cpu_seconds(lambda: tree.query(points * unit))
    np.testing.assert_allclose(tree.query(points * unit)[0], distances, rtol=1e-6, atol=1e-6)
    print(
        f"| scipy cKDTree of the centres (made in {made:.2f} s): the same distances | "
        f"{n / theirs / 1e6:.3f} M points/s | {theirs * 1e9 / n:.0f} ns each | {theirs / own:.1f} |"
    )


def timed_path(volume: vt.Volume, ends: np.ndarray, clearance: float) -> tuple[float, Way | None]:
    found = []
    seconds = cpu_seconds(lambda: found.append(volume.path(*ends, clearance)))
    return seconds, found[0]


def path_rows(volume: vt.Volume, n: int) -> None:
    """Between places some cells above voxels, all over the tile."""
    cell = volume.cell()
    centers = volume.centers()
    rng = np.random.default_rng(4)
    for clearance in (0.0, 3 * cell):
        seconds, looked_at = [], []
        while len(seconds) < n:
            ends = centers[rng.integers(0, len(centers), 2)]
            ends[:, 2] += (clearance + 6 * cell) / float(volume.crs.z_ratio)
            try:
                timed_path(volume, ends, clearance)  # compiles
                time, path = timed_path(volume, ends, clearance)
            except PathEndError:
                continue
            seconds.append(time)
            if path is not None:
                looked_at.append(path.looked_at)
        print(
            f"| {n} pairs, clearance {clearance / cell:.0f} cells: {len(looked_at)} paths "
            f"| {np.median(looked_at):.0f} cells looked at (median) "
            f"| {np.median(seconds) * 1e3:.0f} ms, at most {max(seconds) * 1e3:.0f} ms | |"
        )


def main() -> None:
    parser = tile_parser(__doc__)
    parser.add_argument("--points", type=int, default=200_000)
    parser.add_argument("--paths", type=int, default=40)
    parser.add_argument("--runs", type=int, default=5)
    arguments = parsed(parser)
    with tempfile.TemporaryDirectory() as name:
        volume = made_volume(arguments.tile, arguments.depth, arguments.crs, Path(name))
    print(f"{arguments.tile.name}: {volume!r}, {volume.n_blocks()} blocks\n")
    print("| what | rate | time | volatool is faster by |")
    print("|---|---:|---:|---:|")
    label_rows(volume, arguments.runs)
    clearance_rows(volume, arguments.points, arguments.runs)
    path_rows(volume, arguments.paths)


if __name__ == "__main__":
    main()
