"""The VOLA paper's tables for tiles at hand, one by one and summed as the paper sums a data set."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from volatool.cube import Cube
from volatool.errors import CodedWarning, OptionError
from volatool.model import Progress, no_progress
from volatool.occupancy.depth import choose_depth
from volatool.occupancy.levels import CELLS, PAIRS, add_counts, level_rows
from volatool.options import ConvertOptions
from volatool.papers.vola_tiles import (
    Tile,
    broken_identity,
    read_tile,
    sizes,
    strip_occupancy,
    tile_mean,
)
from volatool.vola.volume import Volume

_UNKNOWN = 1 << 62
"""Stands for the number of points where it isn't known: no level is too deep for it."""


def read_tiles(
    paths: Sequence[Path], options: ConvertOptions, progress: Progress = no_progress
) -> tuple[list[Tile], list[CodedWarning]]:
    """
    Read tiles, each to the depth that the rule gives for all of them.

    Parameters
    ----------
    paths : sequence of pathlib.Path
        LAS, LAZ, COPC or VOLA files.
    options : ConvertOptions
        CRS and metadata.
    progress : callable, optional
        Told (bytes done, bytes of all tiles).

    Returns
    -------
    tiles : list of Tile
        Those with points; read again if their own depth is less than the common one.
    warnings : list of CodedWarning
        Of tiles that were left out, and of the others with their name in front.
    """
    tiles: list[Tile] = []
    warnings: list[CodedWarning] = []
    sizes_of = [path.stat().st_size if path.is_file() else 0 for path in paths]
    for number, path in enumerate(paths):
        told = _part(progress, sum(sizes_of[:number]), sizes_of[number], sum(sizes_of))
        tile = read_tile(path, options, told)
        if isinstance(tile, CodedWarning):
            warnings.append(tile)
            continue
        tiles.append(tile)
        warnings += [replace(one, message=f"{path.name}: {one.message}") for one in tile.warnings]
    if not tiles:
        raise OptionError("no input has a point: there is nothing to measure")
    depth = common_choice(tiles)["depth"]
    return [_at_depth(tile, depth, options) for tile in tiles], warnings


