"""Whether the files of one tile agree: dense with sparse, the report with volumes and models."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from volatool._version import __version__
from volatool.encodings import DENSE_LIMIT_BYTES, Encoding, encodings_of, written_bytes
from volatool.errors import FormatError
from volatool.formats import dense, sparse
from volatool.formats.header import HEADER_BYTES, Header
from volatool.formats.registry import FileInfo, open_volume, opened, read_info
from volatool.formats.stream import SIZE_LIMIT
from volatool.model import U64
from volatool.occupancy.levels import level_rows
from volatool.problems import MISMATCH, Problem
from volatool.vola.strips import level_strips
from volatool.vola.volume import Volume


@dataclass(frozen=True, slots=True)
class TileFiles:
    """
    The sound files of one tile.

    Parameters
    ----------
    volumes : tuple of pathlib.Path
        VOLA files.
    models : tuple of pathlib.Path
        Elevation models and their layers.
    report : pathlib.Path or None
        The report.
    """

    volumes: tuple[Path, ...] = ()
    models: tuple[Path, ...] = ()
    report: Path | None = None


def disagreements(
    files: TileFiles, *, complete: bool = False, size_limit: int = SIZE_LIMIT
) -> Iterator[tuple[Path, Problem]]:
    """
    Hold the files of one tile against each other.

    Parameters
    ----------
    files : TileFiles
        Each is sound by itself.
    complete : bool
        Also require the files that the report names.
    size_limit : int
        As in `open_volume`.

    Yields
    ------
    path, problem : pathlib.Path, Problem
        Which file is to blame, as far as that can be told, and ``E_MISMATCH``.
    """
    document = None
    if files.report is not None:
        document = json.loads(files.report.read_text(encoding="utf-8"))
        if complete:
            yield from _missing(files.report, document)
    opened_volumes = [(path, read_info(path, size_limit=size_limit)) for path in files.volumes]
    sparse_ones = [(path, info) for path, info in opened_volumes if info.header.mode == 0]
    dense_ones = [(path, info) for path, info in opened_volumes if info.header.mode == 1]
    for path, info in sparse_ones or dense_ones:
        volume = open_volume(path, size_limit=size_limit)
        for other, other_info in dense_ones if sparse_ones else []:
            name = path.name
            problems = _dense_problems(volume, name, info, other, other_info, size_limit)
            yield from ((other, problem) for problem in problems)
        if document is not None and files.report is not None:
            yield from _told(files.report, _volume_claims(document, path, info, volume))
    if document is not None and files.report is not None:
        for path, info in dense_ones if sparse_ones else []:  # its cells are the sparse file's
            yield from _told(files.report, _file_claims(document, path, info))
        for path in files.models:
            yield from _told(files.report, _model_claims(document, path))


def _told(report: Path, problems: Iterator[str]) -> Iterator[tuple[Path, Problem]]:
    for message in problems:
        yield report, Problem(MISMATCH, f"{report}: {message}")


def _missing(report: Path, document: Mapping[str, Any]) -> Iterator[tuple[Path, Problem]]:
    model = document["dem"] or {}
    names = [row["path"] for row in document["encodings"]]
    names += [model.get("path"), *(model.get("layers") or {}).values()]
    for name in names:
        # a name only: a crafted report must not make us look elsewhere
        if name is not None and not (report.parent / Path(name).name).is_file():
            yield report, Problem(MISMATCH, f"{report}: names {name}, which is not beside it")


# ------------------------------------------------------------------------------- dense, sparse


def _dense_problems(
    volume: Volume, name: str, info: FileInfo, path: Path, other: FileInfo, size_limit: int
) -> Iterator[Problem]:
    """Compare a sparse volume and a dense file, word by word of the latter."""
    for field, offset in (("depth", 7), ("nbits", 8), ("crs", 12), ("box", 32)):
        ours, theirs = getattr(info.header, field), getattr(other.header, field)
        if ours != theirs:
            message = f"{path}: {field} is {theirs}, that of {name} is {ours} (offset {offset})"
            yield Problem(MISMATCH, message, offset)
            return
    with opened(path, size_limit) as (_, source):
        header = Header.from_bytes(source.read(HEADER_BYTES))
        levels = dense.read_strips(source, header)
    # the toolkit gives a strip the word of one voxel, which its sparse file does not have
    with_metadata = volume.has_metadata and volume.info.quantizer == "floor"
    for level, found in enumerate(levels, 1):
        expected = level_strips(volume, level)
        pairs = [("occupancy", found.words, expected.words, False)]
        if with_metadata and found.metadata is not None and expected.metadata is not None:
            pairs.append(("metadata", found.metadata, sparse.nonzero(expected.metadata), True))
        for what, ours, theirs, is_metadata in pairs:
            number = _first_difference(found.numbers, ours, expected.numbers, theirs)
            if number is not None:
                offset = _offset(header, level, number, is_metadata)
                yield Problem(
                    MISMATCH,
                    f"{path}: {what} word {number} of level {level} is not what {name} says "
                    f"(offset {offset})",
                    offset,
                )
                return
    if info.trailer is not None and other.trailer is not None:
        keys = sorted({*info.trailer, *other.trailer} - {"blocks", "generator"})
        differing = [key for key in keys if info.trailer.get(key) != other.trailer.get(key)]
        if differing:
            where = dense.dense_bytes(header.depth, bool(header.nbits))
            yield Problem(
                MISMATCH,
                f"{path}: the trailer differs from that of {name}: {', '.join(differing)} "
                f"(offset {where})",
                where,
            )


def _first_difference(numbers: U64, words: U64, numbers2: U64, words2: U64) -> int | None:
    """Return the first word that two levels, kept without their empty words, don't share."""
    n = min(len(numbers), len(numbers2))
    differs = np.flatnonzero((numbers[:n] != numbers2[:n]) | (words[:n] != words2[:n]))
    if len(differs):
        return int(min(numbers[differs[0]], numbers2[differs[0]]))
    longer = numbers if len(numbers) > n else numbers2
    return int(longer[n]) if len(longer) > n else None


