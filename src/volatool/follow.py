"""Scans as they come, to a surface that is up to date: a record a scan, and models."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from volatool.errors import InputError, OptionError
from volatool.model import CrsInfo
from volatool.outputs import OutputSet
from volatool.points.frames import Frame
from volatool.points.poses import Pose
from volatool.units import Length

if TYPE_CHECKING:
    from volatool.dem.geotiff import Layer
    from volatool.emap.live import Window
    from volatool.model import Bounds

SCHEMA = "volatool.emap/1"

METRE = CrsInfo(metres_per_unit_xy=Fraction(1), metres_per_unit_z=Fraction(1))
"""Units of scans without a CRS."""


@dataclass(frozen=True, slots=True)
class FollowOptions:
    """
    What to make of the scans.

    Parameters
    ----------
    cell, sigma, tol : Length
        Edge of a cell; standard deviation of a point's height; stop of the solver. Bare numbers
        are in the unit of the scans.
    window : Length or None
        Side of the window that rolls with the sensor; None for all that was seen (or `bounds`).
    bounds : Bounds or None
        Nothing outside is used.
    margin : int or None
        Cells around the window that are solved with it.
    radius, max_gap : Length or None
        Returns farther from the sensor are left out; cells of the rasters farther from measured
        ones are not filled.
    forget : float
        Factor on what was known at each scan.
    max_weight : float or None
        Bound of a place's weight, in points.
    preset : str
        ``"emap"`` or ``"paper"``.
    k_surface : float or None
        Stiffness of the surface.
    crs : str or None
        Of the world.
    frame : {"sensor", "world"}
        What the scans' coordinates are in, when there are poses.
    layers : tuple of str
        Rasters beside each model: ``count``, ``flag``, ``distance``, ``sigma``.
    memory_bytes : int
        Half of it for the evidence, half for the rasters.
    """

    cell: Length
    sigma: Length
    tol: Length
    window: Length | None
    bounds: Bounds | None = None
    margin: int | None = None
    radius: Length | None = None
    max_gap: Length | None = None
    forget: float = 1.0
    max_weight: float | None = None
    preset: str = "emap"
    k_surface: float | None = None
    crs: str | None = None
    frame: Literal["sensor", "world"] = "sensor"
    layers: tuple[str, ...] = ()
    memory_bytes: int = 1 << 30


class Follower:
    """
    A map and what is said of it scan by scan.

    Parameters
    ----------
    options : FollowOptions
        What to make.
    poses : sequence of Pose, optional
        One for each scan, bad ones included.

    Attributes
    ----------
    map : EMap
        The map.
    n_frames : int
        Scans taken, bad ones included.
    """

    def __init__(self, options: FollowOptions, poses: Sequence[Pose] | None = None) -> None:
        from volatool.emap.live import EMap

        self.options = options
        self.poses = poses
        self.n_frames = 0
        if options.radius is not None and poses is None:
            raise OptionError("--radius needs the sensor's places: give --poses")
        self.crs = _crs(options.crs)
        cell = self._units(options.cell)
        assert cell is not None
        self.map = EMap(
            options.bounds,
            cell,
            sigma=self._units(options.sigma) or 0.0,
            k_surface=options.k_surface,
            preset=options.preset,
            radius=self._units(options.radius),
            margin=options.margin,
            forget=options.forget,
            max_weight=options.max_weight,
            tol=self._units(options.tol) or 0.0,
            max_bytes=options.memory_bytes // 2,
        )

    def take(self, frame: Frame) -> dict[str, Any]:
        """
        Add a scan and bring the window's surface up to date.

        Parameters
        ----------
        frame : Frame
            The scan; counts even if it can't be read.

        Returns
        -------
        record : dict
            As docs/reference/live.md says; everything but ``resources`` is the same in each run.

        Raises
        ------
        InputError
            The scan can't be read, or has no pose: the map is as it was.
        ResourceError
            The evidence or the window would take too much.
        """
        number = self.n_frames
        self.n_frames += 1
        clock = [time.perf_counter()]
        xyz = frame.read()
        pose = self._pose(number, frame)
        if pose is not None and self.options.frame == "sensor":
            xyz = pose.to_world(xyz)
        origin = None if pose is None else pose.place
        clock.append(time.perf_counter())
        count = self.map.update(xyz, origin=origin)
        clock.append(time.perf_counter())
        surface = self._surface(xyz, origin)
        clock.append(time.perf_counter())
        record: dict[str, Any] = {
            "schema": SCHEMA,
            "scan": number,
            "name": frame.name,
            "points": count.n_points,
            "used": count.n_used,
            "dropped": {
                "invalid": count.n_invalid,
                "far": count.n_far,
                "outside": count.n_outside,
            },
            "pose": None if origin is None else [float(value) for value in origin],
            **_described(surface),
            "residual_rmse": None if surface is None else self._residual(xyz, origin, surface),
        }
        read, update, solve = (b - a for a, b in itertools.pairwise(clock))
        record["resources"] = {
            "time": time.time(),
            "seconds": {"read": read, "update": update, "solve": solve},
            "evidence_bytes": self.map.n_bytes,
        }
        return record

    def write(self, path: Path, overwrite: bool) -> list[Path]:
        """
        Write the model of all that was seen, or of the bounds, with its layers.

        Parameters
        ----------
        path : pathlib.Path
            ``NAME.tif``; layers are ``NAME.LAYER.tif`` beside it.
        overwrite : bool
            Whether files that exist may be replaced.

        Returns
        -------
        paths : list of pathlib.Path
            Nothing while no point was seen.
        """
        from typing import cast

        from volatool.dem import geotiff
        from volatool.dem.from_scans import dem_of_scans
        from volatool.scratch import Scratch

        scratch = Scratch(self.options.memory_bytes // 2)
        gap = self._units(self.options.max_gap)
        with_sigma = "sigma" in self.options.layers
        dem = dem_of_scans(self.map, self.crs, max_gap=gap, with_sigma=with_sigma, scratch=scratch)
        if dem is None:
            return []
        tags = {"SCANS": str(self.map.n_scans)}
        with OutputSet(overwrite) as outputs:
            geotiff.write_dem(outputs.add(path), dem, tags=tags)
            for layer in self.options.layers:
                target = outputs.add(layer_path(path, layer))
                geotiff.write_layer(target, dem, cast("Layer", layer), tags=tags)
            return outputs.commit()

    def _units(self, length: Length | None) -> float | None:
        if length is None:
            return None
        return float(length.in_units(self.crs.metres_per_unit_xy or Fraction(1)))

    def _pose(self, number: int, frame: Frame) -> Pose | None:
        if self.poses is None:
            return None
        if number >= len(self.poses):
            raise InputError(
                f"{frame.name or 'stdin'}: scan {number} has no pose, there are {len(self.poses)}"
            )
        return self.poses[number]

    def _surface(self, xyz: Any, origin: Any) -> Window | None:
        """Return the window's surface; None before there is a place for one."""
        import numpy as np

        options, m = self.options, self.map
        side = self._units(options.window)
        if side is None or options.bounds is not None:
            return None if m.grid is None else m.surface
        if origin is None:
            finite = xyz[np.isfinite(xyz).all(axis=1), :2]
            if not len(finite):  # stay where the last scan was
                return m.surface if m.grid is not None else None
            origin = np.median(finite, axis=0)
        return m.window(origin, side)

    def _residual(self, xyz: Any, origin: Any, surface: Window) -> float | None:
        """Root mean square of the used points in the window above its surface."""
        import numpy as np

        box, radius = surface.bounds, self.map.radius
        x, y = xyz[:, 0], xyz[:, 1]
        inside = (x >= box.left) & (x <= box.right) & (y >= box.bottom) & (y <= box.top)
        if radius is not None:
            inside &= (x - origin[0]) ** 2 + (y - origin[1]) ** 2 <= radius**2
        rest = xyz[inside, 2] - self.map.heights_at(xyz[inside])
        rest = rest[np.isfinite(rest)]
        return float(np.sqrt(np.mean(rest * rest))) if len(rest) else None


