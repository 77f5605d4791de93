"""Where the sensor was: one line a scan."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from volatool.errors import FormatError, InputError, InputNotFoundError
from volatool.model import F64

_MAX_SKEW = 1e-3
"""How far a matrix may be from a rotation, by element of ``R R^T - 1``."""


@dataclass(frozen=True, slots=True)
class Pose:
    """
    A sensor's place and attitude.

    Parameters
    ----------
    rotation : (3, 3) array of float64
        Sensor axes to world axes.
    place : (3,) array of float64
        In the world.
    """

    rotation: F64
    place: F64

    def to_world(self, xyz: F64) -> F64:
        """Return sensor coordinates in the world; (n, 3) arrays."""
        moved: F64 = xyz @ self.rotation.T + self.place
        return moved


def read_poses(path: Path) -> list[Pose]:
    """
    Read poses.

    Parameters
    ----------
    path : pathlib.Path
        A line a scan, numbers separated by commas or blanks: ``x y z`` (the sensor's axes are the
        world's); ``x y z qx qy qz qw``; 12 numbers, the rows of a 3 x 4 matrix (as KITTI has
        them); or 16, of a 4 x 4 one. Lines that begin with ``#`` and a first line of names are
        skipped.

    Raises
    ------
    InputNotFoundError, FormatError
        Not there; a line that is no pose, with its number.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except FileNotFoundError as error:
        raise InputNotFoundError(f"{path}: no such file") from error
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: can't be read ({error})") from error
    poses: list[Pose] = []
    is_first = True
    for number, line in enumerate(lines, 1):
        words = line.replace(",", " ").split()
        if not words or words[0].startswith("#"):
            continue
        try:
            values = np.array([float(word) for word in words])
        except ValueError as error:
            if is_first:  # column names
                is_first = False
                continue
            raise FormatError(f"{path}: line {number} has words where numbers must be") from error
        is_first = False
        try:
            poses.append(_pose(values))
        except ValueError as error:
            raise FormatError(f"{path}: line {number} is no pose: {error}") from error
    return poses


def _pose(values: F64) -> Pose:
    if not np.all(np.isfinite(values)):
        raise ValueError("a number is not finite")
    if len(values) == 3:
        return Pose(np.eye(3), values)
    if len(values) == 7:
        return Pose(_rotation(values[3:]), values[:3])
    if len(values) not in (12, 16):
        raise ValueError(f"{len(values)} numbers instead of 3, 7, 12 or 16")
    matrix = values[:12].reshape(3, 4)
    rotation = matrix[:, :3].copy()
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > _MAX_SKEW or np.linalg.det(rotation) < 0:
        raise ValueError("its matrix does not rotate")
    return Pose(rotation, matrix[:, 3].copy())


def _rotation(quaternion: F64) -> F64:
    norm = float(np.linalg.norm(quaternion))
    if not norm > 0.5:
        raise ValueError("its quaternion is zero")
    x, y, z, w = quaternion / norm
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
