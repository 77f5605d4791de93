"""The rows of the benchmark's table: what is run, on which tile, and what it is to reach."""

from __future__ import annotations

import fnmatch
from collections.abc import Sequence
from dataclasses import dataclass

PLAIN_VOXELS = "--no-dem --meta none --dense never"
PLACE = "--crs-default EPSG:28992"
"""Of the Delft tile, whose file does not tell: metres need a unit."""


@dataclass(frozen=True, slots=True)
class Row:
    """
    One row.

    Parameters
    ----------
    name, group : str
        What ``--only`` calls it. The rows of a group take turns.
    what : str
        For people.
    kind : str
        ``"stage"`` (in process), ``"command"`` (a process of ours), ``"peer"`` (of others),
        ``"array"`` (ours from an array), ``"surfaces"`` (of ``dem.py``), ``"derived"`` (from other
        rows).
    input : str
        A tile of `inputs.RECIPES`; of a group of stages, all the same.
    arguments : str
        Of ``volatool`` for a command, ``{tile}``, ``{out}`` and ``{half_m}`` (0.5 m in the tile's
        unit) filled in; the peer's name and job for a peer; the stage for a stage.
    floor : str
        Row that the ratios are to; none when empty.
    reach : str
        What is compared with the target, see `results.reached`.
    limit : float or None
        The target: at most so much, or at least if `at_least`.
    at_least : bool
        More is better.
    prototype : str
        What the prototype or the peer took, as DESIGN.md 4 says it; never measured here.
    of : str
        The other row that a derived row or a peer is compared with.
    """

    name: str
    group: str
    what: str
    kind: str
    input: str = "tile"
    arguments: str = ""
    floor: str = ""
    reach: str = ""
    limit: float | None = None
    at_least: bool = False
    prototype: str = ""
    of: str = ""


def _stage(name: str, what: str, reach: str = "", limit: float | None = None) -> Row:
    floor = "" if name == "decode" else "decode"
    return Row(name, "stages", what, "stage", "tile", name, floor, reach, limit)


def _job(name: str, what: str, arguments: str, tile: str = "tile", **rest: object) -> Row:
    command = f"convert {{tile}} -o {{out}} --overwrite -q {arguments}".strip()
    return Row(name, "jobs", what, "command", tile, command, "decode-process", **rest)  # type: ignore[arg-type]


def _solve(name: str, cells: str, limit: float | None = None) -> Row:
    what = f"EMap solve to 0.1 mm, {cells} cells"
    prototype = "2 us (blend)" if limit else ""
    return Row(
        name,
        "solver",
        what,
        "stage",
        "tile",
        name,
        "decode-solver",
        "us_per_unit",
        limit,
        prototype=prototype,
    )


def _voxels(kind: str, tile: str, prototype: str) -> list[Row]:
    """Return the rows of LAZ to voxels of 0.5 m on a tile of about 20 M points."""
    group, ours, floor = f"voxels-{kind}", f"voxels-{kind}", f"decode-{kind}"
    command = f"convert {{tile}} -o {{out}} --overwrite -q {PLAIN_VOXELS} --resolution 0.5m {PLACE}"
    return [
        Row(floor, group, f"decode only, {kind}", "command", tile, "decode"),
        Row(ours, group, f"LAZ to voxels of 0.5 m, {kind}", "command", tile, command, floor),
        Row(
            f"pdal-{kind}",
            group,
            f"PDAL filters.voxeldownsize 0.5 m, {kind}",
            "peer",
            tile,
            "pdal voxels",
            floor,
            "faster",
            2.0,
            at_least=True,
            prototype=prototype,
            of=ours,
        ),
    ]


def _rasters(cell: str, idw: float, tin: float, prototype: str) -> list[Row]:
    """Return the rows of LAZ to a DEM, 4 M points."""
    ours = f"dem-{cell}"
    command = f"dem {{tile}} -o {{out}} --overwrite -q --cell {cell}"
    rows = [Row(ours, "rasters", f"LAZ to a DEM of {cell}", "command", "4M", command, "decode-4M")]
    for name, limit in (("idw", idw), ("faceraster", tin)):
        rows.append(
            Row(
                f"pdal-{name}-{cell}",
                "rasters",
                f"PDAL {name}, {cell}",
                "peer",
                "4M",
                f"pdal {name} {cell}",
                "decode-4M",
                "faster",
                limit,
                at_least=True,
                prototype=prototype,
                of=ours,
            )
        )
    return rows


def _growth(size: str, limit: float | None = None) -> Row:
    tile = "tile" if size == "10M" else size
    command = "convert {tile} -o {out} --overwrite -q --cell 1m"
    return Row(
        f"growth-{size}",
        "growth",
        f"`convert --cell 1m`, {size}",
        "command",
        tile,
        command,
        reach="us_per_point_wall",
        limit=limit,
    )


