"""The experiment's result as Markdown: tables beside the paper's, differences explained."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from volatool.papers.emap_errata import errata
from volatool.papers.emap_experiment import BASELINE, RECOMMENDED
from volatool.papers.emap_scores import SCENARIOS
from volatool.papers.markdown import table

SILENT = (
    "Gazebo is replaced by exact ray casting onto sin(x/pi) sin(y/pi), occlusion included: no "
    "return passes a crest.",
    "Where the paper is silent: sensor level, {sensor_height:g} m above the datum (1 m above the "
    "crests), {rate_hz:g} scans a second, every {every}th scan evaluated, OctoMap's voxels "
    "{octomap_resolution:g} m with the library's own probabilities.",
    "Nodes stay where they are in the world, on multiples of {cell:g} m; the window of {side} x "
    "{side} rolls by whole cells. A net fixed to the sensor would feel the ground slide away.",
    "Returns in range but outside the window count, and {margin} cells around it are solved too. "
    "The rows `-window` solve on the 1600 nodes alone, the rows `-drop` throw the other returns "
    "away as well: that costs more than any choice of springs.",
    "The preset `emap` has bending springs, 10 times as stiff as a point's, and bilinear "
    "attachment; the preset `paper` has stretching springs of a tenth and the nearest node.",
)
"""What is different without being wrong in the paper; filled in from the set-up."""


def to_markdown(document: dict[str, Any], figures: Sequence[str] = ()) -> str:
    """
    Return the report.

    Parameters
    ----------
    document : dict
        Of `volatool.papers.emap_summary.summarize`.
    figures : sequence of str
        File names of the figures, relative to the report.
    """
    setup = document["setup"]
    parts = [
        "# EMap: the paper's experiment",
        f"{setup['runs']} runs of {setup['duration_s']:g} s at {setup['speed']:g} m/s, "
        f"{setup['returns_per_scan']:,.0f} returns a scan, seed {setup['seed']}; "
        f"baseline: {document['baseline'] or 'missing'}; volatool {document['tool']['version']}.",
        *(f"**{warning['code']}**: {warning['message']}" for warning in document["warnings"]),
        "## Table 1",
        "Mean squared error of the surface, weighted by the utility (m^2, mean +- standard "
        "deviation over runs), and how far EMap is below OctoMap. The paper's numbers have no "
        "unit and add up over time: only the per cents compare.",
        _table_1(document),
        "## All methods",
        "Per cent below OctoMap (worst run in brackets); RMSE, MAE and bias of all nodes in "
        "millimetres.",
        _methods(document),
        "## Normalized",
        "RMSE in millimetres where each utility looks: the root of sum F^2 e^2 / sum F^2.",
        _normalized(document),
    ]
    if "resources" in document:
        parts += [
            "## Time of a loop",
            "Add a scan and solve, CPU milliseconds, window only (the paper: 50 ms at 1600 nodes).",
            _loops(document),
        ]
    if figures:
        parts += ["## Figures", *(f"![{name}]({name})" for name in figures)]
    parts += [
        "## Differences to the paper",
        "\n".join(f"- {line.format(**setup)}" for line in SILENT),
        "## Errata",
        table(
            ("", "the paper", "here", "measured in this run"),
            [tuple(erratum) for erratum in errata(document)],
        ),
    ]
    return "\n\n".join(parts) + "\n"


def _percent(value: float | None) -> str:
    if value is None:
        return "-"
    return f"{value:.1f}" if value > -1000 else f"{value:.0e}"


def _millimetres(value: float) -> str:
    return f"{1000 * value:.1f}" if value < 100 else f"{1000 * value:.0e}"


def _table_1(document: dict[str, Any]) -> str:
    rows = []
    for scenario in SCENARIOS:
        row = document["scenarios"][scenario.key]
        octomap = (
            "-"
            if row["octomap_mse"] is None
            else f"{row['octomap_mse']:.2e} +- {row['octomap_std']:.0e}"
        )
        rows.append(
            (
                scenario.title,
                octomap,
                f"{row['emap_mse']:.2e} +- {row['emap_std']:.0e}",
                f"**{_percent(row['improvement_percent'])}**",
                _percent(row["worst_run_percent"]),
                f"{scenario.paper_octomap[0]:g} +- {scenario.paper_octomap[1]:g}",
                f"{scenario.paper_emap[0]:g} +- {scenario.paper_emap[1]:g}",
                f"{scenario.paper_percent:g}",
            )
        )
    head = ("", "OctoMap", "EMap", "better by %", "worst run %")
    return table((*head, "paper: OctoMap", "paper: EMap", "paper: %"), rows)


def _methods(document: dict[str, Any]) -> str:
    rows = []
    for key, method in document["methods"].items():
        cells = []
        for scenario in SCENARIOS:
            score = method["scenarios"][scenario.key]
            best, worst = score["improvement_percent"], score["worst_run_percent"]
            has = best is not None and key != BASELINE
            cells.append(f"{_percent(best)} ({_percent(worst)})" if has else "-")
        sizes = [_millimetres(method[name]) for name in ("rmse", "mae", "bias")]
        rows.append((f"`{key}`", method["title"], *cells, *sizes))
    titles = [scenario.title for scenario in SCENARIOS]
    return table(("", "method", *titles, "RMSE", "MAE", "bias"), rows)


def _normalized(document: dict[str, Any]) -> str:
    rows = []
    for key in (BASELINE, RECOMMENDED):
        if key in document["methods"]:
            scores = document["methods"][key]["scenarios"]
            sizes = [_millimetres(scores[s.key]["normalized_mse"] ** 0.5) for s in SCENARIOS]
            rows.append((f"`{key}`", *sizes))
    return table(("", *(scenario.title for scenario in SCENARIOS)), rows)


def _loops(document: dict[str, Any]) -> str:
    rows = [
        (
            f"{loop['nodes']:,}",
            f"{1000 * loop['update_s']:.2f}",
            f"{1000 * loop['solve_s']:.2f}",
            f"{1000 * loop['loop_s']:.2f}",
            f"{1e6 * loop['loop_s'] / loop['nodes']:.2f}",
        )
        for loop in document["resources"]["loop"]
    ]
    return table(("nodes", "add the scan", "solve", "loop", "microseconds a node"), rows)
