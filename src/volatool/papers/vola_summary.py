"""The numbers of the VOLA paper's tables as one JSON object."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from volatool._version import __version__
from volatool.errors import CodedWarning
from volatool.papers import emap_octomap
from volatool.papers.vola_claims import Claim, claims, packing_times
from volatool.papers.vola_contiguity import table_6
from volatool.papers.vola_effects import DEPTH, effects
from volatool.papers.vola_errata import errata
from volatool.papers.vola_figures import MOST_TILES
from volatool.papers.vola_lookups import DENSE_LIMIT_BYTES, memory, times
from volatool.papers.vola_printed import MISSING
from volatool.papers.vola_scene import surface
from volatool.papers.vola_sizes import size_tables, table_7
from volatool.papers.vola_tile_tables import tile_tables
from volatool.papers.vola_tiles import Tile

SCHEMA = "volatool.reproduce_vola/1"

NOT_IN_DOCUMENTS = (
    "Table 1: what it says of octrees",
    "Tables 2 to 5: dense sizes of New York, Montreal and most of Dublin (their tile counts are "
    "known, and that all 17 agree with the formula), sparse sizes of level 1, magnitudes, and "
    "occupancies of San Francisco's and New York's level 4",
    "Table 6: per cents but for the last row, and the number of blocks drawn",
    "Table 7: LAS of New York and Montreal (known as densities), LAZ and VOLAZip (known as ratios)",
    "Figures 4 to 7 as pictures, numbers of Figure 8",
)
"""What is printed but could not be compared with."""


def summarize(
    tiles: Sequence[Tile],
    *,
    points: int,
    samples: int,
    seed: int,
    timing: bool,
    warnings: Sequence[CodedWarning] = (),
) -> dict[str, Any]:
    """
    Return the result.

    Parameters
    ----------
    tiles : sequence of Tile
        Of `volatool.papers.vola_tile_tables.read_tiles`; may be empty.
    points : int
        Points of the made-up surface of Table 1.
    samples, seed : int
        Random blocks a row of Table 6, and the seed of chance.
    timing : bool
        Time look-ups and packing too: the only numbers that differ from run to run.
    warnings : sequence of CodedWarning
        Of the tiles.

    Returns
    -------
    document : dict
        See docs/reference/reproduce-vola.md.
    """
    sizes = memory(points)
    notes = list(warnings)
    if sizes["octree"] is None:
        notes.append(CodedWarning("W_NO_OCTOMAP", f"{emap_octomap.MISSING}; no octree in Table 1"))
    document: dict[str, Any] = {
        "schema": SCHEMA,
        "tool": {"name": "volatool", "version": __version__},
        "setup": {
            "points": points,
            "samples": samples,
            "seed": seed,
            "dense_limit_bytes": DENSE_LIMIT_BYTES,
            "most_pictures": MOST_TILES,
            "tiles": [tile.path.name for tile in tiles],
        },
        "table_1": {
            "claims": [_claim(claim) for claim in claims(surface(points).truncated(DEPTH))],
            "memory": sizes,
        },
        "tables_2_to_5": size_tables(),
        "table_6": table_6(samples, seed),
        "table_7": table_7(),
        "tiles": tile_tables(tiles) if tiles else None,
        "effects": effects(),
        "not_in_documents": {"text": MISSING, "what": list(NOT_IN_DOCUMENTS)},
        "warnings": [warning.to_dict() for warning in notes],
    }
    if timing:
        document["resources"] = {"lookups": times(points), "packing": packing_times(points)}
    document["errata"] = [dict(erratum._asdict()) for erratum in errata(document)]
    return document


def _claim(claim: Claim) -> dict[str, str]:
    return dict(claim._asdict())
