"""The EMap paper's Figures 4 to 6 as PNG, by matplotlib (extra ``figures``)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from volatool.papers.emap_experiment import BASELINE, CELL, RECOMMENDED, SIDE, Run
from volatool.papers.figures import new_figure, save

NAMES = {
    "figure-4": "figure-4-error-map.png",
    "figure-5": "figure-5-along-the-drive.png",
    "figure-6": "figure-6-time.png",
}

# three of Okabe and Ito's colours, told apart by colour-blind readers and in grey
_COLOURS = {BASELINE: "#d55e00", RECOMMENDED: "#0072b2", "paper": "#555555"}
_STYLES = {BASELINE: "--", RECOMMENDED: "-", "paper": ":"}
_LABELS = {
    BASELINE: "OctoMap, 0.1 m",
    RECOMMENDED: "EMap, recommended",
    "paper": "EMap, preset paper with margin",
}
_PAPER_LOOP = (1600, 50.0)
"""Nodes and milliseconds, as the paper says."""


def error_map(runs: Sequence[Run], path: Path) -> None:
    """
    Draw the root mean square error around the sensor, and how often which error occurs.

    Parameters
    ----------
    runs : sequence of Run
        Errors; OctoMap's panel is left out without the baseline.
    path : pathlib.Path
        PNG to write.
    """
    from matplotlib.colors import LogNorm

    keys = [key for key in (BASELINE, RECOMMENDED) if key in runs[0].errors]
    errors = {key: np.concatenate([run.errors[key] for run in runs]) for key in keys}
    maps = {key: np.sqrt(np.mean(value**2, axis=0)) for key, value in errors.items()}
    half = SIDE * CELL / 2
    figure = new_figure(4.1 * (len(keys) + 1) + 0.6, 4.3)
    axes = figure.subplots(1, len(keys) + 1)
    norm = LogNorm(min(m.min() for m in maps.values()), max(m.max() for m in maps.values()))
    image = None
    for ax, key in zip(axes, keys, strict=False):
        image = ax.imshow(maps[key], norm=norm, cmap="cividis", extent=(-half, half, -half, half))
        ax.plot(0, 0, "o", color="white", markeredgecolor="black", markersize=6)
        arrow = {"arrowstyle": "->", "color": "white", "linewidth": 1.6}
        ax.annotate("", xy=(1.6, 0), xytext=(0.2, 0), arrowprops=arrow)
        total = np.sqrt(np.mean(errors[key] ** 2))
        ax.set_title(f"{_LABELS[key]}: RMSE {total * 1000:.0f} mm", fontsize=10)
        ax.set_xlabel("ahead of the sensor (m)")
        ax.set_ylabel("left of the sensor (m)")
    figure.colorbar(image, ax=axes[: len(keys)], label="RMSE of a node (m)", shrink=0.8)
    ax = axes[-1]
    bins = np.geomspace(1e-6, 3, 80)
    for key in keys:
        sizes = np.clip(np.abs(errors[key]), bins[0], bins[-1])
        weights = np.full(sizes.size, 100 / sizes.size)
        ax.hist(
            sizes.ravel(),
            bins,
            weights=weights,
            histtype="step",
            color=_COLOURS[key],
            linestyle=_STYLES[key],
            linewidth=1.6,
            label=_LABELS[key],
        )
    ax.set_xscale("log")
    ax.set_xlim(1e-5, 3)
    ax.set_xlabel("size of the error of a node (m)")
    ax.set_ylabel("nodes (%)")
    ax.set_title("How often", fontsize=10)
    ax.legend(fontsize=8, loc="upper left")
    ax.grid(alpha=0.3)
    figure.suptitle(
        f"Error of the 10 m x 10 m surface over {len(errors[keys[0]])} scans of {len(runs)} runs"
    )
    save(figure, path)


def along_the_drive(document: dict[str, Any], path: Path) -> None:
    """
    Draw the error after each evaluated scan, with its range over the runs.

    Parameters
    ----------
    document : dict
        Of `volatool.papers.emap_summary.summarize`.
    path : pathlib.Path
        PNG to write.
    """
    along = document["along"]
    figure = new_figure(8.2, 4.4)
    ax = figure.subplots()
    for key, colour in _COLOURS.items():
        if key in along["rmse"]:
            curve = along["rmse"][key]
            ax.fill_between(
                along["x"], curve["least"], curve["most"], color=colour, alpha=0.18, linewidth=0
            )
            ax.plot(
                along["x"],
                curve["mean"],
                color=colour,
                linestyle=_STYLES[key],
                linewidth=1.8,
                label=_LABELS[key],
            )
    ax.set_yscale("log")
    ax.set_xlim(0, None)
    ax.set_xlabel("way driven (m)")
    ax.set_ylabel("RMSE of the 1600 nodes (m)")
    ax.set_title(
        f"Error along the drive: {document['setup']['runs']} runs (band: least to largest)"
    )
    ax.grid(alpha=0.3, which="both")
    ax.legend()
    save(figure, path)


def time_against_nodes(document: dict[str, Any], path: Path) -> None:
    """
    Draw the CPU time of a loop against the number of nodes.

    Parameters
    ----------
    document : dict
        Of `summarize`, with ``resources``.
    path : pathlib.Path
        PNG to write.
    """
    loops = document["resources"]["loop"]
    nodes = np.array([loop["nodes"] for loop in loops])
    figure = new_figure(7.0, 4.6)
    ax = figure.subplots()
    blue = _COLOURS[RECOMMENDED]
    total = np.array([loop["loop_s"] for loop in loops]) * 1000
    update = np.array([loop["update_s"] for loop in loops]) * 1000
    ax.plot(nodes, total, "o-", color=blue, label="EMap, recommended: add a scan and solve")
    ax.plot(nodes, update, "s:", color="#555555", markersize=4, label="of which: add the scan")
    ax.plot(nodes, total[-1] * nodes / nodes[-1], "-", color="#999999", linewidth=1, label="linear")
    ax.plot(*_PAPER_LOOP, "D", color=_COLOURS[BASELINE], label="the paper: 1600 nodes, 50 ms")
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.set_xlabel("nodes")
    ax.set_ylabel("CPU time of a loop (ms)")
    ax.set_title("Time of a loop against nodes in a window of 10 m x 10 m")
    ax.set_xticks(nodes, [f"{n:,}" for n in nodes], fontsize=8)
    ax.minorticks_off()
    ax.grid(alpha=0.3)
    ax.legend(fontsize=9)
    save(figure, path)
