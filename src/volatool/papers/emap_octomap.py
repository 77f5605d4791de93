"""What the EMap paper compares with: the topmost occupied voxels of the real OctoMap library."""

from __future__ import annotations

import importlib.metadata
import importlib.util
from typing import Any

import numpy as np

from volatool.errors import FormatError, OptionError
from volatool.model import F64, I64
from volatool.papers.emap_scene import Nodes

DEPTH = 16
"""Levels of an OctoMap tree; keys count voxels from ``-2 ** 15``."""

MISSING = (
    "the OctoMap baseline needs the PyPI packages pyoctomap and scipy, which are not installed: "
    'pip install "volatool[octomap]"'
)


def is_available() -> bool:
    """Return whether the packages of the extra ``octomap`` are installed."""
    return all(importlib.util.find_spec(name) for name in ("pyoctomap", "scipy"))


def version() -> str:
    """Return the name and version of the installed baseline."""
    return f"OctoMap through pyoctomap {importlib.metadata.version('pyoctomap')}"


class OctoMapTop:
    """
    An OctoMap occupancy tree [Hornung2013]_ read as a surface, as in [Lock2022]_.

    Parameters
    ----------
    resolution : float
        Edge of a voxel, in metres. Sensor model and thresholds are the library's defaults.

    Raises
    ------
    OptionError
        ``E_OPTION``: the extra ``octomap`` is not installed.
    """

    def __init__(self, resolution: float = 0.1) -> None:
        if not is_available():
            raise OptionError(MISSING)
        import pyoctomap

        self.resolution = resolution
        self.tree: Any = pyoctomap.OcTree(resolution)

    def update(self, sensor: F64, points: F64) -> None:
        """
        Insert a scan: full rays, free along them and occupied at their ends.

        Parameters
        ----------
        sensor : (3,) array of float64
            Where the rays start, in metres.
        points : (n, 3) array of float64
            Where they end.
        """
        # lazy: inner nodes are not looked at, leaves are the same (a test compares)
        self.tree.insertPointCloud(points, sensor, -1.0, True)

    def columns(self, bounds: tuple[float, float, float, float]) -> tuple[F64, F64]:
        """
        Return the columns with an occupied voxel and the height of the topmost one's centre.

        Parameters
        ----------
        bounds : tuple of 4 float
            Left, bottom, right, top of where to look, in metres.

        Returns
        -------
        places : (n, 2) array of float64
            x, y of the columns' centres, by row from the south.
        heights : (n,) array of float64
            Metres.
        """
        from volatool.kernels import octree

        half = 1 << (DEPTH - 1)
        left, bottom, right, top = (int(np.floor(b / self.resolution)) + half for b in bounds)
        layers = np.empty((top - bottom + 1, right - left + 1), np.int64)
        # not writeBinary: it would first round the map's probabilities to 0 and 1
        data = self.tree.write()
        start = data.index(b"\ndata\n") + 6
        nodes = np.frombuffer(data, np.uint8, offset=start)
        used = octree.topmost(nodes, self.tree.getOccupancyThresLog(), DEPTH, left, bottom, layers)
        if len(nodes) and used != len(nodes):  # an empty map has no root
            raise FormatError("the OctoMap library has written a tree that can't be read")
        rows, cols = np.nonzero(layers >= 0)
        places = np.column_stack([cols + left, rows + bottom])
        return self._centres(places), self._centres(layers[rows, cols])

    def _centres(self, keys: I64) -> F64:
        keys = keys - (1 << (DEPTH - 1))
        return np.asarray((keys + 0.5) * self.resolution, np.float64)

    def heights(self, nodes: Nodes, reach: float) -> F64:
        """
        Return each node's height: that of the nearest column, by a two-dimensional kD-tree.

        Parameters
        ----------
        nodes : Nodes
            The nodes.
        reach : float
            Columns are looked for so far from the window, in metres.

        Returns
        -------
        z : (side, side) array of float64
            Metres; NaN when no voxel is occupied.
        """
        from scipy.spatial import cKDTree

        x, y = nodes.places()
        bounds = (x.min() - reach, y.min() - reach, x.max() + reach, y.max() + reach)
        places, heights = self.columns(bounds)
        if not len(places):
            return np.full(x.shape, np.nan)
        _, nearest = cKDTree(places).query(np.column_stack([x.ravel(), y.ravel()]))
        return np.asarray(heights[nearest].reshape(x.shape), np.float64)
