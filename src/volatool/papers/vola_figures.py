"""The VOLA paper's Figures 1 to 8 as PNG, by matplotlib (extra ``figures``)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from volatool.model import F64
from volatool.naming import VOLUME_SUFFIXES, stem
from volatool.papers.figures import new_figure, save
from volatool.papers.vola_density import DensityMap
from volatool.papers.vola_scene import SIDE, surface
from volatool.papers.vola_tiles import Tile
from volatool.pictures.marks import unit_name
from volatool.vola.volume import Volume

MOST_TILES = 8
"""Tiles that get pictures of their own."""

SUBDIVISION = "figure-1-to-3-subdivision.png"
LOOK_UPS = "table-1-look-ups.png"
PACKING = "figure-8-packing.png"

_DENSE, _SPARSE, _OTHER, _QUIET = "#d55e00", "#0072b2", "#009e73", "#555555"
_FACES = ((0.94, 0.80, 0.55), (0.72, 0.52, 0.30), (0.84, 0.66, 0.42))
"""Top, and the two sides that are seen."""
_POINTS = 60_000
_PANE = 520
_COLOURS = 128


def tile_names(paths: Sequence[Path]) -> dict[Path, dict[str, str]]:
    """
    Return the names of the pictures that tiles get.

    Parameters
    ----------
    paths : sequence of pathlib.Path
        Inputs.

    Returns
    -------
    names : dict
        By path ``"levels"``, and ``"density"`` for inputs with points; of the first `MOST_TILES`.
        Inputs of one name are numbered.
    """
    names: dict[Path, dict[str, str]] = {}
    taken: set[str] = set()
    for number, path in enumerate(paths[:MOST_TILES], 1):
        name = stem(path)
        if name in taken:
            name = f"{name}-{number}"
        taken.add(name)
        names[path] = {"levels": f"figure-1-to-3-levels-{name}.png"}
        if not path.name.lower().endswith(VOLUME_SUFFIXES):
            names[path]["density"] = f"figure-4-to-7-density-{name}.png"
    return names


def subdivision(path: Path) -> None:
    """
    Draw one cube at levels 1, 2 and 3 (Figures 1 to 3).

    Parameters
    ----------
    path : pathlib.Path
        PNG to write.
    """
    volume = surface(_POINTS)
    figure = new_figure(12.6, 4.9)
    for level, ax in enumerate(figure.subplots(1, 3), 1):
        _cubes(ax, volume, level)
        ax.set_title(
            f"Level {level}: {volume.n_cells(level):,} of {64**level:,} cells set,\n"
            f"{volume.n_blocks(level):,} {'word' if level == 1 else 'words'}; "
            f"a cell is {SIDE / 4**level:g} m",
            fontsize=11,
        )
    figure.suptitle("One cube of 100 m, each level divided by 4 along each axis", fontsize=13)
    save(figure, path, colours=_COLOURS)


def _project(places: F64) -> F64:
    """Return places on the picture: seen from above, from the side of small x and small y."""
    x, y, z = places[..., 0], places[..., 1], places[..., 2]
    return np.stack([0.866 * (x - y), 0.5 * (x + y) * 0.9 + z], axis=-1)


def _cubes(ax: Any, volume: Volume, level: int) -> None:
    """Draw the cells set at a level as cubes, far ones first, in the cube's frame."""
    from matplotlib.collections import LineCollection, PolyCollection

    held = volume.voxels(level).astype(np.int64)
    held = held[np.argsort(held[:, 2] - held[:, 0] - held[:, 1], kind="stable")]
    cells = held.astype(np.float64)
    beside = np.array([[0, 0, 1], [0, -1, 0], [-1, 0, 0]])
    is_open = ~volume.contains_cells((held[:, None] + beside).reshape(-1, 3), level)
    corners = np.array(
        [
            [[0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]],  # top
            [[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]],  # y = 0
            [[0, 0, 0], [0, 1, 0], [0, 1, 1], [0, 0, 1]],  # x = 0
        ],
        np.float64,
    )
    size = 4.0**level
    faces = _project((cells[:, None, None] + corners) / size).reshape(-1, 4, 2)[is_open]
    colours = np.tile(np.array(_FACES), (len(cells), 1))
    # lower is darker, so that the shape shows without any other light
    colours *= np.repeat(0.62 + 0.38 * cells[:, 2] / max(cells[:, 2].max(), 1), 3)[:, None]
    colours = colours[is_open]
    edges: Any = "face" if level > 2 else "#5a4630"
    ax.add_collection(
        PolyCollection(list(faces), facecolors=colours, edgecolors=edges, linewidths=0.3, zorder=2)
    )
    unit = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float64)
    pairs = [(a, b) for a in range(8) for b in range(a) if np.abs(unit[a] - unit[b]).sum() == 1]
    hidden = 7 & ~1  # the far corner below: x = y = 1, z = 0
    for behind in (True, False):
        lines = [_project(unit[list(p)]) for p in pairs if (hidden in p) is behind]
        style = ":" if behind else "-"
        ax.add_collection(
            LineCollection(lines, colors=_QUIET, linewidths=0.9, linestyles=style, zorder=1)
        )
    ax.set_xlim(-0.9, 0.9)
    ax.set_ylim(-0.03, 1.93)
    ax.set_aspect("equal")
    ax.set_axis_off()


