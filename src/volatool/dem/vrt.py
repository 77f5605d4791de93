"""A mosaic of elevation models: a GDAL virtual raster (VRT) that names the files, copying nothing.

Only models whose cells mesh are taken: same cell, same lattice, same CRS. Where files overlap the
later one wins unless it is void there, as in ``gdalbuildvrt``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from volatool.dem.raster import read_profile
from volatool.errors import FormatError

_TYPES = {"uint8": "Byte", "uint16": "UInt16", "uint32": "UInt32", "int16": "Int16",
          "int32": "Int32", "float32": "Float32", "float64": "Float64"}  # fmt: skip
_SLACK = 1e-3
"""Of a cell: how far corners may be off the common lattice (GeoTIFF stores doubles)."""


@dataclass(frozen=True, slots=True)
class _Raster:
    """A file and where it lies on the common lattice."""

    path: Path
    profile: dict[str, Any]

    @property
    def left(self) -> float:
        return float(self.profile["bounds"][0])

    @property
    def top(self) -> float:
        return float(self.profile["bounds"][3])


def mosaic(
    paths: Sequence[Path],
    tags: Mapping[str, str] | None = None,
    band_tags: Mapping[str, str] | None = None,
) -> bytes:
    """
    Return the VRT of rasters that stand in one folder, to be written into it.

    Parameters
    ----------
    paths : sequence of pathlib.Path
        One-band rasters, at least one, in the order in which they lie on each other.
    tags, band_tags : mapping of str to str, optional
        Metadata of the data set and of its band.

    Returns
    -------
    vrt : bytes
        XML. Names are relative.

    Raises
    ------
    FormatError
        ``E_GRID``: they are not on one grid: cell, lattice, CRS, unit, type or nodata differ. The
        two files are named.
    InputNotFoundError
        One is not there.
    """
    rasters = [_Raster(path, read_profile(path)) for path in paths]
    first = rasters[0]
    for other in rasters[1:]:
        _refuse_mismatch(first, other)
    cell = float(first.profile["cell"])
    left = min(raster.left for raster in rasters)
    top = max(raster.top for raster in rasters)
    places = [
        (round((raster.left - left) / cell), round((top - raster.top) / cell)) for raster in rasters
    ]
    sizes = [(raster.profile["width"], raster.profile["height"]) for raster in rasters]
    width = max(col + size[0] for (col, _), size in zip(places, sizes, strict=True))
    height = max(row + size[1] for (_, row), size in zip(places, sizes, strict=True))

    root = ElementTree.Element(
        "VRTDataset", {"rasterXSize": str(width), "rasterYSize": str(height)}
    )
    if first.profile["crs_wkt2"]:
        _text(root, "SRS", first.profile["crs_wkt2"], dataAxisToSRSAxisMapping="1,2")
    _text(root, "GeoTransform", f"{left!r}, {cell!r}, 0.0, {top!r}, 0.0, {-cell!r}")
    area = first.profile["tags"].get("AREA_OR_POINT", "Area")
    _metadata(root, {"AREA_OR_POINT": area, **(tags or {})})
    _band(root, first.profile, rasters, places, band_tags or {})
    ElementTree.indent(root)
    text: bytes = ElementTree.tostring(root, encoding="utf-8", xml_declaration=False)
    return text + b"\n"


def _band(
    root: ElementTree.Element,
    profile: dict[str, Any],
    rasters: Sequence[_Raster],
    places: Sequence[tuple[int, int]],
    tags: Mapping[str, str],
) -> None:
    kind = _TYPES[profile["dtype"]]
    nodata = profile["nodata"]
    band = ElementTree.SubElement(root, "VRTRasterBand", {"dataType": kind, "band": "1"})
    if tags:
        _metadata(band, tags)
    if profile["description"]:
        _text(band, "Description", profile["description"])
    if nodata is not None:
        _text(band, "NoDataValue", f"{nodata!r}")
    if profile["unit"]:
        _text(band, "UnitType", profile["unit"])
    for raster, (col, row) in zip(rasters, places, strict=True):
        size = {
            "xSize": str(raster.profile["width"]),
            "ySize": str(raster.profile["height"]),
        }
        source = ElementTree.SubElement(band, "SimpleSource" if nodata is None else "ComplexSource")
        _text(source, "SourceFilename", raster.path.name, relativeToVRT="1")
        _text(source, "SourceBand", "1")
        ElementTree.SubElement(
            source,
            "SourceProperties",
            {
                "RasterXSize": size["xSize"],
                "RasterYSize": size["ySize"],
                "DataType": kind,
                "BlockXSize": str(raster.profile["block"][1]),
                "BlockYSize": str(raster.profile["block"][0]),
            },
        )
        ElementTree.SubElement(source, "SrcRect", {"xOff": "0", "yOff": "0", **size})
        ElementTree.SubElement(source, "DstRect", {"xOff": str(col), "yOff": str(row), **size})
        if nodata is not None:
            _text(source, "NODATA", f"{nodata!r}")


def _metadata(parent: ElementTree.Element, tags: Mapping[str, str]) -> None:
    metadata = ElementTree.SubElement(parent, "Metadata")
    for key, value in sorted(tags.items()):
        _text(metadata, "MDI", value, key=key)


def _text(
    parent: ElementTree.Element, tag: str, text: str, **attributes: str
) -> ElementTree.Element:
    child = ElementTree.SubElement(parent, tag, attributes)
    child.text = text
    return child


def _refuse_mismatch(first: _Raster, other: _Raster) -> None:
    """Raise if two rasters are not on one grid."""
    one, two = first.profile, other.profile
    pair = f"{first.path} and {other.path}"
    for key, name in (
        ("cell", "cells"),
        ("crs_wkt2", "CRS"),
        ("unit", "units of height"),
        ("dtype", "types"),
        ("nodata", "nodata values"),
    ):
        if one[key] != two[key]:
            shown = "" if key == "crs_wkt2" else f" ({one[key]} and {two[key]})"
            raise FormatError(
                f"{pair}: their {name} differ{shown}; make the models of a set with the same "
                "--cell, --crs and --surface (or --params-from)",
                "E_GRID",
            )
    for distance in (other.left - first.left, other.top - first.top):
        cells = distance / one["cell"]
        if abs(cells - round(cells)) > _SLACK:
            raise FormatError(
                f"{pair}: their cells lie {abs(cells - round(cells)):.3g} of a cell beside each "
                "other; --like gives several models one grid",
                "E_GRID",
            )
