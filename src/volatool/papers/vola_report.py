"""The VOLA paper's tables as Markdown: printed, recomputed and measured side by side."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from volatool.papers.markdown import table
from volatool.papers.vola_tile_report import tile_parts


def to_markdown(document: dict[str, Any], figures: Sequence[str] = ()) -> str:
    """
    Return the report.

    Parameters
    ----------
    document : dict
        Of `volatool.papers.vola_summary.summarize`.
    figures : sequence of str
        File names of the figures, relative to the report.
    """
    setup = document["setup"]
    octree = document["table_1"]["memory"]["octree"]
    parts = [
        "# VOLA: the paper's tables",
        f"volatool {document['tool']['version']}; made-up surface of {setup['points']:,} points, "
        f"{setup['samples']:,} random blocks a row, seed {setup['seed']}; octree: "
        f"{octree or 'missing'}. A dash is a number that is not in our documents or not measured.",
        *(f"**{warning['code']}**: {warning['message']}" for warning in document["warnings"]),
        *_table_1(document),
        *_tables_2_to_5(document),
        *_table_6(document),
        *_table_7(document),
    ]
    if document["tiles"] is None:
        parts += [
            "## Tiles",
            "None given: `volatool reproduce vola TILE...` measures Tables 2 to 7 on LAS, LAZ, "
            "COPC or VOLA files. No sample comes with the package.",
        ]
    else:
        parts += tile_parts(document["tiles"])
    if "resources" in document:
        parts += _figure_8(document)
    if figures:
        parts += ["## Figures", *(f"![{name}]({name})" for name in figures)]
        if len(setup["tiles"]) > setup["most_pictures"]:
            parts.append(f"Of {len(setup['tiles'])} tiles the first {setup['most_pictures']}.")
    parts += [
        "## Errata",
        table(
            ("", "printed", "here", "recomputed or measured"),
            [
                (row["key"], row["paper"], row["here"], row["measured"])
                for row in document["errata"]
            ],
        ),
        "## Not in our documents",
        "\n".join(f"- {line}" for line in document["not_in_documents"]["what"]),
    ]
    return "\n\n".join(parts) + "\n"


def _number(value: float | None, digits: int = 1) -> str:
    return "-" if value is None else f"{value:,.{digits}f}"


def _percent(value: float | None, digits: int = 1) -> str:
    return "-" if value is None else f"{100 * value:.{digits}f}"


def _table_1(document: dict[str, Any]) -> list[str]:
    memory = document["table_1"]["memory"]
    parts = [
        "## Table 1",
        "The paper's eleven rows, checked on the surface at depth 4 in this run.",
        table(
            ("row", "verdict", "what was checked"),
            [
                (claim["row"], claim["verdict"], claim["evidence"])
                for claim in document["table_1"]["claims"]
            ],
        ),
        f"Memory of the same surface ({memory['side_m']:g} m a side), all levels, without headers; "
        "running counts for O(h) look-ups double the sparse size in memory.",
        table(
            "depth | cell (m) | voxels | dense (bytes) | sparse | "
            "sparse bits a voxel | octree | octree bits a voxel",
            [
                (
                    f"{row['depth']}",
                    f"{row['cell_m']:.4g}",
                    f"{row['voxels']:,}",
                    f"{row['dense_bytes']:,}",
                    f"{row['sparse_bytes']:,}",
                    _number(row["bits_per_voxel"], 2),
                    "-" if row["octree_bytes"] is None else f"{row['octree_bytes']:,}",
                    "-"
                    if row["octree_bytes"] is None
                    else _number(8 * row["octree_bytes"] / row["voxels"], 0),
                )
                for row in memory["depths"]
            ],
        ),
    ]
    return parts + (_look_ups(document) if "resources" in document else [])


def _look_ups(document: dict[str, Any]) -> list[str]:
    lookups = document["resources"]["lookups"]
    limit = document["setup"]["dense_limit_bytes"] >> 20
    sizes = {row["depth"]: row["dense_bytes"] for row in document["table_1"]["memory"]["depths"]}
    names = ("sparse", "in_order", "anywhere", "find", "without_ranks", "octree")
    rows = []
    for row in lookups["depths"]:
        dense = row["dense_ns"]
        unmeasured = f"not measured: {sizes[row['depth']]:,} bytes"
        rows.append(
            (
                f"{row['depth']}",
                unmeasured if dense is None else _nanoseconds(dense),
                *(_nanoseconds(row[f"{name}_ns"]) for name in names),
            )
        )
    fits = lookups["fits"]
    return [
        f"Time of a look-up, CPU nanoseconds, medians of {lookups['runs']} runs of "
        f"{lookups['queries']:,} voxels in random order; dense up to {limit} MiB.",
        table(
            "depth | dense | sparse | sparse, cells in order | "
            "sparse, anywhere in the cube | `Volume.find`, checks included | "
            "sparse without counts | octree (Python binding)",
            rows,
        ),
        f"Dense is constant but for the cache: {fits['dense']['least']:.1f} to "
        f"{fits['dense']['most']:.1f} ns. Lines: sparse {_line(fits['sparse'])}; in "
        f"order, where the cache helps, {_line(fits['in_order'])}. Each level costs one step; what "
        "grows faster are cache misses. Bits of a word: "
        f"{lookups['popcount']['table_ns']:.2f} ns by table, "
        f"{lookups['popcount']['arithmetic_ns']:.2f} ns by arithmetic.",
    ]


def _nanoseconds(value: float | None) -> str:
    return "-" if value is None else f"{value:,.{0 if value >= 100 else 1}f}"


def _line(fit: dict[str, float] | None) -> str:
    if fit is None:
        return "-"
    sign = "+" if fit["slope"] >= 0 else "-"
    return (
        f"{fit['at_zero']:.1f} {sign} {abs(fit['slope']):.1f} d ns (r = {fit['correlation']:.2f})"
    )


def _tables_2_to_5(document: dict[str, Any]) -> list[str]:
    parts = [
        "## Tables 2 to 5",
        "Sizes in decimal MB. *Implied* is the occupancy that the printed sizes mean, with its "
        "range for the digits printed; *predicted* the sparse size that the printed occupancies "
        "of the levels above mean.",
    ]
    for data in document["tables_2_to_5"]:
        depth = data["depth"]
        margin = f"{100 * depth['margin']:.2f} points above {100 * depth['threshold']:g} %"
        if depth["next"] is not None:
            margin += f"; the next level is {100 * (depth['threshold'] - depth['next']):.2f} below"
        verdict = "the paper's too" if depth["agree"] else f"the paper used {depth['by_paper']}"
        parts += [
            f"### Table {data['table']}: {data['name']}, {data['tiles']:,} tiles of 100 m "
            f"({data['source']})",
            table(
                "level | dense | printed | sparse printed | dense/sparse | "
                "occupancy printed % | implied % | printed/implied | sparse predicted | "
                "predicted/printed",
                [_level(row) for row in data["levels"]],
            ),
            f"Depth by the rule: {depth['by_rule']} ({margin}); {verdict}.",
        ]
    return parts


def _level(row: dict[str, Any]) -> tuple[str, ...]:
    ends = row["occupancy_implied_range"]
    implied = "-" if ends is None else f"{_percent(row['occupancy_implied'])} ({_range(ends)})"
    predicted = row["predicted_sparse_bytes"]
    return (
        f"{row['level']}",
        f"{row['dense_bytes'] / 1e6:,.3f}",
        row["dense_printed_mb"] or "-",
        row["sparse_printed_mb"] or "-",
        _number(row["reduction"], 2),
        _percent(row["occupancy_printed"], 2),
        implied,
        _number(row["printed_over_implied"], 2),
        "-" if predicted is None else f"{predicted / 1e6:,.3f}",
        _number(row["predicted_over_printed"], 2),
    )


def _range(ends: Sequence[float]) -> str:
    return f"{100 * ends[0]:.1f} to {100 * ends[1]:.1f}"


def _table_6(document: dict[str, Any]) -> list[str]:
    rows = []
    for row in document["table_6"]:
        exact, sampled, printed = row["exact"], row["sampled"], row["printed"]
        rows.append(
            (
                f"{row['percent']}",
                f"{row['cells']}",
                " +- ".join(filter(None, (printed["pairs"], printed["deviation"]))),
                f"{exact['pairs']:.3f} +- {exact['deviation']:.3f}",
                f"{sampled['pairs']:.3f} +- {sampled['deviation']:.3f}",
                f"{sampled['standard_error']:.3f}",
                printed["percent"] or "-",
                f"{exact['percent']:.2f}",
                f"{sampled['components']:.2f}",
            )
        )
    return [
        "## Table 6",
        "Face-sharing pairs of *n* of a block's 64 cells set at random: 144 n (n - 1) / (64 x 63), "
        "its exact standard deviation, and "
        f"{document['setup']['samples']:,} sampled blocks; last, their connected components.",
        table(
            "occupancy % | n | printed | exact | sampled | error of the mean | "
            "connected printed % | exact % | components",
            rows,
        ),
    ]


def _table_7(document: dict[str, Any]) -> list[str]:
    rows = []
    for row in document["table_7"]:
        las = f"{row['las_bytes'] / 1e9:.3g}"
        rows.append(
            (
                row["name"],
                f"{row['depth']}",
                las if row["las_is_printed"] else f"about {las}",
                f"about {row['laz_bytes'] / 1e9:.2g}",
                row["vola_printed_mb"],
                f"about {row['volazip_bytes'] / 1e6:.3g}",
                row["vola_percent_of_las_printed"] or "-",
                ("" if row["las_is_printed"] else "about ")
                + _number(row["vola_percent_of_las"], 2),
                f"about {row['laz_percent_of_las']:.0f}",
                f"{row['volazip_percent_of_vola']:.1f}",
                f"{row['volazip_reduced_percent']:.1f}",
                f"{row['volazip_percent_of_laz']:.1f}",
                "yes" if row["twice_sparse"] else "no",
            )
        )
    return [
        "## Table 7",
        "LAS and LAZ in GB, VOLA and VOLAZip in MB. What says *about* is not printed so in our "
        "documents: it follows from ratios or densities of two or three digits.",
        table(
            " | depth | LAS | LAZ | VOLA, 2 bits | VOLAZip | VOLA printed % of LAS | "
            "is % of LAS | LAZ is % of LAS | VOLAZip is % of VOLA | reduced by % | "
            "is % of LAZ | VOLA = 2 x sparse",
            rows,
        ),
    ]


def _figure_8(document: dict[str, Any]) -> list[str]:
    names = ("sparse_pack_s", "sparse_unpack_s", "dense_pack_s", "dense_unpack_s")
    return [
        "## Figure 8",
        "Packing (a volume to the bytes of a file) and unpacking, CPU milliseconds.",
        table(
            ("depth", "voxels", "sparse: pack", "unpack", "dense: pack", "unpack"),
            [
                (
                    f"{row['depth']}",
                    f"{row['voxels']:,}",
                    *("-" if row[name] is None else f"{1000 * row[name]:.3g}" for name in names),
                )
                for row in document["resources"]["packing"]
            ],
        ),
    ]
