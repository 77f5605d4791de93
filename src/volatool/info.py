"""What headers and trailers say, without reading the body of a file."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, BinaryIO

from volatool.errors import FormatError, InputError, InputNotFoundError
from volatool.remote.path import is_url
from volatool.units import format_size


def describe(path: Path) -> dict[str, Any]:
    """
    Return what a file says of itself.

    Parameters
    ----------
    path : pathlib.Path
        LAS, LAZ, COPC, VOLA (gzip or not), an elevation model, or a ``.vola`` index; told by
        content.

    Returns
    -------
    facts : dict
        ``kind`` ("points", "volume", "dem", "index"), ``name``, ``bytes`` and what the kind has.

    Raises
    ------
    InputNotFoundError, FormatError
        The file is not there, or none of these.
    """
    try:
        if not is_url(path) and path.exists() and not path.is_file():
            raise FormatError(f"{path}: is not a regular file", "E_INPUT")
        with path.open("rb") as stream:
            head = stream.read(8)
            facts: dict[str, Any] = {"name": path.name, "bytes": stream.seek(0, os.SEEK_END)}
            stream.seek(0)
            # a remote file is opened once: what was fetched of it serves again
            return {**facts, **_told(path, head, stream if is_url(path) else path)}
    except InputError:
        raise
    except FileNotFoundError as error:
        raise InputNotFoundError(f"{path}: no such file") from error
    except OSError as error:
        raise FormatError(f"{path}: can't be read ({error.strerror})", "E_INPUT") from error


def _told(path: Path, head: bytes, source: Path | BinaryIO) -> dict[str, Any]:
    """Return the kind, told by the first bytes, and what the kind has."""
    if head.startswith(b"LASF"):
        return {"kind": "points", **_points(source)}
    if head[:4] in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"):
        return {"kind": "dem", **_dem(path)}
    if path.suffix.lower() == ".vola" or head.lstrip()[:1] == b"{":
        return {"kind": "index", **_index(path)}
    return {"kind": "volume", **_volume(source)}


def _points(source: Path | BinaryIO) -> dict[str, Any]:
    from volatool.points.reader import open_points

    with open_points(source, salvage=True) as points:
        header = points.header
        return {
            "las_version": header.version,
            "point_format": header.point_format,
            "compressed": header.is_compressed,
            "copc": header.is_copc,
            "points": header.n_points,
            "record_bytes": header.record_bytes,
            "las_equivalent_bytes": header.las_equivalent_bytes,
            "scale": list(header.scale),
            "offset": list(header.offset),
            "bbox": list(header.box),
            "attributes": sorted(header.dimensions),
            "crs": points.crs.to_dict(),
            "warnings": [warning.to_dict() for warning in points.warnings],
        }


def _volume(source: Path | BinaryIO) -> dict[str, Any]:
    from volatool.formats.registry import read_info

    found = read_info(source)
    header, info = found.header, found.info
    return {
        "mode": "dense" if header.mode else "sparse",
        "gzip": found.is_gzip,
        "depth": header.depth,
        "bits_per_voxel": 1 + header.nbits,
        "cell": found.cube.cell(header.depth),
        "cube": {"origin": list(found.cube.origin), "side": found.cube.side},
        "epsg": header.epsg,
        "crs": info.crs.to_dict(),
        "points": info.n_points,
        "bbox": None if info.box is None else list(info.box),
        "channels": [dict(channel) for channel in info.channels],
        "quantizer": info.quantizer,
        "source": info.source_name,
        "generator": info.generator,
        "has_trailer": found.trailer is not None,
        "blocks": None if found.trailer is None else found.trailer.get("blocks"),
    }


def _dem(path: Path) -> dict[str, Any]:
    from volatool.dem.raster import read_profile

    return read_profile(path)


def _index(path: Path) -> dict[str, Any]:
    from volatool.formats.vola_index import read_index

    index = read_index(path)
    return {
        **index.content,
        "files": len(index.files),
        "missing": [one.filename for one in index.files if one.path is None],
        "depths": sorted({one.content["depth"] for one in index.files if "depth" in one.content}),
    }


def describe_text(facts: dict[str, Any]) -> str:
    """
    Return the facts for people, one a line.

    Parameters
    ----------
    facts : dict
        As `describe` returns them.
    """
    lines = [f"{facts['name']} ({facts['kind']}, {format_size(facts['bytes'])})"]
    for key, value in facts.items():
        if key in ("name", "kind", "bytes"):
            continue
        if key == "crs" and isinstance(value, dict):
            lines += _crs_lines(value)
        elif key == "warnings":
            lines += [f"  {warning['code']}: {warning['message']}" for warning in value]
        elif key == "channels":
            lines.append(f"  {key}: {', '.join(str(channel['name']) for channel in value) or '-'}")
        else:
            lines.append(f"  {key.replace('_', ' ')}: {_text(value)}")
    return "\n".join(lines)


def _crs_lines(crs: dict[str, Any]) -> list[str]:
    if crs["horizontal"] is None and crs["wkt2"] is None:
        return ["  crs: none"]
    vertical = f" + {crs['vertical']}" if crs["vertical"] else ""
    return [
        f"  crs: {crs['horizontal']}{vertical} (from {crs['source']})",
        f"  units: {crs['unit_xy'] or 'unknown'}, vertical {crs['unit_z'] or 'unknown'}",
    ]


def _text(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, list):
        return ", ".join(_text(item) for item in value)
    if isinstance(value, dict):
        return ", ".join(f"{key} {_text(item)}" for key, item in value.items())
    if isinstance(value, float):
        return f"{value:.12g}"
    return str(value)
