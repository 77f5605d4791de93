"""How far a DEM is off at points that it has not seen: near data and in gaps."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from volatool.dem.gather import SurfacePoints
from volatool.dem.sigma import Ensemble, distances_at, fit, scale_at, unit_errors_at
from volatool.dem.split import part, some, split
from volatool.dem.surfaces import Dem
from volatool.emap.system import windows
from volatool.model import F64
from volatool.scratch import Scratch

NEAR_SPACINGS, NEAR_CELLS = 3.0, 1.5
"""A point is near data up to so many mean spacings, or cells, whichever is more."""


MAX_TEST = 1 << 22
"""Held-out points that are looked at, about: bounds memory and time."""


def assess(
    points: SurfacePoints,
    dem: Dem,
    percent: float,
    make: Callable[[SurfacePoints], Dem],
    sigma: float | None = None,
) -> dict[str, Any]:
    """
    Return how far a DEM made without some of the points is off at them.

    Half of the points held out are scattered, half are in whole blocks (`split`).

    Parameters
    ----------
    points : SurfacePoints
        The points of the DEM.
    dem : Dem
        The DEM of all points: its cells and spacing are used.
    percent : float
        How many to hold out.
    make : callable
        Makes the DEM of the others, in the same way and on the same cells.
    sigma : float, optional
        The points' noise, when it is known.

    Returns
    -------
    document : dict
        The report's ``dem.holdout``: ``percent``, ``n`` points held out, ``void`` of them where
        the DEM of the others has no height, ``near_within`` (horizontal unit) and, for points with
        data so near and for the others (``near``, ``gaps``), ``n``, ``rmse``, ``mae``, ``bias``
        (DEM minus point), ``p95`` of the absolute error (vertical unit) and the parts of the
        points inside the 68 % and 95 % intervals, null when no standard errors are known.
    """
    scratch, crs = dem.scratch, dem.crs
    spacing = dem.spacing or dem.grid.cell
    within = max(NEAR_SPACINGS * spacing, NEAR_CELLS * dem.grid.cell)
    half = percent / 200
    errors = ratios = np.empty(0)
    near = np.empty(0, bool)
    n_held = 0
    if len(points):
        chosen = split(points, half, half, spacing, crs.metres_per_unit_xy)
        train = part(points, chosen, held=False)
        test = some(part(points, chosen, held=True), MAX_TEST, scratch)
        n_held = len(test)
    if n_held and len(train):
        other = make(train)
        errors = errors_at(other, test)
        distance = distances_at(train, test, dem.grid, scratch)
        near = distance <= within
        ratios = np.abs(errors) / _spreads(train, test, other, distance, sigma, scratch)
        scratch.free(distance)
        other.free()
        test.close()
    known = np.isfinite(errors)
    return {
        "percent": percent,
        "n": n_held,
        "void": int(np.count_nonzero(~known)),
        "near_within": within,
        "near": _group(errors[known & near], ratios[known & near]),
        "gaps": _group(errors[known & ~near], ratios[known & ~near]),
    }


def errors_at(dem: Dem, points: SurfacePoints) -> F64:
    """
    Return DEM minus point, bilinear between the cells' centres; NaN where the DEM is void.

    Parameters
    ----------
    dem : Dem
        The model.
    points : SurfacePoints
        Points.
    """
    from volatool.kernels import spring

    height, width = dem.z.shape
    z = dem.z
    if min(height, width) < 2:  # bilinear reading needs two a side
        z = np.pad(z, ((0, 2 - min(height, 2)), (0, 2 - min(width, 2))), mode="edge")
        height, width = z.shape
    out = np.empty(len(points))
    start = 0
    for rows in points.pieces():
        col, row = dem.grid.places(rows, points.scale, points.offset)
        found = np.empty(len(rows))
        for first, last in windows(dem.scratch, height, width, z):
            spring.interpolate(z, col, row, False, first, last, found)
            dem.scratch.relax(z, first, last)
        heights = rows[:, 2] * points.scale[2] + points.offset[2]
        out[start : start + len(rows)] = found - heights
        start += len(rows)
    return out


def _spreads(
    train: SurfacePoints,
    test: SurfacePoints,
    dem: Dem,
    distance: F64,
    sigma: float | None,
    scratch: Scratch,
) -> F64:
    """Return the standard deviation expected of each error; NaN when it is not known."""
    model = None
    if dem.tuned is not None and dem.spacing is not None:
        model = fit(
            train, dem.grid, dem.tuned, dem.noise, dem.spacing, dem.crs, scratch, sigma
        )  # fmt: skip
    if model is None:
        return np.full(len(test), np.nan)
    ensemble = Ensemble(train, model.tuned, dem.grid, scratch)
    evidence = ensemble.evidence()
    unit = unit_errors_at(ensemble, evidence, test)
    evidence.free()
    spreads = scale_at(model, test, distance) * np.sqrt(1 + np.square(unit))
    scratch.free(unit)
    return np.asarray(spreads)


def _group(errors: F64, ratios: F64) -> dict[str, Any]:
    """Return the figures of some points; null without any."""
    if not len(errors):
        names = ("rmse", "mae", "bias", "p95", "coverage_68", "coverage_95")
        return {"n": 0, **dict.fromkeys(names)}
    size: NDArray[np.float64] = np.abs(errors)
    has_spread = bool(np.isfinite(ratios).all())
    return {
        "n": len(errors),
        "rmse": float(np.sqrt(np.mean(np.square(errors)))),
        "mae": float(size.mean()),
        "bias": float(errors.mean()),
        "p95": float(np.quantile(size, 0.95)),
        "coverage_68": float(np.mean(ratios <= 1)) if has_spread else None,
        "coverage_95": float(np.mean(ratios <= 1.96)) if has_spread else None,
    }
