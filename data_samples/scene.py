"""What a laser pulse can meet: the interface of a scene, and trees, which all scenes share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Codes = NDArray[np.uint8]


@dataclass(frozen=True)
class Surface:
    """
    What lies at places of the ground, seen from above and without trees.

    Parameters
    ----------
    height : (n,) array of float64
        Of what is hit, in metres.
    code : (n,) array of uint8
        ASPRS class.
    colour : (n, 3) array of float64
        Red, green, blue, 0 to 255.
    reflectance : (n,) array of float64
        Of the laser, 0 to 1.
    detection : (n,) array of float64
        Chance that a pulse comes back at all.
    """

    height: Floats
    code: Codes
    colour: Floats
    reflectance: Floats
    detection: Floats


@dataclass(frozen=True)
class Trees:
    """
    At most one tree per cell of a lattice, so that a pulse looks at nine of them at most.

    Parameters
    ----------
    pitch : float
        Edge of the lattice's cells in metres; no crown is wider than one of them.
    u, v : (rows, columns) arrays of float64
        Stems.
    foot, tall, radius : (rows, columns) arrays of float64
        Ground height, height of the tree above it, radius of the crown (0 = no tree).
    is_cone : (rows, columns) array of bool
        Conifer.
    colour : (rows, columns, 3) array of float64
        Red, green, blue, 0 to 255.
    """

    pitch: float
    u: Floats
    v: Floats
    foot: Floats
    tall: Floats
    radius: Floats
    is_cone: NDArray[np.bool_]
    colour: Floats

    def crowns(self, u: Floats, v: Floats) -> tuple[Floats, Floats, NDArray[np.int64]]:
        """
        Return the highest crown over each place.

        Parameters
        ----------
        u, v : (n,) arrays of float64
            Places in metres.

        Returns
        -------
        top, bottom : (n,) arrays of float64
            Heights of the crown; -inf where there is none.
        tree : (n,) array of int64
            Flat index into the lattice, -1 where there is none.
        """
        rows, columns = self.u.shape
        column = np.floor(u / self.pitch).astype(np.int64) + 1  # one cell of margin all round
        row = np.floor(v / self.pitch).astype(np.int64) + 1
        top = np.full(len(u), -np.inf)
        bottom = np.full(len(u), -np.inf)
        tree = np.full(len(u), -1, np.int64)
        for di in (-1, 0, 1):
            for dj in (-1, 0, 1):
                index = np.clip(row + di, 0, rows - 1) * columns + np.clip(
                    column + dj, 0, columns - 1
                )
                radius = self.radius.ravel()[index]
                squared = (u - self.u.ravel()[index]) ** 2 + (v - self.v.ravel()[index]) ** 2
                part = np.sqrt(squared) / np.maximum(radius, 1e-9)
                inside = np.flatnonzero((radius > 0) & (part < 1))
                part, index = part[inside], index[inside]
                tall, foot = self.tall.ravel()[index], self.foot.ravel()[index]
                cone = self.is_cone.ravel()[index]
                dome = 0.45 + 0.55 * np.sqrt(1 - part * part)
                high = foot + tall * np.where(cone, 1 - 0.72 * part, dome)
                low = foot + tall * np.where(cone, 0.18, 0.45 - 0.17 * np.sqrt(1 - part * part))
                higher = high > top[inside]
                inside = inside[higher]
                top[inside], bottom[inside] = high[higher], low[higher]
                tree[inside] = index[higher]
        return top, bottom, tree


class Scene(Protocol):
    """A landscape that can be scanned; lengths in metres from the tile's south-west corner."""

    seed: int
    trees: Trees
    steps: Floats
    """Heights above ground at which a slanting pulse is checked for walls, highest first."""
    canopy: float
    """Chance that a pulse stops before it reaches the surface under a crown."""
    clouds: tuple[float, float]
    """Heights above ground between which stray returns (birds, haze) hang, metres."""

    def terrain(self, u: Floats, v: Floats) -> Floats:
        """Return the bare earth's height at (n,) places."""

    def roof(self, u: Floats, v: Floats) -> Floats:
        """Return the height of the building at (n,) places, -inf where there is none."""

    def surface(self, u: Floats, v: Floats, is_roof: NDArray[np.bool_]) -> Surface:
        """Return what lies at (n,) places: the roof where `is_roof`, else the ground."""
