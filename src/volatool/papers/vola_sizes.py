"""Tables 2 to 5 of the VOLA paper: what its sizes and occupancies say of each other."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from math import sqrt
from typing import Any

from volatool.occupancy.depth import MIN_OCCUPANCY, deepest_passing
from volatool.occupancy.levels import CELLS, dense_bytes
from volatool.papers.vola_printed import (
    DATA_SETS,
    POINT_BYTES,
    TILE_M,
    DataSet,
    agrees,
    interval,
    occupancy,
)

_MB = 10**6

Interval = tuple[float, float]


def size_tables() -> list[dict[str, Any]]:
    """
    Return Tables 2 to 5 recomputed.

    Returns
    -------
    tables : list of dict
        One a data set: `level_table`, and the depth that the rule gives.
    """
    return [
        {
            "key": data.key,
            "name": data.name,
            "source": data.source,
            "table": data.table,
            "tiles": data.tiles,
            "levels": level_table(data),
            "depth": depth_outcome(data),
        }
        for data in DATA_SETS
    ]


def level_table(data: DataSet) -> list[dict[str, Any]]:
    """
    Return the rows of one data set.

    Parameters
    ----------
    data : DataSet
        What is printed.

    Returns
    -------
    rows : list of dict
        Sizes in bytes, occupancies as fractions. ``occupancy_implied`` follows from the printed
        sizes, with its least and largest value for the digits printed; ``predicted_sparse_bytes``
        from the printed occupancies of the levels above. ``spread_needed`` is the standard
        deviation of the blocks' occupancies with which the printed one would be that seen from a
        voxel, E[n^2] / (64 E[n]). None where a number is missing.
    """
    implied = implied_occupancies(data)
    predicted = predicted_sizes(data)
    rows = []
    for level, printed in enumerate(data.levels, 1):
        exact = dense_bytes(level, data.tiles)
        own = occupancy(printed)
        low_high = implied[level - 1]
        middle = None if low_high is None else sum(low_high) / 2
        size = predicted[level - 1]
        sparse = _sparse_bytes(data, level)
        rows.append(
            {
                "level": level,
                "cell_m": TILE_M / 4**level,
                "dense_bytes": exact,
                "dense_printed_mb": printed.dense,
                "dense_agrees": None
                if printed.dense is None
                else agrees(Fraction(exact, _MB), printed.dense),
                "sparse_printed_mb": printed.sparse,
                "reduction": None if sparse is None else exact / (sum(sparse) / 2),
                "occupancy_printed": own,
                "occupancy_implied": middle,
                "occupancy_implied_range": None if low_high is None else list(low_high),
                "printed_over_implied": None if own is None or not middle else own / middle,
                "spread_needed": None
                if own is None or middle is None
                else sqrt(max(middle * (own - middle), 0.0)),
                "predicted_sparse_bytes": size,
                "predicted_over_printed": None
                if size is None or sparse is None or printed.sparse is None
                else size / (sum(sparse) / 2),
            }
        )
    return rows


def _sparse_bytes(data: DataSet, level: int) -> Interval | None:
    """
    Least and largest size of the sparse levels down to one.

    The root has one block a tile, whatever is printed; Table 7 has one digit more at its depth.
    """
    if level == 1:
        return (8.0 * data.tiles, 8.0 * data.tiles)
    printed = data.levels[level - 1].sparse
    if printed is None:
        return None
    low, high = interval(printed)
    if level == data.depth:
        low_7, high_7 = (end / 2 for end in interval(data.vola_mb))
        low, high = max(low, low_7), min(high, high_7)
    return float(low * _MB), float(high * _MB)


def implied_occupancies(data: DataSet) -> list[Interval | None]:
    """
    Return the occupancies that the sparse sizes mean.

    Parameters
    ----------
    data : DataSet
        What is printed.

    Returns
    -------
    occupancies : list of (float, float) or None
        Least and largest for each level; None for the last, whose bits no words follow.

    Notes
    -----
    Words of a level are the bits set in the one above [Byrne2018]_, section 3:
    ``blocks(d + 1) = 64 occupancy(d) blocks(d)``, and a level's blocks are the difference of two
    sizes over 8.
    """
    sizes = [_sparse_bytes(data, level) for level in range(1, len(data.levels) + 1)]
    found: list[Interval | None] = []
    for level in range(1, len(sizes) + 1):
        if level == len(sizes):
            found.append(None)
            continue
        above, here, below = (
            (0.0, 0.0) if level == 1 else sizes[level - 2],
            sizes[level - 1],
            sizes[level],
        )
        if above is None or here is None or below is None:
            found.append(None)
            continue
        # blocks(d + 1) / blocks(d) is smallest with the smaller difference over the larger one
        ends = [
            (b - h) / (CELLS * (h - a)) for a in set(above) for h in set(here) for b in set(below)
        ]
        found.append((min(ends), max(ends)))
    return found


def predicted_sizes(data: DataSet) -> list[float | None]:
    """
    Return the sparse sizes that the printed occupancies mean.

    Parameters
    ----------
    data : DataSet
        What is printed.

    Returns
    -------
    sizes : list of float or None
        Bytes of all levels down to each.
    """
    blocks: float | None = 1.0
    total = 0.0
    sizes: list[float | None] = []
    for printed in data.levels:
        if blocks is None:
            sizes.append(None)
            continue
        total += blocks
        sizes.append(8 * total * data.tiles)
        own = occupancy(printed)
        blocks = None if own is None else blocks * CELLS * own
    return sizes


def depth_outcome(data: DataSet) -> dict[str, Any]:
    """
    Return what the rule of 15 % makes of the printed occupancies.

    Parameters
    ----------
    data : DataSet
        What is printed.

    Returns
    -------
    outcome : dict
        ``by_rule``, ``by_paper``, ``agree``; ``margin`` of the chosen level and ``next`` of the one
        below it, fractions. A level whose occupancy is not known ends the table: that the first two
        data sets' level 4 lies below 15 % is the paper's word (it stopped at 3).
    """
    known: list[float] = []
    for level in data.levels:
        own = occupancy(level)
        if own is None:
            break
        known.append(own)
    by_rule = deepest_passing(known)
    assert by_rule is not None
    return {
        "threshold": MIN_OCCUPANCY,
        "by_rule": by_rule,
        "by_paper": data.depth,
        "agree": by_rule == data.depth,
        "margin": known[by_rule - 1] - MIN_OCCUPANCY,
        "next": known[by_rule] if by_rule < len(known) else None,
    }


def dublin_fills() -> dict[str, float]:
    """
    Return the three numbers that section 5.1's "1.36 % occupancy" may be, from Table 5.

    Returns
    -------
    fills : dict
        ``block_fill`` (blocks of level 5 that exist), ``size_ratio`` (sparse over dense),
        ``voxel_fill``; ``voxels`` is how many voxels Table 5 needs.
    """
    data = DATA_SETS[3]
    sizes = [sum(size) / 2 for size in map(lambda n: _sparse_bytes(data, n), (4, 5)) if size]
    blocks = (sizes[1] - sizes[0]) / 8
    own = occupancy(data.levels[4])
    assert own is not None
    voxels = blocks * CELLS * own
    return {
        "block_fill": blocks / (data.tiles * CELLS**4),
        "size_ratio": sizes[1] / dense_bytes(5, data.tiles),
        "voxel_fill": voxels / (data.tiles * CELLS**5),
        "voxels": voxels,
    }


def las_bytes(data: DataSet) -> tuple[float, bool]:
    """
    Return the size of a data set as LAS.

    Parameters
    ----------
    data : DataSet
        What is printed.

    Returns
    -------
    size, is_printed : float, bool
        Bytes; not printed but worked out from densities (see `DataSet`), good to two digits.
    """
    if data.las_gb is not None:
        return float(data.las_gb) * 1e9, True
    assert data.las_density is not None
    area = data.tiles * TILE_M**2
    ends = [
        [float(end) * area * size for end in interval(text)]
        for text, size in zip(data.las_density, reversed(POINT_BYTES), strict=True)
    ]
    low, high = max(pair[0] for pair in ends), min(pair[1] for pair in ends)
    return (low + high) / 2, False


def densities() -> dict[str, dict[str, Any]]:
    """
    Return points a square metre as the sizes of the LAS files have them.

    Returns
    -------
    densities : dict of dict
        By data set: ``printed``; ``low`` and ``high`` for 34 and 28 bytes a point, over all the
        tiles' area; ``points`` likewise.
    """
    found = {}
    for data in DATA_SETS:
        points = [las_bytes(data)[0] / size for size in reversed(POINT_BYTES)]
        area = data.tiles * TILE_M**2
        found[data.key] = {
            "printed": data.density,
            "low": points[0] / area,
            "high": points[1] / area,
            "points": points,
        }
    return found


def table_7() -> list[dict[str, Any]]:
    """
    Return Table 7 as far as it is known, and recomputed.

    Returns
    -------
    rows : list of dict
        Sizes in bytes; ``laz_bytes`` and ``volazip_bytes`` follow from ratios of two digits, and
        ``las_bytes`` from densities where ``las_is_printed`` is false: good to 1 or 2 digits.
        ``twice_sparse`` tells whether the VOLA column is twice the sparse size at the depth used.
    """
    rows = []
    for data in DATA_SETS:
        vola = float(data.vola_mb) * _MB
        packed = vola * float(data.zip_of_vola) / 100
        las, is_printed = las_bytes(data)
        laz = packed / (float(data.zip_of_laz) / 100)
        sparse = data.levels[data.depth - 1].sparse
        assert sparse is not None
        rows.append(
            {
                "key": data.key,
                "name": data.name,
                "depth": data.depth,
                "las_bytes": las,
                "las_is_printed": is_printed,
                "laz_bytes": laz,
                "laz_percent_of_las": 100 * laz / las,
                "vola_printed_mb": data.vola_mb,
                "volazip_bytes": packed,
                "vola_percent_of_las": 100 * vola / las,
                "vola_percent_of_las_printed": data.vola_percent_of_las,
                "volazip_percent_of_vola": float(data.zip_of_vola),
                "volazip_reduced_percent": 100 - float(data.zip_of_vola),
                "volazip_percent_of_laz": float(data.zip_of_laz),
                "twice_sparse": _meet(interval(sparse), interval(data.vola_mb)),
            }
        )
    return rows


def _meet(sparse: Sequence[Fraction], vola: Sequence[Fraction]) -> bool:
    """Tell whether twice one interval meets the other."""
    return 2 * sparse[0] < vola[1] and vola[0] < 2 * sparse[1]