def _offset(header: Header, level: int, number: int, is_metadata: bool) -> int:
    """Return where a word of a dense file is."""
    above = dense.dense_bytes(level - 1, bool(header.nbits)) if level > 1 else HEADER_BYTES
    return above + 8 * (number + (64 ** (level - 1) if is_metadata else 0))


# -------------------------------------------------------------------------------------- report


def _is_sum(document: Mapping[str, Any]) -> bool:
    """Whether a report tells of several volumes (``--split``, a summary)."""
    return "tiles" in document or "cubes" in (document["cube"] or {})


def _file_claims(document: Mapping[str, Any], path: Path, info: FileInfo) -> Iterator[str]:
    """Compare what the report says of a file with its header and size."""
    named = [row for row in document["encodings"] if row["path"] == path.name]
    if not named:
        if not _is_sum(document):
            yield f"does not name {path.name}"
        return
    (row, *_) = named
    is_dense = bool(info.header.mode)
    facts = {
        "kind": "dense" if is_dense else "sparse",
        "bits_per_voxel": 1 + info.header.nbits,
        "codec": "gzip" if info.is_gzip else "none",
        "file_bytes": info.size_stored,
        "header_bytes": HEADER_BYTES,
    }
    if is_dense:
        size = dense.dense_bytes(info.header.depth, bool(info.header.nbits))
        facts["payload_bytes"] = size - HEADER_BYTES
    for key, value in facts.items():
        if row[key] != value:
            yield f"{key} of {path.name} is {row[key]!r}, the file's is {value!r}"
    depth = (document["choice"] or {}).get("depth")
    if depth != info.header.depth:
        yield f"choice.depth is {depth}, {path.name} has {info.header.depth} levels"


def _volume_claims(
    document: Mapping[str, Any], path: Path, info: FileInfo, volume: Volume
) -> Iterator[str]:
    """Compare what the report says with a volume, level by level."""
    yield from _file_claims(document, path, info)
    if _is_sum(document):
        return
    yield from _level_claims(document, path, volume)
    yield from _encoding_claims(document, path, volume)
    cube = document["cube"] or {}
    told: dict[str, Any] = {
        "origin": list(volume.cube.origin),
        "side": volume.cube.side,
        "snapped": volume.cube.is_snapped,
        "z_scale": float(volume.crs.z_ratio),
    }
    if info.trailer is None:  # the box's numbers only, no unit
        told = {"origin": told["origin"]}
    for key, value in told.items():
        if not _same(cube.get(key), value):
            yield f"cube.{key} is {cube.get(key)!r}, that of {path.name} is {value!r}"
    source = document["input"] or {}
    facts = {"points_used": volume.info.n_points}
    for key, value in facts.items():
        if value is not None and source.get(key) != value:
            yield f"input.{key} is {source.get(key)!r}, {path.name} says {value!r}"
    if info.trailer is not None and source.get("crs") is not None:
        differing = [
            key
            for key, value in volume.crs.to_dict().items()
            if key != "source" and source["crs"].get(key) != value
        ]
        if differing:
            yield f"input.crs is not that of {path.name}: {', '.join(differing)} differ"


