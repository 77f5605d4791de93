"""STAC 1.1 items and a collection for a folder of volumes [STAC]_.

Extensions: pointcloud 1.0 (what the volume was made of), projection 2.0 (CRS, box), file 2.1
(sizes). What no extension has a name for is prefixed ``vola:``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from volatool.catalog.attribution import Attribution
from volatool.catalog.footprint import Footprint, footprint
from volatool.catalog.tiles import Tile
from volatool.errors import CodedWarning, OptionError
from volatool.points.crs import known_wkt

VERSION = "1.1.0"
ITEM_SUFFIX = ".stac.json"
COLLECTION = "collection.json"

_SCHEMAS = "https://stac-extensions.github.io"
EXTENSIONS = (
    f"{_SCHEMAS}/pointcloud/v1.0.0/schema.json",
    f"{_SCHEMAS}/projection/v2.0.0/schema.json",
    f"{_SCHEMAS}/file/v2.1.0/schema.json",
)
_ASSETS = {
    "dense": ("VOLA volume, dense", "application/octet-stream", "data"),
    "dem": (
        "Elevation model",
        "image/tiff; application=geotiff; profile=cloud-optimized",
        "data",
    ),
    "report": ("Report of the conversion", "application/json", "metadata"),
    "preview": ("Preview", "image/png", "thumbnail"),
}


@dataclass(frozen=True, slots=True)
class Period:
    """
    When the points were measured.

    Parameters
    ----------
    start, end : datetime
        In UTC; the same for a single moment.
    """

    start: datetime
    end: datetime

    @classmethod
    def parse(cls, text: str) -> Period:
        """
        Return the period of a date or time, or of two with a slash between them.

        Parameters
        ----------
        text : str
            ISO 8601: ``"2019-05-01"``, ``"2019-05-01T10:30:00Z"``, ``"2019-05-01/2019-06-30"``.
            Without a zone UTC is meant; a date alone as the end is the end of that day.

        Raises
        ------
        OptionError
            It is not that.
        """
        parts = text.split("/")
        try:
            times = [_moment(part, is_end=place == 1) for place, part in enumerate(parts)]
        except ValueError as error:
            raise OptionError(
                f"{text!r} is not a date such as 2019-05-01, or two with a slash between"
            ) from error
        if len(times) > 2 or times[0] > times[-1]:
            raise OptionError(f"{text!r}: give START/END, the earlier first")
        return cls(times[0], times[-1])

    def to_properties(self) -> dict[str, str | None]:
        """Return what an item says of it."""
        if self.start == self.end:
            return {"datetime": _text(self.start)}
        return {
            "datetime": None,
            "start_datetime": _text(self.start),
            "end_datetime": _text(self.end),
        }


def _moment(text: str, is_end: bool) -> datetime:
    text = text.strip()
    if is_end and len(text) == 10:
        text += "T23:59:59"
    moment = datetime.fromisoformat(text)
    return moment.replace(tzinfo=UTC) if moment.tzinfo is None else moment.astimezone(UTC)


def _text(moment: datetime) -> str:
    return moment.isoformat().replace("+00:00", "Z")


def item(
    tile: Tile,
    period: Period,
    collection: str,
    density: float | None = None,
) -> tuple[dict[str, Any], list[CodedWarning]]:
    """
    Return the item of a tile, to be written beside it.

    Parameters
    ----------
    tile : Tile
        The volume and what stands beside it.
    period : Period
        When it was measured.
    collection : str
        Name of its collection.
    density : float, optional
        Points per square unit of the CRS.

    Returns
    -------
    item : dict
        Without geometry if the place is unknown.
    warnings : list of CodedWarning
        ``W_STAC_PLACE``.
    """
    info = tile.facts.info
    place = footprint(info.crs, tile.bounds)
    warnings = []
    content: dict[str, Any] = {
        "type": "Feature",
        "stac_version": VERSION,
        "stac_extensions": list(EXTENSIONS),
        "id": tile.name,
        "collection": collection,
        "geometry": None,
        "properties": {
            **period.to_properties(),
            **_pointcloud(tile, density),
            **_projection(tile),
            **_vola(tile),
        },
        "links": [
            {"rel": "root", "href": f"./{COLLECTION}", "type": "application/json"},
            {"rel": "collection", "href": f"./{COLLECTION}", "type": "application/json"},
            {"rel": "parent", "href": f"./{COLLECTION}", "type": "application/json"},
        ],
        "assets": _assets(tile),
    }
    if place is None:
        warnings.append(
            CodedWarning(
                "W_STAC_PLACE",
                f"{tile.path.name}: has no CRS that leads to longitude and latitude; its STAC item "
                "has no geometry",
            )
        )
    else:
        content |= {"geometry": place.geometry, "bbox": list(place.bbox)}
        content["properties"]["proj:centroid"] = _centroid(place)
    return content, warnings


def _pointcloud(tile: Tile, density: float | None) -> dict[str, Any]:
    info = tile.facts.info
    box, channels = tile.box, sorted(info.channels, key=lambda channel: channel["byte"])
    content: dict[str, Any] = {
        "pc:type": "lidar",
        "pc:encoding": "VOLA",
        "pc:schemas": [
            *({"name": name, "size": 8, "type": "floating"} for name in "XYZ"),
            *({"name": one["name"], "size": 1, "type": "unsigned"} for one in channels),
        ],
        "pc:statistics": [
            {
                "name": name,
                "position": axis,
                "minimum": box[axis],
                "maximum": box[3 + axis],
            }
            for axis, name in enumerate("XYZ")
        ],
    }
    content["pc:count"] = tile.n_voxels if info.n_points is None else info.n_points
    if density is not None:
        content["pc:density"] = density
    return content


def _projection(tile: Tile) -> dict[str, Any]:
    crs, bounds = tile.facts.info.crs, tile.bounds
    ring = [
        [bounds.left, bounds.bottom],
        [bounds.right, bounds.bottom],
        [bounds.right, bounds.top],
        [bounds.left, bounds.top],
        [bounds.left, bounds.bottom],
    ]
    return {
        "proj:code": None if crs.epsg is None else f"EPSG:{crs.epsg}",
        "proj:wkt2": known_wkt(crs),
        "proj:bbox": list(tile.box),
        "proj:geometry": {"type": "Polygon", "coordinates": [ring]},
    }


def _centroid(place: Footprint) -> dict[str, float]:
    west, south, east, north = place.bbox
    lon = (west + east) / 2 if west <= east else ((west + east + 360) / 2 + 180) % 360 - 180
    return {"lat": (south + north) / 2, "lon": lon}


def _vola(tile: Tile) -> dict[str, Any]:
    header, cube = tile.header, tile.facts.cube
    return {
        "vola:depth": header.depth,
        "vola:cell": cube.cell(header.depth),
        "vola:cube": {"origin": list(cube.origin), "side": cube.side},
        "vola:bits_per_voxel": 1 + header.nbits,
        "vola:voxels": tile.n_voxels,
        "vola:quantizer": tile.facts.info.quantizer,
    }


def _assets(tile: Tile) -> dict[str, Any]:
    gzipped = tile.facts.is_gzip
    assets = {
        "volume": _asset(
            tile.path,
            "VOLA volume" + (", gzip" if gzipped else ""),
            "application/gzip" if gzipped else "application/octet-stream",
            "data",
        )
    }
    for kind, path in tile.beside.items():
        title, media, role = _ASSETS[kind]
        if path.suffix == ".gz":
            title, media = f"{title}, gzip", "application/gzip"
        assets[kind] = _asset(path, title, media, role)
    return assets


def _asset(path: Path, title: str, media: str, role: str) -> dict[str, Any]:
    return {
        "href": f"./{path.name}",
        "title": title,
        "type": media,
        "roles": [role],
        "file:size": path.stat().st_size,
    }


def collection(
    attribution: Attribution, items: Sequence[Mapping[str, Any]], period: Period
) -> dict[str, Any]:
    """
    Return the collection of items, to be written beside them.

    Parameters
    ----------
    attribution : Attribution
        Name, description, provider and licence.
    items : sequence of mappings
        As `item` made them.
    period : Period
        Of all of them.
    """
    boxes = [one["bbox"] for one in items if "bbox" in one]
    licence_link = []
    if attribution.licenseurl:
        licence_link = [{"rel": "license", "href": attribution.licenseurl}]
    provider: dict[str, Any] = {"name": attribution.author, "roles": ["producer", "licensor"]}
    if attribution.authorurl:
        provider["url"] = attribution.authorurl
    about = [{"rel": "about", "href": attribution.url}] if attribution.url else []
    ends = [_text(period.start), _text(period.end)]
    return {
        "type": "Collection",
        "stac_version": VERSION,
        "id": attribution.dataset,
        "title": attribution.dataset,
        "description": attribution.info or attribution.dataset,
        "license": _spdx(attribution.license),
        "providers": [provider],
        "extent": {
            "spatial": {"bbox": _extent(boxes)},
            "temporal": {"interval": [ends]},
        },
        "links": [
            {"rel": "root", "href": f"./{COLLECTION}", "type": "application/json"},
            *licence_link,
            *about,
            *(
                {
                    "rel": "item",
                    "href": f"./{one['id']}{ITEM_SUFFIX}",
                    "type": "application/geo+json",
                }
                for one in items
            ),
        ],
    }


def _spdx(licence: str) -> str:
    """Return a licence as STAC takes it: an SPDX identifier, or ``other``."""
    is_identifier = all(c.isascii() and (c.isalnum() or c in ".-+") for c in licence)
    return licence if is_identifier else "other"


def _extent(boxes: Sequence[Sequence[float]]) -> list[list[float]]:
    """Return the box around all; the whole globe when nothing is known, or to be sure."""
    if not boxes:
        return [[-180.0, -90.0, 180.0, 90.0]]
    south, north = min(box[1] for box in boxes), max(box[3] for box in boxes)
    if any(box[0] > box[2] for box in boxes):  # one lies across the antimeridian
        return [[-180.0, south, 180.0, north]]
    return [[min(box[0] for box in boxes), south, max(box[2] for box in boxes), north]]
