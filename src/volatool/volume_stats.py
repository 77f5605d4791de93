"""The report of a VOLA file: the same tables as for the points it was made from."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from volatool.encodings import encoding_row, encodings_of
from volatool.errors import CodedWarning
from volatool.formats.registry import open_volume
from volatool.model import CrsInfo, LevelCounts
from volatool.occupancy.depth import fixed_depth
from volatool.occupancy.levels import level_rows
from volatool.options import ConvertOptions
from volatool.report import Report
from volatool.vola.volume import Volume


def volume_report(path: Path, options: ConvertOptions) -> Report:
    """
    Return the report of a VOLA file.

    Parameters
    ----------
    path : pathlib.Path
        ``.vol``, ``.dvol``, gzip or not.
    options : ConvertOptions
        As in a conversion; only what goes into the report's ``tool``.

    Notes
    -----
    What only the points can tell is null, or known from the file's trailer.
    """
    volume = open_volume(path)
    info = volume.info
    counts: list[LevelCounts] = volume.counts()
    n_points = info.n_points
    return Report(
        status="ok",
        input=volume_input(path, volume, volume.crs),
        cube=volume_cube(volume),
        levels=tuple(row.to_dict() for row in level_rows(counts, volume.cube.side, n_points)),
        choice={
            **fixed_depth(volume.depth, volume.cube, counts).to_dict(),
            "reason": f"the file has {volume.depth} levels",
        },
        encodings=tuple(
            encoding_row(volume, encoding, None, None, None, info.source_bytes)
            for encoding in encodings_of(volume)
        ),
        options=options.given(),
        warnings=(*info.warnings, *_ignored(options)),
    )


def volume_input(path: Path, volume: Volume, crs: CrsInfo) -> dict[str, Any]:
    """Return the report's ``input`` of a VOLA file; what only points can tell is null."""
    info = volume.info
    x, y, z = volume.cube.origin
    far = [value + volume.cube.side for value in (x, y, z / float(volume.crs.z_ratio))]
    return {
        "name": path.name,
        "bytes": path.stat().st_size,
        "las_version": None,
        "point_format": None,
        "compressed": None,
        "las_equivalent_bytes": None,
        "points_header": None,
        "points_read": None,
        "points_used": info.n_points,
        "dropped": {},
        "classes": {},
        "returns": {},
        "bbox": list(info.box) if info.box is not None else [x, y, z, *far],
        "density": {
            "all_per_area_bbox": None,
            "all_per_area_occupied": None,
            "first_per_area_occupied": None,
            "occupied_cell": None,
        },
        "crs": crs.to_dict(),
    }


def volume_cube(volume: Volume) -> dict[str, Any]:
    """Return the report's ``cube`` of a VOLA file."""
    return {
        "origin": list(volume.cube.origin),
        "side": volume.cube.side,
        "unit": volume.crs.unit_xy,
        "snapped": volume.cube.is_snapped,
        "z_scale": float(volume.crs.z_ratio),
    }


def _ignored(options: ConvertOptions) -> list[CodedWarning]:
    """Say which options mean nothing for a volume that is made already."""
    names = ["--" + name.replace("_", "-") for name in options.given()]
    if not names:
        return []
    return [
        CodedWarning(
            "W_OPTIONS_IGNORED",
            f"{', '.join(names)}: of no effect on a volume; give the points it was made from",
        )
    ]
