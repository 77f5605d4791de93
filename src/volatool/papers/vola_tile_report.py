"""The part of the VOLA report about tiles at hand, as Markdown."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from volatool.papers.markdown import table


def tile_parts(tiles: dict[str, Any]) -> list[str]:
    """
    Return the paragraphs.

    Parameters
    ----------
    tiles : dict
        ``tiles`` of the document.
    """
    whole = tiles["sum"]
    identity = whole["identity"]
    several = whole["tiles"] > 1
    points = "unknown number of" if whole["points"] is None else f"{whole['points']:,}"
    parts = [
        "## Tiles",
        f"{whole['name']}, {points} points. Depth {whole['depth']} for all: "
        f"{whole['choice']['reason']}.",
        f"Blocks of each level are the voxels of the one above: "
        f"{'holds' if identity['holds'] else 'BROKEN'} for {identity['levels']} levels, "
        f"{identity['blocks']:,} blocks"
        + ("." if identity["holds"] else f"; broken: {identity['broken']}."),
        "### Tables 2 to 5, measured",
        "The paper's columns first; * marks the depth used. Pairs of touching cells a block, in "
        "per cent of 144, beside what as many random cells have (Table 6).",
    ]
    for one in [*tiles["tiles"], whole] if several else [whole]:
        parts += [f"**{one['name']}**{_about(one)}", _levels(one)]
    parts += [
        "### Table 7, measured",
        "Bytes of the levels, without header and trailer, as the paper counts them; LAS is what "
        "the points take uncompressed. Each tile at the depth that the rule gives for it alone"
        + (", and all at the common depth." if several else "."),
        _sizes(tiles["tiles"], whole if several else None),
        "### What else occupancy could mean",
        "Per cent, at each level: bits set of stored blocks; its mean over tiles; as seen from a "
        "voxel; as the sizes imply; of the dense form's words that are not empty.",
        _definitions(whole),
    ]
    return parts


def _about(one: dict[str, Any]) -> str:
    parts = []
    if one["side"] is not None:
        parts.append(f"cube of {one['side']:.6g} {one['unit'] or 'units'}")
    density = (one["density"] or {}).get("all_per_area_occupied")
    if one["points_per_m2"] is not None:
        parts.append(f"{one['points_per_m2']:.3g} points a square metre of covered area")
    elif density is not None:
        parts.append(f"{density:.3g} points a square {one['unit'] or 'unit'} of covered area")
    return ": " + ", ".join(parts) if parts else ""


def _mb(n_bytes: int | None) -> str:
    if n_bytes is None:
        return "-"
    value = n_bytes / 1e6
    return f"{value:,.2f}" if value >= 10 else f"{value:.4f}" if value >= 0.01 else f"{value:.6f}"


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def _levels(one: dict[str, Any]) -> str:
    rows = []
    for row in one["levels"]:
        mark = "*" if row["level"] == one["depth"] else ""
        points = row["points_per_voxel"]
        rows.append(
            (
                f"{row['level']}{mark}",
                _mb(row["dense_bytes"]),
                _mb(row["sparse_bytes"]),
                f"{row['reduction']:,.2f}",
                _percent(100 * row["occupancy"]),
                "-" if row["cell"] is None else f"{row['cell']:.4g}",
                f"{row['blocks']:,}",
                f"{row['voxels']:,}",
                "-" if points is None else f"{points:,.2f}",
                _percent(100 * row["contiguous_fraction"]),
                _percent(100 * row["contiguous_expected"] / 144),
            )
        )
    head = ("level", "dense MB", "sparse MB", "dense/sparse", "occupancy %", "cell", "blocks")
    return table((*head, "voxels", "points/voxel", "pairs %", "random %"), rows)


def _sizes(tables: Sequence[dict[str, Any]], whole: dict[str, Any] | None) -> str:
    lines = [(one["name"], f"{one['own_depths'][0]}", one["own_sizes"]) for one in tables]
    if whole is not None:
        own = " and ".join(map(str, whole["own_depths"]))
        lines.append((f"{whole['name']}, each at its own", own, whole["own_sizes"]))
        lines.append((f"{whole['name']}, at one", f"{whole['depth']}", whole["sizes"]))
    rows = []
    for name, depth, sizes in lines:
        kind = ", ".join(sizes["laz_kind"])
        rows.append(
            (
                name,
                depth,
                _mb(sizes["las"]),
                _mb(sizes["laz"]) + ("" if sizes["laz"] is None else f" ({kind})"),
                _mb(sizes["vola_1_bit"]),
                _mb(sizes["vola_1_bit_gzip"]),
                _mb(sizes["vola_2_bit"]),
                _mb(sizes["vola_2_bit_gzip"]),
                _percent(sizes["laz_percent_of_las"]),
                _percent(sizes["vola_percent_of_las"]),
                _percent(sizes["volazip_percent_of_vola"]),
                _percent(sizes["volazip_percent_of_laz"]),
            )
        )
    head = ("", "depth", "LAS MB", "LAZ MB", "VOLA, 1 bit", "gzip", "VOLA, 2 bits", "VOLAZip")
    return table(
        (*head, "LAZ % of LAS", "VOLA % of LAS", "VOLAZip % of VOLA", "VOLAZip % of LAZ"), rows
    )


def _definitions(one: dict[str, Any]) -> str:
    names = ("block_mean", "tile_mean", "voxel_weighted", "implied_by_sizes", "dense_words")
    return table(
        "level | block mean | tile mean | from a voxel | implied by sizes | "
        "dense words | pairs / random",
        [
            (
                f"{row['level']}",
                *(_percent(None if row[name] is None else 100 * row[name]) for name in names),
                _percent(row["contiguous_over_random"]),
            )
            for row in one["definitions"]
        ],
    )
