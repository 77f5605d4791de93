"""A forest slope with a creek, a logging road, boulders and fallen trunks."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from chance import smooth, uniform
from numpy.typing import NDArray
from scene import Floats, Surface, Trees


@dataclass
class Forest:
    """
    The forest's scene (see `scene.Scene`).

    Parameters
    ----------
    width, height : float
        Of the tile, metres.
    seed : int
        Another seed, another forest.
    """

    width: float
    height: float
    seed: int = 607
    steps: Floats = field(default_factory=lambda: np.empty(0))
    clouds: tuple[float, float] = (36.0, 52.0)
    canopy: float = 0.62

    def __post_init__(self) -> None:
        self.trees = self._plant()

    def _slope(self, u: Floats, v: Floats) -> Floats:
        """Return the hillside before the road was cut into it."""
        rise = 34.0 * np.sin(2 * np.pi * (0.35 * u + 0.94 * v - 95.0) / 620.0)
        creek = np.exp(-(((u - 0.18 * v - self._creek(v)) / 9.0) ** 2))
        rough = 2.6 * smooth(21, u, v, 60.0) + 0.8 * smooth(22, u, v, 19.0)
        return 1240.0 + 2.4 * rise + rough + 0.18 * smooth(23, u, v, 4.1) - 5.5 * creek

    def _creek(self, v: Floats) -> Floats:
        """Return the creek's bed, sideways from its straight line; repeated every 160 m."""
        return 34.0 + 6.0 * np.sin(v / 23.0)

    def _road(self, u: Floats, v: Floats) -> tuple[Floats, Floats]:
        """Return the distance from the road's middle, uphill positive, and the road's height."""
        axis = 58.0 + 7.0 * np.sin(u / 31.0) - 0.1 * u
        period = 190.0
        turn = np.round((v - axis) / period) * period
        return v - axis - turn, self._slope(u, axis + turn)

    def terrain(self, u: Floats, v: Floats) -> Floats:
        """Return the bare earth's height."""
        natural = self._slope(u, v)
        off, road = self._road(u, v)
        bench = np.clip((np.abs(off) - 2.4) / 3.6, 0.0, 1.0)
        return road + (natural - road) * bench * bench * (3 - 2 * bench)

    def roof(self, u: Floats, v: Floats) -> Floats:
        """Return -inf: nobody lives here."""
        return np.full(len(u), -np.inf)

    def surface(self, u: Floats, v: Floats, is_roof: NDArray[np.bool_]) -> Surface:
        """Return the forest floor: litter, the gravel road, boulders, trunks, undergrowth."""
        ground, (off, _) = self.terrain(u, v), self._road(u, v)
        is_road = np.abs(off) < 2.2
        i, j = np.floor(u / 5.0).astype(np.int64), np.floor(v / 5.0).astype(np.int64)
        du = u - (i + 0.25 + 0.5 * uniform(self.seed + 30, i, j)) * 5.0
        dv = v - (j + 0.25 + 0.5 * uniform(self.seed + 31, i, j)) * 5.0
        lot = uniform(self.seed + 32, i, j)
        size = 0.5 + 0.9 * uniform(self.seed + 33, i, j)
        boulder = np.where(lot < 0.1, np.sqrt(np.maximum(size**2 - du**2 - dv**2, 0)) * 0.8, 0.0)
        trunk = np.where((lot > 0.95) & (np.abs(du - dv) < 0.4), 0.5, 0.0)
        fern = np.where(
            smooth(self.seed + 34, u, v, 11.0) > 0.25, 0.5 * uniform(self.seed + 35, i, j), 0.0
        )
        extra = np.where(is_road, 0.0, np.maximum(np.maximum(boulder, trunk), fern))
        grain = smooth(self.seed + 36, u, v, 6.0)
        count = len(u)
        return Surface(
            height=ground + extra,
            code=np.ones(count, np.uint8),
            colour=np.full((count, 3), 90.0),
            reflectance=np.where(is_road, 0.55, 0.34 + 0.06 * grain),
            detection=np.full(count, 0.96),
        )

    def _plant(self) -> Trees:
        """Plant firs, some broad-leaved trees along the creek, and leave the road free."""
        pitch = 5.6
        columns, rows = int(self.width / pitch) + 4, int(self.height / pitch) + 4
        j, i = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
        u = (i - 1 + 0.1 + 0.8 * uniform(self.seed + 40, i, j)) * pitch
        v = (j - 1 + 0.1 + 0.8 * uniform(self.seed + 41, i, j)) * pitch
        flat_u, flat_v = u.ravel(), v.ravel()
        foot, (off, _) = self.terrain(flat_u, flat_v), self._road(flat_u, flat_v)
        near_creek = np.abs(flat_u - 0.18 * flat_v - self._creek(flat_v)) < 14
        stand = smooth(self.seed + 42, flat_u, flat_v, 38.0)  # clearings and thickets
        chance = np.clip(0.95 + 0.6 * stand, 0.15, 0.98)
        grows = (np.abs(off) > 3.6) & (uniform(self.seed + 43, i, j).ravel() < chance)
        size = uniform(self.seed + 44, i, j).ravel()
        cone = uniform(self.seed + 45, i, j).ravel() < np.where(near_creek, 0.3, 0.9)
        tall = np.where(cone, 12 + 20 * size, 8 + 9 * size)
        radius = np.where(cone, 1.5 + 0.085 * tall, 2.0 + 0.15 * tall)
        shape = u.shape
        return Trees(
            pitch=pitch,
            u=u,
            v=v,
            foot=foot.reshape(shape),
            tall=tall.reshape(shape),
            radius=np.where(grows, np.minimum(radius, 0.95 * pitch), 0.0).reshape(shape),
            is_cone=cone.reshape(shape),
            colour=np.full((*shape, 3), 90.0),
        )
