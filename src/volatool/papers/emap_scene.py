"""The EMap paper's simulated drive: a robot with an OS1-64 over a sinusoidal terrain."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from volatool.errors import OptionError
from volatool.model import F64, I64, Bool


def terrain(x: F64, y: F64) -> F64:
    """
    Height of the terrain, ``sin(x / pi) sin(y / pi)``; period 2 pi^2 = 19.74 m [Lock2022]_.

    Parameters
    ----------
    x, y : arrays of float64
        Places, in metres.

    Returns
    -------
    height : array of float64
        Metres, -1 to 1.
    """
    return np.asarray(np.sin(x / np.pi) * np.sin(y / np.pi), np.float64)


@dataclass(frozen=True, slots=True)
class Drive:
    """
    The experiment's set-up; defaults are the paper's, or ours where it is silent.

    Parameters
    ----------
    duration_s, rate_hz, speed : float
        Length of a run, scans a second (ours), metres a second along x from x = 0.
    sensor_height : float
        Of the level sensor above the datum (ours), in metres; the crests are at 1.
    azimuths, rings : int
        Beams of the OS1-64 around and up, evenly spread.
    half_angle_deg : float
        Rings reach so far up and down.
    noise : float
        Standard deviation of the measured range, in metres.
    max_range : float
        Returns measured farther away are dropped, in metres.
    every : int
        One scan of so many is evaluated (ours).
    seed : int
        Run n draws from ``numpy.random.default_rng(seed + n)``.
    """

    duration_s: float = 30.0
    rate_hz: float = 5.0
    speed: float = 1.0
    sensor_height: float = 2.0
    azimuths: int = 512
    rings: int = 64
    half_angle_deg: float = 22.5
    noise: float = 0.05
    max_range: float = 10.0
    every: int = 5
    seed: int = 1000

    def __post_init__(self) -> None:
        if not (self.duration_s > 0 and self.n_evaluated >= 1):
            raise OptionError(f"a drive of {self.duration_s} s has no scan to evaluate")
        if self.seed < 0:
            raise OptionError(f"--seed can't be negative, got {self.seed}")

    @property
    def n_scans(self) -> int:
        """Scans of a run."""
        return round(self.duration_s * self.rate_hz)

    @property
    def n_evaluated(self) -> int:
        """Evaluated scans of a run: the 5th, 10th, ..."""
        return self.n_scans // self.every

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON object."""
        return {name: getattr(self, name) for name in self.__slots__}


@dataclass(frozen=True, slots=True)
class Scan:
    """
    What the sensor delivers in one turn.

    Parameters
    ----------
    number : int
        From 0.
    sensor : (3,) array of float64
        Its place in the world, in metres.
    points : (n, 3) array of float64
        Returns in the world, in metres.
    evaluated : bool
        Errors are taken after this scan.
    """

    number: int
    sensor: F64
    points: F64
    evaluated: bool


def beams(drive: Drive) -> F64:
    """
    Directions of the beams of one turn.

    Returns
    -------
    directions : (rings * azimuths, 3) array of float64
        Unit vectors, the lowest ring first.
    """
    half = np.radians(drive.half_angle_deg)
    up = np.linspace(-half, half, drive.rings)[:, None]
    around = np.arange(drive.azimuths) * (2 * np.pi / drive.azimuths)
    directions = np.empty((drive.rings, drive.azimuths, 3))
    directions[..., 0] = np.cos(up) * np.cos(around)
    directions[..., 1] = np.cos(up) * np.sin(around)
    directions[..., 2] = np.sin(up)
    return directions.reshape(-1, 3)


def scans(drive: Drive, run: int) -> Iterator[Scan]:
    """
    Yield the scans of a run: exact ray casting, occlusion included, then noise on the range.

    Parameters
    ----------
    drive : Drive
        The set-up.
    run : int
        Run n drives along y = n metres.
    """
    from volatool.kernels import raycast

    rng = np.random.default_rng(drive.seed + run)
    directions = beams(drive)
    ranges = np.empty(len(directions))
    reach = drive.max_range + 6 * drive.noise  # noise may bring a return in
    for number in range(drive.n_scans):
        sensor = np.array([drive.speed * number / drive.rate_hz, float(run), drive.sensor_height])
        raycast.cast(sensor, directions, reach, ranges)
        hit = np.isfinite(ranges)
        measured = ranges[hit] + rng.normal(0.0, drive.noise, np.count_nonzero(hit))
        near = measured <= drive.max_range
        points = sensor + measured[near, None] * directions[hit][near]
        yield Scan(number, sensor, points, (number + 1) % drive.every == 0)


@dataclass(frozen=True, slots=True)
class Nodes:
    """
    The square of nodes around the sensor, on the world's multiples of the cell.

    Parameters
    ----------
    col, row : int
        Cells of its north-west corner, east of x = 0 and south of y = 0.
    side : int
        Nodes a side.
    cell : float
        Metres between nodes; the nodes are at cell centres.
    """

    col: int
    row: int
    side: int
    cell: float

    @classmethod
    def around(cls, sensor: F64, side: int = 40, cell: float = 0.25) -> Nodes:
        """Return the window whose centre is nearest to the sensor."""
        col, row = (round(float(value) / cell) for value in (sensor[0], -sensor[1]))
        return cls(col - side // 2, row - side // 2, side, cell)

    @property
    def centre(self) -> tuple[float, float]:
        """Where four cells meet in the middle, for an even number a side."""
        half = self.side // 2
        return (self.col + half) * self.cell, -(self.row + half) * self.cell

    @property
    def x(self) -> F64:
        """(side,) array: x of the columns."""
        return np.asarray((self.col + 0.5 + np.arange(self.side)) * self.cell, np.float64)

    @property
    def y(self) -> F64:
        """(side,) array: y of the rows, from the north."""
        return np.asarray(-(self.row + 0.5 + np.arange(self.side)) * self.cell, np.float64)

    def places(self) -> tuple[F64, F64]:
        """Return x and y of all nodes, two (side, side) arrays."""
        x, y = np.meshgrid(self.x, self.y)
        return x, y

    def distance(self, sensor: F64) -> F64:
        """Return the nodes' horizontal distance to the sensor, a (side, side) array."""
        x, y = self.places()
        return np.asarray(np.hypot(x - sensor[0], y - sensor[1]), np.float64)

    def indices(self, x: F64, y: F64) -> tuple[I64, I64]:
        """Return the rows and columns of the cells that places lie in; may fall outside."""
        row = np.floor(-y / self.cell).astype(np.int64) - self.row
        col = np.floor(x / self.cell).astype(np.int64) - self.col
        return row, col

    def holds(self, points: F64) -> Bool:
        """Return which of the (n, 3) points lie in the window's cells."""
        row, col = self.indices(points[:, 0], points[:, 1])
        return (row >= 0) & (row < self.side) & (col >= 0) & (col < self.side)