def levels(tile: Tile, path: Path) -> None:
    """
    Draw a tile's voxels level by level (Figures 1 to 3 on real data).

    Parameters
    ----------
    tile : Tile
        Its volume.
    path : pathlib.Path
        PNG to write.
    """
    from volatool.pictures.oblique import Oblique, sky

    volume = tile.volume
    shown = range(max(1, volume.depth - 3), volume.depth + 1)
    columns = min(2, len(shown))
    rows = -(-len(shown) // columns)
    figure = new_figure(4.2 * columns, 3.05 * rows + 0.4)
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    unit = unit_name(volume.crs.unit_xy) or "units"
    for ax in axes:
        ax.set_axis_off()
    azimuth = Oblique(volume, _PANE, int(0.66 * _PANE)).azimuth
    for ax, level in zip(axes, shown, strict=False):
        view = Oblique(volume.truncated(level), _PANE, int(0.66 * _PANE), azimuth)
        page = sky(_PANE, int(0.66 * _PANE))
        at = ((page.width - view.image.width) // 2, (page.height - view.image.height) // 2)
        page.paste(view.image, at, view.mask)
        ax.imshow(np.asarray(page))
        count = volume.n_cells(level)
        ax.set_title(
            f"Level {level}: {count:,} cells of {volume.cell(level):.3g} {unit}, "
            f"occupancy {100 * count / (64 * volume.n_blocks(level)):.1f} %",
            fontsize=9,
        )
    figure.suptitle(tile.path.name, fontsize=12)
    save(figure, path, colours=_COLOURS)


def density(tile: Tile, path: Path) -> None:
    """
    Draw points per square metre (Figures 4 to 7), colours by logarithm.

    Parameters
    ----------
    tile : Tile
        With a density map.
    path : pathlib.Path
        PNG to write.
    """
    from matplotlib.colors import LogNorm

    made = tile.density
    assert made is not None
    crs = tile.volume.crs
    metres = crs.metres_per_unit_xy
    values = made.per_area(None if metres is None else float(metres))
    unit = unit_name(crs.unit_xy) or "units"
    area = "square metre" if metres is not None else "square unit"
    covered = values[values > 0]
    figure = new_figure(*_page(made))
    ax = figure.subplots()
    left, bottom = made.bounds.left, made.bounds.bottom
    low, high = np.percentile(covered, (1, 99))
    image = ax.imshow(
        np.ma.masked_equal(values, 0),
        origin="lower",
        extent=(0, made.bounds.right - left, 0, made.bounds.top - bottom),
        norm=LogNorm(max(low, 1e-9), max(high, low * 1.5)),
        cmap="viridis",
        interpolation="nearest",
    )
    ax.set_facecolor("#e4e4e4")
    bar = figure.colorbar(image, ax=ax, label=f"points per {area}", extend="both")
    _plain_ticks(bar.ax.yaxis)
    ax.set_xlabel(f"east of {left:,.10g} ({unit})")
    ax.set_ylabel(f"north of {bottom:,.10g} ({unit})")
    ax.set_title(
        f"{tile.path.name}: {made.counts.sum():,} points, cells of {made.cell:g} {unit}\n"
        f"median {_short(np.median(covered))} where there are any, middle 90 % "
        f"{_short(np.percentile(covered, 5))} to {_short(np.percentile(covered, 95))}; "
        "grey: none",
        fontsize=9.5,
    )
    save(figure, path)  # all colours: they are values


def _short(value: float) -> str:
    """Return three digits, never as a power of ten."""
    return f"{float(f'{value:.3g}'):,g}"


def _page(made: DensityMap) -> tuple[float, float]:
    """Return width and height of a page, inches, that fits a map."""
    height, width = made.counts.shape
    scale = 5.4 / max(height, width)
    return max(width * scale, 3.6) + 2.2, max(height * scale, 2.2) + 1.3


def _plain_ticks(axis: Any) -> None:
    """Label a logarithmic axis with plain numbers, at 1, 2 and 5 times powers of ten."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axis.set_major_locator(LogLocator(10, subs=(1, 2, 5)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def look_ups(document: dict[str, Any], path: Path) -> None:
    """
    Draw time and memory against depth (Table 1).

    Parameters
    ----------
    document : dict
        Of `volatool.papers.vola_summary.summarize`, with ``resources``.
    path : pathlib.Path
        PNG to write.
    """
    figure = new_figure(11.4, 4.6)
    left, right = figure.subplots(1, 2)
    rows = document["resources"]["lookups"]["depths"]
    for key, label, colour, style in (
        ("dense_ns", "dense: one word", _DENSE, "s-"),
        ("sparse_ns", "sparse with counts, any order", _SPARSE, "o-"),
        ("in_order_ns", "sparse with counts, cells in order", _SPARSE, "o:"),
        ("without_ranks_ns", "sparse, counting each time", _QUIET, "^--"),
        ("octree_ns", "OctoMap through Python", _OTHER, "D-."),
    ):
        _curve(left, rows, key, label, colour, style)
    left.set_ylabel("CPU time of a look-up (ns)")
    left.set_title("Time: voxels of one surface looked up")
    memory = document["table_1"]["memory"]["depths"]
    for key, label, colour, style in (
        ("dense_bytes", "dense", _DENSE, "s-"),
        ("octree_bytes", "OctoMap in memory", _OTHER, "D-."),
        ("sparse_bytes", "sparse", _SPARSE, "o-"),
    ):
        _curve(right, memory, key, label, colour, style)
    right.set_ylabel("all levels (bytes)")
    right.set_title(f"Memory: {document['setup']['points']:,} points at most")
    for ax in (left, right):
        ax.set_yscale("log")
        ax.set_xlabel("depth (levels)")
        ax.grid(alpha=0.3)
        ax.legend(fontsize=8.5)
    save(figure, path, colours=_COLOURS)


def _curve(
    ax: Any, rows: Sequence[dict[str, Any]], key: str, label: str, colour: str, style: str
) -> None:
    known = [(row["depth"], row[key]) for row in rows if row[key] is not None]
    if known:
        x, y = zip(*known, strict=True)
        ax.plot(x, y, style, color=colour, label=label, markersize=5)


def packing(document: dict[str, Any], path: Path) -> None:
    """
    Draw the time of packing and unpacking, sparse and dense (Figure 8).

    Parameters
    ----------
    document : dict
        Of `volatool.papers.vola_summary.summarize`, with ``resources``.
    path : pathlib.Path
        PNG to write.
    """
    rows = document["resources"]["packing"]
    figure = new_figure(6.6, 4.2)
    ax = figure.subplots()
    x = np.arange(len(rows))
    bars = (
        ("sparse_pack_s", "sparse: pack", _SPARSE, ""),
        ("sparse_unpack_s", "sparse: unpack", _SPARSE, "//"),
        ("dense_pack_s", "dense: pack", _DENSE, ""),
        ("dense_unpack_s", "dense: unpack", _DENSE, "//"),
    )
    for number, (key, label, colour, hatch) in enumerate(bars):
        values = [1000 * (row[key] or np.nan) for row in rows]
        place = x + 0.2 * (number - 1.5)
        ax.bar(place, values, 0.18, label=label, color=colour, hatch=hatch, edgecolor="white")
    ax.set_xticks(x, [f"depth {row['depth']}\n{row['voxels']:,} voxels" for row in rows])
    ax.set_yscale("log")
    _plain_ticks(ax.yaxis)
    ax.set_ylabel("CPU time (ms)")
    ax.set_title("A volume to the bytes of a file, and back")
    ax.grid(alpha=0.3, axis="y")
    ax.set_axisbelow(True)
    ax.legend(fontsize=9)
    save(figure, path, colours=_COLOURS)