def _level_claims(document: Mapping[str, Any], path: Path, volume: Volume) -> Iterator[str]:
    """Compare all columns of the level table, worked out again."""
    levels = {row["level"]: row for row in document["levels"]}
    rows = level_rows(volume.counts(), volume.cube.exact[3], volume.info.n_points)
    for row in rows:
        told = levels.get(row.level)
        if told is None:
            yield f"level {row.level} of {path.name} is not in the table"
            continue
        for key, value in row.to_dict().items():
            if value is None or _same(told.get(key), value):
                continue
            if isinstance(value, list):
                yield f"level {row.level}: {key} is not that of {path.name}"
            else:
                yield (
                    f"level {row.level}: {key} is {told.get(key)!r}, that of {path.name} is "
                    f"{value!r}"
                )


def _encoding_claims(document: Mapping[str, Any], path: Path, volume: Volume) -> Iterator[str]:
    """
    Compare the sizes of the encodings, also of those that were not written.

    What gzip makes of them depends on the zlib of the machine, and what the trailer takes on the
    version of volatool: those sizes are compared only where they must be the same.
    """
    rows = {
        (row["kind"], row["bits_per_voxel"], row["codec"]): row for row in document["encodings"]
    }
    is_ours = volume.info.generator == f"volatool {__version__}"
    for encoding in encodings_of(volume):
        row = rows.get((encoding.kind, encoding.bits_per_voxel, encoding.codec))
        if row is None:
            continue
        name = f"{encoding.kind}, {encoding.bits_per_voxel} bit, {encoding.codec}"
        payload = encoding.payload_bytes(volume)
        if row["payload_bytes"] != payload:
            yield f"payload_bytes ({name}) is {row['payload_bytes']}, {path.name} makes {payload}"
        elif is_ours and row["path"] is None and _is_cheap(encoding, payload):
            size = written_bytes(volume, encoding)
            if row["measured"] and row["file_bytes"] != size:
                yield f"file_bytes ({name}) is {row['file_bytes']}, {path.name} makes {size}"


def _is_cheap(encoding: Encoding, payload: int) -> bool:
    return encoding.codec == "none" and payload <= DENSE_LIMIT_BYTES


def _model_claims(document: Mapping[str, Any], path: Path) -> Iterator[str]:
    """Compare what the report says of the elevation model with its cells."""
    from volatool.dem.recheck import flag_counts, raster_facts

    model = document["dem"]
    if model is None:
        yield f"tells of no elevation model, but there is {path.name}"
        return
    layers = model.get("layers") or {}
    if path.name not in (model["path"], *layers.values()):
        yield f"does not name {path.name}"
        return
    facts = raster_facts(path)
    told: dict[str, Any] = {"width": facts.width, "height": facts.height, "cell": facts.cell}
    if path.name == model["path"]:
        told |= {
            "nodata": facts.nodata,
            "cells_void": facts.n_void,
            "z_min": facts.low,
            "z_max": facts.high,
        }
        total = sum(model[f"cells_{what}"] for what in ("measured", "filled", "void"))
        if total != facts.width * facts.height:
            yield (
                f"cells_measured + cells_filled + cells_void is {total}, {path.name} has "
                f"{facts.width * facts.height} cells"
            )
    elif path.name == layers.get("flag"):
        try:
            counts = flag_counts(path)
        except FormatError as error:
            yield str(error)
            return
        told |= {"cells_void": counts[0], "cells_measured": counts[1], "cells_filled": counts[2]}
    for key, value in told.items():
        if not _same(model.get(key), value):
            yield f"dem.{key} is {model.get(key)!r}, that of {path.name} is {value!r}"


def _same(told: Any, found: Any) -> bool:
    """Whether two values of a report agree; floats to the last digits of another machine's sum."""
    if isinstance(found, list):
        return (
            isinstance(told, list)
            and len(told) == len(found)
            and all(_same(a, b) for a, b in zip(told, found, strict=True))
        )
    if isinstance(found, float) and isinstance(told, int | float):
        try:
            return math.isclose(told, found, rel_tol=1e-12, abs_tol=1e-12)
        except OverflowError:  # JSON has whole numbers that no float has
            return False
    return bool(told == found)