def _part(progress: Progress, before: int, size: int, total: int) -> Progress:
    """Return a progress for one tile that tells of all of them."""
    return lambda done, of: progress(before + (size * done // of if of else size), total)


def _at_depth(tile: Tile, depth: int, options: ConvertOptions) -> Tile:
    if tile.volume.depth < depth:
        again = read_tile(tile.path, replace(options, depth=depth))
        assert isinstance(again, Tile)
        return replace(tile, volume=again.volume)
    return replace(tile, volume=tile.volume.truncated(depth))


def common_choice(tiles: Sequence[Tile]) -> dict[str, Any]:
    """
    Return the depth that the rule gives for tiles taken together, with its reason.

    Parameters
    ----------
    tiles : sequence of Tile
        At least one.
    """
    counts = add_counts(tile.counts for tile in tiles)
    side = max(tile.volume.cube.side for tile in tiles)
    n_points = _total([tile.n_points for tile in tiles])
    cube = Cube((0.0, 0.0, 0.0), side)
    return choose_depth(counts, n_points or _UNKNOWN, cube=cube).to_dict()


def _total(values: Sequence[int | None]) -> int | None:
    known = [value for value in values if value is not None]
    return sum(known) if len(known) == len(values) else None


def tile_tables(tiles: Sequence[Tile]) -> dict[str, Any]:
    """
    Return the tables.

    Parameters
    ----------
    tiles : sequence of Tile
        Of `read_tiles`: all of one depth.

    Returns
    -------
    tables : dict
        ``tiles`` (each on its own) and ``sum``. See docs/reference/reproduce-vola.md.
    """
    one_by_one = [_table([tile], tile.path.name) for tile in tiles]
    return {"tiles": one_by_one, "sum": _table(tiles, f"{len(tiles)} tiles")}


def _table(tiles: Sequence[Tile], name: str) -> dict[str, Any]:
    counts = add_counts(tile.counts for tile in tiles)
    n_points = _total([tile.n_points for tile in tiles])
    sides = {tile.volume.cube.side for tile in tiles}
    units = {tile.volume.crs.unit_xy for tile in tiles}
    rows = [row.to_dict() for row in level_rows(counts, max(sides), n_points, tiles=len(tiles))]
    for row in rows:
        del row["occupancy_histogram"]
        if len(sides) > 1:
            row["cell"] = None
    return {
        "name": name,
        "tiles": len(tiles),
        "points": n_points,
        "side": sides.pop() if len(sides) == 1 else None,
        "unit": units.pop() if len(units) == 1 else None,
        "density": tiles[0].source["density"] if len(tiles) == 1 else None,
        "points_per_m2": tiles[0].density_m2 if len(tiles) == 1 else None,
        "choice": common_choice(tiles),
        "depth": tiles[0].volume.depth,
        "levels": rows,
        "definitions": _definitions(tiles, rows),
        "identity": _identity(tiles),
        "sizes": _sizes(tiles, [tile.volume for tile in tiles]),
        "own_depths": sorted({tile.own.depth for tile in tiles}),
        "own_sizes": _sizes(tiles, [tile.own for tile in tiles]),
    }


def _definitions(tiles: Sequence[Tile], rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return what else "block occupancy" could mean, level by level to the depth used."""
    found = []
    for row in rows[: tiles[0].volume.depth]:
        level = row["level"]
        strips = [strip_occupancy(tile.volume, level) for tile in tiles]
        known = [pair for pair in strips if pair is not None]
        voxels, words = map(sum, zip(*known, strict=True)) if len(known) == len(tiles) else (0, 0)
        below = rows[level] if level < len(rows) else None
        found.append(
            {
                "level": level,
                "block_mean": row["occupancy"],
                "tile_mean": tile_mean(tiles, level),
                "voxel_weighted": row["occupancy_voxel_weighted"],
                "implied_by_sizes": None
                if below is None
                else (below["sparse_bytes"] - row["sparse_bytes"]) / (8 * CELLS * row["blocks"]),
                "dense_words": voxels / (CELLS * words) if words else None,
                "contiguous_over_random": row["contiguous_pairs_mean"] / row["contiguous_expected"]
                if row["contiguous_expected"]
                else None,
                "contiguous_percent": 100 * row["contiguous_pairs_mean"] / PAIRS,
            }
        )
    return found


def _identity(tiles: Sequence[Tile]) -> dict[str, Any]:
    broken = {tile.path.name: levels for tile in tiles if (levels := broken_identity(tile.volume))}
    return {
        "holds": not broken,
        "levels": sum(tile.volume.depth for tile in tiles),
        "blocks": sum(len(words) for tile in tiles for words in tile.volume.levels),
        "broken": broken,
    }


def _sizes(tiles: Sequence[Tile], at: Sequence[Volume]) -> dict[str, Any]:
    """Return Table 7's columns: bytes, and per cents of LAS, LAZ and VOLA."""
    las = _total([tile.source["las_equivalent_bytes"] for tile in tiles])
    laz = _total([tile.laz_bytes for tile in tiles])
    measured = [sizes(volume) for volume in at]
    volumes = {name: _total([one[name] for one in measured]) for name in measured[0]}
    kinds = sorted({tile.laz_kind for tile in tiles})
    vola, packed = volumes["vola_2_bit"], volumes["vola_2_bit_gzip"]
    if vola is None:
        vola, packed = volumes["vola_1_bit"], volumes["vola_1_bit_gzip"]
    return {
        "las": las,
        "laz": laz,
        "laz_kind": kinds,
        **volumes,
        "laz_percent_of_las": _percent(laz, las),
        "vola_percent_of_las": _percent(vola, las),
        "vola_percent_of_laz": _percent(vola, laz),
        "volazip_percent_of_vola": _percent(packed, vola),
        "volazip_percent_of_laz": _percent(packed, laz),
        "volazip_percent_of_las": _percent(packed, las),
    }


def _percent(part: int | None, whole: int | None) -> float | None:
    return None if part is None or not whole else 100 * part / whole
