"""The experiment's numbers as one JSON object: scenarios, methods, effects of the errata."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from volatool._version import __version__
from volatool.errors import CodedWarning
from volatool.model import F64
from volatool.papers import emap_octomap
from volatool.papers.emap_experiment import (
    BASELINE,
    CELL,
    MARGIN,
    METHODS,
    RECOMMENDED,
    RESOLUTION,
    SIDE,
    WIDE,
    Run,
)
from volatool.papers.emap_scene import Drive
from volatool.papers.emap_scores import (
    SCENARIOS,
    cdf,
    cdf_as_printed,
    gaussian,
    gaussian_as_printed,
    percent,
    range_within,
    spread,
    weighted_mse,
)
from volatool.papers.emap_timing import LoopTime

SCHEMA = "volatool.reproduce_emap/1"

RANGES = (0.02, 0.05, 0.1)
"""Metres of RMSE for which a range is given."""


def summarize(
    drive: Drive, runs: Sequence[Run], times: Sequence[LoopTime] | None = None
) -> dict[str, Any]:
    """
    Return the result of the experiment.

    Parameters
    ----------
    drive : Drive
        The set-up.
    runs : sequence of Run
        Errors; at least one run.
    times : sequence of LoopTime, optional
        Figure 6; left out if not given, as it is never twice the same.

    Returns
    -------
    document : dict
        See docs/reference/reproduce-emap.md. Errors in metres, MSE in square metres; null where
        the OctoMap baseline would be needed and is missing.
    """
    keys = [method.key for method in METHODS if method.key in runs[0].errors]
    scores = {key: _scores(runs, key) for key in keys}
    baseline = scores.get(BASELINE)
    document = {
        "schema": SCHEMA,
        "tool": {"name": "volatool", "version": __version__},
        "setup": {
            **drive.to_dict(),
            "runs": len(runs),
            "side": SIDE,
            "cell": CELL,
            "margin": MARGIN,
            "octomap_resolution": RESOLUTION,
            "returns_per_scan": sum(run.n_points for run in runs) / len(runs) / drive.n_scans,
        },
        "baseline": emap_octomap.version() if baseline else None,
        "scenarios": {
            scenario.key: {
                "octomap_mse": None,
                "octomap_std": None,
                "emap_mse": scores[RECOMMENDED][scenario.key].mean(),
                "emap_std": spread(scores[RECOMMENDED][scenario.key]),
                **_improvement(scores, RECOMMENDED, scenario.key),
                "paper_octomap": scenario.paper_octomap[0],
                "paper_emap": scenario.paper_emap[0],
                "paper_percent": scenario.paper_percent,
            }
            | (
                {
                    "octomap_mse": baseline[scenario.key].mean(),
                    "octomap_std": spread(baseline[scenario.key]),
                }
                if baseline
                else {}
            )
            for scenario in SCENARIOS
        },
        "methods": {
            method.key: _method(runs, scores, method.key, method.title)
            for method in METHODS
            if method.key in keys
        },
        "along": _along(drive, runs, keys),
        "effects": _effects(runs, scores),
        "warnings": [warning.to_dict() for warning in warnings(has_baseline=baseline is not None)],
    }
    if times is not None:
        document["resources"] = {"loop": [entry.to_dict() for entry in times]}
    return document


def warnings(*, has_baseline: bool) -> list[CodedWarning]:
    """Return what is missing from the experiment."""
    if has_baseline:
        return []
    return [CodedWarning("W_NO_OCTOMAP", f"{emap_octomap.MISSING}; per cents are left out")]


def _scores(runs: Sequence[Run], key: str) -> dict[str, F64]:
    """Mean over time of each scenario's MSE, a value a run."""
    return {
        scenario.key: np.array(
            [weighted_mse(run.errors[key], scenario.utility(run.distance)).mean() for run in runs]
        )
        for scenario in SCENARIOS
    }


