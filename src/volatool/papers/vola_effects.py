"""What the VOLA paper's and the toolkit's contradictions amount to, on a made-up surface."""

from __future__ import annotations

from typing import Any

import numpy as np

from volatool.model import F64
from volatool.occupancy.levels import CELLS, dense_bytes, occupancy_of
from volatool.papers.vola_printed import TILE_M
from volatool.papers.vola_scene import SIDE, floor_cells, surface_places, volume_of_cells
from volatool.papers.vola_sizes import densities, dublin_fills

DEPTH = 4

POINTS = 100_000
"""10 a square metre."""

DENSITIES = (0.2, 1.0, 10.0)
"""Points a square metre for which rounding and floor are compared."""


def effects() -> dict[str, Any]:
    """
    Return what the errata amount to, beside what other parts of the document say.

    Returns
    -------
    found : dict
        By erratum; see docs/reference/reproduce-vola.md.
    """
    return {
        "rounding": [rounding(density) for density in DENSITIES],
        "reading_back": reading_back(POINTS),
        "block_words": block_words(POINTS),
        "leaf_share": CELLS ** (DEPTH - 1) * 8 / dense_bytes(DEPTH),
        "dublin": dublin_fills(),
        "densities": densities(),
        "cell_edge_m": TILE_M / 4**5,
        "dense_grid_bytes": {"side_5_m_cell_1_cm": 4 * 512**3, "as_printed_5_m3": _five_cubic()},
    }


def _five_cubic() -> int:
    """Return the bytes of 5 cubic metres in cells of 1 cm, 4 bytes each."""
    return 5 * 100**3 * 4


def rounded(places: F64, depth: int) -> Any:
    """Return the cells that the toolkit's rounding gives (the box is the whole cube)."""
    from volatool.vola.toolkit import rounded_cells

    cells, _ = rounded_cells(places, (0.0, 0.0, 0.0, 1.0, 1.0, 1.0), depth)
    return cells


def rounding(density: float) -> dict[str, Any]:
    """
    Compare block occupancies by the floor rule and by the toolkit's rounding (C1a).

    Parameters
    ----------
    density : float
        Points a square metre of a tile of 100 m.

    Returns
    -------
    found : dict
        ``density``; of levels 1 to 4 ``floor``, ``rounded`` (one file of depth 4),
        ``rounded_alone`` (each level the last one of a file of its own: rounding hangs on the
        file's depth) and ``voxel_weighted`` (floor, seen from a voxel).
    """
    places = surface_places(round(density * SIDE**2))
    alone = [
        volume_of_cells(rounded(places, depth), depth).counts()[-1] for depth in range(1, DEPTH + 1)
    ]
    found: dict[str, Any] = {
        "density": density,
        "rounded_alone": [occupancy_of(count) for count in alone],
    }
    for name, cells in (
        ("floor", floor_cells(places, DEPTH)),
        ("rounded", rounded(places, DEPTH)),
    ):
        counts = volume_of_cells(cells, DEPTH).counts()
        found[name] = [occupancy_of(count) for count in counts]
        if name == "floor":
            n = np.arange(CELLS + 1)
            found["voxel_weighted"] = [
                float((n * n * count.histogram).sum() / (CELLS * count.voxels)) for count in counts
            ]
    return found


def reading_back(n_points: int) -> dict[str, Any]:
    """
    Tell how far points lie from the cell that a reader shows for them (C12).

    Parameters
    ----------
    n_points : int
        Of the surface.

    Returns
    -------
    found : dict
        ``toolkit`` and ``ours``: ``inside`` (share of the points that lie in the cell that is
        shown) and ``farthest`` (from its middle, along an axis, in cells: 0.5 is the limit of a
        correct grid).
    """
    places = surface_places(n_points)
    found = {}
    for name, cells in (("toolkit", rounded(places, DEPTH)), ("ours", floor_cells(places, DEPTH))):
        away = np.abs(places * 4**DEPTH - (cells + 0.5))
        found[name] = {
            "inside": float(np.mean((away <= 0.5).all(axis=1))),
            "farthest": float(away.max()),
        }
    return found


def block_words(n_points: int) -> dict[str, float]:
    """
    Compare the mean of a block's points with the last one's value (C7), for heights as bytes.

    Parameters
    ----------
    n_points : int
        Of the surface.

    Returns
    -------
    found : dict
        ``differing`` (share of the blocks of the deepest level whose bytes differ), ``rms`` and
        ``largest`` difference, of 255.
    """
    places = surface_places(n_points)
    cells = floor_cells(places, DEPTH)
    z = places[:, 2]
    byte = np.rint(255 * (z - z.min()) / np.ptp(z)).astype(np.int64)
    # the toolkit takes a block's last voxel by x, then y, then z, and of a voxel the last point
    order = np.lexsort((np.arange(n_points), *cells.T[::-1], *(cells // 4).T))
    blocks = cells[order] // 4
    starts = np.flatnonzero(np.any(np.diff(blocks, axis=0, prepend=-1), axis=1))
    ends = np.append(starts[1:], n_points)
    mean = np.rint(np.add.reduceat(byte[order], starts) / (ends - starts))
    difference = mean - byte[order][ends - 1]
    return {
        "differing": float(np.mean(difference != 0)),
        "rms": float(np.sqrt(np.mean(difference**2))),
        "largest": float(np.abs(difference).max()),
    }