ROWS: tuple[Row, ...] = (
    _stage("decode", "decode floor: lazrs, parallel, xyz, in process"),
    _stage("read", "read through our reader, xyz"),
    _stage("read-all", "read with what metadata need"),
    _stage("occupancy", "`convert` in process, occupancy only", "wall_ratio", 1.20),
    _stage("metadata", "`convert` in process, occupancy and metadata"),
    _stage("gzip", "gzip of the volume"),
    _stage("builder", "builder, points in memory"),
    _stage("gather", "points of the elevation model gathered"),
    _stage("ground", "ground filter"),
    _stage("surface", "EMap surface at 1 m, evidence and all nets"),
    _stage("dem-write", "DEM written as COG and read back"),
    Row("decode-process", "jobs", "decode only, whole process", "command", "tile", "decode"),
    _job("convert-occupancy", "`convert --no-dem --meta none`", "--no-dem --meta none"),
    _job("convert-volume", "`convert --no-dem`", "--no-dem"),
    _job(
        "convert-everything",
        "`convert --cell 1m`",
        "--cell 1m",
        reach="wall_ratio",
        limit=1.8,
    ),
    _job("convert-min", "`convert --cell 1m --surface min`", "--cell 1m --surface min"),
    _job("convert-auto", "`convert`", ""),
    _job(
        "convert-256M",
        "`convert --memory 256M`",
        "--memory 256M",
        reach="peak_mib",
        limit=256.0,
    ),
    _job(
        "convert-depth-4",
        "`convert --depth 4 --no-dem`, against the original VOLA toolkit",
        "--depth 4 --no-dem",
        reach="toolkit",
        limit=20.0,
        at_least=True,
        prototype="toolkit 0.10-0.18 M points/s (cited from DESIGN.md)",
    ),
    _job("small", "`convert`, 100 k points", "", "100k", reach="wall_s", limit=3.0),
    _job("start-up", "`convert`, 1 k points", "", "1k", reach="wall_s", limit=1.5),
    Row(
        "help",
        "jobs",
        "`volatool --help`",
        "command",
        "1k",
        "--help",
        "decode-process",
        "wall_s",
        0.15,
    ),
    *_voxels("sparse", "20M", "PDAL 33 s, 1200 MB; prototype 9.7 s, 310-420 MB"),
    *_voxels("dense", "20M-dense", "PDAL 14.6 s; prototype 7.0 s, 310-420 MB"),
    Row(
        "array-volatool",
        "arrays",
        "voxels of 0.5 m, 4 M points in memory",
        "array",
        "4M",
        "array volatool",
    ),
    *(
        Row(
            f"array-{name}",
            "arrays",
            f"the same by {what}",
            "peer",
            "4M",
            f"array {name}",
            reach="faster",
            of="array-volatool",
        )
        for name, what in (
            ("open3d", "Open3D (VoxelGrid)"),
            ("pyoctomap", "OctoMap (pyoctomap)"),
        )
    ),
    Row("decode-4M", "rasters", "decode only, 4 M points", "command", "4M", "decode"),
    *_rasters("1m", 1.8, 2.0, "PDAL idw 8.8 s, faceraster 9.7 s; prototype 6.9 s"),
    *_rasters("0.5m", 1.0, 1.0, "PDAL idw 24.2 s, faceraster 9.5 s; prototype 9.8 s"),
    Row("decode-solver", "solver", "decode floor beside the solver", "stage", "tile", "decode"),
    _solve("solve-250k", "0.25 M"),
    _solve("solve-4M", "4 M", 1.0),
    _solve("solve-16M", "16 M", 1.0),
    Row(
        "solve-growth",
        "solver",
        "us per cell, 16 M to 0.25 M",
        "derived",
        reach="units_ratio",
        limit=1.3,
        prototype="membrane: none seen",
        of="solve-16M solve-250k",
    ),
    Row("surfaces", "surfaces", "EMap and others through the same ground points", "surfaces"),
    *(_growth(size) for size in ("1M", "4M", "10M", "20M", "100M")),
    Row(
        "growth-time",
        "growth",
        "wall time per point, 100 M to 10 M",
        "derived",
        reach="units_ratio",
        limit=1.1,
        of="growth-100M growth-10M",
    ),
    Row(
        "growth-memory",
        "growth",
        "peak memory, 100 M to 10 M",
        "derived",
        reach="peak_ratio",
        limit=1.1,
        of="growth-100M growth-10M",
    ),
    Row(
        "growth-ceiling",
        "growth",
        "peak memory, 100 M, MiB",
        "derived",
        reach="peak_mib",
        limit=1024.0,
        of="growth-100M",
    ),
)


def chosen(patterns: Sequence[str]) -> tuple[Row, ...]:
    """
    Return the rows that names or groups match, with the rows that these are compared with.

    Parameters
    ----------
    patterns : sequence of str
        With ``*`` and ``?``; all rows when empty.

    Raises
    ------
    ValueError
        A pattern that matches nothing.

    Examples
    --------
    >>> [row.name for row in chosen(["occupancy"])]
    ['decode', 'occupancy']
    """
    wanted: set[str] = set()
    for pattern in patterns or ["*"]:
        found = {
            row.name
            for row in ROWS
            if fnmatch.fnmatch(row.name, pattern) or fnmatch.fnmatch(row.group, pattern)
        }
        if not found:
            raise ValueError(f"no row or group is called {pattern}")
        wanted |= found
    for row in reversed(ROWS):
        if row.name in wanted:
            wanted |= {row.floor, *row.of.split()} - {""}
    for row in ROWS:  # floors of what was just added
        if row.name in wanted and row.floor:
            wanted.add(row.floor)
    return tuple(row for row in ROWS if row.name in wanted)