def _improvement(
    scores: dict[str, dict[str, F64]], key: str, scenario: str
) -> dict[str, float | None]:
    """Per cent below OctoMap: of the means, and of the worst run."""
    if BASELINE not in scores:
        return {"improvement_percent": None, "worst_run_percent": None}
    ours, theirs = scores[key][scenario], scores[BASELINE][scenario]
    return {
        "improvement_percent": percent(ours.mean(), theirs.mean()),
        "worst_run_percent": min(map(percent, ours.tolist(), theirs.tolist())),
    }


def _method(
    runs: Sequence[Run], scores: dict[str, dict[str, F64]], key: str, title: str
) -> dict[str, Any]:
    errors = np.array([run.errors[key] for run in runs])
    mse = scores[key]["raw"].mean()
    result = {
        "title": title,
        "rmse": np.sqrt(mse),
        "mae": np.abs(errors).mean(),
        "bias": errors.mean(),
        "scenarios": {
            scenario.key: {
                "mse": scores[key][scenario.key].mean(),
                "std": spread(scores[key][scenario.key]),
                "normalized_mse": scores[key][scenario.key].mean()
                / np.mean([np.mean(scenario.utility(run.distance) ** 2) for run in runs]),
                **_improvement(scores, key, scenario.key),
            }
            for scenario in SCENARIOS
        },
    }
    if key in runs[0].wide:
        wide = np.array([run.wide[key] for run in runs])
        r = np.array([run.wide_distance for run in runs])
        half = wide.shape[1] // 2
        mse = float(np.mean(wide**2))
        result["wide"] = {
            "side": WIDE,
            "mse": mse,
            "improvement_percent": percent(
                mse, float(np.mean([run.wide[BASELINE] ** 2 for run in runs]))
            )
            if BASELINE in runs[0].wide
            else None,
            "range_by_rmse": {f"{t:g}": range_within(wide, r, t) for t in RANGES},
            "range_by_rmse_second_half": {
                f"{t:g}": range_within(wide[:, half:], r[:, half:], t) for t in RANGES
            },
        }
    return result


def _along(drive: Drive, runs: Sequence[Run], keys: Sequence[str]) -> dict[str, Any]:
    """RMSE after each evaluated scan: over all runs, and the least and largest of a run."""
    numbers = np.arange(drive.n_evaluated) * drive.every + drive.every - 1
    result: dict[str, Any] = {"x": (numbers / drive.rate_hz * drive.speed).tolist(), "rmse": {}}
    for key in keys:
        mse = np.array([np.mean(run.errors[key] ** 2, axis=(1, 2)) for run in runs])
        result["rmse"][key] = {
            "mean": np.sqrt(mse.mean(axis=0)).tolist(),
            "least": np.sqrt(mse.min(axis=0)).tolist(),
            "most": np.sqrt(mse.max(axis=0)).tolist(),
        }
    return result


def _effects(runs: Sequence[Run], scores: dict[str, dict[str, F64]]) -> dict[str, Any]:
    """Return what the errata amount to, beside what other parts of the document say."""
    r = np.concatenate([run.distance for run in runs])
    shown = [key for key in (BASELINE, RECOMMENDED) if key in scores]
    errors = {key: np.concatenate([run.errors[key] for run in runs]) for key in shown}

    def means(utility: F64) -> dict[str, float]:
        return {key: float(weighted_mse(errors[key], utility).mean()) for key in shown}

    return {
        "share_of_nodes_without_return": float(np.mean([run.empty for run in runs])),
        "gaussian_as_printed": {
            "largest_weight": float(gaussian_as_printed(r).max()),
            "mse": means(gaussian_as_printed(r)),
        },
        "cdf_as_printed": {
            "largest_weight": float(cdf_as_printed(r).max()),
            "least_weight": float(cdf_as_printed(r).min()),
            "mse": means(cdf_as_printed(r)),
        },
        "least_gaussian_plus_cdf_squared": float((gaussian(r) ** 2 + cdf(r) ** 2).min()),
        "gaussian_plus_cdf_over_raw": {
            key: float((scores[key]["gaussian"] + scores[key]["cdf"]).mean())
            / float(scores[key]["raw"].mean())
            for key in shown
        },
        "sum_over_time": {
            key: float(scores[key]["raw"].mean()) * len(runs[0].errors[key]) for key in shown
        },
    }
