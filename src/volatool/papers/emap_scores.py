"""How the EMap paper judges a surface: four utility functions and the errors they weight."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from volatool.model import F64

R_NEAREST = 0.25
"""Metres: the paper's "nearest" nodes."""

R_GAUSS = 6.0
"""Metres: where the Gaussian utility has its peak."""

R_STEP = 4.0
"""Metres: where the CDF utility is a half."""


def _erf(values: F64) -> F64:
    # scipy is no dependency of volatool; thousands of nodes, not millions
    return np.array([math.erf(value) for value in values.ravel()]).reshape(values.shape)


def raw(r: F64) -> F64:
    """Return 1 at all distances ``r`` in metres."""
    return np.ones_like(r)


def nearest(r: F64) -> F64:
    """Return 1 nearer than `R_NEAREST`, else 0 ([Lock2022]_, equation 5)."""
    return (r < R_NEAREST).astype(np.float64)


def gaussian(r: F64) -> F64:
    """Return ``exp(-1/2 (r - 6)^2)``: [Lock2022]_, equation 6, with its sign put right."""
    return np.asarray(np.exp(-0.5 * (r - R_GAUSS) ** 2), np.float64)


def cdf(r: F64) -> F64:
    """Return ``1 - 1/2 (1 + erf((r - 4) / sqrt 2))``: equation 7, the root put into the erf."""
    return 1 - 0.5 * (1 + _erf((r - R_STEP) / math.sqrt(2)))


def gaussian_as_printed(r: F64) -> F64:
    """Return ``exp(-1/2 (r + 6)^2)``, equation 6 as printed."""
    return np.asarray(np.exp(-0.5 * (r + R_GAUSS) ** 2), np.float64)


def cdf_as_printed(r: F64) -> F64:
    """Return ``1 - 1/2 (1 + erf(r - 4) / sqrt 2)``, equation 7 as printed."""
    return 1 - 0.5 * (1 + _erf(r - R_STEP) / math.sqrt(2))


@dataclass(frozen=True, slots=True)
class Scenario:
    """
    A row of the paper's Table 1.

    Parameters
    ----------
    key, title : str
        Name in the JSON, and in the table.
    utility : callable
        Weight F of a node by its distance to the sensor.
    paper_octomap, paper_emap : tuple of 2 float
        Printed mean and standard deviation; no unit is given.
    paper_percent : float
        Printed improvement.
    """

    key: str
    title: str
    utility: Callable[[F64], F64]
    paper_octomap: tuple[float, float]
    paper_emap: tuple[float, float]
    paper_percent: float


SCENARIOS = (
    Scenario("raw", "Raw", raw, (74.6, 18.2), (45.8, 6.3), 38.6),
    Scenario("nearest", "Nearest", nearest, (88.8, 51.4), (50.0, 25.6), 43.7),
    Scenario("gaussian", "Gaussian", gaussian, (1.21, 1.19), (0.86, 0.67), 28.9),
    Scenario("cdf", "CDF", cdf, (0.93, 0.58), (0.59, 0.32), 36.6),
)


def weighted_mse(errors: F64, utility: F64) -> F64:
    """
    Equation 4 of [Lock2022]_ as a mean: of the squared errors times the squared utility.

    Parameters
    ----------
    errors : (..., side, side) array of float64
        Errors at the nodes, in metres.
    utility : array of float64
        F of each node, same shape.

    Returns
    -------
    mse : (...) array of float64
        Mean over the nodes of ``(F e)^2``, in square metres.
    """
    return np.asarray(np.mean((errors * utility) ** 2, axis=(-2, -1)), np.float64)


def range_within(errors: F64, r: F64, threshold: float) -> float:
    """
    Largest radius inside of which the root mean square error stays below a threshold.

    Parameters
    ----------
    errors : array of float64
        Errors at the nodes of any number of scans, in metres.
    r : array of float64, same shape
        Distance of the nodes to the sensor, in metres.
    threshold : float
        Metres.

    Returns
    -------
    radius : float
        Metres; nodes at one distance count together. 0 when no radius will do; the distance of
        the farthest node when all do.
    """
    squares = (errors**2).ravel()
    distances = r.ravel().round(9)
    order = np.argsort(distances, kind="stable")
    distances = distances[order]
    sums = np.cumsum(squares[order])
    last = np.append(distances[1:] != distances[:-1], True)
    rmse = np.sqrt(sums / np.arange(1, len(sums) + 1))
    good = distances[last & (rmse <= threshold)]
    return float(good[-1]) if len(good) else 0.0


def percent(ours: float, theirs: float) -> float:
    """Return by how many per cent an error is below another."""
    return 100 * (1 - ours / theirs)


def spread(values: NDArray[np.float64]) -> float:
    """Return the standard deviation over runs; 0 for a single run."""
    return float(np.std(values, ddof=1)) if len(values) > 1 else 0.0
