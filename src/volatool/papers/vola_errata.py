"""What the VOLA paper and its toolkit say that can't be, and what it amounts to."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple


class Erratum(NamedTuple):
    """
    A row of the table of differences.

    Parameters
    ----------
    key : str
        C1 to C12 and C24, the project's numbering.
    paper, here, measured : str
        What is printed; what volatool does; what it amounts to, computed.
    """

    key: str
    paper: str
    here: str
    measured: str


_Writer = Callable[[dict[str, Any]], str]

_ROWS: tuple[tuple[str, str, str, str], ...] = (
    (
        "C1",
        "Tables 2 to 5: words of a level are the bits set in the level above (section 3), so block "
        "occupancies determine sparse sizes; the printed ones don't",
        "occupancy is bits set / (64 x stored blocks); blocks of a level equal voxels of the level "
        "above, exactly",
        "sizes",
    ),
    (
        "C1a",
        "what could explain it: occupancy as seen from a voxel, the toolkit's rounding, means over "
        "tiles",
        "each is printed under its own name; nothing is tuned to the printed column",
        "definitions",
    ),
    (
        "C2",
        "the rule is a block occupancy above 15 %; Montreal has 15.62 % at level 4, Table 7 uses "
        "depth 3",
        "the rule, with its margin",
        "depths",
    ),
    (
        "C3",
        'Table 6, row "10 %": 1.49 +- 1.09 pairs and 0.75 % connected',
        "144 n (n - 1) / (64 x 63), for 7 and for 6 cells",
        "tenth",
    ),
    (
        "C4",
        'Table 6 counts "connected components"; what is counted are pairs of cells that share a '
        "face, inside a block",
        "called contiguous pairs; components apart",
        "components",
    ),
    (
        "C5",
        "dense sizes: what they include is not said",
        "all levels, 8 (64^d - 1) / 63 bytes a tile, decimal MB, without the 80 bytes of header",
        "dense",
    ),
    (
        "C6",
        'Table 7: San Francisco "1.07 %" of LAS; VOLAZip "reduces by up to 50 %"; 2 bits a voxel',
        'a metadata word for each word, on all levels; "is x % of" and "reduced by" apart',
        "table_7",
    ),
    (
        "C7",
        "point information is averaged over a block; the toolkit takes the last voxel's last point",
        "means; --compat toolkit for the other",
        "block_words",
    ),
    (
        "C8",
        'Dublin: "9.7 cm^3 cube" at depth 5; "5m^3 volume with 1 cm" takes 512 MiB',
        "edges, with their unit; a cube of (5 m)^3",
        "edges",
    ),
    (
        "C9",
        "points per metre and per square metre are mixed; Dublin is 190, 348.43, or 600 million "
        "points over 2 km^2",
        "density an area, its definition beside it",
        "densities",
    ),
    (
        "C10",
        '"average occupancy of 1.36 % per 100 meter tile" (Dublin)',
        "occupancy, block_fill and voxel_fill under their own names",
        "fills",
    ),
    (
        "C11",
        '"immediately readable without header information"; sparse search is O(h)',
        "header and trailer; running counts beside the words, in memory",
        "header",
    ),
    (
        "C12",
        "the box is divided into 64 cells; the toolkit rounds to 4^d points and reads back 4^d "
        "cells",
        "half-open cells by floor; one rule for writing and reading",
        "reading_back",
    ),
    (
        "C24",
        'the toolkit\'s "2-bit metadata blocks" are written with nbits = 1',
        "the header's nbits is the number of more 64-bit words a block, and is checked",
        "nbits",
    ),
)


def errata(document: dict[str, Any]) -> list[Erratum]:
    """
    Return the table for a result.

    Parameters
    ----------
    document : dict
        Of `volatool.papers.vola_summary.summarize`.
    """
    return [
        Erratum(key, paper, here, _MEASURED[name](document)) for key, paper, here, name in _ROWS
    ]


def _percent(value: float, digits: int = 1) -> str:
    return f"{100 * value:.{digits}f} %"


def _known(document: dict[str, Any], column: str) -> list[float]:
    return [
        row[column]
        for table in document["tables_2_to_5"]
        for row in table["levels"]
        if row[column] is not None
    ]


def _sizes(document: dict[str, Any]) -> str:
    over, ratio = (
        _known(document, "predicted_over_printed"),
        _known(document, "printed_over_implied"),
    )
    text = (
        f"sizes that the printed occupancies mean are {min(over):.1f} to {max(over):.1f} times the "
        f"printed ones; printed occupancies are {min(ratio):.2f} to {max(ratio):.2f} times those "
        "that the sizes mean"
    )
    tiles = document["tiles"]
    if tiles is not None:
        identity = tiles["sum"]["identity"]
        verdict = "holds" if identity["holds"] else "IS BROKEN"
        text += (
            f". On the tiles given the identity {verdict} on all {identity['levels']} levels "
            f"({identity['blocks']:,} blocks)"
        )
    return text


def _definitions(document: dict[str, Any]) -> str:
    at = document["effects"]["rounding"]
    thin, thick = at[0], at[-1]
    needed = _known(document, "spread_needed")
    text = (
        "to be the occupancy seen from a voxel the printed ones need blocks whose own occupancies "
        f"spread by {100 * min(needed):.1f} to {100 * max(needed):.1f} points (standard "
        "deviation). Made-up surface: "
    ) + "; ".join(
        f"{case['density']:g} points a square metre, levels 1 to 4: floor "
        f"{_row(case['floor'])}, rounded {_row(case['rounded'])}, each level rounded in a file of "
        f"its own {_row(case['rounded_alone'])}, from a voxel {_row(case['voxel_weighted'])} %"
        for case in (thin, thick)
    )
    tiles = document["tiles"]
    if tiles is not None:
        found = tiles["sum"]["definitions"]
        ratios = [row["voxel_weighted"] / row["block_mean"] for row in found if row["block_mean"]]
        means = [row["tile_mean"] / row["block_mean"] for row in found if row["block_mean"]]
        text += (
            f". On the tiles given, seen from a voxel {min(ratios):.2f} to {max(ratios):.2f} times "
            f"the block mean, mean over tiles {min(means):.2f} to {max(means):.2f} times"
        )
    return text + ". None of them raises all levels as the printed ones are"


def _row(values: Sequence[float]) -> str:
    return " / ".join(f"{100 * value:.1f}" for value in values)


def _depths(document: dict[str, Any]) -> str:
    parts = []
    for table in document["tables_2_to_5"]:
        depth = table["depth"]
        more = "" if depth["agree"] else f" (margin {100 * depth['margin']:.2f} points)"
        parts.append(f"{table['name']} {depth['by_rule']}{more}, paper {depth['by_paper']}")
    return "by rule " + "; ".join(parts)


def _tenth(document: dict[str, Any]) -> str:
    seven, six = [row for row in document["table_6"] if row["percent"] == 10]
    return (
        f"7 cells: {seven['exact']['pairs']:.3f} +- {seven['exact']['deviation']:.3f} pairs, "
        f"{seven['exact']['percent']:.2f} %; 6 cells: {six['exact']['pairs']:.3f} +- "
        f"{six['exact']['deviation']:.3f}, {six['exact']['percent']:.2f} %: the pairs are those "
        "of 7 cells, the per cent that of 6"
    )


def _components(document: dict[str, Any]) -> str:
    return "mean connected components of the same random blocks: " + ", ".join(
        f"{row['cells']} cells {row['sampled']['components']:.2f}" for row in document["table_6"]
    )


def _dense(document: dict[str, Any]) -> str:
    known = [
        row["dense_agrees"]
        for table in document["tables_2_to_5"]
        for row in table["levels"]
        if row["dense_agrees"] is not None
    ]
    share = document["effects"]["leaf_share"]
    return (
        f"{sum(known)} of the {len(known)} printed sizes that our documents have agree, cut off or "
        f"rounded; the last level alone would be {_percent(1 - share)} less"
    )


def _table_7(document: dict[str, Any]) -> str:
    rows = document["table_7"]
    first = rows[0]
    reduced = [row["volazip_reduced_percent"] for row in rows]
    twice = sum(row["twice_sparse"] for row in rows)
    return (
        f"San Francisco {first['vola_percent_of_las']:.2f} % "
        f"({first['vola_printed_mb']} MB of {first['las_bytes'] / 1e9:g} GB); VOLAZip is "
        f"{min(reduced):.0f} to {max(reduced):.0f} % less than VOLA; VOLA is twice the sparse size "
        f"for {twice} of {len(rows)} data sets"
    )


def _block_words(document: dict[str, Any]) -> str:
    found = document["effects"]["block_words"]
    return (
        f"heights of a made-up surface as bytes: {_percent(found['differing'], 0)} of the blocks "
        f"differ, by {found['rms']:.1f} of 255 (RMS), {found['largest']:.0f} at most"
    )


def _edges(document: dict[str, Any]) -> str:
    effects = document["effects"]
    edge, grids = effects["cell_edge_m"], effects["dense_grid_bytes"]
    return (
        f"100 m / 4^5 is an edge of {100 * edge:.2f} cm ({1e6 * edge**3:.0f} cm^3); 512^3 cells of "
        f"4 bytes are {grids['side_5_m_cell_1_cm'] / 2**20:.0f} MiB, 5 cubic metres in cells of "
        f"1 cm {grids['as_printed_5_m3'] / 2**20:.0f} MiB"
    )


def _densities(document: dict[str, Any]) -> str:
    found = document["effects"]["densities"]
    names = {table["key"]: table["name"] for table in document["tables_2_to_5"]}
    parts = [
        f'{names[key]} {row["low"]:.3g} to {row["high"]:.3g} ("{row["printed"]}" printed)'
        for key, row in found.items()
    ]
    points = found["dublin"]["points"]
    voxels = document["effects"]["dublin"]["voxels"]
    return (
        "points a square metre by the LAS sizes: "
        + "; ".join(parts)
        + (
            f". Dublin: {points[0] / 1e9:.2f} to {points[1] / 1e9:.2f} billion points; its Table 5 "
            f"needs {voxels / 1e6:.0f} million voxels, more than 600 million points can fill"
        )
    )


def _fills(document: dict[str, Any]) -> str:
    found = document["effects"]["dublin"]
    return (
        f"from Table 5, level 5: blocks that exist {_percent(found['block_fill'], 3)}, sparse of "
        f"dense bytes {_percent(found['size_ratio'], 3)}, voxels set "
        f"{_percent(found['voxel_fill'], 3)}"
    )


def _header(document: dict[str, Any]) -> str:
    text = (
        "the depth can be told from the words' own counts, the cube and the CRS can't. Counts take "
        "as many bytes as the words"
    )
    lookups = document.get("resources", {}).get("lookups")
    if not lookups:
        return text
    rows = lookups["depths"]
    last = rows[-1]
    return (
        f"{text}; at depth {last['depth']} a look-up takes {last['sparse_ns']:.0f} ns with them "
        f"and {last['without_ranks_ns']:,.0f} ns without"
    )


def _reading_back(document: dict[str, Any]) -> str:
    found = document["effects"]["reading_back"]
    return "; ".join(
        f"{name}: {_percent(found[key]['inside'], 0)} of the points lie in the cell shown for "
        f"them, the farthest {found[key]['farthest']:.2f} cells from its middle along an axis"
        for key, name in (("toolkit", "the toolkit"), ("ours", "here"))
    )


def _nbits(document: dict[str, Any]) -> str:
    twice = sum(row["twice_sparse"] for row in document["table_7"])
    return f"Table 7 agrees with one word more a word ({twice} of 4 data sets)"


_MEASURED: dict[str, _Writer] = {
    "sizes": _sizes,
    "definitions": _definitions,
    "depths": _depths,
    "tenth": _tenth,
    "components": _components,
    "dense": _dense,
    "table_7": _table_7,
    "block_words": _block_words,
    "edges": _edges,
    "densities": _densities,
    "fills": _fills,
    "header": _header,
    "reading_back": _reading_back,
    "nbits": _nbits,
}
