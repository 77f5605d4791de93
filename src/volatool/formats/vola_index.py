"""The ``.vola`` index of a data set: JSON that the original toolkit's viewer opens.

The original writes names as they were on its command line, files in the folder's order, Infinity
for a place that has none, and depth, nbits, crs and mode of the last file as if all were equal.
Here names are relative to the index and sorted, what is not finite is null, and the four stand at
the top only when all files agree. Its viewer opens ``files[i]["filename"]`` from the folder it is
started in: start it in the index's folder.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from volatool.errors import FormatError, InputNotFoundError
from volatool.formats.header import Header

SUFFIX = ".vola"
MAX_BYTES = 1 << 28
"""A longer index is refused; a file's entry takes about 500 bytes."""

_TEXTS = ("dataset", "info", "url", "author", "authorurl", "license", "licenseurl")
_Box = tuple[float, float, float, float, float, float]


def entry(filename: str, header: Header, points_box: _Box | None) -> dict[str, Any]:
    """
    Return what the index says of one file.

    Parameters
    ----------
    filename : str
        Relative to the index, with ``/``.
    header : Header
        Its header.
    points_box : tuple of 6 float or None
        Tight box of the points (z in the vertical unit), if the file tells it; the header's box is
        the cube for files of ours.
    """
    lat, lon = header.place
    return {
        "filename": filename,
        **_extent(header.box),
        "crs": header.crs,
        "lat": lat,
        "lon": lon,
        "depth": header.depth,
        "nbits": header.nbits,
        "points_bbox": None if points_box is None else list(points_box),
    }


def document(texts: Mapping[str, str], entries: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """
    Return the index.

    Parameters
    ----------
    texts : mapping of str to str
        ``dataset, info, url, author, authorurl, license, licenseurl``.
    entries : sequence of mappings
        At least one, as `entry` makes them, sorted by name.

    Returns
    -------
    index : dict
        The box of all files is there only if they are in one CRS.
    """
    content: dict[str, Any] = {name: texts[name] for name in _TEXTS}
    common = {key: {one[key] for one in entries} for key in ("depth", "nbits", "crs")}
    content |= {key: values.pop() for key, values in common.items() if len(values) == 1}
    content["mode"] = 0  # only sparse files are listed
    if "crs" in content:
        boxes = [one["bbox"] for one in entries]
        lows = [min(box[axis] for box in boxes) for axis in range(3)]
        highs = [max(box[3 + axis] for box in boxes) for axis in range(3)]
        content |= _extent((*lows, *highs))
    content["files"] = list(entries)
    return content


def _extent(box: _Box) -> dict[str, list[float]]:
    low, high = box[:3], box[3:]
    return {
        "bbox": list(box),
        "centroid": [(a + b) / 2 for a, b in zip(low, high, strict=True)],
        "sides": [b - a for a, b in zip(low, high, strict=True)],
    }


@dataclass(frozen=True, slots=True)
class IndexedFile:
    """
    One file that an index names.

    Parameters
    ----------
    filename : str
        As the index has it.
    path : pathlib.Path or None
        Where it was found: relative to the index, else as named (the original toolkit's names are
        those of its command line); None if it is in neither place.
    content : dict
        The entry.
    """

    filename: str
    path: Path | None
    content: dict[str, Any]


@dataclass(frozen=True, slots=True)
class VolaIndex:
    """
    A data set's index as read.

    Parameters
    ----------
    path : pathlib.Path
        The file.
    content : dict
        All but the entries.
    files : tuple of IndexedFile
        In the order of the index.
    """

    path: Path
    content: dict[str, Any]
    files: tuple[IndexedFile, ...]


def read_index(path: Path) -> VolaIndex:
    """
    Read an index of ours or of the original toolkit.

    Parameters
    ----------
    path : pathlib.Path
        A ``.vola`` file.

    Raises
    ------
    InputNotFoundError, FormatError
        ``E_NOT_FOUND``; ``E_NOT_INDEX``: not such a file.
    """

    def refuse(why: str) -> FormatError:
        return FormatError(f"{path}: {why}", "E_NOT_INDEX")

    try:
        with path.open("rb") as stream:
            data = stream.read(MAX_BYTES + 1)
    except FileNotFoundError as error:
        raise InputNotFoundError(f"{path}: no such file") from error
    except OSError as error:
        raise refuse(f"can't be read ({error.strerror})") from error
    if len(data) > MAX_BYTES:
        raise refuse(f"is longer than {MAX_BYTES} bytes")
    try:
        # the original writes Infinity and NaN, which are not JSON
        content = json.loads(data, parse_constant=lambda name: None)
    except (ValueError, RecursionError) as error:
        raise refuse(f"is not a .vola index: {error}") from error
    entries = content.pop("files", None) if isinstance(content, dict) else None
    if not isinstance(entries, list):
        raise refuse('is not a .vola index: it has no list "files"')
    files = []
    for number, one in enumerate(entries, 1):
        name = one.get("filename") if isinstance(one, dict) else None
        if not isinstance(name, str) or not name or "\0" in name:
            raise refuse(f"entry {number} of its files has no file name")
        files.append(IndexedFile(name, _found(path, name), one))
    return VolaIndex(path, content, tuple(files))


def _found(index: Path, name: str) -> Path | None:
    for candidate in (index.parent / name, Path(name)):
        try:
            if candidate.is_file():
                return candidate
        except OSError:  # a name too long
            continue
    return None