def layer_path(path: Path, layer: str) -> Path:
    """
    Return the name of a layer beside a model.

    Examples
    --------
    >>> layer_path(Path("out/map.tif"), "flag").as_posix()
    'out/map.flag.tif'
    """
    return path.with_name(f"{path.stem}.{layer}{path.suffix or '.tif'}")


def _described(surface: Window | None) -> dict[str, Any]:
    """Return what the record says of the window."""
    if surface is None:
        return {"window": None, "cells": None, "z_min": None, "z_max": None, "solver": None}
    bounds, grid, info = surface.bounds, surface.grid, surface.info
    measured = int(surface.measured.sum())
    low, high = float(surface.z.min()), float(surface.z.max())
    is_known = math.isfinite(low)
    return {
        "window": {
            "bounds": [bounds.left, bounds.bottom, bounds.right, bounds.top],
            "width": grid.width,
            "height": grid.height,
        },
        "cells": {
            "measured": measured,
            "filled": grid.width * grid.height - measured if is_known else 0,
        },
        "z_min": low if is_known else None,
        "z_max": high if is_known else None,
        "solver": None
        if info is None
        else {
            "iterations": info.iterations,
            "residual": info.residual,
            "converged": info.converged,
        },
    }


def _crs(text: str | None) -> CrsInfo:
    if text is None:
        return METRE
    from volatool.errors import CRSError
    from volatool.points.crs import crs_from_user

    crs = crs_from_user(text)
    if crs.is_geographic:
        raise CRSError(
            f"--crs {text}: scans in degrees can't be mapped; give a projected CRS", "E_GEOGRAPHIC"
        )
    return crs
